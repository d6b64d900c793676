"""From level to level: which levels meet, the search of Fig. 9, refits of C, vertex to point (paper, section 5.4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.maps.level_map import LevelMap
from cagemap.maps.level_pairs import ladder
from cagemap.maps.pair import LevelPair, Pair, Progress
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray, real_numbers, whole_numbers
from cagemap.spectral.fine_rows import (
    SpectralRows,
    blocks,
    recover_in_blocks,
    search_candidates,
    spectral_rows,
)
from cagemap.spectral.nearest import nearest_rows, strongest_parents
from cagemap.spectral.samples import Samples, evenly_spaced, fit_functional_map
from cagemap.spectral.surface import Surface

# Levels up to this size serve the refits of C; of larger ones as many vertices do.
SAMPLE_VERTICES = 30_000


def down_the_levels(
    pair: Pair,
    first: LevelMap,
    below: Callable[[LevelMap, LevelPair], LevelMap],
    progress: Progress,
) -> tuple[tuple[LevelMap, ...], PointMap]:
    """Maps of a first pair of levels and of all below, vertex to point on each, and T12 of the finest ones.

    ``below`` makes the map of the next pair of levels from the one above it.
    """
    maps = [first]
    for levels in ladder(pair, first.levels):
        progress(f"functional and point map, levels {levels[0]} and {levels[1]}")
        maps.append(below(maps[-1], levels))
    progress("point map")
    points = [recover_points(pair, found) for found in maps]
    return tuple(replace(found, points=on) for found, on in zip(maps, points, strict=True)), points[-1]


def basis_sizes(pair: Pair, levels: LevelPair) -> tuple[int, int]:
    """(k~1, k~2), the basis functions that a pair of levels has."""
    return pair.target.basis.size(levels[0]), pair.source.basis.size(levels[1])


def search_full(pair: Pair, functional_map: FloatArray, levels: LevelPair) -> IndexArray:
    """Nearest source vertex of every target vertex of a level, among all (paper, 5.4)."""
    target, source = _both_rows(pair, functional_map, levels)
    every = [
        np.arange(_size(surface, level)) for surface, level in zip((pair.target, pair.source), levels, strict=True)
    ]
    return nearest_rows(target.at(every[0]), source.at(every[1]))


def search_level(pair: Pair, functional_map: FloatArray, levels: LevelPair, coarse: LevelMap) -> IndexArray:
    """Nearest candidates of all target vertices of a level (paper, Fig. 9)."""
    parents = _parents(pair.target, coarse.levels[0], levels[0])
    children = _children(pair.source, coarse.levels[1], levels[1])
    rows = _both_rows(pair, functional_map, levels)
    return search_candidates(*rows, blocks(pair.target, levels[0]), parents, children, coarse.match)


def refit(pair: Pair, levels: LevelPair, match: IndexArray, sizes: tuple[int, int] | None = None) -> FloatArray:
    """C12 = Phi~1^+ P12 Phi~2 of a match of two levels, on a sample of its vertices (paper, 2.1.2).

    Parameters
    ----------
    pair : Pair
    levels : (int, int)
    match : (n,) array
        Source vertex of every target vertex.
    sizes : (int, int), optional
        Basis functions (k1, k2) of both sides; default: those of the levels.
    """
    k1, k2 = basis_sizes(pair, levels) if sizes is None else sizes
    chosen = evenly_spaced(len(match), SAMPLE_VERTICES)
    rows = spectral_rows(pair.target, levels[0], k1).at(chosen).astype(np.float64)
    values = spectral_rows(pair.source, levels[1], k2).at(match[chosen]).astype(np.float64)
    areas = _areas(pair.target, levels[0])[chosen]
    return fit_functional_map(Samples(rows, areas, np.zeros((len(rows), 0))), values, k1)


def start_map(pair: Pair, start: ArrayLike, sizes: tuple[int, int]) -> FloatArray:
    """Functional map to start from: one that is given, or what a vertex map says.

    Parameters
    ----------
    pair : Pair
    start : (k1, k2) or (n,) array
        C12 of any size; or a source vertex for every target vertex of one of its levels.
    sizes : (int, int)
        Basis functions that a vertex map is read with.

    Raises
    ------
    ParameterError
        If the start is neither.
    """
    given = real_numbers(start, "start")
    counts = [len(level.positions) for level in pair.target.hierarchy.levels]
    n2 = pair.source.refinement.finest.n_vertices
    if given.ndim == 1 and len(given) in counts:
        match = whole_numbers(given, "start")
        if match.min() >= 0 and match.max() < n2:
            return refit(pair, (counts.index(len(match)), pair.source.finest), match, sizes)
    if given.ndim != 2 or not given.size or not np.isfinite(given).all():
        raise ParameterError(
            "start: expected a finite functional map (k1, k2), or a source vertex from 0 to "
            f"{n2 - 1} for every target vertex of a level, {' or '.join(map(str, counts))} of them, got an array "
            f"{given.shape} with values from {given.min(initial=np.inf)} to {given.max(initial=-np.inf)}"
        )
    return given


def recover_points(pair: Pair, matched: LevelMap) -> PointMap:
    """Vertex-to-point map of a pair of levels from its vertex matches."""
    rows = _both_rows(pair, matched.functional_map, matched.levels)
    target, source = pair.target.triangles(matched.levels[0]), pair.source.triangles(matched.levels[1])
    found = recover_in_blocks(*rows, blocks(pair.target, matched.levels[0]), source.triangles, matched.match)
    return PointMap.from_arrays(target, source, *found)


def _both_rows(pair: Pair, functional_map: FloatArray, levels: LevelPair) -> tuple[SpectralRows, SpectralRows]:
    """Embeddings of a pair of levels: Phi~1 and Phi~2 C12^T."""
    k1, k2 = functional_map.shape
    target = spectral_rows(pair.target, levels[0], k1)
    return target, spectral_rows(pair.source, levels[1], k2, functional_map.T)


def _parents(surface: Surface, coarse: int, fine: int) -> sparse.csr_array:
    """Coarse vertices whose matches give a target vertex its candidates; itself where the level stays."""
    if fine == coarse:
        return sparse.csr_array(sparse.eye_array(_size(surface, fine)))
    return strongest_parents(surface.hierarchy.matrices[coarse])


def _children(surface: Surface, coarse: int, fine: int) -> sparse.csc_array:
    """Source vertices that a coarse source vertex offers: its column of S_2^l; its neighbours where the level stays."""
    if fine == coarse:
        return _neighbours(surface, fine)
    return sparse.csc_array(surface.hierarchy.matrices[coarse])


def _neighbours(surface: Surface, level: int) -> sparse.csc_array:
    """Which vertices of a level share a face."""
    faces = surface.hierarchy.levels[level].faces
    corners = surface.triangles(level).triangles if faces is None else faces
    of = np.repeat(np.arange(len(corners)), corners.shape[1])
    on = sparse.csr_array((np.ones(corners.size), (of, corners.ravel())), shape=(len(corners), _size(surface, level)))
    return sparse.csc_array(on.T @ on)


def _areas(surface: Surface, level: int) -> FloatArray:
    """(n,) area that each vertex of a level stands for; of its triangles where the operators end below the level."""
    operators = surface.operators
    return operators.areas(level) if level <= operators.finest else surface.triangles(level).vertex_areas


def _size(surface: Surface, level: int) -> int:
    return len(surface.hierarchy.levels[level].positions)
