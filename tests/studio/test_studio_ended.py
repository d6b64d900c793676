"""Studios of their own in a real browser: parts, other answers, the token, and what the end leaves."""

import socket
import time
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from examples.shapes import creature, cube
from test_studio_parts import dense, named

from cagemap.files.meshes.formats import write_mesh
from cagemap.mesh.parts import join_meshes
from cagemap.studio.autosave import autosave_path
from cagemap.studio.models import MIN_SCAN_FACES

from browser_page import PATIENCE, Page, studio
from example_character import bare_body, character, write_character
from refusals import refuses
from running_studio import arguments, half_a_landmark, saved

pytestmark = [pytest.mark.slow, pytest.mark.browser]
# Seconds within which a page is back once its studio answers; its models come as soon as they are read.
WHOLE = 5.0


def test_a_page_says_that_its_studio_ended_and_is_whole_again(running, files, record_property):
    """Killed at five moments: nothing is lost, landmarks are recovered, and the same page shows them again."""
    page, port = running.page, running.page.address.rstrip("/").rpartition(":")[2]
    page.run("window.before = true")
    count = page.landmarks()
    for moment in ("at rest", "half a landmark", "while it matches", "while it bakes", "while files are chosen"):
        if moment == "half a landmark":
            page.set("symmetric", False)
            half_a_landmark(page)
            page.until(lambda: autosave_path(files.landmarks).is_file(), "the autosave")
        elif moment == "while it matches":
            page.press("again")
            page.until(lambda: page.state("status")["kind"] == "busy", "a match")
        elif moment == "while it bakes":
            page.press("start")
            page.until(lambda: page.text("status").startswith("Baking, step 1/"), "a bake")
        elif moment == "while files are chosen":
            page.press("open")
        running.process.kill()
        assert len(saved(files)) == count
        page.until(lambda: "has ended" in page.text("status"), f"{moment}: a word that it has ended")
        running.process, address = running.begun.enter_context(studio(*arguments(files), "--port", port, forks=True))
        assert address == page.address
        ready = time.monotonic()
        page.until(lambda: "has ended" not in page.text("status"), f"{moment}: the page again", WHOLE)
        page.until(lambda: page.state("models"), f"{moment}: its models")
        record_property(f"{moment}: seconds to the models", time.monotonic() - ready)
        page.until(lambda: page.landmarks() == count, f"{moment}: its landmarks")
        if moment in ("at rest", "half a landmark", "while files are chosen"):  # at the others it is matching
            page.until(lambda: page.revision() >= 1, f"{moment}: its map")
        if moment == "half a landmark":
            page.until(lambda: page.said("recovered"), "the recovered landmarks")
            assert page.state("proposal")
            complete_and_delete(page, count)
    page.run("document.getElementById('models').close()")
    assert not files.result.exists()  # the bake left nothing half made
    assert page.run("return window.before")  # the very same page


def complete_and_delete(page: Page, count: int) -> None:
    """Accept the proposed place of the landmark that waits, then delete the landmark."""
    page.set("symmetric", False)
    page.press("accept")
    page.until(lambda: page.landmarks() == count + 1, "the landmark completed")
    page.select(count + 1)
    page.press("delete")
    page.until(lambda: page.landmarks() == count, "no landmark more")


def test_files_are_added_faults_are_named_and_a_scan_is_taken_as_it_is(page, files, held, tmp_path):
    held.pop("failed")  # other models are open at its end: a test after it begins anew
    (tmp_path / "broken.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    write_mesh(tmp_path / "scan.obj", dense(MIN_SCAN_FACES))
    page.press("open")
    for name in ("broken.obj", "scan.obj"):
        page.upload(tmp_path / name)
        page.until(lambda name=name: page.said(f"added {name}"), f"{name} in the lists")
        assert (files.target.parent / name).read_bytes() == (tmp_path / name).read_bytes()
    page.until(lambda: page.run("return [...document.querySelector('[name=target]').options].length") > 3, "the list")
    page.run("const at = document.querySelector('[name=target]'); at.value = 'broken.obj';")
    page.press("open-now")
    page.until(lambda: "broken.obj, line 4" in page.text("status"), "what is wrong with it")
    # A file that is dropped on a half is opened there; an image dropped with a target is the target's own.
    drop = """const data = new DataTransfer(); data.items.add(new File([arguments[0]], 'dropped.obj'));
        data.items.add(new File(['none'], 'own.png'));
        const at = document.getElementById('target').getBoundingClientRect();
        document.getElementById('views').dispatchEvent(new DragEvent('drop', {dataTransfer: data, bubbles: true,
            cancelable: true, clientX: at.left + 5, clientY: at.top + 5}))"""
    page.run(drop, (tmp_path / "scan.obj").read_text())
    page.until(lambda: page.state("models") and page.state("models")["target"]["name"] == "dropped.obj", "the drop")
    assert (files.target.parent / "own.png").is_file()
    assert page.state("files")["texture"] != "own.png"
    dense_target = "return window.studio.state.models?.target.dense"
    page.until(lambda: page.run(dense_target), "the offer")
    page.press("cancel")  # its map as a cage
    page.press("plain-target")
    page.until(lambda: page.run(dense_target) is False, "the scan as it is")

    # Chosen in the dialog; the image is guessed, and how a model is taken is not said of the next one, nor its files.
    page.option("Detailed mesh", "Mesh", "scan.obj")
    page.option("Files", "Name", "scan")
    page.until(lambda: page.revision() >= 1, "its map")
    page.set("wrapAmount", 1.0)
    page.press("open")
    page.set("models [name=target]", "deer.obj")
    page.set("models [name=source]", "pony.obj")
    page.until(lambda: page.run("return document.querySelector('[name=texture]').value") == "pony.png", "the image")
    assert page.run("return document.getElementById('scheme-target').value") == ""
    page.set("scheme-source", "bilinear")
    page.press("open-now")
    chosen = "const files = window.studio.state.files; return [files.target, files.schemes[1]]"
    page.until(lambda: page.run(chosen) == ["deer.obj", "bilinear"], "the pair as it was chosen")
    typed = """return ['transfer.detail', 'name'].map(key => document.querySelector(
        `[data-key="${key}"] select, [data-key="${key}"] input`).value)"""
    assert page.run(typed) == ["", ""]
    assert page.run("return document.getElementById('wrapAmount').value") == "0"
    page.until(lambda: page.state("models"), "the pair")
    page.press("plain-source")
    page.until(lambda: page.run(chosen) == ["deer.obj", "none"], "the source as it is")
    for side, button in (("target", "turn-target"), ("source", "turn-source")):
        page.until(lambda: page.state("models"), "both models")
        page.drawn()
        tall = f"return window.studio.views.sides.{side}.tall"
        before = page.run(tall)
        page.press(button)
        page.until(lambda tall=tall, before=before: abs(page.run(tall) - before) > 0.01, f"the {side} on its side")


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
