"""``python -m benchmarks.studio``: waits of studio and report, and a new user's walk; benchmarks/results/studio.md.

Everything is measured in a headless Chromium with a software renderer, which shares the processor with the studio; the
load of the machine is printed beside.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path

from benchmarks.accuracy.data import DATA
from benchmarks.studio.waits import Rows, many_rows, map_rows, report_rows, start_rows
from benchmarks.studio.walk import walk
from cagemap.studio.opening import built_in_files, default_files
from cagemap.studio.state import Files

RESULTS = Path(__file__).resolve().parents[1] / "results" / "studio.md"
PARTS = ("start", "map", "many", "walk", "report")


def copied(folder: Path, target: str, source: str) -> Files:
    """Two models of the shared data in a folder of their own."""
    for name in {target, source}:
        shutil.copy(DATA / name, folder / Path(name).name)
    return default_files(folder / Path(target).name, folder / Path(source).name, None)


def bodies(folder: Path) -> Files:
    """Two bodies whose first levels have 100k vertices together: no level of the built-in pair is near that."""
    return copied(folder, "humans/base_male_young.obj", "humans/base_female_old_heavy.obj")


def head(folder: Path) -> Files:
    """A head beside itself: half a million triangles each on level 3."""
    return copied(folder, *["heads/mh_head_male_young.obj"] * 2)


def table(rows: Rows) -> list[str]:
    """Rows as a table."""
    return ["| | |", "| --- | --- |", *(f"| {name} | {value} |" for name, value in rows)]


def measured(title: str, make: Callable[[], list[str]]) -> list[str]:
    """A section; one that fails says so and does not keep the others from being measured."""
    load = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    try:
        lines = make()
    except Exception:
        traceback.print_exc()
        lines = ["not measured: " + traceback.format_exc().strip().splitlines()[-1]]
    section = [f"## {title}", "", f"({load})", "", *lines, ""]
    print("\n".join(section), flush=True)
    return section


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--displayed", type=int, default=100_000, help="vertices of both models at the start")
    parser.add_argument("--vertices", type=int, default=25_000, help="of each model of the live map")
    parser.add_argument("--many", type=int, default=250_000, help="of each model beside itself: two triangles a vertex")
    parser.add_argument("--landmarks", type=int, default=200)
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        files = built_in_files(Path(folder))
        makes: dict[str, tuple[str, Callable[[], list[str]]]] = {
            "start": ("Start", lambda: table(start_rows(bodies(Path(folder)), asked.displayed))),
            "map": ("The live map", lambda: table(map_rows(files, asked.vertices))),
            "many": (
                "Many landmarks, many triangles",
                lambda: table(many_rows(head(Path(folder)), asked.many, asked.landmarks)),
            ),
            "report": ("The report", lambda: table(report_rows(bodies(Path(folder)), asked.displayed // 2))),
            "walk": ("Spot to cow, from nothing to a baked texture", walk),
        }
        lines = ["# The studio", ""]
        for part in asked.parts:
            lines += measured(*makes[part])
    asked.output.write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
