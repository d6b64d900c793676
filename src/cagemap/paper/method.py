"""The paper's method, level by level (section 5), without additions from later papers but `ConstraintConfig.decay`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.maps.functional_maps import LevelMap, MapLike, functional_map_from
from cagemap.maps.pair import LevelPair, Pair, Progress, no_progress
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.paper.constraints import ConstraintConfig, Constraints, gather_constraints
from cagemap.paper.embeddings import (
    Rows,
    nearest_candidates,
    spectral_rows,
    strongest_parents,
    vertex_blocks,
    vertex_to_point,
)
from cagemap.paper.equations import extend_functional_map, solve_functional_map
from cagemap.spectral.surface import Surface
from cagemap.spectral.zoomout import evenly_spaced_vertices, fit_functional_map, nearest_rows

ENOUGH_FUNCTIONS = 50  # least number of basis functions of search levels on both sides, if the bases have so many
COMPARABLE = 2.5  # both sides are refined in the same step while neither has so many times the other's vertices
FEWEST_FUNCTIONS = 3  # least number of basis functions: fewer cannot represent three coordinates
SAMPLE_VERTICES = 30_000  # most vertices used to refit C; of larger levels so many are sampled


@dataclass(frozen=True, repr=False)
class PaperConfig(ConstraintConfig):
    """Parameters of the paper's method. Our copy of the paper lacks section 6, which gives their values."""

    rounds: int = 2  #: alternations of P and C on every level (2.1.4); 0: keep C of eqs. 13-16
    orthonormal: bool = False  #: make C orthonormal in every round (2.1.4), though P is no permutation here


@kinds_checked
def paper_map(
    pair: Pair,
    config: PaperConfig = PaperConfig(),
    progress: Progress = no_progress,
    *,
    constraints: Constraints | None = None,
    start: MapLike | None = None,
) -> tuple[tuple[LevelMap, ...], PointMap]:
    """Vertex-to-point maps of all levels, and the point map of the finest ones.

    ``constraints`` replace those of `gather_constraints`. ``start`` replaces the solution of eq. 13: a map as in
    `cagemap.research`. If its size is not that of level 0, its leading block is used and extended by eqs. 14-16.
    ParameterError if level 0 has too few functions, or the start is no map.
    """
    progress("functional map, level 0")
    constraints = gather_constraints(pair, config) if constraints is None else constraints
    maps = [_alternate(pair, (0, 0), _first_map(pair, constraints, config, start), config, None)]
    for levels in finer_level_pairs(pair, (0, 0)):
        progress(f"functional and point map, levels {levels[0]} and {levels[1]}")
        functional_map, sizes = maps[-1].functional_map, basis_sizes(pair, levels)
        if sizes != functional_map.shape:  # eqs. 14-16 (5.3.2)
            functional_map = extend_functional_map(functional_map, constraints.leading(*sizes), config)
        maps.append(_alternate(pair, levels, functional_map, config, maps[-1]))
    progress("point map")
    maps = [replace(level_map, points=recover_points(pair, level_map)) for level_map in maps]
    assert maps[-1].points is not None
    return tuple(maps), maps[-1].points


def _first_map(pair: Pair, constraints: Constraints, config: PaperConfig, start: MapLike | None) -> FloatArray:
    """C12 of level 0, by eq. 13 (5.3.1) or from a start."""
    sizes = basis_sizes(pair, (0, 0))
    if min(sizes) < FEWEST_FUNCTIONS:
        raise ParameterError(
            f"expected at least {FEWEST_FUNCTIONS} basis functions on level 0 of both surfaces, got {sizes}: give a "
            "schedule such as 100,50,50"
        )
    wanted = constraints.leading(*sizes)
    if start is None:
        return solve_functional_map(wanted, config)
    given = functional_map_from(pair, start, sizes)[: sizes[0], : sizes[1]]
    return given if given.shape == sizes else extend_functional_map(given, wanted, config)


def _alternate(
    pair: Pair, levels: LevelPair, functional_map: FloatArray, config: PaperConfig, coarse: LevelMap | None
) -> LevelMap:
    """Alternate the point map P and C, fitted to P (2.1.2, 2.1.4); unlike the paper's, P is no permutation."""
    match = search_level(pair, functional_map, levels, coarse)
    for _ in range(config.rounds):
        functional_map = refit_map(pair, levels, match)
        if config.orthonormal:
            functional_map = nearest_orthonormal(functional_map)
        match = search_level(pair, functional_map, levels, coarse)
    return LevelMap(levels, functional_map, match)


def nearest_orthonormal(functional_map: FloatArray) -> FloatArray:
    """Nearest matrix to C with orthonormal rows or columns: U V^T of its singular vectors (2.1.4)."""
    left, _, right = np.linalg.svd(functional_map, full_matrices=False)
    return np.asarray(left @ right)


def basis_sizes(pair: Pair, levels: LevelPair) -> tuple[int, int]:
    """Numbers (k~1, k~2) of basis functions of a pair of levels."""
    return pair.target.basis.size(levels[0]), pair.source.basis.size(levels[1])


def search_level(
    pair: Pair, functional_map: FloatArray, levels: LevelPair, coarse: LevelMap | None = None
) -> IndexArray:
    """(n1,) nearest source vertex of each target vertex: of all (5.4), or of candidates by ``coarse`` (Fig. 9).

    If the target keeps its level, each of its vertices is its own parent; if the source does, the children of a vertex
    are its neighbours.
    """
    rows = _both_rows(pair, functional_map, levels)
    if coarse is None:
        every = np.arange(_size(pair.target, levels[0])), np.arange(_size(pair.source, levels[1]))
        return nearest_rows(*(of(vertices) for of, vertices in zip(rows, every, strict=True)))
    unchanged = [fine == before for fine, before in zip(levels, coarse.levels, strict=True)]
    if unchanged[0]:
        parents = sparse.csr_array(sparse.eye_array(_size(pair.target, levels[0])))
    else:
        parents = strongest_parents(pair.target.hierarchy.matrices[coarse.levels[0]])
    if unchanged[1]:
        children = _neighbours(pair.source, levels[1])
    else:
        children = pair.source.hierarchy.matrices[coarse.levels[1]]
    return nearest_candidates(*rows, vertex_blocks(pair.target, levels[0]), parents, children, coarse.match)


def refit_map(pair: Pair, levels: LevelPair, match: IndexArray) -> FloatArray:
    """Refit C12 = Phi~1^+ P12 Phi~2 to a match (n,) of two levels, on a sample of vertices (paper, 2.1.2)."""
    k1, k2 = basis_sizes(pair, levels)
    chosen = evenly_spaced_vertices(len(match), SAMPLE_VERTICES)
    rows = spectral_rows(pair.target, levels[0], k1)(chosen).astype(np.float64)
    values = spectral_rows(pair.source, levels[1], k2)(match[chosen]).astype(np.float64)
    operators = pair.target.operators
    on_level = levels[0] <= operators.finest_level
    areas = operators.areas(levels[0]) if on_level else pair.target.triangles(levels[0]).vertex_areas
    return fit_functional_map(rows, areas[chosen], values)


@kinds_checked
def recover_points(pair: Pair, matched: LevelMap) -> PointMap:
    """Vertex-to-point map of a pair of levels from its vertex matches."""
    rows = _both_rows(pair, matched.functional_map, matched.levels)
    target, source = pair.target.triangles(matched.levels[0]), pair.source.triangles(matched.levels[1])
    projected = vertex_to_point(*rows, vertex_blocks(pair.target, matched.levels[0]), source.triangles, matched.match)
    return PointMap.from_arrays(target, source, *projected)


def _both_rows(pair: Pair, functional_map: FloatArray, levels: LevelPair) -> tuple[Rows, Rows]:
    """Functions that give rows of the spectral embeddings of two levels, Phi~1 and Phi~2 C12^T."""
    k1, k2 = functional_map.shape
    target = spectral_rows(pair.target, levels[0], k1)
    return target, spectral_rows(pair.source, levels[1], k2, functional_map.T)


def _neighbours(surface: Surface, level: int) -> sparse.csr_array:
    """Sparse (n, n) matrix with entries where two vertices of a level share a face."""
    corners = surface.hierarchy.faces(level)
    faces_of = np.repeat(np.arange(len(corners)), corners.shape[1])
    on = sparse.csr_array(
        (np.ones(corners.size), (faces_of, corners.ravel())), shape=(len(corners), _size(surface, level))
    )
    return sparse.csr_array(on.T @ on)


def _size(surface: Surface, level: int) -> int:
    return surface.hierarchy.levels[level].n_vertices


def search_levels(target: Surface, source: Surface, vertices: int, source_vertices: int = 0) -> LevelPair:
    """Coarsest levels with enough vertices (``source_vertices`` 0: as of the target) and functions."""

    def first(surface: Surface, wanted: int) -> int:
        functions = min(ENOUGH_FUNCTIONS, surface.basis.count)
        enough = (
            i
            for i, level in enumerate(surface.hierarchy.levels)
            if len(level.positions) >= wanted and surface.basis.size(i) >= functions
        )
        return next(enough, surface.finest_level)

    return first(target, vertices), first(source, source_vertices or vertices)


def finer_level_pairs(pair: Pair, start: LevelPair) -> list[LevelPair]:
    """Pairs of levels after ``start`` to the finest: both finer in a step if comparable, else the coarser one."""
    steps = []
    l1, l2 = start
    while (l1, l2) != (pair.target.finest_level, pair.source.finest_level):
        n1, n2 = pair.target.triangles(l1).n, pair.source.triangles(l2).n
        target_may, source_may = l1 < pair.target.finest_level, l2 < pair.source.finest_level
        move_target = target_may and (not source_may or n1 < COMPARABLE * n2)
        move_source = source_may and (not target_may or n2 < COMPARABLE * n1)
        l1, l2 = l1 + move_target, l2 + move_source
        steps.append((l1, l2))
    return steps
