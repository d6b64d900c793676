"""The finish in a real browser: each kind of control used, files as the command line writes them."""

import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import typed_request
from test_studio_finish_process import compared, rich_finish, same, write_inputs

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


def test_what_the_page_bakes_is_what_the_command_line_writes(tmp_path: Path, browser: Any) -> None:
    (tmp_path / "page").mkdir()
    files = built_in_files(tmp_path / "page")
    write_inputs(files)
    shutil.copytree(tmp_path / "page", tmp_path / "line")
    with studio(*arguments(files, VERTICES)) as (_, address), ThreadPoolExecutor(1) as beside:
        page = Page(browser, address)
        page.until(lambda: page.revision() == 1, "the first map")
        fill_in(page)
        page.press("start")
        typed = beside.submit(run_typed, tmp_path / "line")
        page.until(lambda: page.text("status").startswith("Baking, step"), "a running finish")
        browser.get("about:blank")  # stops nothing
        page = Page(browser, address)
        page.until(lambda: page.said("Bake: done"), "the end", LONG)
        same_files(files, typed.result())
        page.until(lambda: page.run("return !!window.studio.views.sides.target.images.baked"), "the bake on the model")
        assert page.state("baked").endswith(".png")


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
