"""The studio in a real browser, one for all these tests, which leave it as they found it: clicks, the live map, undo,
every control, wrong landmarks, two tabs, the bake.
"""

from __future__ import annotations

import base64
import io
import json
import shutil
import zipfile
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pygltflib
import pytest

from cagemap.files.images.image import read_image
from cagemap.files.landmarks.point_formats import POINT_FORMS
from cagemap.files.meshes.formats import read_mesh
from cagemap.mesh.cage_points import CagePoints
from cagemap.numerics.arrays import FloatArray
from cagemap.pipeline import choose_level
from cagemap.studio.autosave import autosave_path
from cagemap.studio.glb import MeshPart, pack_glb
from cagemap.studio.landmark_files import SAVE_FORMATS, side_file
from cagemap.studio.places import cage_places
from cagemap.studio.shape import Shape, pick, refined_shape
from cagemap.studio.state import Files
from cagemap.subdivision import refine

from browser_page import PATIENCE, Page
from running_studio import FLANK, VERTICES, half_a_landmark, saved

pytestmark = [pytest.mark.slow, pytest.mark.browser]
DRAGGED = (0.16, -0.08)
BESIDE = (0.1, -0.93)
# Of the model's radius: a pixel of the first view is 0.003.
CLOSE = 0.01
# Mean difference of two pictures, of 255: turned or painted otherwise it is more than 6.
OTHER = 2.5
SERIOUS = {"serious", "critical"}
# Whether a press at a landmark's place on a model, inside its half, grips it.
GRIPPED = """
const [name, number] = arguments, {views} = window.studio, side = views.sides[name];
const mark = side.marks.find(one => one.number === number), box = side.pane.getBoundingClientRect();
const at = new THREE.Vector3(...mark.at.slice(0, 3)).project(side.camera);
const isInside = Math.max(...at.toArray().map(Math.abs)) < 1;
return isInside && views.markAt(side, {clientX: box.left + (at.x + 1) / 2 * box.width,
    clientY: box.top + (1 - at.y) / 2 * box.height}) === mark"""
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
# Names and roles that a drop of files on the source's half sends, in order.
DROPPED = """
const [names, done] = arguments, {send} = WebSocket.prototype, sent = [], data = new DataTransfer();
for (const name of names) data.items.add(new File([''], name));
WebSocket.prototype.send = blob => sent.push(blob.text());
const at = document.getElementById('source').getBoundingClientRect();
document.getElementById('views').dispatchEvent(new DragEvent('drop', {dataTransfer: data, bubbles: true,
    cancelable: true, clientX: at.left + 5, clientY: at.top + 5}));
WebSocket.prototype.send = send;
Promise.all(sent).then(all => done(all.map(one => JSON.parse(one)).map(({name, role}) => [name, role])));"""
# The ray through a point of a side's half.
RAY = """
const [side, x, y] = arguments, camera = window.studio.views.sides[side].camera, ray = new THREE.Raycaster();
ray.setFromCamera(new THREE.Vector2(x, y), camera);
return [...ray.ray.origin.toArray(), ...ray.ray.direction.toArray()]"""

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


def ray(page: Page, side: str, point: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """What `Page.click` sends into the scene."""
    found = np.array(page.run(RAY, side, *point))
    return found[:3], found[3:]


def shape(path: Path) -> Shape:
    control = read_mesh(path)
    return refined_shape(refine(control, choose_level(control, VERTICES)))


def misses(page: Page, files: Files, pair: dict[str, Any], side: str, point: tuple[float, float]) -> float:
    """How far an end of a saved landmark lies from where the page was clicked, of the model's radius."""
    surface = shape(getattr(files, side))
    hit = pick(surface, *ray(page, side, point))
    end = pair[side]
    corners, weights = ([end] * 3, [1, 0, 0]) if isinstance(end, int) else (end["corners"], end["weights"])
    (place,) = cage_places(surface, CagePoints(np.array([corners]), np.array([weights], dtype=float)))
    return float(np.linalg.norm(np.array(place.position) - hit.position)) / surface.radius


def other(now: np.ndarray, before: np.ndarray) -> bool:
    """Whether a canvas shows something else."""
    return float(np.abs(now - before).mean()) > OTHER


def back_to(page: Page, count: int) -> None:
    """Undo until so many landmarks are left, and none waits for its other place."""
    while page.landmarks() != count or page.state("proposal"):
        before = page.state("undo")
        page.press("undo")
        page.until(lambda before=before: page.state("undo") < before, "one step back")


def save(page: Page, files: Files, count: int) -> None:
    page.press("save")
    page.until(lambda: len(saved(files)) == count, f"{count} landmarks in the file")


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


def test_what_is_chosen_in_the_dialog_stays_until_it_is_closed(page: Page, files: Files) -> None:
    target = "return document.querySelector('#models [name=target]').value"
    page.press("open")
    page.set("models [name=target]", "pony.obj")
    frames = page.run("return window.studio.views.frames")
    for name in ("else.json", files.landmarks.name):  # the server tells of other files meanwhile
        page.set("file", name)
        page.press("save")
        page.until(lambda name=name: page.state("files")["landmarks"] == name, name)
        assert page.run(target) == "pony.obj"
    page.run("return new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert page.run("return window.studio.views.frames") == frames  # what is on screen is not drawn again
    page.run("document.querySelector('#models button[value=\"\"]').click()")
    page.until(lambda: page.run(target) == files.target.name, "the open model again")


def test_nothing_is_asked_of_other_machines(page: Page) -> None:
    asked = page.run("return performance.getEntries().map(e => [e.entryType, e.name])")
    named = [name for kind, name in asked if kind in ("resource", "navigation")]
    assert named
    assert [url for url in named if not url.startswith(("http://127.0.0.1", "data:", "blob:"))] == []
    refused = [entry["message"] for entry in page.browser.get_log("browser")]  # what the page's policy has forbidden
    assert [message for message in refused if "Content Security Policy" in message] == []


def test_the_page_is_accessible_in_light_and_dark(page: Page) -> None:
    from axe_core_python.selenium import Axe

    for theme in ("light", "dark"):
        page.run("document.documentElement.dataset.theme = arguments[0]", theme)
        for tab in ("tab-bake", "tab-landmarks"):
            page.press(tab)
            page.run("document.querySelectorAll('details').forEach(one => { one.open = one.id != 'more'; })")
            found = Axe().run(page.browser)["violations"]
            assert [(one["id"], one["nodes"][0]["html"]) for one in found if one["impact"] in SERIOUS] == []
    page.run("document.querySelectorAll('details').forEach(one => { one.open = false; })")
    page.run("delete document.documentElement.dataset.theme")
    assert page.browser.title == "cagemap studio"


def test_clicks_and_drags_place_landmarks_where_they_end(page: Page, files: Files) -> None:
    page.set("symmetric", False)
    count, revision = page.landmarks(), page.revision()
    first = page.look("target")
    assert first.std() > 10, "no model on screen"
    half_a_landmark(page)
    page.click("source", FLANK)
    page.until(lambda: page.landmarks() == count + 1, "the landmark in the list")
    page.until(lambda: page.revision() > revision, "the map after it")
    save(page, files, count + 1)
    for side in ("target", "source"):
        assert misses(page, files, saved(files)[-1], side, FLANK) < CLOSE

    # Dragged elsewhere, it is there; undo puts it back, and away, redo and Delete do what they say.
    revision = page.revision()
    page.drag("target", page.at("target", count + 1), DRAGGED)
    page.until(lambda: page.revision() > revision, "the map after the drag")
    page.press("save")
    page.until(lambda: misses(page, files, saved(files)[-1], "target", DRAGGED) < CLOSE, "the dragged landmark")
    assert misses(page, files, saved(files)[-1], "source", FLANK) < CLOSE
    page.drag("target", page.at("target", count + 1), (0.9, 0.9))  # let go beside the model, it returns
    page.until(lambda: np.hypot(*np.subtract(page.at("target", count + 1), DRAGGED)) < 0.05, "the landmark back")
    again = page.revision()
    page.keys("\ue009", "z")
    page.until(lambda: page.revision() > again, "the map as before the drag")
    page.keys("\ue009", "z")
    page.until(lambda: page.landmarks() == count, "one landmark fewer")
    page.keys("\ue009", "\ue008", "z")
    page.until(lambda: page.landmarks() == count + 1, "the landmark again")
    page.keys("\ue00c")
    page.until(lambda: page.state("selected") is None, "nothing selected")
    page.click("target", page.at("target", count + 1))  # on its mark: selects it
    page.until(lambda: page.state("selected") == count + 1, "the landmark selected")
    page.keys("\ue017")
    page.until(lambda: page.landmarks() == count, "no landmark there")
    save(page, files, count)
    page.set("symmetric", True)


def test_a_drag_that_the_system_ends_moves_no_landmark(page: Page) -> None:
    page.press("frame")
    page.drawn()
    count, steps = page.landmarks(), page.state("undo")
    # The pointer is lost over the flank, for example to a dialog of the system; then it moves on without a button.
    script = """
        const side = window.studio.views.sides.target, box = side.pane.getBoundingClientRect();
        side.pane.setPointerCapture = () => {};
        const at = ([x, y]) => ({
            clientX: box.left + (x + 1) / 2 * box.width, clientY: box.top + (1 - y) / 2 * box.height});
        const [mark, flank, kind] = arguments, told = (kind, where, buttons) =>
            side.pane.dispatchEvent(new PointerEvent(kind, {...at(where), button: 0, buttons, pointerId: 1}));
        told('pointerdown', mark, 1);
        const held = !!side.dragged;
        told('pointermove', flank, 1);
        told(kind, flank, 0);
        delete side.pane.setPointerCapture;
        return [held, !!side.dragged, side.controls.enabled]"""
    number = next(one["number"] for one in page.state("landmarks") if page.run(GRIPPED, "target", one["number"]))
    for kind in ("pointercancel", "pointermove"):
        assert page.run(script, page.at("target", number), FLANK, kind) == [True, False, True]
    page.click("target", page.clear_point("target", FLANK))
    page.until(lambda: page.state("undo") == steps + 1, "a new landmark by the next click")
    assert page.state("proposal")
    back_to(page, count)


def test_a_landmark_beside_the_mirror_plane_brings_its_counterpart(page: Page) -> None:
    count = page.landmarks()
    assert page.state("symmetric")
    half_a_landmark(page)
    page.keys("\ue007")
    page.until(lambda: page.landmarks() == count + 2, "the landmark and its counterpart")
    page.press("undo")
    page.until(lambda: page.landmarks() == count, "both away in one step")
    back_to(page, count)


def test_a_wrong_landmark_is_marked(page: Page) -> None:
    page.keys("f")
    page.set("symmetric", False)
    count = page.landmarks()
    half_a_landmark(page)
    # The flank of one is no hoof of the other.
    page.click("source", page.clear_point("source", page.at("source", 19)))
    page.until(lambda: page.landmarks() == count + 1, "the landmark in the list")
    page.press("again")
    page.until(lambda: any("\u26a0" in row for row in page.rows()), "the mark")
    assert "contradict" in page.text("verdict")
    page.drawn()
    first = page.look("target")
    page.set("doubts", False)
    page.until(lambda: np.abs(page.look("target") - first).max() > 20, "none of them red")
    page.set("doubts", True)
    back_to(page, count)
    page.until(lambda: not any("\u26a0" in row for row in page.rows()), "no mark")
    page.set("symmetric", True)


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


def test_landmarks_are_named_mirrored_and_go_through_every_form(page: Page, files: Files) -> None:
    known = page.landmarks()
    page.set("symmetric", False)
    half_a_landmark(page)
    page.press("accept")
    page.until(lambda: page.landmarks() == known + 1, "the landmark in the list")
    page.set("name", "flank_L")
    page.until(lambda: any("flank_L" in row for row in page.rows()), "its name")
    page.press("mirror")
    page.until(lambda: any("flank_R" in row for row in page.rows()), "the landmark across")
    page.press("undo")
    page.until(lambda: not any("flank_R" in row for row in page.rows()), "one step back")
    page.press("redo")
    page.until(lambda: any("flank_R" in row for row in page.rows()), "one step forward")
    page.select(known + 2)
    assert autosave_path(files.landmarks).is_file()
    every_form_is_saved_and_read(page, files, known + 2)
    back_to(page, known)
    save(page, files, known)
    page.set("symmetric", True)


def every_form_is_saved_and_read(page: Page, files: Files, count: int) -> None:
    before = json.loads(files.landmarks.read_text())
    save(page, files, count)
    for ending in SAVE_FORMATS.values():
        if ending != ".json":
            page.set("file-form", ending)
            page.press("save")
            written = side_file(files.landmarks.with_name(f"landmarks{ending}"), "target")
            page.until(written.is_file, f"{ending} on disk")
    assert {form.ending for form in POINT_FORMS} < set(SAVE_FORMATS.values())
    page.until(lambda: page.said("order alone"), "what Wrap's form cannot hold")
    page.set("file-form", ".json")
    (files.landmarks.parent / "wrong.json").write_text("{")
    (files.landmarks.parent / "first.json").write_text(json.dumps(before))
    page.press("save")  # lists what has come since
    load(page, "first.json", "", count - 2)
    load(page, "landmarks.target.mrk.json", "landmarks.source.mrk.json", count)
    page.set("points", "")
    page.set("pairs", "wrong.json")
    page.press("load")
    page.until(lambda: "wrong.json, line 1: expected JSON" in page.text("status"), "what is wrong with the file")
    assert page.landmarks() == count


def load(page: Page, name: str, points: str, count: int) -> None:
    page.set("pairs", name)
    page.set("points", points)
    page.press("load")
    page.until(lambda: page.landmarks() == count, f"the landmarks of {name}")


def test_two_tabs_and_a_reconnect_show_one_state(page: Page) -> None:
    page.set("symmetric", False)
    count, first = page.landmarks(), page.browser.current_window_handle
    page.browser.switch_to.new_window("tab")
    second = Page(page.browser, page.address)
    second.until(lambda: second.landmarks() == count, "the landmarks in the second tab")
    half_a_landmark(second)
    second.browser.close()
    page.browser.switch_to.window(first)
    page.until(lambda: page.state("proposal"), "half a landmark in the first tab")
    page.press("accept")
    page.until(lambda: page.landmarks() == count + 1, "the whole landmark")
    again = Page(page.browser, page.address)
    again.until(lambda: again.landmarks() == count + 1, "the same after closing and opening")
    back_to(again, count)
    again.set("symmetric", True)


def test_a_number_that_is_none_is_refused(page: Page) -> None:
    field = page.browser.find_element("css selector", '[data-key="match.vertices"] input')
    assert not field.get_attribute("title")  # the tooltip of its line shows
    assert field.get_attribute("step") == "1000"
    page.press("tab-bake")
    field.send_keys("e")
    page.press("start")
    page.until(lambda: page.said("Vertices: expected a whole number or nothing"), "what is wrong")
    assert not page.state("baking")
    page.option("", "Vertices", str(VERTICES))
    page.press("tab-landmarks")


def test_an_error_is_named_and_the_bake_goes_on_after_it(page: Page, files: Files) -> None:
    page.option("", "Vertices", "200000")  # a match that lasts until it is cancelled
    page.option("", "Image size", "512")
    files.result.mkdir()
    (files.result / "thesis.tex").write_text("not ours")
    page.press("start")
    page.until(lambda: page.said("nothing is written to it"), "the error")
    assert (files.result / "thesis.tex").read_text() == "not ours"
    shutil.rmtree(files.result)
    page.press("start")
    page.until(lambda: page.text("status").startswith("Baking, step 1/"), "a running match")
    page.press("cancel")
    page.until(lambda: page.said("Bake: cancelled"), "its end")
    assert not files.result.exists()
    page.option("", "Vertices", str(VERTICES))
    page.press("start")
    page.until(lambda: "everything" in page.text("outputs"), "the finish", 2 * PATIENCE)
    (baked,) = files.result.parent.glob("deer_from_*.png")
    assert read_image(baked).pixels.std() > 10
    assert page.link(baked.name) == baked.read_bytes()
    with zipfile.ZipFile(io.BytesIO(page.link("all.zip"))) as archive:
        assert {baked.name, "RESULT/manifest.json", "RESULT.html"} <= set(archive.namelist())
    assert len(pygltflib.GLTF2.load_from_bytes(page.link(f"{baked.stem}.glb")).images) == 1

    # It is on the model, nearly as the map showed it, and the map is one choice away.
    page.until(lambda: page.run("return !!window.studio.views.sides.target.images.baked"), "the image on the model")
    assert page.state("view")["mode"] == "baked"
    shown = page.look("target")
    page.set("other", "baked")
    page.set("baked", "")
    page.until(lambda: page.state("view")["mode"] == "texture", "the map")
    assert np.abs(page.look("target") - shown).mean() < 2 * OTHER
    compared = "const at = document.getElementById('other'); return [at.value, [...at.options].map(one => one.value)]"
    chosen, offered = page.run(compared)
    assert chosen == ""
    assert "baked" not in offered  # the model is drawn without the image


def test_enter_accepts_after_next_landmark_and_rows_stay_and_are_chosen_by_keys(page: Page) -> None:
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.keys import Keys

    count = page.landmarks()
    page.set("symmetric", False)
    page.run("document.getElementById('next').focus()")
    page.press("next")
    page.until(lambda: page.state("proposal"), "a proposal")
    page.until(lambda: "other model" in page.text("status"), "what to do next")
    ActionChains(page.browser).send_keys(Keys.ENTER).perform()
    page.until(lambda: page.landmarks() == count + 1, "the accepted landmark")
    page.until(lambda: page.state("status")["kind"] != "busy", "its map")

    page.run("window.row = document.querySelector('#list tbody tr:nth-child(2)')")
    page.set("cages", True)
    page.set("cages", False)
    assert page.run("return window.row.isConnected")  # a click that begins now ends on the same row
    page.run("window.row.querySelector('button').focus()")
    ActionChains(page.browser).send_keys(Keys.SPACE).perform()
    number = int(page.run("return window.row.dataset.number"))
    page.until(lambda: page.state("selected") == number, "the row's landmark selected")
    assert page.run("return document.activeElement.getAttribute('aria-pressed')") == "true"
    back_to(page, count)
    page.set("symmetric", True)


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


def test_images_are_dropped_before_the_files_that_name_them(page: Page) -> None:
    def sent(*names: str) -> list[list[str | None]]:
        return [list(one) for one in page.browser.execute_async_script(DROPPED, list(names))]

    named = [["a.png", None], ["a.mtl", "source"], ["a.obj", "source"]]
    assert sent("a.obj", "a.mtl", "a.png") == [*named, ["a.png", "source"]]
    assert sent("a.obj", "a.mtl", "a.png", "b.png") == [named[0], ["b.png", None], *named[1:]]
    assert sent("a.png") == [["a.png", "source"]]


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
