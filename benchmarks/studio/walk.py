"""Tried as a new user would: spot and cow in a folder, `cagemap studio` there, and on to a baked texture."""

from __future__ import annotations

import shutil
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from tests.fixtures.browser_page import Page, chromium, studio

from benchmarks.accuracy.data import DATA
from benchmarks.studio.waits import LONG

# A hand and an eye need about this long for a click.
HAND = 2.0


@dataclass
class Walk:
    """Steps so far.

    Attributes
    ----------
    lines : list of str
        Rows of the table.
    clicks : int
    begin : float
    """

    lines: list[str] = field(default_factory=list)
    clicks: int = 0
    begin: float = field(default_factory=time.perf_counter)

    def step(self, what: str, clicks: int) -> None:
        """Note a step that is done."""
        self.clicks += clicks
        self.lines.append(f"| {what} | {clicks} | {time.perf_counter() - self.begin:.1f} |")


def walk(vertices: int | None, picture: Path | None = None) -> list[str]:
    """Walk; rows of the table. ``vertices``: of the finish, its own default if None."""
    with tempfile.TemporaryDirectory() as temporary, chromium() as browser:
        folder = Path(temporary)
        for name in ("spot.obj", "spot.mtl", "cow.obj", "cow.mtl", "spot_texture.png"):
            shutil.copy(DATA / "animals" / name, folder / name)
        steps = Walk()
        with studio("--folder", str(folder)) as (_, address):
            steps.step("`cagemap studio` in the folder of the models; the address is printed", 0)
            page = Page(browser, address)
            page.until(lambda: "Open two models" in page.text("status"), "the page")
            steps.step("the page is there (it opens by itself)", 0)
            page.press("open")
            page.set("models [name=target]", "cow.obj")
            page.set("models [name=source]", "spot.obj")
            guessed = "return document.querySelector('#models [name=texture]').value"
            page.until(lambda: page.run(guessed) == "spot_texture.png", "the guessed texture")
            steps.step("*Open…*, *Target* cow.obj, *Source* spot.obj; the texture is guessed", 5)
            page.press("open-now")
            page.until(lambda: page.revision() == 1, "the first map", LONG)
            steps.step("*Open*; the first map is shown", 1)
            if vertices is not None:
                page.option("", "Vertices", str(vertices))
            page.press("start")
            page.until(lambda: "everything" in page.text("outputs"), "the bake", LONG)
            steps.step("*Bake*, *Bake*; map, texture and report are written", 2)
            (baked,) = folder.glob("cow_from_*.png")
            if page.link(baked.name) != baked.read_bytes():
                raise AssertionError("the download is not the file")
            steps.step(f"the link {baked.name}; it is downloaded", 1)
            if picture is not None:
                page.screenshot(picture)
    waiting = time.perf_counter() - steps.begin
    return [
        "| step | clicks | seconds since the start |",
        "| --- | --- | --- |",
        *steps.lines,
        f"| together, with {HAND:.0f} s for each click | {steps.clicks} | {waiting + HAND * steps.clicks:.0f} |",
    ]
