"""What both models show in a real browser: views, turns, what is under the pointer, and narrow windows."""

import base64
import io

import imageio.v3 as imageio
import numpy as np
import pytest

from cagemap.studio.glb import MeshPart, pack_glb

from browser_page import Page
from running_studio import BESIDE, FLANK, GRIPPED, OTHER, back_to, other

pytestmark = [pytest.mark.slow, pytest.mark.browser]
# Looks at empty space next to both models.
ASIDE = """
for (const {camera, controls} of Object.values(window.studio.views.sides)) {
    controls.target.set(0, 5, 0);
    camera.position.set(0, 5, 1);
    controls.update();
}"""
# How far the messages, the menu and the last row of the panel are inside the window, with eight alignments.
OPENED = """
const [log, more, answers] = ['log', 'more', 'answers'].map(id => document.getElementById(id));
const kept = [...answers.children], hidden = log.hidden, outside = [];
answers.replaceChildren(...Array.from({length: 8}, () => document.createElement('button')));
log.hidden = false;
log.open = more.open = true;
const last = document.getElementById('save-box');
last.scrollIntoView();
for (const one of [log.querySelector('ol'), more.querySelector('.menu'), last]) {
    const {left, right, top, bottom} = one.getBoundingClientRect();
    const end = one === last ? document.querySelector('aside').getBoundingClientRect().bottom : innerHeight;
    outside.push(left, innerWidth - right, top, end - bottom);
}
log.open = more.open = false;
log.hidden = hidden;
answers.replaceChildren(...kept);
return outside"""
# Widths that the half of both models takes in turn, a picture each, while something is waiting to be drawn.
RESIZED = """
const done = arguments[0], {views} = window.studio, box = views.canvas.parentElement;
const widths = ['', ...[1060, 900, 760, 700].map(w => `0 0 ${w}px`)];
const next = () => {
    if (!widths.length) return requestAnimationFrame(() => requestAnimationFrame(done));
    box.style.flex = widths.pop();
    views.changed();
    requestAnimationFrame(next);
};
next();"""
# Which of two marks is gripped at a point of the target: one is there, but on the far side; the other one beside it.
NEAREST = """
const [x, y] = arguments, {views} = window.studio, side = views.sides.target, box = side.pane.getBoundingClientRect();
const event = {clientX: box.left + (x + 1) / 2 * box.width, clientY: box.top + (1 - y) / 2 * box.height};
const behind = views.ray(side, event).intersectObjects(Object.values(side.parts)).at(-1).point;
const before = views.hit(side, views.ray(side, {...event, clientX: event.clientX + 3})).point, kept = side.marks;
side.marks = [behind, before].map((point, number) => ({number: number + 1, at: [...point.toArray(), 0, 0, 0]}));
const found = views.markAt(side, event);
side.marks = kept;
return [found?.number, behind.distanceTo(before)]"""
# Whether a new image of the target leaves the picture of the source, which does not show it.
LEFT = """
const {views} = window.studio, {target, source} = views.sides, before = source.pictureKey, {images} = target;
target.images = {...images, another: views.blank};
views.render();
target.images = images;
views.changed();
return source.pictureKey === before"""
# Draw all pictures anew.
ANEW = """
const {views} = window.studio;
for (const side of Object.values(views.sides)) side.pictureKey = '';
views.changed();"""


def test_views_change_what_is_shown(page: Page) -> None:
    page.keys("f")
    page.drawn()
    first = {side: page.look(side) for side in ("target", "source")}
    seen = first["target"]
    for mode in ("colours", "checker", "plain"):
        page.set("mode", mode)
        page.until(lambda seen=seen: other(page.look("target"), seen), f"{mode} on the target")
        seen = page.look("target")
    page.set("mode", "texture")
    page.until(lambda: not other(page.look("target"), first["target"]), "the texture again")

    # Compared: one look left of a border, another one right of it.
    page.set("other", "plain")
    middle = seen.shape[1] // 2
    for split, halves in ((1.0, [False, False]), (0.0, [True, True]), (0.5, [False, True])):
        page.set("split", split)

        def changed() -> list[bool]:
            now = page.look("target")
            return [other(now[:, half], first["target"][:, half]) for half in (slice(middle), slice(middle, None))]

        page.until(lambda halves=halves: changed() == halves, f"the border at {split}")
    page.set("other", "")
    page.until(lambda: not other(page.look("target"), first["target"]), "one look")

    # The target takes the source's shape; the source lies over it.
    page.set("wrapAmount", 1.0)
    page.until(lambda: other(page.look("target"), first["target"]), "the wrapped target")
    assert np.abs(page.look("target") - page.look("source")).mean() < OTHER
    page.click("target", FLANK)
    page.until(lambda: "Set Wrap back" in page.text("status"), "why no landmark is placed")
    assert not page.state("proposal")
    page.set("wrapAmount", 0.0)
    page.set("overlay", True)
    page.until(lambda: other(page.look("target"), first["target"]), "both over each other")
    page.set("overlay", False)
    page.until(lambda: np.array_equal(page.look("target"), page.look("target")), "a picture that stays")
    still = page.look("target")

    for name in ("cages", "numbers"):
        page.set(name, name == "cages")
        page.until(lambda: np.abs(page.look("target") - still).max() > 30, name)
        page.set(name, name != "cages")
        page.until(lambda: not other(page.look("target"), still), f"no {name}")


def test_the_screen_shows_what_drawing_anew_shows(page: Page) -> None:
    changes = {
        "colours": lambda: page.run("window.studio.views.set({look: 'colours'})"),
        "compared": lambda: page.run("window.studio.views.set({other: 'plain', split: 0.3})"),
        "halfway to the source": lambda: page.run("window.studio.views.set({wrapAmount: 0.5})"),
        "overlaid": lambda: page.run("window.studio.views.set({overlay: true, wrapAmount: 0})"),
        "turned": lambda: page.run("window.studio.views.frame([1, 0, 0])"),
        "resized": lambda: page.browser.execute_async_script(RESIZED),
    }
    page.drawn()
    before = page.run("return {...window.studio.views.shown}")
    for name, change in changes.items():
        change()
        kept = {side: page.look(side) for side in ("target", "source")}
        page.run(ANEW)
        for side, seen in kept.items():
            np.testing.assert_array_equal(page.look(side), seen, err_msg=f"{name}: {side}")
    page.run("window.studio.views.set(arguments[0]); window.studio.views.frame()", before)
    page.look("target")
    assert page.run(LEFT)


def test_a_hidden_landmark_does_not_cover_a_visible_one(page: Page) -> None:
    page.keys("f")
    page.drawn()
    gripped, thickness = page.run(NEAREST, *page.clear_point("target", FLANK))
    assert thickness > 0.1
    assert gripped == 2


def test_the_name_of_a_landmark_is_shown_under_the_pointer_and_the_theme_is_kept(page: Page) -> None:
    page.keys("f")
    named = page.run("return window.studio.state.landmarks.find(one => one.number == 19).name")
    page.hover("target", page.at("target", 19))
    page.until(lambda: page.text("tip") == named, "its name")
    page.hover("target", BESIDE)
    page.until(lambda: page.run("return document.getElementById('tip').hidden"), "no name")
    for theme in ("dark", "light"):
        page.run("document.documentElement.dataset.theme = arguments[0]", "light" if theme == "dark" else "dark")
        page.press("theme")
        assert page.run("return [document.documentElement.dataset.theme, localStorage.theme]") == [theme, theme]


def test_models_are_turned_together_alone_and_by_keys(page: Page) -> None:
    page.keys("f")
    page.drawn()
    first = {side: page.look(side) for side in ("target", "source")}
    page.drag("target", BESIDE, (0.5, -0.93))
    page.until(lambda: other(page.look("source"), first["source"]), "the source turned with the target")
    page.press("frame")
    page.until(lambda: not any(other(page.look(side), first[side]) for side in first), "both as at first")
    page.set("linked", False)
    page.drag("target", BESIDE, (0.5, -0.93))
    page.until(lambda: other(page.look("target"), first["target"]), "the target turned")
    assert not other(page.look("source"), first["source"])
    page.set("linked", True)
    for key in "137":
        before = page.look("source")
        page.keys(key)
        page.until(lambda before=before: other(page.look("source"), before), f"the view of key {key}")
    page.browser.find_element("id", "target").send_keys("\ue012")  # left
    page.keys("f")
    page.until(lambda: not any(other(page.look(side), first[side]) for side in first), "the whole models")


def test_a_chosen_landmark_that_is_hidden_or_outside_the_picture_is_turned_into_view(page: Page) -> None:
    page.set("symmetric", False)
    count, turn = page.landmarks(), "window.studio.views.frame(arguments[0])"
    for script, direction in ((turn, [0.2, 0.1, 1]), (turn, [-0.2, 0.1, -1]), (ASIDE, None)):
        for _ in range(2):  # the second time, the landmark is open already
            page.run(script, direction)
            page.press("next")
            page.until(lambda: page.state("proposal"), "a proposal")
            page.until(lambda: page.run(GRIPPED, "target", page.state("selected")), "the new landmark in view")
        back_to(page, count)
        page.run(script, direction)
        page.select(3)
        page.until(lambda: page.run(GRIPPED, "target", 3), "the landmark of the row in view")
    page.press("frame")
    page.set("symmetric", True)


def test_models_that_do_not_turn_together_are_turned_alone_to_a_chosen_landmark(page: Page) -> None:
    camera = "return window.studio.views.sides.target.camera.position.toArray()"
    page.set("linked", False)
    page.press("frame")
    before = page.run(camera)
    page.run(ASIDE.replace("Object.values(window.studio.views.sides)", "[window.studio.views.sides.source]"))
    number = next(one["number"] for one in page.state("landmarks") if page.run(GRIPPED, "target", one["number"]))
    page.select(number)
    page.until(lambda: page.run(GRIPPED, "source", number), "the landmark of the row in view")
    assert page.run(camera) == before
    page.set("linked", True)
    page.press("frame")


def test_a_wrapped_target_is_not_turned_to_a_chosen_landmark(page: Page) -> None:
    camera = "return window.studio.views.sides.target.camera.position.toArray()"
    page.set("wrapAmount", 1.0)
    page.run(ASIDE)
    before = page.run(camera)
    page.select(3)
    assert page.run(camera) == before
    page.set("wrapAmount", 0.0)
    page.press("frame")


def test_models_fit_their_halves_again_after_these_were_very_narrow(page: Page) -> None:
    distance = """const {camera, controls} = window.studio.views.sides.target;
        return camera.position.distanceTo(controls.target)"""
    width = "window.studio.views.canvas.parentElement.style.flex = arguments[0]"
    page.press("frame")
    before = page.run(distance)
    page.run(width, "0 0 90px")
    page.until(lambda: page.run(distance) > 4 * before, "the models in a narrow window")
    page.run(width, "")
    page.until(lambda: page.run(distance) < 2 * before, "the models in the whole window")
    assert page.run(distance) == pytest.approx(before)


def test_a_narrow_window_shows_the_models_above_the_panel(page: Page) -> None:
    size = page.browser.get_window_size()
    frame = page.run("return outerHeight - innerHeight")
    try:
        for width in (800, 640, 500):
            page.browser.set_window_size(width, 700 + frame)
            page.until(lambda width=width: page.run("return innerWidth") == width, "a narrow window")
            assert page.run("return innerHeight") == 700
            edges = page.run(OPENED)
            assert min(edges) >= 0, (width, edges)
        widths = page.run(
            "return ['views', 'landmarks', 'status'].map(id => document.getElementById(id).offsetWidth / innerWidth)"
        )
        assert min(widths) > 0.75, widths
    finally:
        page.browser.set_window_size(size["width"], size["height"])


def test_a_target_whose_triangles_all_cross_seams_is_drawn(page: Page) -> None:
    corners, image = np.eye(3), io.BytesIO()
    imageio.imwrite(image, np.full((4, 4, 3), 200, dtype=np.uint8), extension=".png")
    values = {"POSITION": corners, "NORMAL": corners, "COLOR_1": corners, "TEXCOORD_0": corners[:, :2]}
    parts = [MeshPart(name, values, np.arange(3)[None][:count]) for name, count in (("model", 0), ("seams", 1))]
    drawing = base64.b64encode(pack_glb(parts, {"seams": image.getvalue()})).decode()
    script = """const [drawing, done] = arguments, fetched = window.fetch, {views} = window.studio;
        window.fetch = async () => new Response(Uint8Array.from(atob(drawing), one => one.charCodeAt(0)));
        views.load('target', 'skin', 'of this test').then(() => done(Object.keys(views.sides.target.parts)),
            error => done(String(error))).finally(() => { window.fetch = fetched; });"""
    assert "seams" in page.browser.execute_async_script(script, drawing)
    page.set("cages", True)
    page.set("cages", False)
    page.drawn()
