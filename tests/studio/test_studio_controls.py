"""Studios of their own in a real browser: parts and other answers, the token."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from examples.shapes import creature, cube
from test_studio_parts import named

from cagemap.files.meshes.formats import write_mesh
from cagemap.mesh.parts import join_meshes

from browser_page import PATIENCE, Page, studio
from example_character import bare_body, character, write_character
from refusals import refuses

pytestmark = [pytest.mark.slow, pytest.mark.browser]


def models(folder: Path) -> None:
    """A small box and a body in one file for each side."""
    eye = cube()
    eye = eye.with_positions(0.3 * eye.positions + np.array([0.0, 4.0, 0.0]))
    # One surface on both sides would have one answer only.
    for side, longer in (("a", [1.0, 1.0, 1.0]), ("b", [1.0, 1.05, 1.0])):
        shapes = {"eye": eye, "body": creature()}
        parts = [named(one.with_positions(one.positions * longer), name) for name, one in shapes.items()]
        write_mesh(folder / f"{side}.obj", join_meshes(parts))


def test_parts_are_chosen_and_other_answers_are_one_click_away(tmp_path: Path, browser: Any) -> None:
    models(tmp_path)
    asked = ["--target", str(tmp_path / "a.obj"), "--source", str(tmp_path / "b.obj")]
    with studio(*asked, "--vertices", "800", forks=True) as (_, address):
        page = Page(browser, address)
        page.until(lambda: page.opened("target") == "object:body", "the largest parts")
        page.drawn()
        shown = page.look("target")
        page.set("other_parts", False)
        page.until(lambda: not np.array_equal(page.look("target"), shown), "the eye away")
        before = page.state("said")
        # Choosing a part cancels the match of the bodies, and that of a box with a body, which would take 25 s.
        for side, part in (("target", "part-target"), ("source", "part-source")):
            page.set(part, "object:eye")
            page.until(lambda side=side: page.opened(side) == "object:eye", f"the eye of the {side}")
        found = "the map of it"  # six seconds of a processor that others may use too
        page.until(lambda: page.revision() == 1 and page.state("said") != before, found, 3 * PATIENCE)
        assert page.text("verdict").startswith("Two answers")
        assert "Next landmark" in page.state("said")[0]
        # Asked about, a place is marked on both models and named; it is no landmark.
        page.drawn()
        page.click("target", (0.0, 0.0), shift=True)
        page.until(lambda: "eye \u2192 eye" in page.text("status"), "the parts of both places")
        assert all(page.run("return Object.values(window.studio.views.sides).map(side => side.marks.length)"))
        assert page.landmarks() == 0
        # A box on a cube: other answers are buttons.
        answers = "return [...document.querySelectorAll('#answers button')]"
        page.until(lambda: len(page.run(answers)) > 1, "other answers")
        # Long names wrap, and no button is lower than its text.
        long = "document.querySelectorAll('#answers button').forEach(one => one.textContent = 'limbs '.repeat(50));"
        heights = page.run(f"{long} {answers}.map(one => [one.scrollHeight, one.clientHeight])")
        assert all(text <= button for text, button in heights)
        page.run(f"{answers}[1].click()")
        page.until(lambda: page.revision() == 2, "the other answer")
        assert page.state("chosen") == 1


def test_an_animated_source_poses_both_models(tmp_path: Path, browser: Any) -> None:
    body = bare_body(1)
    write_character(tmp_path / "C.glb", character(body))
    write_mesh(tmp_path / "B.glb", body)
    asked = ["--target", str(tmp_path / "B.glb"), "--source", str(tmp_path / "C.glb"), "--vertices", "800"]
    with studio(*asked, forks=True) as (_, address):
        page = Page(browser, address)
        page.until(lambda: page.revision() == 1, "the first map")
        page.drawn()
        rest = [page.look(side) for side in ("target", "source")]
        page.set("pose", "nod, 0.75 s")
        page.until(lambda: page.state("view")["pose"] == "nod, 0.75 s", "the pose")
        for side, still in zip(("target", "source"), rest, strict=True):
            page.until(lambda side=side, still=still: np.abs(page.look(side) - still).mean() > 1, f"a posed {side}")
        assert "posed" in page.text("status")
        page.click("target", (0.0, 0.0))
        page.until(lambda: "Set Pose back to rest" in page.text("status"), "why no landmark is placed")
        page.set("pose", "")
        for side, still in zip(("target", "source"), rest, strict=True):
            page.until(lambda side=side, still=still: np.abs(page.look(side) - still).mean() < 0.1, f"{side} at rest")
        assert page.landmarks() == 0
        assert not page.state("proposal")


def test_files_of_another_folder_are_listed_with_its_name(tmp_path: Path, browser: Any) -> None:
    listed = "return [...document.querySelector('#models [name=target]').options].map(one => [one.value, one.text])"
    for name in ("studio", "scans"):
        (tmp_path / name).mkdir()
        write_mesh(tmp_path / name / "box.obj", cube())
    folders = [word for name in ("studio", "scans") for word in ("--folder", str(tmp_path / name))]
    with studio(*folders) as (_, address):
        page = Page(browser, address)
        page.until(lambda: len(page.run(listed)) > 1, "the files")
        assert page.run(listed)[1:] == [["box.obj", "box.obj"], ["../scans/box.obj", "box.obj (folder scans)"]]


def test_another_machine_needs_the_token(tmp_path: Path, browser: Any) -> None:
    with studio("--folder", str(tmp_path), "--host", "0.0.0.0") as (_, address):
        here = address.replace(socket.gethostname(), "127.0.0.1", 1)
        bare, _, token = here.partition("?token=")
        assert token
        for wrong in (bare, f"{bare}?token=wrong", f"{bare}page.js"):
            refuses(HTTPError, "403", urlopen, wrong)
        page = Page(browser, here)
        page.until(lambda: "Open two models" in page.text("status"), "the page, with the token")
