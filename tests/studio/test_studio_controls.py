"""Studios of their own in a real browser: parts and other answers, the token, and how soon the page answers."""

from __future__ import annotations

import json
import re
import socket
import statistics
import sys
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from examples.shapes import creature, cube
from test_studio_parts import named

from cagemap.cli import main
from cagemap.files.meshes.formats import write_mesh
from cagemap.mesh.join import join_meshes
from cagemap.studio.opening import built_in_files

from browser_page import Page, studio

pytestmark = [pytest.mark.slow, pytest.mark.browser]
# Waits that no loaded machine has without a fault of ours; the bars are measured by `benchmarks.studio`.
LONGEST_UPDATE, LONGEST_ANSWER = 20.0, 5.0


def models(folder: Path) -> None:
    """A small box and a body in one file for each side, and in files of their own."""
    eye = cube()
    eye = eye.with_positions(0.3 * eye.positions + np.array([0.0, 4.0, 0.0]))
    # One surface on both sides would have one answer only.
    for side, longer in (("a", [1.0, 1.0, 1.0]), ("b", [1.0, 1.05, 1.0])):
        shapes = {"eye": eye, "body": creature()}
        parts = [named(one.with_positions(one.positions * longer), name) for name, one in shapes.items()]
        for name, part in zip(shapes, parts, strict=True):
            write_mesh(folder / f"{side}_{name}.obj", part)
        write_mesh(folder / f"{side}.obj", join_meshes(parts))


@pytest.mark.parametrize(
    ("target", "source", "verdict", "heading"),
    [
        ("body", "body", "sure", "The map looks sound."),
        ("eye", "body", "look at it", "Look at this map first: it may not be the right one."),
        ("eye", "eye", "two answers", "Two answers: which is right?"),
    ],
)
def test_how_sure_a_map_is_reads_alike_on_terminal_in_manifest_and_report(
    tmp_path: Path, browser: Any, small_pages: None, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str], target: str, source: str, verdict: str, heading: str,
) -> None:  # fmt: skip
    models(tmp_path)
    files = ["--target", f"{tmp_path}/a_{target}.obj", "--source", f"{tmp_path}/b_{source}.obj"]
    folder, page = tmp_path / "R", tmp_path / "report.html"
    for words in (["match", *files, "--vertices", "600", "-o", folder], ["report", folder, "-o", page]):
        monkeypatch.setattr(sys, "argv", ["cagemap", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        assert not ended.value.code
    terminal = capsys.readouterr()
    known = json.loads((folder / "manifest.json").read_text())["confidence"]
    assert known["verdict"] == verdict
    message = known["message"].replace("`answer=1`", "--answer 1")
    assert message in (terminal.out if verdict == "sure" else terminal.err)
    browser.get(page.as_uri())
    shown = browser.find_element("tag name", "main").text
    # The page names a mark where the terminal names a vertex.
    assert message.partition("target vertex")[0] in shown
    assert heading in shown
    assert ("which is right?" in shown) == (verdict != "sure")


def test_parts_are_chosen_and_other_answers_are_one_click_away(tmp_path: Path, browser: Any) -> None:
    models(tmp_path)
    asked = ["--target", str(tmp_path / "a.obj"), "--source", str(tmp_path / "b.obj"), "--source-part", "object:eye"]
    with studio(*asked, "--vertices", "800") as (_, address):
        page = Page(browser, address)
        page.until(lambda: page.revision() == 1, "the first map, of the largest part of one")
        shown = page.settle("target")
        page.switch("target", "Other parts")
        page.until(lambda: not np.array_equal(page.look("target"), shown), "the eye away")
        # Asked about, a place is a ball on both models and named; it is no landmark.
        page.click("target", (0.0, 0.0), shift=True)
        page.until(lambda: "body \u2192 eye" in page.text("status"), "the parts of both places")
        assert page.landmarks() == 0
        before = page.text("map")
        page.choose("target", "Target part", "object:eye (6 faces)")
        page.until(lambda: page.text("names").count(", eye, ") == 2, "the eye")
        page.until(lambda: page.revision() == 1 and page.text("map") != before, "the map of it")
        decides = re.search(r"two answers: .* A landmark at target vertex \d+ decides", page.text("map"))
        assert decides is not None, page.text("map")
        # A box on a cube: other answers are buttons.
        before = page.text("map")
        page.button("source", page.until(lambda: page.answers()[1:], "other answers")[0])
        page.until(lambda: page.revision() == 2, "the other answer")
        assert page.text("map") != before
        page.choose("target", "Source part", "object:body", exact=False)
        page.until(lambda: ", body, " in page.text("names"), "the body")
        page.until(lambda: "look at it: " in page.text("map"), "that a body on a box is not sure")
        page.choose("target", "Target part", "object:body", exact=False)
        page.until(lambda: "sure: " in page.text("map"), "that a body on a body is")


def test_another_machine_needs_the_token(tmp_path: Path, browser: Any) -> None:
    with studio("--folder", str(tmp_path), "--host", "0.0.0.0") as (_, address):
        here = address.replace(socket.gethostname(), "127.0.0.1", 1)
        bare, _, token = here.partition("?token=")
        assert token
        for wrong in (bare, f"{bare}?token=wrong", f"{bare}target/"):
            with pytest.raises(HTTPError, match="403"):
                urlopen(wrong)
        page = Page(browser, here)
        page.until(lambda: "Choose a target" in page.text("status"), "the page, with the token")


def test_a_landmark_is_answered_at_once(
    tmp_path: Path, browser: Any, record_property: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    files = built_in_files(tmp_path)
    asked = ["--target", str(files.target), "--source", str(files.source), "--texture", str(files.texture)]
    with studio(*asked, "--landmarks", str(files.landmarks), "--vertices", "25000") as (_, address):
        page = Page(browser, address)
        page.until(lambda: page.revision() == 1, "the first map")
        updates = []
        for k in range(4):
            page.click("target", (-0.2, 0.05 * k - 0.1))
            page.until(lambda: "accept the proposal" in page.text("status"), "half a landmark")
            pattern = f"^map {page.revision() + 1},"
            updates.append(page.pressed("Accept proposal", "map", pattern, pictures=2))
        page.pressed("Match again", "status", "finding the map")
        answers = [page.pressed("Undo", "list") for _ in range(4)]
        assert "finding the map" in page.text("status"), "answers were to be measured beside a computation"
    # The first one comes to compiled code that was not loaded yet.
    said = {
        "landmark to preview": statistics.median(updates[1:]),
        "answer beside a computation": statistics.median(answers),
    }
    for what, seconds in said.items():
        record_property(what, seconds)
    with capsys.disabled():
        sys.stdout.write("\n" + ", ".join(f"{what}: {seconds:.2f} s" for what, seconds in said.items()) + "\n")
    assert said["landmark to preview"] < LONGEST_UPDATE
    assert said["answer beside a computation"] < LONGEST_ANSWER
