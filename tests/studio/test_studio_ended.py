"""What the end of a studio leaves, and files that are opened in its place, in a real browser."""

from __future__ import annotations

import time

import pytest
from test_studio_parts import dense

from cagemap.files.meshes.formats import write_mesh
from cagemap.studio.autosave import autosave_path
from cagemap.studio.models import MIN_SCAN_FACES

from browser_page import Page, studio
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
