"""``python -m benchmarks.sure``: is a map with few landmarks or none right where it is said to be sure?

Draws ordered pairs of every sort at random, of all meshes of ../shared/data. Every pair is written as soon as it is
done; what is there is not measured again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from benchmarks.accuracy.data import DATA, REPOSITORY
from benchmarks.sure.judge import Surfaces, row
from benchmarks.sure.models import SORTS, drawn_pairs, models, sort_of
from benchmarks.verdicts import table


def key(entry: dict) -> tuple[str, str, int, int]:
    """What makes a row one of its own."""
    return entry["target"], entry["source"], entry["vertices"], entry["landmarks"]


def read(place: Path) -> list[dict]:
    """Rows of a file, one a line; none if it is not there."""
    return [json.loads(line) for line in place.read_text().splitlines()] if place.is_file() else []


def main() -> None:
    """Measure the pairs that are missing, and write the table of all."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sure", description=__doc__)
    parser.add_argument("--pairs", type=int, default=8, help="of every sort")
    parser.add_argument("--seed", type=int, default=16)
    parser.add_argument("--vertices", type=int, default=3000, help="of each refined surface, about")
    parser.add_argument("--landmarks", type=int, default=0, choices=range(3), help="that are given")
    parser.add_argument("--output", type=Path, default=REPOSITORY / "benchmarks" / "results" / "sure.jsonl")
    arguments = parser.parse_args()
    if not DATA.is_dir():
        parser.error("the meshes are not beside this checkout (../shared/data)")
    done, surfaces = {key(entry) for entry in read(arguments.output)}, Surfaces(arguments.vertices)
    for target, source in drawn_pairs(arguments.pairs, arguments.seed):
        if (target.name, source.name, arguments.vertices, arguments.landmarks) not in done:
            with arguments.output.open("a") as lines:
                lines.write(json.dumps(row(surfaces, target, source, arguments.landmarks)) + "\n")
    rows, named = read(arguments.output), {model.name: model for model in models()}
    groups = {
        f"{sort}, {count or 'no'} landmarks": [
            entry
            for entry in rows
            if sort_of(named[entry["target"]], named[entry["source"]]) == sort and entry["landmarks"] == count
        ]
        for count in range(3)
        for sort in SORTS
    }
    text = "\n".join(table({name: some for name, some in groups.items() if some})) + "\n"
    arguments.output.with_suffix(".md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
