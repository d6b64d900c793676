"""``python -m benchmarks.passengers [MAP ...] [--chosen] [--out FILE]``: passengers against MakeHuman's own fitting.

MAP is perfect (base topology on both sides), base (matched with 14 landmarks) or soma18056 (matched, another topology).
Parameters were chosen on neutral <-> male_young (``--chosen``) and are judged on male_young <-> female_old_heavy.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks.accuracy.posed import landmarks_of
from benchmarks.passengers.measure import PARTS, judge, part, surface
from benchmarks.riding.scenes import body
from cagemap.character.passengers import carry_passengers
from cagemap.maps.point_map import PointMap
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import choose_level, match, prepare_surface

VERTICES = 25_000
MAPS = ("perfect", "base", "soma18056")
CHOSEN, JUDGED = ("neutral", "male_young"), ("male_young", "female_old_heavy")
HEAD = (
    "| part | to the true surface: mean, p95 | inside (source) | deepest (source) | through (truth) | oval eyes |\n"
    "|---|---|---|---|---|---|"
)


def point_map_of(kind: str, source: str, target: str) -> PointMap:
    """From a body of identity ``target`` to the base body of identity ``source``."""
    if kind == "perfect":
        on = surface("base", target)
        return PointMap.from_vertices(on, surface("base", source), np.arange(on.n))
    marks = landmarks_of("soma18056", "base", 14)
    assert marks is not None
    if kind == "base":
        marks = Landmarks(marks.names, marks.source, marks.source)
    controls = body(kind, target), body("base", source)
    return match(*(prepare_surface(one, choose_level(one, VERTICES)) for one in controls), marks).point_map


def rows(kind: str, source: str, target: str) -> Iterator[dict]:
    """Figures of every part, with those of the source and of the truth."""
    point_map, given = point_map_of(kind, source, target), [part(name, source) for name in PARTS]
    begun = time.perf_counter()
    carried = carry_passengers(point_map, given)
    seconds = time.perf_counter() - begun
    cage = "base" if kind == "perfect" else kind
    for name, mesh, one in zip(PARTS, given, carried, strict=True):
        yield {
            "map": kind, "source": source, "target": target, "part": name, "seconds_of_all": round(seconds, 2),
            "found": asdict(judge(name, one.positions, source, cage, target)),
            "before": asdict(judge(name, mesh.positions, source, "base", source)),
            "truth": asdict(judge(name, part(name, target).positions, source, "base", target)),
        }  # fmt: skip


def line(row: dict) -> str:
    """One row of the table."""
    found, before, truth = row["found"], row["before"], row["truth"]
    through = "" if found["through"] is None else f"{found['through']} ({truth['through']})"
    oval = "" if found["oval"] is None else f"{100 * found['oval']:.1f} %"
    return (
        f"| {row['part']} | {found['mean']:.2f}, {found['p95']:.2f} | {found['inside']} ({before['inside']}) | "
        f"{found['deepest']:.2f} ({before['deepest']:.2f}) | {through} | {oval} |"
    )


def main() -> None:
    """Print a table for each map and direction."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("maps", nargs="*", metavar="MAP", help=", ".join(MAPS))
    parser.add_argument("--chosen", action="store_true", help="the pair that parameters were chosen on")
    parser.add_argument("--out", type=Path, help="append rows as JSON")
    given = parser.parse_args()
    one, other = CHOSEN if given.chosen else JUDGED
    for kind in given.maps or MAPS:
        for source, target in ((one, other), (other, one)):
            table = list(rows(kind, source, target))
            print(f"\n{kind}, {source} -> {target}, {table[0]['seconds_of_all']} s for all\n")
            print(HEAD)
            print("\n".join(line(row) for row in table), flush=True)
            if given.out:
                with given.out.open("a") as file:
                    file.writelines(json.dumps(row) + "\n" for row in table)


main()
