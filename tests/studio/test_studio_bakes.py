"""The finish in a real browser: each kind of control used, files as the command line writes them, errors, ends."""

from __future__ import annotations

import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest
import typed_request
from test_studio_finish_files import compared, rich_finish, same, write_inputs

from cagemap.studio.finish import finish_commands
from cagemap.studio.opening import built_in_files
from cagemap.studio.state import Files
from cagemap.tasks.requests.catalogue import all_options

from browser_page import Page, studio
from running_studio import arguments

pytestmark = [pytest.mark.slow, pytest.mark.browser]
# Labels of the fields of `rich_finish` in their folds, and what is chosen or typed there; True: the box is pressed.
ASKED: dict[str, dict[str, str | bool]] = {
    "More images": {
        "Normal map": "normals.png",
        "Green": "down",
        "Displacement": "bumps.png",
        "Height scale": "0.01",
        "Sharpness": "linear",
        "Maps": "roughness=bumps.png",
    },
    "Detailed mesh": {"Mesh": "pony.obj", "normal": True, "ao": True, "Rays": "8"},
    "Rig": {"Skin weights": "skin.csv", "Influences": "1", "Blend shapes": "faces", "Attribute": "age.npy"},
    "Wrap": {"Wrap": True, "Fairness": "0.001", "Displacement": True, "Normal map": True, "MakeHuman file": True},
    "Match": {"Trust landmarks": True},
    "Files": {"Bits": "16", "UVs of the source": True, "Map file": ".npz", "Report": False},
}
# The images of the wrapped cage take 14 s more each time at 512 texels, the least that the page lists.
VERTICES, SIZE = 1000, 64
# Seconds that a finish of many commands may take on a loaded machine.
LONG = 400.0


def finished(page: Page, words: str) -> None:
    """Wait for the end of a finish."""
    page.until(lambda: page.said(words), words, LONG)


def test_what_the_page_bakes_is_what_the_command_line_writes(tmp_path: Path, browser: Any) -> None:
    (tmp_path / "page").mkdir()
    files = built_in_files(tmp_path / "page")
    write_inputs(files)
    shutil.copytree(tmp_path / "page", tmp_path / "line")
    with studio(*arguments(files, VERTICES)) as (process, address), ThreadPoolExecutor(1) as beside:
        page = Page(browser, address)
        page.until(lambda: page.revision() == 1, "the first map")
        fill_in(page)
        page.press("start")
        typed = beside.submit(run_typed, tmp_path / "line")
        page.until(lambda: page.text("status").startswith("Baking, step"), "a running finish")
        browser.get("about:blank")  # stops nothing
        page = Page(browser, address)
        finished(page, "Bake: done")
        same_files(files, typed.result())
        page.until(lambda: page.run("return !!window.studio.views.sides.target.images.baked"), "the bake on the model")
        assert page.state("baked").endswith(".png")
        fill_in(page)
        an_error_is_said_and_the_rest_is_made(page, files)
        a_killed_studio_leaves_nothing_half_written(page, files, process)


def fill_in(page: Page) -> None:
    """All options of the finish."""
    page.option("", "Vertices", str(VERTICES))
    page.run("document.querySelector('[data-key=\"transfer.size\"] select').add(new Option(arguments[0]))", str(SIZE))
    page.option("", "Image size", str(SIZE))
    for fold, fields in ASKED.items():
        for label, value in fields.items():
            page.option(fold, label, value)


def run_typed(folder: Path) -> Path:
    """Run the commands that one would type in a folder; returns it."""
    own = built_in_files(folder)
    asked = replace(rich_finish(own, SIZE, VERTICES), report=False)
    for command in finish_commands(all_options(), own, asked, use_landmarks=True):
        typed_request.run_typed(command.request)
    return folder


def same_files(files: Files, folder: Path) -> None:
    """The files of the page's bake are those of the commands that one would type."""
    typed = compared(folder)
    assert len(typed) > 20
    made = files.target.parent
    assert [path.name for path in typed if not same(path, made / path.relative_to(folder))] == []
    assert not list(made.glob("*.html"))


def an_error_is_said_and_the_rest_is_made(page: Page, files: Files) -> None:
    """A file of somebody else's is refused with the remedy, and the other images are baked, of the map there is."""
    theirs, other = (files.result.with_name(f"deer_from_pony_{name}.png") for name in ("normals", "bumps"))
    theirs.write_text("not ours")
    other.unlink()
    map_file = files.result / "map.npz"
    written = map_file.stat().st_mtime_ns
    page.press("start")
    finished(page, theirs.name)
    assert page.said("(Bake, Files, Overwrite)")
    assert theirs.read_text() == "not ours"
    page.until(other.is_file, "the image after it", LONG)
    page.press("cancel")
    # On a quick machine the last image may be there before the page's word arrives: then nothing is left to cancel.
    page.until(lambda: not page.state("baking"), "the end of the bake", LONG)
    assert map_file.stat().st_mtime_ns == written


def a_killed_studio_leaves_nothing_half_written(page: Page, files: Files, process: Any) -> None:
    """Whoever computes for a studio ends with it."""
    page.option("Files", "Name", "late")
    page.option("", "Vertices", "200000")  # lasts until it is killed
    page.press("start")
    page.until(lambda: page.text("status").startswith("Baking, step 1/"), "a running match")
    children = psutil.Process(process.pid).children(recursive=True)
    assert children
    process.kill()
    _, alive = psutil.wait_procs(children, timeout=60)
    assert alive == []
    time.sleep(0.1)
    folder = files.result.parent
    assert [path.name for path in folder.iterdir() if path.name.startswith("late") or ".part" in path.name] == []
