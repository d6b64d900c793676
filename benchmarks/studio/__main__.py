"""Waits of the studio as its page shows them: start, first map, landmark to preview, answers while computing, frames.

Prints one table. Everything is measured in a headless Chromium with a software renderer; the machine's load is printed
beside, since all of it shares the processor.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from tests.browser_page import Page, chromium, studio

from cagemap.studio.opening import built_in_files

FRAMES = """
const done = arguments[arguments.length - 1], canvas = document.querySelector('canvas');
const box = canvas.getBoundingClientRect();
const at = x => ({bubbles: true, pointerId: 1, button: 0, buttons: 1, clientX: box.left + x, clientY: box.top + 5,
    pointerType: 'mouse', isPrimary: true});
const send = (kind, x) => canvas.dispatchEvent(new PointerEvent(kind, at(x)));
let count = 0, begin = performance.now();
send('pointerdown', 20);
const turn = () => {
    count += 1;
    document.dispatchEvent(new PointerEvent('pointermove', at(20 + 4 * count)));
    if (performance.now() - begin < 4000) requestAnimationFrame(turn);
    else { send('pointerup', 20); done(1000 * count / (performance.now() - begin)); }
};
requestAnimationFrame(turn);
"""


def waited(action: Callable[[], None], done: Callable[[], bool]) -> float:
    """Seconds from an action until something is so."""
    begin = time.perf_counter()
    action()
    while not done():
        if time.perf_counter() - begin > 300:
            raise TimeoutError
    return time.perf_counter() - begin


def measure(vertices: int) -> list[tuple[str, str]]:
    """Rows of the table for one size of preview."""
    rows = [
        ("load of the machine", f"{os.getloadavg()[0]:.0f} on {os.cpu_count()} cores"),
        ("vertices asked", f"{vertices}"),
    ]
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        files = built_in_files(Path(folder))
        named = ["--target", files.target, "--source", files.source, "--texture", files.texture]
        named += ["--landmarks", files.landmarks, "--result", files.result, "--vertices", vertices]
        begin = time.perf_counter()
        with studio(*map(str, named)) as (_, address):
            rows.append(("command to address", f"{time.perf_counter() - begin:.1f} s"))
            page = Page(browser, address)
            page.until(lambda: page.picture("source").std() > 12, "models")
            rows.append(("command to both models on screen", f"{time.perf_counter() - begin:.1f} s"))
            page.until(lambda: page.revision() == 1, "the first map")
            rows.append(("command to the first map", f"{time.perf_counter() - begin:.1f} s"))
            rows.append(("first map alone", page.text("map").split(",")[1].split("s")[0].strip() + " s"))
            rows += live(page)
    return rows


def newer(page: Page, revision: int) -> bool:
    """Whether a newer map is shown."""
    return page.revision() > revision


def shorter(page: Page, lines: int) -> bool:
    """Whether the list is shorter than it was."""
    return page.text("list").count("\n") < lines


def live(page: Page) -> list[tuple[str, str]]:
    """Landmark to preview, answers while computing, frames."""
    updates = []
    for k in range(5):
        page.click("target", (-0.2, 0.05 * k))
        page.until(lambda: "accept the proposal" in page.text("status"), "half a landmark")
        before = page.revision()
        updates.append(waited(partial(page.button, "source", "Accept proposal"), partial(newer, page, before)))
    answers = []
    page.button("source", "Match again")
    for _ in range(6):
        shown = page.text("list").count("\n")
        answers.append(waited(partial(page.button, "source", "Undo"), partial(shorter, page, shown)))
    page.until(lambda: "finding" not in page.text("status"), "the end of the computation")
    page.into("target")
    frames = page.browser.execute_async_script(FRAMES)
    return [
        ("landmark to preview, median of 5", f"{statistics.median(updates):.2f} s"),
        ("landmark to preview, best of 5", f"{min(updates):.2f} s"),
        ("answer while computing, median of 6", f"{1000 * statistics.median(answers):.0f} ms"),
        ("answer while computing, best of 6", f"{1000 * min(answers):.0f} ms"),
        ("frames a second while turning", f"{frames:.0f}"),
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vertices", type=int, nargs="+", default=[25_000])
    for vertices in parser.parse_args().vertices:
        for name, value in measure(vertices):
            print(f"| {name} | {value} |")


if __name__ == "__main__":
    main()
