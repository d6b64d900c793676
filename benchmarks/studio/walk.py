"""Tried as a new user would: files are dropped on the page of `cagemap studio`, and *Bake* makes a picture."""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from tests.fixtures.browser_page import Page, chromium, studio

from benchmarks.accuracy.data import DATA
from benchmarks.processor import tree_time
from benchmarks.studio.waits import FULL_SIZE

TARGET, SOURCE = [DATA / "animals" / "cow.obj"], sorted((DATA / "animals").glob("spot[._]*"))
# Seconds that a step may last.
PATIENCE = 600.0
# Files of a hidden input are dropped on a half of the page, as a user drops them there.
DROP = """
const [files, side] = [document.getElementById('walk').files, document.getElementById(arguments[0])];
const data = new DataTransfer(), box = side.getBoundingClientRect();
for (const file of files) data.items.add(file);
side.dispatchEvent(new DragEvent('drop', {dataTransfer: data, bubbles: true, clientX: box.left + box.width / 2,
    clientY: box.top + box.height / 2}));
"""
INPUT = """
document.getElementById('walk')?.remove();
document.body.append(Object.assign(document.createElement('input'), {id: 'walk', type: 'file', multiple: true,
    hidden: true}));
"""


@dataclass
class Walk:
    """A page, and what was seen on it.

    Attributes
    ----------
    page : Page
    number : int
        Process of the studio.
    pictures : Path or None
        Folder for a picture of the page after each step.
    lines : list of str
        Rows of the table.
    """

    page: Page
    number: int
    pictures: Path | None
    lines: list[str] = field(default_factory=list)
    begin: float = field(default_factory=time.perf_counter)
    said: set[str] = field(default_factory=set)

    def row(self, what: str) -> None:
        """Note what was done or said, with wall seconds and processor seconds of the studio."""
        seconds = time.perf_counter() - self.begin
        self.lines.append(f"| {what} | {seconds:.1f} | {tree_time(self.number):.1f} |")
        print(self.lines[-1], flush=True)

    def drop(self, side: str, files: list[Path]) -> None:
        """Drop files on a half."""
        self.page.run(INPUT)
        self.page.browser.find_element("id", "walk").send_keys("\n".join(map(str, files)))
        self.page.run(DROP, side)
        self.row(f"*{', '.join(file.name for file in files)}* dropped on the {side}")

    def wait(self, step: str, done: str) -> None:
        """Note every new text until a script is true or an error is shown, then take a picture."""
        last, end = "", time.monotonic() + PATIENCE
        while time.monotonic() < end:
            for message in self.page.state("messages") or ():
                if message["text"] not in self.said:
                    self.said.add(message["text"])
                    self.row(f"{message['kind']}: {message['text']}".replace("\n", " "))
            if last != (text := self.page.text("status")):
                last = text
                self.row(text)
            if self.page.run(f"const {{state}} = window.studio; return {done}"):
                break
            time.sleep(0.2)
        else:
            self.row(f"{step}: not within {PATIENCE:.0f} s")
        self.row(f"**{step}**: {self.page.text('verdict')}")
        if self.pictures is not None:
            time.sleep(1.0)  # the last drawing
            self.page.screenshot(self.pictures / f"{step.replace(' ', '_')}.png")


def walk(target: list[Path] = TARGET, source: list[Path] = SOURCE, pictures: Path | None = None) -> list[str]:
    """Drop both models, wait for the map, bake; rows of the table."""
    with (
        tempfile.TemporaryDirectory() as folder,
        chromium(FULL_SIZE) as browser,
        studio("--folder", folder) as (process, address),
    ):
        steps = Walk(Page(browser, address), process.pid, pictures)
        steps.wait("start", "state.status.kind != 'busy'")
        steps.drop("target", target)
        steps.wait("target", "state.status.kind != 'busy'")
        steps.drop("source", source)
        steps.wait("map", "state.revision > 0 && state.status.kind != 'busy' || state.status.kind == 'error'")
        steps.page.press("tab-bake")
        steps.row(steps.page.text("bake-hint"))
        steps.page.press("start")
        ended = "!state.baking && state.messages.some(one => one.text.startsWith('Bake:'))"
        steps.wait("picture", f"state.view.mode == 'baked' || {ended}")
        steps.wait("bake", f"{ended} && state.status.kind != 'busy'")
        steps.row("; ".join(f"{one['what']} {one['name']}" for one in steps.page.state("outputs")))
        steps.row(f"baked picture: {steps.page.state('images') or 'none'}")
    return ["| | seconds | processor |", "| --- | --- | --- |", *steps.lines]


def main() -> None:
    """Walk with a user's files, or with spot and cow."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--target", nargs="+", type=Path, default=TARGET)
    parser.add_argument("--source", nargs="+", type=Path, default=SOURCE)
    parser.add_argument("--pictures", type=Path, help="folder for a picture of each step")
    asked = parser.parse_args()
    walk(asked.target, asked.source, asked.pictures)


if __name__ == "__main__":
    main()
