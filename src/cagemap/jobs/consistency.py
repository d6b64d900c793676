"""Cycle consistency: comparison of maps A -> C with detours A -> B -> C.

The disagreement of a triple is at most the sum of the errors of its three maps. Non-negative least squares over all
triples estimates these errors.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.optimize import nnls
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from cagemap.files.atomic import write_whole
from cagemap.files.ownership import mark
from cagemap.files.schema import read_own_note
from cagemap.maps.point_map import PointMap

MapKey = tuple[str, str]  # target, source: the direction of T12

# A map is doubtful if its error exceeds both this, of sqrt(area), and this multiple of the collection's median error.
MIN_DOUBTFUL_ERROR = 0.02
MIN_MEDIAN_RATIO = 3.0
# Compared triples for each map, and vertices for each comparison.
MAX_TRIPLES_PER_MAP = 24
MAX_SAMPLE_VERTICES = 1500


@dataclass(frozen=True)
class Consistency:
    """Estimated errors of a collection's maps, and detours around doubtful maps."""

    # estimated mean error of every map in a triple, of sqrt(area)
    errors: dict[MapKey, float] = field(default_factory=dict)
    triples: int = 0  # number of compared triples
    doubtful: tuple[MapKey, ...] = ()  # worst first
    # For doubtful maps with a better detour: the assets along it, from target to source
    detours: dict[MapKey, tuple[str, ...]] = field(default_factory=dict)


def measure_consistency(maps: Mapping[MapKey, PointMap]) -> Consistency:
    """Compare every map with its detours and estimate the error of each.

    Maps of an asset at another level than most of its maps are left out.
    """
    map_keys = _comparable(maps)
    column_of = {map_key: index for index, map_key in enumerate(map_keys)}
    rows, columns, disagreements = [], [], []
    for index, (direct, first, second) in enumerate(_triples(map_keys)):
        rows += [index] * 3
        columns += [column_of[direct], column_of[first], column_of[second]]
        disagreements.append(disagreement(maps[direct], maps[first], maps[second]))
    if not disagreements:
        return Consistency()
    system = csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(disagreements), len(map_keys)))
    in_triples = np.flatnonzero(system.sum(axis=0) > 0)
    estimates = nnls(system[:, in_triples].toarray(), np.array(disagreements))[0]
    errors = {map_keys[i]: error for i, error in zip(in_triples, estimates.tolist(), strict=True)}
    limit = max(MIN_DOUBTFUL_ERROR, MIN_MEDIAN_RATIO * float(np.median(list(errors.values()))))
    doubtful = tuple(
        sorted((map_key for map_key in errors if errors[map_key] > limit), key=lambda map_key: -errors[map_key])
    )
    return Consistency(errors, len(disagreements), doubtful, _detours(errors, doubtful))


def disagreement(direct: PointMap, first: PointMap, second: PointMap) -> float:
    """Mean distance of the maps A -> C and A -> B -> C (target -> source), of sqrt(area of C)."""
    n = direct.target.n
    vertices = np.unique(np.linspace(0, n - 1, min(n, MAX_SAMPLE_VERTICES)).astype(np.int64))
    composed_images = first.images.at(vertices).interpolate(second.images.positions)
    return float(np.linalg.norm(composed_images - direct.images.at(vertices).positions, axis=1).mean())


def _comparable(maps: Mapping[MapKey, PointMap]) -> list[MapKey]:
    """Sorted keys of the maps between the most frequent surfaces of their assets."""
    sizes = {
        map_key: [(side.n, len(side.triangles)) for side in (point_map.target, point_map.source)]
        for map_key, point_map in maps.items()
    }
    counts: dict[str, Counter[tuple[int, int]]] = {}
    for map_key in sorted(maps):
        for name, size in zip(map_key, sizes[map_key], strict=True):
            counts.setdefault(name, Counter())[size] += 1
    usual = {name: count.most_common(1)[0][0] for name, count in counts.items()}
    return [map_key for map_key in sorted(maps) if sizes[map_key] == [usual[name] for name in map_key]]


def _triples(map_keys: Sequence[MapKey]) -> Iterator[tuple[MapKey, MapKey, MapKey]]:
    """Keys of a direct map and of both maps of a detour, randomly chosen."""
    keys = set(map_keys)
    names = sorted({name for map_key in map_keys for name in map_key})
    random = np.random.default_rng(47)
    for a, c in map_keys:
        middles = [b for b in names if (a, b) in keys and (b, c) in keys]
        for b in random.permutation(middles)[:MAX_TRIPLES_PER_MAP].tolist():
            yield (a, c), (a, b), (b, c)


def _detours(errors: Mapping[MapKey, float], doubtful: Sequence[MapKey]) -> dict[MapKey, tuple[str, ...]]:
    """Chains of better maps that replace a doubtful map, where their summed error is at most half of its error."""
    names = sorted({name for map_key in errors for name in map_key})
    index = {name: i for i, name in enumerate(names)}
    reliable = [map_key for map_key in errors if map_key not in doubtful]
    lengths = csr_array(
        (
            [errors[map_key] + 1e-6 for map_key in reliable],
            ([index[a] for a, _ in reliable], [index[b] for _, b in reliable]),
        ),
        shape=(len(names), len(names)),
    )
    total, predecessors = dijkstra(lengths, return_predecessors=True)
    detours = {}
    for map_key in doubtful:
        start, end = index[map_key[0]], index[map_key[1]]
        if total[start, end] > 0.5 * errors[map_key]:
            continue
        path = [end]
        while path[-1] != start:
            path.append(int(predecessors[start, path[-1]]))
        detours[map_key] = tuple(names[i] for i in reversed(path))
    return detours


def write_consistency(path: Path, keys: dict[str, str], verdict: Consistency) -> None:
    """Write a verdict and the keys of its matches."""
    note = {
        "written_by": mark(),
        "keys": keys,
        "errors": [[*map_key, error] for map_key, error in verdict.errors.items()],
        "triples": verdict.triples,
        "doubtful": verdict.doubtful,
        "detours": [[*map_key, route] for map_key, route in verdict.detours.items()],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, json.dumps(note, indent=1))


def read_consistency(path: Path, keys: dict[str, str]) -> Consistency | None:
    """The stored verdict on exactly these matches, or None."""
    note = read_own_note(path)
    if note is None or note["keys"] != keys:
        return None
    return Consistency(
        {(target, source): error for target, source, error in note["errors"]},
        note["triples"],
        tuple((target, source) for target, source in note["doubtful"]),
        {(target, source): tuple(route) for target, source, route in note["detours"]},
    )
