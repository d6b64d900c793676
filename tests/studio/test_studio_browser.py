"""The studio in a real browser, one for all these tests, which leave it as they found it: landmarks, tabs, the bake."""

import io
import json
import shutil
import zipfile
from pathlib import Path
from typing import Any

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
from cagemap.studio.landmark_files import SAVE_FORMATS, side_file
from cagemap.studio.places import cage_places
from cagemap.studio.shape import Shape, pick, refined_shape
from cagemap.studio.state import Files
from cagemap.subdivision import refine

from browser_page import PATIENCE, Page
from running_studio import FLANK, GRIPPED, OTHER, VERTICES, back_to, half_a_landmark, saved

pytestmark = [pytest.mark.slow, pytest.mark.browser]
DRAGGED = (0.16, -0.08)
# Of the model's radius: a pixel of the first view is 0.003.
CLOSE = 0.01
SERIOUS = {"serious", "critical"}
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


# The extent of places of which the last one is doubtful.
EXTENT = """
const done = arguments[1], array = values => ({array: values});
const values = {place: array(arguments[0]), trust: array([1, 1, 0])};
import('./gl.js').then(({matchedExtent}) => done(matchedExtent([{getAttribute: name => values[name]}])));"""


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


def save(page: Page, files: Files, count: int) -> None:
    page.press("save")
    page.until(lambda: len(saved(files)) == count, f"{count} landmarks in the file")


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


def test_colours_and_checker_span_the_part_that_is_matched(page: Page) -> None:
    """A head on a body would have one colour and three squares."""
    extent = lambda *places: page.browser.execute_async_script(EXTENT, places)  # noqa: E731
    np.testing.assert_allclose(extent(0.2, 0.4, 0, 0.2, 0.4, 0.4, 9, 9, 9), [0.2, 0.4, 0.2, 0.2])
    assert extent(-1, 0, 0, 1, 0, 0, 9, 9, 9) == [0, 0, 0, 1]
    assert page.run("return window.studio.views.matched") == [0, 0, 0, 1]
    before = page.run("return document.getElementById('mode').value")
    page.set("mode", "checker")
    page.drawn()
    whole = [page.look(side) for side in ("target", "source")]

    def is_other(side: str, shown: np.ndarray) -> bool:  # set again each time: meshes that arrive late reset it
        page.run("window.studio.views.matched = [0.2, 0.4, 0.2, 0.2]; window.studio.views.changed()")
        return bool(np.abs(page.look(side) - shown).mean() > 2)

    for side, shown in zip(("target", "source"), whole, strict=True):
        page.until(lambda side=side, shown=shown: is_other(side, shown), "other colours")
    page.run("window.studio.views.matched = [0, 0, 0, 1]; window.studio.views.changed()")
    page.set("mode", before)


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


def test_images_are_dropped_before_the_files_that_name_them(page: Page) -> None:
    def sent(*names: str) -> list[list[str | None]]:
        return [list(one) for one in page.browser.execute_async_script(DROPPED, list(names))]

    named = [["a.png", None], ["a.mtl", "source"], ["a.obj", "source"]]
    assert sent("a.obj", "a.mtl", "a.png") == [*named, ["a.png", "source"]]
    assert sent("a.obj", "a.mtl", "a.png", "b.png") == [named[0], ["b.png", None], *named[1:]]
    assert sent("a.png") == [["a.png", "source"]]
