"""``python -m benchmarks.library.page``: the page of 500 simulated pairs in headless Chromium, into benchmarks/results.

Pictures are 300 x 150 JPEG files of some 14 kB, as `pair_rows` finds them; half of the rows have messages.
"""

from __future__ import annotations

import argparse
import io
import os
import statistics
import tempfile
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from tests.fixtures.browser_page import chromium

from benchmarks.processor import children_time
from cagemap.jobs.page import PairRow, build_library_page

RESULTS = Path(__file__).resolve().parents[1] / "results" / "library_page.md"
TRIES = 5
# From the navigation's start to the picture of the first rows on screen: two frames after the page has loaded.
OPENED = """
const done = arguments[arguments.length - 1];
const shown = () => requestAnimationFrame(() => requestAnimationFrame(() => done(performance.now())));
document.readyState == 'complete' ? shown() : addEventListener('load', shown);
"""
SORTED = """
const done = arguments[arguments.length - 1], begin = performance.now();
document.querySelectorAll('.library th')[3].click();
requestAnimationFrame(() => requestAnimationFrame(() => done(performance.now() - begin)));
"""


def rows(count: int) -> list[PairRow]:
    """Pairs as a night's job gives them."""
    rng = np.random.default_rng(0)
    made = []
    for number in range(count):
        ramp = np.linspace(0, 1, 300)[None, :, None] * rng.random(3) + np.linspace(0, 1, 150)[:, None, None]
        noise = rng.normal(0, 9, (150, 300, 1))
        picture = np.clip(90 * ramp + noise + 60, 0, 255).astype(np.uint8)
        stream = io.BytesIO()
        imageio.imwrite(stream, picture, extension=".jpg", quality=85)
        figures = {
            "flipped_area": float(rng.exponential(1e-3)),
            "coverage": float(1 - rng.exponential(1e-2)),
            "landmark_error_mean": float(rng.exponential(1e-3)),
            "landmark_error_worst": 0.01,
            "dirichlet": float(1 + rng.exponential(0.2)),
            "aspect_ratio_percentiles": {"50": 1.2, "95": 2.0},
            "trusted_area": float(1 - rng.exponential(0.05)),
            "warnings": [],
        }
        words = ("the ears of the source are covered twice, by the target's ears and its horns",) if number % 2 else ()
        name = f"model{number % 25}", f"model{number // 25}"
        files = (f"{name[0]}__{name[1]}/RESULT.html", f"{name[0]}__{name[1]}/skin.png")
        made.append(PairRow(*name, "good", words, 40.0, figures, 0.004, files, stream.getvalue()))
    return made


def measure(count: int) -> list[str]:
    """Rows of the table."""
    page = build_library_page(f"{count} simulated pairs", rows(count))
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        file = Path(folder) / "index.html"
        file.write_text(page, encoding="utf-8")
        opened, spent, sorts = [], [], []
        for _ in range(TRIES):
            browser.get("about:blank")
            before = children_time()
            browser.get(file.as_uri())
            opened.append(browser.execute_async_script(OPENED) / 1000)
            spent.append(children_time() - before)
            sorts.append(browser.execute_async_script(SORTED) / 1000)
        browser.save_screenshot(str(Path(folder) / "page.png"))
    return [
        "| | |",
        "| --- | --- |",
        f"| load of the machine | {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores |",
        f"| pairs, size of the page | {count}, {len(page.encode()) / 1e6:.1f} MB |",
        f"| opened, median and best of {TRIES} | {statistics.median(opened):.2f} s, {min(opened):.2f} s |",
        f"| processor time of that, median and best | {statistics.median(spent):.2f} s, {min(spent):.2f} s |",
        f"| sorted by a figure, median and best | {statistics.median(sorts):.2f} s, {min(sorts):.2f} s |",
    ]


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=500)
    text = "\n".join(["# The page of a library", "", *measure(parser.parse_args().pairs), ""])
    RESULTS.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
