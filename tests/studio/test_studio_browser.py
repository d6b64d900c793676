"""The studio in a real browser, one for all these tests, which leave it as they found it: clicks, the live map, undo,
files, every control, wrong landmarks, two tabs, the bake, what a kill leaves. A failure gives the next test a new one.
"""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import time
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest
from test_studio_parts import dense

from cagemap.files.images.image import read_image
from cagemap.files.landmarks.point_formats import POINT_FORMS
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.mesh.cage_points import CagePoints
from cagemap.numerics.arrays import FloatArray
from cagemap.pipeline import choose_level
from cagemap.studio.autosave import autosave_path
from cagemap.studio.landmark_files import FORMS, points_file
from cagemap.studio.models import DENSE
from cagemap.studio.opening import built_in_files
from cagemap.studio.places import places_of
from cagemap.studio.shape import Shape, pick, shape_of
from cagemap.studio.state import Files
from cagemap.subdivision import refine

from browser_page import PATIENCE, Page, studio

pytestmark = [pytest.mark.slow, pytest.mark.browser]
VERTICES = 3000
# Of the first view; no landmark of the pair is near on either model.
FLANK = (0.12, -0.02)
DRAGGED = (0.16, -0.08)
BESIDE = (0.1, -0.93)
# Of the model's radius: a pixel of the first view is 0.003.
CLOSE = 0.01
# Mean difference of two pictures, of 255: turned or painted otherwise it is more than 6.
OTHER = 2.5
SERIOUS = {"serious", "critical"}
# Seconds within which a page is back once its studio answers; its models come as soon as they are read.
WHOLE = 5.0
# The ray through a point of a side's half.
RAY = """
const [side, x, y] = arguments, camera = window.studio.views.sides[side].camera, ray = new THREE.Raycaster();
ray.setFromCamera(new THREE.Vector2(x, y), camera);
return [...ray.ray.origin.toArray(), ...ray.ray.direction.toArray()]"""


@dataclass
class Running:
    """The studio of these tests, and the page that looks at it."""

    browser: Any
    files: Files
    process: subprocess.Popen[str]
    page: Page
    begun: ExitStack

    @classmethod
    def of(cls, browser: Any, files: Files) -> Running:
        with ExitStack() as begun:  # a studio without a map ends at once
            process, address = begun.enter_context(studio(*arguments(files)))
            page = Page(browser, address)
            page.until(lambda: page.revision() >= 1, "the first map")
            return cls(browser, files, process, page, begun.pop_all())

    def start_again(self) -> None:
        """A studio of the same files in place of this one."""
        self.begun.close()
        again = Running.of(self.browser, self.files)
        self.process, self.page, self.begun = again.process, again.page, again.begun


def arguments(files: Files) -> list[str]:
    named = ["--target", files.target, "--source", files.source, "--texture", files.texture]
    named += ["--landmarks", files.landmarks, "--result", files.result, "--vertices", VERTICES]
    return list(map(str, named))


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """What runs, and how many tests had failed when it was started."""
    made: dict[str, Any] = {"folder": lambda: tmp_path_factory.mktemp("built-in")}
    yield made
    if "running" in made:
        made["running"].begun.close()


@pytest.fixture
def running(browser: Any, held: dict[str, Any], request: pytest.FixtureRequest) -> Running:
    failed = request.session.testsfailed
    if held.get("failed") != failed:
        if "running" in held:
            held.pop("running").begun.close()
        held["running"] = Running.of(browser, built_in_files(held["folder"]()))
        held["failed"] = failed
    return held["running"]


@pytest.fixture
def page(running: Running) -> Page:
    return running.page


@pytest.fixture
def files(running: Running) -> Files:
    return running.files


def ray(page: Page, side: str, point: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """What `Page.click` sends into the scene."""
    found = np.array(page.run(RAY, side, *point))
    return found[:3], found[3:]


def shape(path: Path) -> Shape:
    control = read_mesh(path)
    return shape_of(refine(control, choose_level(control, VERTICES)))


def saved(files: Files) -> list[dict[str, Any]]:
    return json.loads(files.landmarks.read_text())["pairs"]


def misses(page: Page, files: Files, pair: dict[str, Any], side: str, point: tuple[float, float]) -> float:
    """How far an end of a saved landmark lies from where the page was clicked, of the model's radius."""
    surface = shape(getattr(files, side))
    hit = pick(surface, *ray(page, side, point))
    assert hit is not None
    end = pair[side]
    corners, weights = ([end] * 3, [1, 0, 0]) if isinstance(end, int) else (end["corners"], end["weights"])
    (place,) = places_of(surface, CagePoints(np.array([corners]), np.array([weights], dtype=float)))
    return float(np.linalg.norm(np.array(place.position) - hit.position)) / surface.radius


def other(now: np.ndarray, before: np.ndarray) -> bool:
    """Whether a canvas shows something else."""
    return float(np.abs(now - before).mean()) > OTHER


def half_a_landmark(page: Page) -> None:
    page.click("target", FLANK)
    page.until(lambda: page.state("proposal"), "the first half of a landmark")


def back_to(page: Page, count: int) -> None:
    """Undo until so many landmarks are left, and none waits for its other place."""
    while page.landmarks() != count or page.state("asks"):
        before = page.rows()
        page.press("undo")
        page.until(lambda before=before: page.rows() != before, "one step back")


def save(page: Page, files: Files, count: int) -> None:
    page.press("save")
    page.until(lambda: len(saved(files)) == count, f"{count} landmarks in the file")


def test_views_change_what_is_shown(page: Page) -> None:
    page.keys("f")
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
    for split, same in ((1.0, True), (0.0, False), (0.5, False)):
        page.set("split", split)
        page.until(lambda same=same: other(page.look("target"), first["target"]) != same, f"the border at {split}")
    page.set("other", "")
    page.until(lambda: not other(page.look("target"), first["target"]), "one look")

    # The target takes the source's shape; the source lies over it.
    page.set("morph", 1.0)
    page.until(lambda: other(page.look("target"), first["target"]), "the wrapped target")
    assert np.abs(page.look("target") - page.look("source")).mean() < OTHER
    page.click("target", FLANK)
    page.until(lambda: "Set Wrap back" in page.text("status"), "why no landmark is placed")
    assert not page.state("asks")
    page.set("morph", 0.0)
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
    page.until(lambda: page.revision() == revision + 1, "the map after it")
    save(page, files, count + 1)
    for side in ("target", "source"):
        assert misses(page, files, saved(files)[-1], side, FLANK) < CLOSE

    # Dragged elsewhere, it is there; undo puts it back, and away, redo and Delete do what they say.
    page.drag("target", page.at("target", count + 1), DRAGGED)
    page.until(lambda: page.revision() == revision + 2, "the map after the drag")
    page.press("save")
    page.until(lambda: misses(page, files, saved(files)[-1], "target", DRAGGED) < CLOSE, "the dragged landmark")
    assert misses(page, files, saved(files)[-1], "source", FLANK) < CLOSE
    page.drag("target", page.at("target", count + 1), (0.9, 0.9))  # let go beside the model, it returns
    page.until(lambda: np.hypot(*np.subtract(page.at("target", count + 1), DRAGGED)) < 0.05, "the landmark back")
    page.keys("\ue009", "z")
    page.until(lambda: page.revision() == revision + 3, "the map as before the drag")
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


def test_a_landmark_beside_the_mirror_plane_brings_its_counterpart(page: Page) -> None:
    count = page.landmarks()
    assert page.state("symmetric")
    page.until(lambda: page.state("view")["symmetric"], "symmetric placing, as at first")
    half_a_landmark(page)
    page.keys("\ue007")
    page.until(lambda: page.landmarks() == count + 2, "the landmark and its counterpart")
    page.press("undo")
    page.until(lambda: page.landmarks() == count, "both away in one step")
    back_to(page, count)


def test_the_next_landmark_is_proposed_on_both_models(page: Page) -> None:
    count = page.landmarks()
    page.press("next")
    page.until(lambda: page.state("proposal"), "a proposal")
    page.until(lambda: "other model" in page.text("status"), "what to do next")
    page.press("accept")
    page.until(lambda: page.landmarks() > count, "the proposed landmark")
    back_to(page, count)


def test_a_wrong_landmark_is_marked(page: Page) -> None:
    page.set("symmetric", False)
    count = page.landmarks()
    half_a_landmark(page)
    page.click("source", np.add(page.at("source", 19), (0.0, 0.06)))  # the flank of one is no hoof of the other
    page.until(lambda: page.landmarks() == count + 1, "the landmark in the list")
    page.press("again")
    page.until(lambda: any("\u26a0" in row for row in page.rows()), "the mark")
    assert "contradict" in page.text("verdict")
    first = page.look("target")
    page.set("doubts", False)
    page.until(lambda: not page.state("view")["doubts"], "doubtful places not marked")
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
    first = {side: page.look(side) for side in ("target", "source")}
    page.drag("target", BESIDE, (0.5, -0.93))
    page.until(lambda: other(page.look("source"), first["source"]), "the source turned with the target")
    page.press("frame")
    page.until(lambda: not any(other(page.look(side), first[side]) for side in first), "both as at first")
    page.set("linked", False)
    page.until(lambda: not page.state("view")["linked"], "each alone")
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
    for ending in FORMS.values():
        if ending != ".json":
            page.set("file-form", ending)
            page.press("save")
            written = points_file(files.landmarks.with_name(f"landmarks{ending}"), "target")
            page.until(written.is_file, f"{ending} on disk")
    assert {form.ending for form in POINT_FORMS} < set(FORMS.values())
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


def test_an_error_is_named_and_the_bake_goes_on_after_it(page: Page, files: Files) -> None:
    page.option("", "Vertices", "200000")  # a match that lasts until it is cancelled
    page.option("", "Texels", "512")
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
    page.set("baked", "")
    page.until(lambda: page.state("view")["mode"] == "texture", "the map")
    assert np.abs(page.look("target") - shown).mean() < 2 * OTHER


def test_a_page_says_that_its_studio_ended_and_is_whole_again(
    running: Running, files: Files, held: dict[str, Any], record_property: Any
) -> None:
    """Killed at rest, with half a landmark, and while it matches."""
    held.pop("failed")  # its studio ends: a test after it begins anew
    page, process, port = running.page, running.process, running.page.address.rstrip("/").rpartition(":")[2]
    page.run("window.before = true")
    count = page.landmarks()
    for moment in ("at rest", "half a landmark", "while it matches"):
        if moment == "half a landmark":
            half_a_landmark(page)
        if moment == "while it matches":
            page.press("again")
        process.kill()
        page.until(lambda: "has ended" in page.text("status"), f"{moment}: a word that it has ended")
        begun = running.begun.enter_context(studio(*arguments(files), "--port", port))
        process, address = begun
        assert address == page.address
        ready = time.monotonic()
        page.until(lambda: "has ended" not in page.text("status"), f"{moment}: the page again", WHOLE)
        page.until(lambda: page.state("models"), f"{moment}: its models")
        record_property(f"{moment}: seconds to the models", time.monotonic() - ready)
        page.until(lambda: page.revision() >= 1, f"{moment}: its map")
        assert page.landmarks() == count
        if moment == "half a landmark":
            assert page.state("asks")
            back_to_none(page)
    assert page.run("return window.before")  # the very same page


def back_to_none(page: Page) -> None:
    """Delete the landmark that waits for its other place."""
    page.select(page.landmarks() + 1)
    page.press("delete")
    page.until(lambda: not page.state("asks"), "no landmark that waits")


def test_a_killed_studio_gives_its_landmarks_back(running: Running, files: Files) -> None:
    page = running.page
    page.set("symmetric", False)
    count = len(saved(files))
    half_a_landmark(page)
    page.until(lambda: autosave_path(files.landmarks).is_file(), "the autosave")
    running.process.kill()
    assert len(saved(files)) == count
    running.start_again()
    page = running.page
    page.until(lambda: page.said("recovered"), "the recovered landmarks")
    page.set("symmetric", False)
    page.press("accept")
    page.until(lambda: page.landmarks() == count + 1, "the landmark completed")
    page.select(count + 1)
    page.press("delete")
    page.until(lambda: page.landmarks() == count, "no landmark more")


def test_files_are_added_faults_are_named_and_a_scan_is_taken_as_it_is(
    page: Page, files: Files, held: dict[str, Any], tmp_path: Path
) -> None:
    held.pop("failed")  # other models are open at its end: a test after it begins anew
    (tmp_path / "broken.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    write_mesh(tmp_path / "scan.obj", dense(DENSE))
    page.press("open")
    for name in ("broken.obj", "scan.obj"):
        page.upload(tmp_path / name)
        page.until(lambda name=name: page.said(f"added {name}"), f"{name} in the lists")
        assert (files.target.parent / name).read_bytes() == (tmp_path / name).read_bytes()
    page.until(lambda: page.run("return [...document.querySelector('[name=target]').options].length") > 3, "the list")
    page.run("const at = document.querySelector('[name=target]'); at.value = 'broken.obj';")
    page.press("open-now")
    page.until(lambda: "broken.obj, line 4" in page.text("status"), "what is wrong with it")
    # A file that is dropped on a half is opened there.
    drop = """const data = new DataTransfer(); data.items.add(new File([arguments[0]], 'dropped.obj'));
        const at = document.getElementById('target').getBoundingClientRect();
        document.getElementById('views').dispatchEvent(new DragEvent('drop', {dataTransfer: data, bubbles: true,
            cancelable: true, clientX: at.left + 5, clientY: at.top + 5}))"""
    page.run(drop, (tmp_path / "scan.obj").read_text())
    page.until(lambda: page.state("models") and page.state("models")["target"]["name"] == "dropped.obj", "the drop")
    dense_target = "return window.studio.state.models?.target.dense"
    page.until(lambda: page.run(dense_target), "the offer")
    page.press("cancel")  # its map as a cage
    page.press("plain-target")
    page.until(lambda: page.run(dense_target) is False, "the scan as it is")

    # Chosen in the dialog; the image is guessed, and how a model is taken is not said of the next one.
    page.press("open")
    page.set("models [name=target]", "deer.obj")
    page.set("models [name=source]", "pony.obj")
    page.until(lambda: page.run("return document.querySelector('[name=texture]').value") == "pony.png", "the image")
    assert page.run("return document.getElementById('scheme-target').value") == ""
    page.set("scheme-source", "bilinear")
    page.set("up-target", "z")
    page.press("open-now")
    chosen = "const files = window.studio.state.files; return [files.target, files.schemes[1], files.ups[0]]"
    page.until(lambda: page.run(chosen) == ["deer.obj", "bilinear", "z"], "the pair as it was chosen")
