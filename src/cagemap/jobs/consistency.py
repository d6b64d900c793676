"""Cycle consistency of a collection: the map A -> C should agree with every detour A -> B -> C.

The disagreement of a triple is at most the sum of the errors of its three maps. Non-negative least squares over all
triples estimates these errors.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import nnls
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from cagemap.files.atomic import write_whole
from cagemap.files.ownership import mark
from cagemap.files.schema import own_note
from cagemap.maps.point_map import PointMap

Pair = tuple[str, str]  # target, source: the direction of T12

# A pair is doubtful from this error on, of sqrt(area), if it also has this many times the collection's median error.
LEAST_ERROR = 0.02
TIMES_MEDIAN = 3.0
# Most triples for each pair.
TRIPLES = 24
SAMPLES = 1500


@dataclass(frozen=True)
class Consistency:
    """How well the maps of a collection agree.

    Attributes
    ----------
    errors : dict of (target, source) to float
        Estimated mean error of every map that is part of a triple, of sqrt(area).
    triples : int
        How many were compared.
    doubtful : tuple of (target, source)
        Worst first.
    detours : dict of (target, source) to tuple of str
        For doubtful pairs with a better detour: the assets along it, from target to source.
    """

    errors: dict[Pair, float]
    triples: int
    doubtful: tuple[Pair, ...]
    detours: dict[Pair, tuple[str, ...]]


def measure_consistency(maps: Mapping[Pair, PointMap]) -> Consistency:
    """Compare every map with its detours and estimate the error of each.

    Parameters
    ----------
    maps : mapping of (target, source) to PointMap
        All of one asset at the same level.
    """
    pairs = sorted(maps)
    place = {pair: number for number, pair in enumerate(pairs)}
    rows, columns, found = [], [], []
    for number, (direct, first, second) in enumerate(_triples(pairs)):
        rows += [number] * 3
        columns += [place[direct], place[first], place[second]]
        found.append(disagreement(maps[direct], maps[first], maps[second]))
    if not found:
        return Consistency({}, 0, (), {})
    system = csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(found), len(pairs)))
    used = np.flatnonzero(system.sum(axis=0) > 0)
    errors = {
        pairs[i]: e for i, e in zip(used, nnls(system[:, used].toarray(), np.array(found))[0].tolist(), strict=True)
    }
    limit = max(LEAST_ERROR, TIMES_MEDIAN * float(np.median(list(errors.values()))))
    doubtful = tuple(sorted((pair for pair in errors if errors[pair] > limit), key=lambda pair: -errors[pair]))
    return Consistency(errors, len(found), doubtful, _detours(errors, doubtful))


def disagreement(direct: PointMap, first: PointMap, second: PointMap) -> float:
    """Mean distance between A -> C and A -> B -> C, of sqrt(area of C), over some vertices of A.

    Parameters
    ----------
    direct, first, second : PointMap
        Maps with target A and source C, target A and source B, target B and source C.
    """
    n = direct.target.n
    chosen = np.unique(np.linspace(0, n - 1, min(n, SAMPLES)).astype(np.int64))
    around = first.images.at(chosen).interpolate(second.images.positions)
    return float(np.linalg.norm(around - direct.images.at(chosen).positions, axis=1).mean())


def _triples(pairs: Sequence[Pair]) -> Iterator[tuple[Pair, Pair, Pair]]:
    """Direct pair, and the two pairs of a detour; some of them where there are many."""
    known = set(pairs)
    names = sorted({name for pair in pairs for name in pair})
    random = np.random.default_rng(47)
    for a, c in pairs:
        between = [b for b in names if (a, b) in known and (b, c) in known]
        for b in random.permutation(between)[:TRIPLES].tolist():
            yield (a, c), (a, b), (b, c)


def _detours(errors: Mapping[Pair, float], doubtful: Sequence[Pair]) -> dict[Pair, tuple[str, ...]]:
    """Shortest detours around doubtful pairs through the others, where they are at least twice as good."""
    names = sorted({name for pair in errors for name in pair})
    number = {name: i for i, name in enumerate(names)}
    good = [pair for pair in errors if pair not in doubtful]
    lengths = csr_array(
        ([errors[pair] + 1e-6 for pair in good], ([number[a] for a, _ in good], [number[b] for _, b in good])),
        shape=(len(names), len(names)),
    )
    total, before = dijkstra(lengths, return_predecessors=True)
    detours = {}
    for pair in doubtful:
        start, end = number[pair[0]], number[pair[1]]
        if total[start, end] > 0.5 * errors[pair]:
            continue
        way = [end]
        while way[-1] != start:
            way.append(int(before[start, way[-1]]))
        detours[pair] = tuple(names[i] for i in reversed(way))
    return detours


def write_consistency(path: Path, keys: dict[str, str], verdict: Consistency) -> None:
    """Store a verdict with the keys of its matches."""
    note = {
        "written_by": mark(),
        "keys": keys,
        "errors": [[*pair, error] for pair, error in verdict.errors.items()],
        "triples": verdict.triples,
        "doubtful": verdict.doubtful,
        "detours": [[*pair, way] for pair, way in verdict.detours.items()],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, json.dumps(note, indent=1))


def read_consistency(path: Path, keys: dict[str, str]) -> Consistency | None:
    """The verdict kept about just these matches, or None."""
    note = own_note(path)
    if note is None or note["keys"] != keys:
        return None
    return Consistency(
        {(target, source): error for target, source, error in note["errors"]},
        note["triples"],
        tuple((target, source) for target, source in note["doubtful"]),
        {(target, source): tuple(way) for target, source, way in note["detours"]},
    )
