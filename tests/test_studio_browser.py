"""The studio in a real browser: clicks, the live map, undo, files, wrong landmarks, the bake, what a kill leaves."""

from __future__ import annotations

import io
import json
import shutil
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from browser_page import Page, chromium, studio
from cagemap.files.images import read_image
from cagemap.files.meshes import read_mesh
from cagemap.mesh.cage_points import CagePoints
from cagemap.numerics.arrays import FloatArray
from cagemap.pipeline import choose_level
from cagemap.refinement import refine
from cagemap.studio.autosave import autosave_path
from cagemap.studio.opening import built_in_files
from cagemap.studio.page.view import FIELD_OF_VIEW, FIRST_VIEW
from cagemap.studio.places import places_of
from cagemap.studio.shape import Shape, pick, shape_of
from cagemap.studio.state import Files

pytestmark = [pytest.mark.slow, pytest.mark.browser]
VERTICES = 3000
# Of the first view; no landmark of the pair is near on either model.
FLANK = (-0.2, 0.0)
DRAGGED = (-0.16, -0.12)
# Of the model's radius: a pixel of the first view is 0.003.
CLOSE = 0.01


@pytest.fixture(scope="module")
def built_in(tmp_path_factory: pytest.TempPathFactory) -> Files:
    return built_in_files(tmp_path_factory.mktemp("built-in"))


@pytest.fixture
def files(built_in: Files, tmp_path: Path) -> Files:
    """The built-in pair in a folder of the test's own."""
    shutil.copytree(built_in.target.parent, tmp_path, dirs_exist_ok=True)
    moved = {
        name: tmp_path / getattr(built_in, name).name for name in ("target", "source", "texture", "landmarks", "result")
    }
    return replace(built_in, **moved)


def arguments(files: Files) -> list[str]:
    named = ["--target", files.target, "--source", files.source, "--texture", files.texture]
    named += ["--landmarks", files.landmarks, "--result", files.result, "--vertices", VERTICES]
    return list(map(str, named))


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as started:
        yield started


@pytest.fixture
def page(files: Files, browser: Any) -> Iterator[Page]:
    browser.get_log("performance")  # what earlier tests asked for
    with studio(*arguments(files)) as (_, address):
        yield Page(browser, address)


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


def test_clicks_and_drags_place_landmarks_where_they_end(page: Page, files: Files) -> None:
    count = len(saved(files))
    page.until(lambda: page.revision() == 1, "the first map")
    first = page.picture("target").astype(float)
    assert first.std() > 10, "no model on screen"
    page.click("target", FLANK)
    page.until(lambda: "accept the proposal" in page.text("status"), "the first half of a landmark")
    page.click("source", FLANK)
    page.until(lambda: f"{count + 1} landmarks" in page.text("list"), "the landmark in the list")
    page.until(lambda: page.revision() == 2, "the map after it")
    page.until(lambda: difference(page.picture("target"), first), "the preview's change")
    page.button("source", "Save landmarks")
    page.until(lambda: len(saved(files)) == count + 1, "the file")
    for side in ("target", "source"):
        assert misses(page, files, saved(files)[-1], side, FLANK) < CLOSE

    # Dragged elsewhere, it is there; undo puts it back, and away, redo and Delete do what they say.
    page.drag("target", FLANK, DRAGGED)
    page.until(lambda: page.revision() == 3, "the map after the drag")
    page.button("source", "Save landmarks")
    page.until(lambda: misses(page, files, saved(files)[-1], "target", DRAGGED) < CLOSE, "the dragged landmark")
    assert misses(page, files, saved(files)[-1], "source", FLANK) < CLOSE
    page.button("source", "Undo")
    page.until(lambda: page.revision() == 4, "the map as before the drag")
    page.button("source", "Undo")
    page.until(lambda: f"{count} landmarks" in page.text("list"), "one landmark fewer")
    page.button("source", "Redo")
    page.until(lambda: f"{count + 1} landmarks" in page.text("list"), "the landmark again")
    page.click("target", FLANK)  # on the ball: selects it
    page.button("source", "Delete")
    page.until(lambda: f"{count} landmarks" in page.text("list"), "no landmark there")
    # The next one is proposed on both models.
    page.button("source", "Next landmark")
    page.until(lambda: "accept the proposal" in page.text("status"), "a proposal")
    page.button("source", "Accept proposal")
    page.until(lambda: f"{count + 1} landmarks" in page.text("list"), "the proposed landmark")


def test_the_bake_is_on_disk_on_screen_and_can_be_cancelled(page: Page, files: Files) -> None:
    page.until(lambda: page.revision() == 1, "the first map")
    page.fill("target", "Vertices", str(VERTICES))
    page.button("target", "Bake")
    page.until(lambda: "match:" in page.text("status"), "a running match")
    page.button("source", "Cancel")
    page.until(lambda: "finish: cancelled" in page.text("status"), "its end")
    assert not files.result.exists()
    page.button("target", "Bake")
    page.until(lambda: "all as one zip" in page.text("outputs"), "the finish")
    (baked,) = files.result.parent.glob("deer_from_*.png")
    assert read_image(baked).pixels.std() > 10
    assert page.link(baked.name) == baked.read_bytes()
    with zipfile.ZipFile(io.BytesIO(page.link("all as one zip"))) as archive:
        assert {baked.name, "RESULT/manifest.json", "RESULT.html"} <= set(archive.namelist())


def test_a_wrong_landmark_is_marked(page: Page, files: Files) -> None:
    page.until(lambda: page.revision() >= 1, "the first map")
    count = len(saved(files))
    # The flank of one is not the head of the other.
    page.click("target", FLANK)
    page.until(lambda: "accept the proposal" in page.text("status"), "the first half of a landmark")
    page.click("source", (-0.02, 0.35))
    page.until(lambda: f"{count + 1} landmarks" in page.text("list"), "the landmark in the list")
    page.button("source", "Match again")
    page.until(lambda: "\u26a0" in page.text("list"), "the mark")


def test_a_killed_studio_gives_its_landmarks_back(files: Files, browser: Any) -> None:
    count = len(saved(files))
    with studio(*arguments(files)) as (process, address):
        page = Page(browser, address)
        page.until(lambda: page.revision() == 1, "the first map")
        page.click("target", FLANK)
        page.until(lambda: autosave_path(files.landmarks).is_file(), "the autosave")
        process.kill()
    assert len(saved(files)) == count
    with studio(*arguments(files)) as (_, address):
        page = Page(browser, address)
        page.until(lambda: "recovered" in page.text("status"), "the recovered landmarks")
        page.until(lambda: page.revision() == 1, "the map again")
        page.button("source", "Accept proposal")
        page.until(lambda: f"{count + 1} landmarks" in page.text("list"), "the landmark completed")


def test_two_tabs_and_a_reconnect_show_one_state(page: Page, files: Files) -> None:
    count = len(saved(files))
    page.until(lambda: page.revision() == 1, "the first map")
    first = page.browser.current_window_handle
    page.browser.switch_to.new_window("tab")
    second = Page(page.browser, page.address)
    second.until(lambda: second.revision() == 1, "the map in the second tab")
    second.click("target", FLANK)
    second.until(lambda: "accept the proposal" in second.text("status"), "half a landmark")
    second.browser.close()
    page.browser.switch_to.window(first)
    page.until(lambda: "accept the proposal" in page.text("status"), "half a landmark in the first tab")
    page.button("source", "Accept proposal")
    page.until(lambda: f"{count + 1} landmarks" in page.text("list"), "the whole landmark")
    again = Page(page.browser, page.address)
    again.until(lambda: f"{count + 1} landmarks" in again.text("list"), "the same after closing and opening")


def test_nothing_is_asked_of_other_machines(page: Page) -> None:
    page.until(lambda: page.revision() == 1, "the first map")
    events = [json.loads(entry["message"])["message"] for entry in page.browser.get_log("performance")]
    asked = [event["params"]["request"]["url"] for event in events if event["method"] == "Network.requestWillBeSent"]
    assert asked
    assert [url for url in asked if not url.startswith(("http://127.0.0.1", "data:", "blob:", "chrome"))] == []


def test_an_error_is_named_and_the_studio_goes_on(page: Page, files: Files) -> None:
    page.until(lambda: page.revision() == 1, "the first map")
    files.result.mkdir()
    (files.result / "thesis.tex").write_text("not ours")
    page.button("target", "Bake")
    page.until(lambda: "error" in page.text("status"), "the error")
    assert (files.result / "thesis.tex").read_text() == "not ours"
    page.button("source", "Match again")
    page.until(lambda: page.revision() == 2, "another map")


def difference(now: np.ndarray, before: FloatArray) -> bool:
    """Whether some place of a picture has become another."""
    return bool(np.abs(now - before).max(axis=2).mean() > 0.05)
