"""``python -m benchmarks.public SET FOLDER --output OUT [--pairs N] [--landmarks N ...]``: a public set, one table.

Rows are written as they come, and what is there is not measured again: after an interrupt run the same command. A shape
that cannot be read costs its own pairs; they are named, and tried again the next time.
"""

from __future__ import annotations

import argparse
import json
import sys
from itertools import groupby
from pathlib import Path

import numpy as np

from benchmarks.public.measure import Shapes, measured, receiver
from benchmarks.public.sets import SETS, SetError
from benchmarks.verdicts import table
from cagemap.errors import CagemapError
from cagemap.files.atomic import atomic_path
from cagemap.files.result.manifest import code_version

KEY = ("set", "target", "source", "landmarks", "scheme", "vertices", "points")
UNREADABLE = (CagemapError, SetError, OSError)


def main(given: list[str] | None = None) -> None:
    """Measure what is missing; exit code 1 if a pair failed, 2 if nothing could begin."""
    arguments = parsed(given)
    try:
        rows, failed = measure(arguments)
    except UNREADABLE as error:
        print(error, file=sys.stderr)
        raise SystemExit(2) from None
    table = markdown(rows, failed)
    arguments.output.mkdir(parents=True, exist_ok=True)
    (arguments.output / "public.md").write_text(table, encoding="utf-8")
    print(table)
    if failed:
        raise SystemExit(1)


def parsed(given: list[str] | None) -> argparse.Namespace:
    """What the command line says."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.public", description=__doc__)
    parser.add_argument("set", choices=list(SETS))
    parser.add_argument("folder", type=Path, help="where the set was unpacked")
    parser.add_argument("--pairs", type=int, help="a sample of so many, always the same; all of them otherwise")
    parser.add_argument("--landmarks", type=int, nargs="+", help="how many; the literature's first, then the farthest")
    parser.add_argument(
        "--scheme",
        choices=["none", "loop", "catmull-clark"],
        default="none",
        help="none: the meshes as they are; the others: refined by subdivision",
    )
    parser.add_argument("--vertices", type=int, default=20_000, help="of refined surfaces, about")
    parser.add_argument("--points", type=int, default=1000, help="known points that are judged, at most")
    parser.add_argument("--output", type=Path, required=True, help="folder of public.json and public.md")
    return parser.parse_args(given)


def measure(arguments: argparse.Namespace) -> tuple[list[dict], list[str]]:
    """Rows of all that was measured, now and before, and what failed now."""
    public, place = SETS[arguments.set], arguments.output / "public.json"
    pairs = public.pairs(arguments.folder, arguments.pairs)
    rows = read_rows(place)
    done = {tuple(row[name] for name in KEY) for row in rows}
    # Subdivision alone looks at the number of vertices.
    vertices = None if arguments.scheme == "none" else arguments.vertices
    more = (arguments.scheme, vertices, arguments.points)
    wanted = [
        (target, source, count)
        for target, source in pairs
        for count in arguments.landmarks or list(public.landmarks)
        if (public.name, target, source, count, *more) not in done
    ]
    wanted.sort(key=lambda one: one[1])
    shapes, failed, left = Shapes(public, arguments.folder, arguments.scheme, arguments.vertices), [], len(wanted)
    print(f"{len(pairs)} pairs; {left} rows to measure, {len(rows)} are there", flush=True)
    for source, ones in groupby(wanted, key=lambda one: one[1]):
        some = list(ones)
        try:
            at = receiver(shapes[source], arguments.points)
        except UNREADABLE as error:
            left -= len(some)
            failed.append(f"{source}: {error} ({len(some)} rows)")
            print(f"{failed[-1]}, {left} left", flush=True)
            continue
        for target, _, count in some:
            left -= 1
            row = dict(zip(KEY, (public.name, target, source, count, *more), strict=True))
            try:
                row |= measured(public, *shapes.pair(target, source), at, count)
            except UNREADABLE as error:
                failed.append(f"{source} -> {target}: {error}")
                print(f"{failed[-1]}, {left} left", flush=True)
                continue
            rows.append(row | {"code": code_version()})
            write_rows(place, rows)
            print(f"{source} -> {target}, {count} landmarks: {row['mean']:.2f}, {left} left", flush=True)
    return rows, failed


def read_rows(place: Path) -> list[dict]:
    """Rows of earlier runs."""
    if not place.is_file():
        return []
    try:
        rows = json.loads(place.read_text(encoding="utf-8"))
        return [row for row in rows if all(name in row for name in KEY)]
    except (ValueError, TypeError) as error:
        raise SetError(f"{place}: expected rows of this command, got {error}. Move it away, or mend it.") from error


def write_rows(place: Path, rows: list[dict]) -> None:
    """All rows, whole or not at all."""
    place.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(place, force=True) as temporary:
        temporary.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def markdown(rows: list[dict], failed: list[str]) -> str:
    """One table of all that was measured."""
    lines = [
        "Mean geodesic error x100 of sqrt(area) on the surface that gives, at the template's points, over all pairs;",
        "`of largest`: the same x100 of the largest distance there. Ours is given landmarks, which count as points,",
        "and was trained on nothing.",
        "",
        "| set | landmarks | scheme | pairs | mean | median pair | worst pair | above 5 | of largest | folds % | "
        "left out | processor s | wall s | peak MB | published |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    order = ("set", "landmarks", "scheme", "vertices", "points")
    for key, group in groupby(
        sorted(rows, key=lambda r: [str(r[n]) for n in order]), key=lambda r: [r[n] for n in order]
    ):
        some = list(group)
        means = np.array([row["mean"] for row in some])
        others = [np.mean([row[name] for row in some]) for name in ("of_largest", "flipped", "left_out", "seconds")]
        mine = [f"{value:.2f}" for value in (means.mean(), np.median(means))]
        cells = [SETS[key[0]].about, key[1], key[2], len(some), *mine, f"{means.max():.1f}", int((means > 5).sum())]
        walls, peaks = ([row[name] for row in some if name in row] for name in ("wall_seconds", "peak_mb"))
        cells += [f"{value:.2f}" for value in others]
        cells += [f"{np.mean(walls):.2f}" if walls else "-", f"{max(peaks):.0f}" if peaks else "-"]
        lines.append("| " + " | ".join(map(str, [*cells, SETS[key[0]].published])) + " |")
    judged = [row | {"error": row["mean"]} for row in rows if "said" in row]
    names = {f"{row['set']}, {row['landmarks']} landmarks, {row['scheme']}" for row in judged}
    groups = {
        name: [row for row in judged if f"{row['set']}, {row['landmarks']} landmarks, {row['scheme']}" == name]
        for name in sorted(names)
    }
    if groups:
        lines += ["", *table(groups)]
    codes = {row.get("code") for row in rows}
    if len(codes) > 1:
        lines += [
            "",
            f"Rows are of {len(codes)} versions of cagemap (`code` in public.json): remove those of old ones.",
        ]
    if failed:
        lines += ["", "Not measured:", "", *(f"- {text}" for text in failed)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
