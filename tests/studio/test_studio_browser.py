"""The studio in a real browser, one for all these tests, which leave it as they found it: clicks, the live map, undo,
files, every control, wrong landmarks, two tabs, the bake, what a kill leaves. A failure gives the next test a new one.
"""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_studio_parts import dense

from cagemap.files.images.image import read_image
from cagemap.files.landmarks.point_formats import POINT_FORMS
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.mesh.cage_points import CagePoints
from cagemap.numerics.arrays import FloatArray
from cagemap.pipeline import choose_level
from cagemap.studio.autosave import autosave_path
from cagemap.studio.landmark_files import points_file
from cagemap.studio.models import DENSE
from cagemap.studio.opening import built_in_files
from cagemap.studio.page.panels import FORMS
from cagemap.studio.page.view import FIELD_OF_VIEW, FIRST_VIEW
from cagemap.studio.places import places_of
from cagemap.studio.shape import Shape, pick, shape_of
from cagemap.studio.state import Files
from cagemap.subdivision import refine

from browser_page import PATIENCE, Page, studio

pytestmark = [pytest.mark.slow, pytest.mark.browser]
VERTICES = 3000
# Of the first view; no landmark of the pair is near on either model.
FLANK = (-0.2, 0.0)
DRAGGED = (-0.16, -0.12)
HEAD = (-0.02, 0.35)
BESIDE = (0.1, -0.85)
# Of the model's radius: a pixel of the first view is 0.003.
CLOSE = 0.01
# Mean difference of two pictures, of 255: turned it is 37, painted otherwise 9.
OTHER = 5.0


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
    """What `Page.click` sends into the scene, by the first view's pinhole."""
    page.into(side)
    size = page.browser.find_element("css selector", "canvas").size
    eye = np.array(FIRST_VIEW)
    ahead = -eye / np.linalg.norm(eye)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    half = np.tan(FIELD_OF_VIEW / 2)
    direction = ahead + half * (point[0] * size["width"] / size["height"] * right + point[1] * up)
    return eye, direction / np.linalg.norm(direction)


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
    """Whether a canvas shows something else; viser draws it coarser where the machine is slow, which differs by 2."""
    return float(np.abs(now - before).mean()) > OTHER


def touched(now: np.ndarray, before: np.ndarray) -> bool:
    """Whether some place of a picture has become another."""
    return bool(np.abs(now - before).max(axis=2).mean() > 0.05)


def bluish(picture: np.ndarray) -> int:
    """Places that may be lines of a cage."""
    return int((picture[..., 2] > picture[..., 0] + 60).sum())


def half_a_landmark(page: Page) -> None:
    page.click("target", FLANK)
    page.until(lambda: "accept the proposal" in page.text("status"), "the first half of a landmark")


def back_to(page: Page, count: int) -> None:
    """Undo until so many landmarks are left, and none waits for its other place."""
    while page.landmarks() != count or "\u2026" in page.text("list"):
        before = page.text("list")
        page.button("source", "Undo")
        page.until(lambda before=before: page.text("list") != before, "one step back")


def test_nothing_is_asked_of_other_machines(page: Page) -> None:
    asked = []
    for frame in (None, "target", "source"):
        page.browser.switch_to.default_content()
        if frame is not None:
            page.browser.switch_to.frame(frame)
        asked += page.browser.execute_script("return performance.getEntries().map(e => [e.entryType, e.name])")
    named = [name for kind, name in asked if kind in ("resource", "navigation")]
    assert named
    assert [url for url in named if not url.startswith(("http://127.0.0.1", "data:", "blob:"))] == []
    refused = [entry["message"] for entry in page.browser.get_log("browser")]  # what the page's policy has forbidden
    assert [message for message in refused if "Content Security Policy" in message] == []


def test_clicks_and_drags_place_landmarks_where_they_end(page: Page, files: Files) -> None:
    count, revision = page.landmarks(), page.revision()
    first = page.settle("target")
    assert first.std() > 10, "no model on screen"
    half_a_landmark(page)
    page.click("source", FLANK)
    page.until(lambda: page.landmarks() == count + 1, "the landmark in the list")
    page.until(lambda: page.revision() == revision + 1, "the map after it")
    page.until(lambda: touched(page.look("target"), first), "the preview's change")
    page.button("source", "Save landmarks")
    page.until(lambda: len(saved(files)) == count + 1, "the file")
    for side in ("target", "source"):
        assert misses(page, files, saved(files)[-1], side, FLANK) < CLOSE

    # Dragged elsewhere, it is there; undo puts it back, and away, redo and Delete do what they say.
    page.until(lambda: page.has_ball("target", count + 1), "its ball")
    page.drag("target", FLANK, DRAGGED)
    page.until(lambda: page.revision() == revision + 2, "the map after the drag")
    page.button("source", "Save landmarks")
    page.until(lambda: misses(page, files, saved(files)[-1], "target", DRAGGED) < CLOSE, "the dragged landmark")
    assert misses(page, files, saved(files)[-1], "source", FLANK) < CLOSE
    page.button("source", "Undo")
    page.until(lambda: page.revision() == revision + 3, "the map as before the drag")
    page.button("source", "Undo")
    page.until(lambda: page.landmarks() == count, "one landmark fewer")
    page.button("source", "Redo")
    page.until(lambda: page.landmarks() == count + 1, "the landmark again")
    page.choose("source", "Selected", "(none)")
    page.click("target", FLANK)  # on the ball: selects it
    page.button("source", "Delete")
    page.until(lambda: page.landmarks() == count, "no landmark there")
    page.button("source", "Save landmarks")
    page.until(lambda: len(saved(files)) == count, "the file as it was")


def test_the_next_landmark_is_proposed_on_both_models(page: Page) -> None:
    count = page.landmarks()
    page.button("source", "Next landmark")
    page.until(lambda: "accept the proposal" in page.text("status"), "a proposal")
    page.button("source", "Accept proposal")
    page.until(lambda: page.landmarks() == count + 1, "the proposed landmark")
    back_to(page, count)


def test_a_wrong_landmark_is_marked(page: Page) -> None:
    count = page.landmarks()
    half_a_landmark(page)
    page.click("source", HEAD)  # the flank of one is not the head of the other
    page.until(lambda: page.landmarks() == count + 1, "the landmark in the list")
    page.button("source", "Match again")
    page.until(lambda: "\u26a0" in page.text("list"), "the mark")
    for _ in range(2):  # its doubtful places are not red, and red again
        drawn = page.skin("target")
        page.switch("target", "Doubtful places")
        page.until(lambda drawn=drawn: page.skin("target") > drawn, "the target drawn otherwise")
    back_to(page, count)
    page.until(lambda: "\u26a0" not in page.text("list"), "no mark")


def test_views_change_what_is_shown(page: Page) -> None:
    page.choose("source", "Selected", "(none)")
    first = {side: page.settle(side) for side in ("target", "source")}
    seen = first["target"]
    for mode in ("colours", "checker", "plain"):
        page.choose("target", "Show", mode)
        page.until(lambda seen=seen: other(page.look("target"), seen), f"{mode} on the target")
        seen = page.settle("target")
    page.choose("target", "Show", "texture")
    page.until(lambda: not other(page.look("target"), first["target"]), "the texture again")
    page.switch("target", "Cages")
    page.until(lambda: all(bluish(page.look(side)) > bluish(first[side]) + 50 for side in first), "the cages")
    # Lines of some pixels, and not so many radii.
    assert max(float(np.abs(page.look(side) - first[side]).mean()) for side in first) < 30
    page.switch("target", "Cages")
    page.until(lambda: all(bluish(page.look(side)) < bluish(first[side]) + 50 for side in first), "no cages")
    # Turned together, then one alone, then framed.
    page.drag("target", BESIDE, (0.5, -0.85))
    page.until(lambda: other(page.look("source"), first["source"]), "the source turned with the target")
    page.button("target", "Frame")
    page.until(lambda: not any(other(page.look(side), first[side]) for side in first), "both as at first")
    page.switch("target", "Turn together")
    page.drag("target", BESIDE, (0.5, -0.85))
    page.until(lambda: other(page.look("target"), first["target"]), "the target turned")
    assert not other(page.settle("source"), first["source"])
    page.button("target", "Frame")
    page.switch("target", "Turn together")
    page.until(lambda: not other(page.look("target"), first["target"]), "the target as at first")


def test_landmarks_are_named_mirrored_and_go_through_every_form(page: Page, files: Files) -> None:
    known = page.landmarks()
    half_a_landmark(page)
    page.button("source", "Accept proposal")
    page.until(lambda: page.landmarks() == known + 1, "the landmark in the list")
    page.fill("source", "Name", "flank_L")
    page.until(lambda: "flank_L\t" in page.text("list"), "its name")
    page.button("source", "Mirror")
    page.until(lambda: "flank_R" in page.text("list"), "the landmark across")
    # Keys undo as the buttons do.
    page.choose("source", "Selected", "(none)")
    page.button("source", "Undo")
    page.until(lambda: "flank_R" not in page.text("list"), "one step back")
    page.button("source", "Redo")
    page.until(lambda: "flank_R" in page.text("list"), "one step forward")
    assert "flank_R" in page.choose("source", "Selected", "flank_R", exact=False)
    assert autosave_path(files.landmarks).is_file()
    every_form_is_saved_and_read(page, files, known + 2)
    back_to(page, known)
    page.button("source", "Save landmarks")
    page.until(lambda: len(saved(files)) == known, "the file as it was")


def every_form_is_saved_and_read(page: Page, files: Files, count: int) -> None:
    before = json.loads(files.landmarks.read_text())
    page.button("source", "Save landmarks")
    page.until(lambda: len(saved(files)) == count, "the file of pairs")
    written = {
        form.ending: points_file(files.landmarks.with_name(f"landmarks{form.ending}"), "target") for form in POINT_FORMS
    }
    for title, ending in FORMS.items():
        if ending != ".json":
            page.choose("source", "Save as", title)
            page.until(lambda ending=ending: page.value("source", "File").endswith(ending), f"the ending {ending}")
            page.button("source", "Save landmarks")
            page.until(written[ending].is_file, f"{ending} on disk")
    page.until(lambda: "order alone" in page.text("status"), "what Wrap's form cannot hold")
    page.choose("source", "Save as", next(iter(FORMS)))
    page.until(lambda: page.value("source", "File").endswith(files.landmarks.name), "the name of the file of pairs")
    (files.landmarks.parent / "wrong.json").write_text("{")
    (files.landmarks.parent / "first.json").write_text(json.dumps(before))
    page.button("source", "Save landmarks")  # lists what has come since
    page.unfold("source", "Load landmarks")
    load(page, "first.json", count - 2)
    page.choose("source", "And", "landmarks.source.mrk.json")
    load(page, "landmarks.target.mrk.json", count)
    page.choose("source", "And", "(none)")
    page.choose("source", "From", "wrong.json")
    page.button("source", "Load")
    page.until(lambda: "wrong.json, line 1: expected JSON" in page.text("status"), "what is wrong with the file")
    assert page.landmarks() == count
    page.unfold("source", "Load landmarks")


def load(page: Page, name: str, count: int) -> None:
    page.choose("source", "From", name)
    page.button("source", "Load")
    page.until(lambda: page.landmarks() == count, f"the landmarks of {name}")


def test_two_tabs_and_a_reconnect_show_one_state(page: Page) -> None:
    count, first = page.landmarks(), page.browser.current_window_handle
    page.browser.switch_to.new_window("tab")
    second = Page(page.browser, page.address)
    second.until(lambda: second.landmarks() == count, "the landmarks in the second tab")
    half_a_landmark(second)
    second.browser.close()
    page.browser.switch_to.window(first)
    page.until(lambda: "accept the proposal" in page.text("status"), "half a landmark in the first tab")
    page.button("source", "Accept proposal")
    page.until(lambda: page.landmarks() == count + 1, "the whole landmark")
    again = Page(page.browser, page.address)
    again.until(lambda: again.landmarks() == count + 1, "the same after closing and opening")
    back_to(again, count)


def test_an_error_is_named_and_the_bake_goes_on_after_it(page: Page, files: Files) -> None:
    page.fill("target", "Vertices", "200000")  # a match that lasts until it is cancelled
    page.choose("target", "Texels", "512")
    files.result.mkdir()
    (files.result / "thesis.tex").write_text("not ours")
    page.button("target", "Bake")
    page.until(lambda: "nothing is written to it" in page.text("status"), "the error")
    assert (files.result / "thesis.tex").read_text() == "not ours"
    shutil.rmtree(files.result)
    page.button("target", "Bake")
    page.until(lambda: "match:" in page.text("status"), "a running match")
    page.button("source", "Cancel")
    page.until(lambda: "finish: cancelled" in page.text("status"), "its end")
    assert not files.result.exists()
    page.fill("target", "Vertices", str(VERTICES))
    page.button("target", "Bake")
    page.until(lambda: "all as one zip" in page.text("outputs"), "the finish", 2 * PATIENCE)
    (baked,) = files.result.parent.glob("deer_from_*.png")
    assert read_image(baked).pixels.std() > 10
    assert page.link(baked.name) == baked.read_bytes()
    with zipfile.ZipFile(io.BytesIO(page.link("all as one zip"))) as archive:
        assert {baked.name, "RESULT/manifest.json", "RESULT.html"} <= set(archive.namelist())


def test_a_page_says_that_its_studio_ended_and_comes_back_with_it(
    running: Running, files: Files, held: dict[str, Any]
) -> None:
    held.pop("failed")  # its studio ends: a test after it begins anew
    page = running.page

    def gone() -> str:
        page.browser.switch_to.default_content()
        return str(page.browser.execute_script("return document.getElementById('gone').innerText"))

    assert gone() == ""
    page.browser.execute_script("window.before = true")
    running.process.kill()
    page.until(lambda: "The studio has ended" in gone(), "a word that it has ended")
    port = page.address.rstrip("/").rpartition(":")[2]
    with studio(*arguments(files), "--port", port) as (_, address):
        assert address == page.address
        page.until(lambda: not gone(), "the page again")
        page.until(lambda: page.revision() >= 1, "the right half again")
        page.until(lambda: page.text("names"), "the left half again")
        page.browser.switch_to.default_content()
        assert not page.browser.execute_script("return window.before ?? false")  # both halves, by a page of its own


def test_a_killed_studio_gives_its_landmarks_back(running: Running, files: Files) -> None:
    page = running.page
    count = len(saved(files))
    half_a_landmark(page)
    page.until(lambda: autosave_path(files.landmarks).is_file(), "the autosave")
    running.process.kill()
    assert len(saved(files)) == count
    running.start_again()
    page = running.page
    page.until(lambda: "recovered" in page.text("status"), "the recovered landmarks")
    page.button("source", "Accept proposal")
    page.until(lambda: page.landmarks() == count + 1, "the landmark completed")
    page.choose("source", "Selected", f"{count + 1} ", exact=False)
    page.button("source", "Delete")
    page.until(lambda: page.landmarks() == count, "no landmark more")


def test_files_are_added_faults_are_named_and_a_scan_is_taken_as_it_is(
    page: Page, files: Files, held: dict[str, Any], tmp_path: Path
) -> None:
    held.pop("failed")  # other models are open at its end: a test after it begins anew
    (tmp_path / "broken.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    write_mesh(tmp_path / "scan.obj", dense(DENSE))
    for name in ("broken.obj", "scan.obj"):
        page.upload("target", tmp_path / name)
        page.until(lambda name=name: f"added {name}" in page.text("status"), f"{name} in the lists")
        assert (files.target.parent / name).read_bytes() == (tmp_path / name).read_bytes()
    page.choose("target", "Target", "broken.obj")
    page.button("target", "Open")
    page.until(lambda: "broken.obj, line 4" in page.text("status"), "what is wrong with it")
    page.choose("target", "Target", "scan.obj")
    page.button("target", "Open")
    page.until(lambda: page.has_button("target", "Take the target as it is"), "the offer")
    page.button("source", "Cancel")  # its map as a cage
    page.button("target", "Take the target as it is")
    page.until(lambda: not page.has_button("target", "Take the target as it is"), "the scan as it is")
    page.until(lambda: "scan.obj" in page.text("names"), "its name")
