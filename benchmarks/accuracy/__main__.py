"""``python -m benchmarks.accuracy [--pairs ...] [--vertices N ...] [--methods elastic hfm pyfm]``: measure, write."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from benchmarks.accuracy.data import ANIMALS, BARS, DATA, HUMANS, REPOSITORY
from benchmarks.accuracy.measure import animal_rows, human_rows
from benchmarks.accuracy.tables import markdown

RESULTS = REPOSITORY / "benchmarks" / "results"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy", description="Protocol B: accuracy.")
    parser.add_argument("--pairs", nargs="*", choices=list(HUMANS), default=list(BARS), help="human pairs, with truth")
    parser.add_argument("--animals", nargs="*", choices=list(ANIMALS), default=[], help="pairs without truth")
    parser.add_argument("--vertices", type=int, nargs="+", default=[25_000], help="of each refined surface, about")
    parser.add_argument("--landmarks", type=int, nargs="+", choices=[14, 30], default=[14, 30])
    parser.add_argument("--methods", nargs="+", choices=["elastic", "hfm", "pyfm"], default=["elastic", "hfm"])
    parser.add_argument("--pyfm", metavar="PYTHON", help="interpreter with pyfmaps 1.3.1, for the method pyfm")
    parser.add_argument("--peer-seconds", type=float, default=900.0, help="longest ZoomOut of pyFM")
    parser.add_argument("--left-out", type=int, default=4, help="landmarks left out, one at a time, for animals")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder of accuracy.json and accuracy.md")
    arguments = parser.parse_args()
    if not DATA.is_dir():
        parser.error("the meshes are not beside this checkout (../shared/data)")
    if "pyfm" in arguments.methods and not arguments.pyfm:
        parser.error("--methods pyfm: name its interpreter with --pyfm PYTHON")
    arguments.output.mkdir(parents=True, exist_ok=True)
    place = arguments.output / "accuracy.json"
    figures = json.loads(place.read_text()) if place.is_file() else {"humans": [], "animals": []}

    def keep(table: str, rows: list[dict]) -> None:
        """Replace the rows of the same runs and write at once: a long run may be interrupted."""
        names = ("pair", "source", "method", "landmarks", "vertices")
        new = {tuple(map(str, (row[name] for name in names))) for row in rows}
        old = [row for row in figures[table] if tuple(map(str, (row[name] for name in names))) not in new]
        figures[table] = old + rows
        place.write_text(json.dumps(figures, indent=1) + "\n")
        (arguments.output / "accuracy.md").write_text(markdown(figures))

    for vertices in arguments.vertices:
        for key in arguments.pairs:
            for method in arguments.methods:
                keep(
                    "humans",
                    human_rows(
                        HUMANS[key], vertices, arguments.landmarks, method, arguments.pyfm, arguments.peer_seconds
                    ),
                )
        for key in arguments.animals:
            for method in arguments.methods:
                if method != "pyfm":
                    keep("animals", animal_rows(key, vertices, method, arguments.left_out))
    print(markdown(figures))


main()
