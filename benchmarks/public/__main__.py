"""``python -m benchmarks.public SET FOLDER [--pairs N] [--landmarks N ...]``: measure a public set, write one table.

Rows are written as they come; what is there is not measured again.
"""

from __future__ import annotations

import argparse
import json
from itertools import groupby
from pathlib import Path

import numpy as np

from benchmarks.public.measure import Shapes, measured, receiver
from benchmarks.public.sets import SETS

KEY = ("set", "target", "source", "landmarks", "scheme")


def main(given: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.public", description=__doc__)
    parser.add_argument("set", choices=list(SETS))
    parser.add_argument("folder", type=Path, help="where the set was unpacked")
    parser.add_argument("--pairs", type=int, help="a sample of so many, always the same; all of them otherwise")
    parser.add_argument("--landmarks", type=int, nargs="+", help="how many; the literature's first, then the farthest")
    parser.add_argument("--scheme", default="none", help="none: the meshes as they are; loop: refined by subdivision")
    parser.add_argument("--vertices", type=int, default=20_000, help="of refined surfaces, about")
    parser.add_argument("--points", type=int, default=1000, help="known points that are judged, at most")
    parser.add_argument("--output", type=Path, required=True, help="folder of public.json and public.md")
    arguments = parser.parse_args(given)
    public = SETS[arguments.set]
    counts = arguments.landmarks or list(public.landmarks)
    arguments.output.mkdir(parents=True, exist_ok=True)
    place = arguments.output / "public.json"
    rows = json.loads(place.read_text()) if place.is_file() else []
    done = {tuple(row[name] for name in KEY) for row in rows}
    shapes = Shapes(public, arguments.folder, arguments.scheme, arguments.vertices)
    wanted = [
        (target, source, count)
        for target, source in public.pairs(arguments.folder, arguments.pairs)
        for count in counts
        if (public.name, target, source, count, arguments.scheme) not in done
    ]
    wanted.sort(key=lambda one: one[1])
    for source, ones in groupby(wanted, key=lambda one: one[1]):
        at = receiver(shapes[source], arguments.points)
        for target, _, count in ones:
            row = dict(zip(KEY, (public.name, target, source, count, arguments.scheme), strict=True))
            rows.append(row | measured(public, shapes[target], shapes[source], at, count))
            print(f"{source} -> {target}, {count} landmarks: {rows[-1]['mean']:.2f}", flush=True)
            place.write_text(json.dumps(rows, indent=1) + "\n")
    (arguments.output / "public.md").write_text(markdown(rows))
    print(markdown(rows))


def markdown(rows: list[dict]) -> str:
    """One table of all that was measured."""
    lines = [
        "Mean geodesic error x100 of sqrt(area) on the surface that gives, at the template's points, over all pairs;",
        "`of largest`: the same x100 of the largest distance there. Ours is given landmarks, which count as points,",
        "and was trained on nothing.",
        "",
        "| set | landmarks | scheme | pairs | mean | median pair | worst pair | above 5 | of largest | folds % | "
        "left out | s | published |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    order = ("set", "landmarks", "scheme")
    for key, group in groupby(
        sorted(rows, key=lambda r: [str(r[n]) for n in order]), key=lambda r: [r[n] for n in order]
    ):
        some = list(group)
        means = np.array([row["mean"] for row in some])
        others = [np.mean([row[name] for row in some]) for name in ("of_largest", "flipped", "left_out", "seconds")]
        mine = [f"{value:.2f}" for value in (means.mean(), np.median(means))]
        cells = [SETS[key[0]].about, key[1], key[2], len(some), *mine, f"{means.max():.1f}", int((means > 5).sum())]
        cells += [f"{value:.2f}" for value in others]
        lines.append("| " + " | ".join(map(str, [*cells, SETS[key[0]].published])) + " |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
