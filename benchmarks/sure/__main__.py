"""``python -m benchmarks.sure``: is a map without landmarks right where it is said to be sure?

Goes over all ordered pairs of all meshes of ../shared/data, or over one share of them, at a small size. Every pair is
written as soon as it is done; what is there is not measured again. ``--collect FILES`` joins what shares have written.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

from benchmarks.accuracy.data import DATA, REPOSITORY
from benchmarks.sure.judge import Surfaces, row
from benchmarks.sure.models import ordered_pairs
from benchmarks.sure.tables import markdown


def key(entry: dict) -> tuple[str, str, int]:
    """What makes a row one of its own; another size wants another file."""
    return entry["target"], entry["source"], entry.get("landmarks", 0)


def read(place: Path) -> list[dict]:
    """Rows of a file, one a line; none if it is not there."""
    return [json.loads(line) for line in place.read_text().splitlines()] if place.is_file() else []


def collect(place: Path, others: list[Path]) -> None:
    """Join the rows of files into one; later files have the last word."""
    rows = {key(entry): entry for file in (place, *others) for entry in read(file)}
    place.write_text("".join(json.dumps(rows[name]) + "\n" for name in sorted(rows)))


def main() -> None:
    """Measure a share of the pairs, or collect shares."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sure", description=__doc__)
    parser.add_argument("--vertices", type=int, default=3000, help="of each refined surface, about")
    parser.add_argument("--landmarks", type=int, default=0, choices=range(3), help="that are given")
    parser.add_argument("--share", default="0/1", metavar="I/N", help="only the I-th of N equal shares, from 0")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="start no pair after this time")
    parser.add_argument("--output", type=Path, default=REPOSITORY / "benchmarks" / "results" / "sure.jsonl")
    parser.add_argument("--collect", type=Path, nargs="*", metavar="FILE", help="join these files, measure nothing")
    arguments = parser.parse_args()
    if not DATA.is_dir():
        parser.error("the meshes are not beside this checkout (../shared/data)")
    if arguments.collect is not None:
        collect(arguments.output, arguments.collect)
    else:
        start, (share, shares), pairs = time.monotonic(), map(int, arguments.share.split("/")), ordered_pairs()
        done, surfaces = {key(entry) for entry in read(arguments.output)}, Surfaces(arguments.vertices)
        for target, source in pairs[share * len(pairs) // shares : (share + 1) * len(pairs) // shares]:
            if time.monotonic() - start > arguments.seconds:
                break
            if (target.name, source.name, arguments.landmarks) not in done:
                with arguments.output.open("a") as lines:
                    lines.write(json.dumps(row(surfaces, target, source, arguments.landmarks)) + "\n")
    table = markdown(read(arguments.output))
    arguments.output.with_suffix(".md").write_text(table)
    print(table)


if __name__ == "__main__":
    main()
