"""The hierarchical map (paper, section 5), from the control meshes down to the finest level.

Level 0 solves eq. 13; every band of basis functions that a level adds extends the functional map by eqs. 14-16. The
point map is searched in full at one coarse level only; below it a vertex's candidates come from its parents' matches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from cagemap.basis import Surface
from cagemap.descriptors import (
    heat_filters,
    heat_times,
    landmark_descriptors,
    normalise_columns,
    propagate_symmetry,
    signatures,
    symmetry_operator,
    wave_energies,
    wave_filters,
)
from cagemap.errors import ParameterError
from cagemap.functional_map import (
    OperatorWeights,
    SpectralData,
    coarse_functional_map,
    extend_functional_map,
)
from cagemap.maps.point_map import PointMap
from cagemap.maps.spectral.row_blocks import SpectralRows, blocks, recover_in_blocks, search_candidates, spectral_rows
from cagemap.maps.spectral.search import nearest_rows, strongest_parents
from cagemap.maps.spectral.zoomout import (
    Samples,
    embed_source,
    embed_target,
    fit_functional_map,
    growth,
    spread,
    upsample,
)
from cagemap.numerics.arrays import FloatArray, IndexArray

Progress = Callable[[str], None]
LevelPair = tuple[int, int]

# Levels up to this size serve the pointwise parts of descriptors, which are smooth, and the refits of C.
SAMPLE_VERTICES = 30_000
# Two levels are walked down together while neither has this many times the other's vertices.
COMPARABLE = 2.5
FEWEST_FUNCTIONS = 3
# Eq. 13 is solved at the first level that has this many functions on both sides.
ENOUGH_FUNCTIONS = 50


@dataclass(frozen=True)
class HierarchyConfig:
    """Parameters of the hierarchical map; the defaults are the measured ones.

    Attributes
    ----------
    heat, wave : int
        Filters of each kind, for landmarks and signatures alike.
    signature_weight : float
        Weight of a signature beside a landmark descriptor.
    weights : OperatorWeights
        alpha(O) of eq. 13.
    search_vertices : int
        The point map is searched in full at each side's coarsest level with at least this many vertices; the paper's
        level 0 is the value 0.
    descriptor_functions : int
        Basis functions that descriptors are asked about at most; those above are found from the match.
    upsample_start : int
        Basis functions trusted from the descriptors alone, where spectral upsampling starts.
    upsample_stop : int
        Where it ends; the functions above are fitted once, further down, to vertices that move only among candidates.
        Full searches with more functions make maps between bodies that are not isometric worse again.
    descriptor_bands : bool
        Extend C by eqs. 14-16 above the search levels too, as the paper does. Otherwise a band found there is fitted
        to the vertex matches, C = Phi1^+ P12 Phi2, which folds less: descriptors say little about functions that
        oscillate fast.
    """

    heat: int = 10
    wave: int = 20
    signature_weight: float = 0.2
    weights: OperatorWeights = OperatorWeights()
    search_vertices: int = 3000
    descriptor_functions: int = 150
    upsample_start: int = 15
    upsample_stop: int = 150
    descriptor_bands: bool = False


@dataclass(frozen=True)
class Pair:
    """The two prepared surfaces and what is known to correspond.

    Attributes
    ----------
    target, source : Surface
    target_landmarks, source_landmarks : (p,) arrays
        Control vertices that correspond.
    target_symmetry, source_symmetry : (n_0,) arrays or None
        Self-symmetries of the control meshes (both or none), as vertex permutations.
    """

    target: Surface
    source: Surface
    target_landmarks: IndexArray
    source_landmarks: IndexArray
    target_symmetry: IndexArray | None = None
    source_symmetry: IndexArray | None = None


@dataclass(frozen=True)
class LevelMap:
    """Functional map and vertex matches between one level of the target and one of the source.

    Attributes
    ----------
    levels : (int, int)
        Level of the target, level of the source.
    functional_map : (k1, k2) array
        C12 on the basis functions of these levels.
    match : (n1,) array
        Source vertex of every target vertex.
    """

    levels: LevelPair
    functional_map: FloatArray
    match: IndexArray


def hierarchical_map(
    pair: Pair, config: HierarchyConfig, progress: Progress = lambda stage: None
) -> tuple[FloatArray, PointMap]:
    """The paper's method from level 0 to the finest: functional map C12, and point map T12 of the finest levels.

    Raises
    ------
    ParameterError
        If the surfaces cannot share descriptors (too few basis functions).
    """
    progress("functional map")
    current = coarse_map(pair, config)
    for levels in ladder(pair, current.levels):
        progress(f"point map, levels {levels[0]} and {levels[1]}")
        current = descend(pair, current, levels, config)
    progress("vertex to point")
    return current.functional_map, recover_points(pair, current)


def search_levels(pair: Pair, config: HierarchyConfig) -> LevelPair:
    """The levels whose point map is searched in full: the coarsest ones with enough vertices and basis functions."""

    def first(surface: Surface) -> int:
        functions = min(ENOUGH_FUNCTIONS, surface.basis.count)
        enough = (
            i
            for i, level in enumerate(surface.refinement.levels)
            if len(level.positions) >= config.search_vertices and _basis_size(surface, i) >= functions
        )
        return next(enough, surface.finest)

    return first(pair.target), first(pair.source)


def ladder(pair: Pair, start: LevelPair) -> list[LevelPair]:
    """Pairs of levels from just above `start` to the finest ones, each side at most one level a step.

    Both sides go together while their sizes are comparable; otherwise the coarser one catches up first.
    """
    steps = []
    l1, l2 = start
    while (l1, l2) != (pair.target.finest, pair.source.finest):
        n1, n2 = _size(pair.target, l1), _size(pair.source, l2)
        target_may, source_may = l1 < pair.target.finest, l2 < pair.source.finest
        move_target = target_may and (not source_may or n1 < COMPARABLE * n2)
        move_source = source_may and (not target_may or n2 < COMPARABLE * n1)
        l1, l2 = l1 + move_target, l2 + move_source
        steps.append((l1, l2))
    return steps


def coarse_map(pair: Pair, config: HierarchyConfig) -> LevelMap:
    """Functional map by eqs. 13-16 up to the search levels, then full search and spectral upsampling there."""
    levels = search_levels(pair, config)
    functional_map = descriptor_map(pair, levels, config)
    target = _samples(pair.target, levels[0])
    source = _samples(pair.source, levels[1])
    return LevelMap(levels, *grown_map(functional_map, target, source, config))


def grown_map(
    functional_map: FloatArray, target: Samples, source: Samples, config: HierarchyConfig, factor: float = 1.25
) -> tuple[FloatArray, IndexArray]:
    """Functional map and match of samples from the leading block of C12: full search, then spectral upsampling.

    Parameters
    ----------
    functional_map : (k1, k2) array
        From descriptors.
    target, source : Samples
    config : HierarchyConfig
    factor : float
        See `growth`.
    """
    start = min(config.upsample_start, *functional_map.shape)
    trusted = functional_map[:start, :start]
    match = nearest_rows(embed_target(target, start), embed_source(source, trusted))
    stop = min(config.upsample_stop, max(target.rows.shape[1], source.rows.shape[1]))
    return upsample(target, source, match, growth(start, stop, factor))


def descriptor_map(pair: Pair, levels: LevelPair, config: HierarchyConfig) -> FloatArray:
    """Functional map from descriptors alone, up to `levels`.

    Eq. 13 at the first levels that have enough functions (a poor C_l would stay fixed inside C_h), eqs. 14-16 for every
    band above.
    """

    def sizes_at(current: LevelPair) -> tuple[int, int]:
        most = config.descriptor_functions
        return min(_basis_size(pair.target, current[0]), most), min(_basis_size(pair.source, current[1]), most)

    functional_map: FloatArray | None = None
    enough = min(ENOUGH_FUNCTIONS, *sizes_at(levels))
    for step in range(max(levels) + 1):
        current = min(step, levels[0]), min(step, levels[1])
        sizes = sizes_at(current)
        if min(sizes) < max(enough, FEWEST_FUNCTIONS):
            continue
        if functional_map is not None and functional_map.shape == sizes:
            continue
        target, source = spectral_data(pair, current, config)
        data = target.leading(sizes[0]), source.leading(sizes[1])
        if functional_map is None:
            functional_map = coarse_functional_map(*data, config.weights)
        else:
            functional_map = extend_functional_map(functional_map, *data, config.weights)
    if functional_map is None:
        raise ParameterError(
            f"expected at least {FEWEST_FUNCTIONS} basis functions on both surfaces at levels {levels}, "
            f"got {sizes}: raise k"
        )
    return functional_map


def spectral_data(pair: Pair, levels: LevelPair, config: HierarchyConfig) -> tuple[SpectralData, SpectralData]:
    """Descriptors and operators of both surfaces in coefficients of the basis up to these levels (paper, 5.1, 5.2).

    Both surfaces have unit area and share the filters' parameters, taken from the geometric mean of their spectra.
    """
    spectra = [_eigenvalues(pair.target, levels[0]), _eigenvalues(pair.source, levels[1])]
    count = min(len(spectrum) for spectrum in spectra)
    shared = np.exp(np.mean([np.log(np.maximum(np.sort(s)[:count], 1e-12)) for s in spectra], axis=0))
    times = heat_times(shared, config.heat)
    energies, width = wave_energies(shared, config.wave)

    def one(surface: Surface, level: int, landmarks: IndexArray, symmetry: IndexArray | None) -> SpectralData:
        spectrum = _eigenvalues(surface, level)
        filters = np.hstack([heat_filters(spectrum, times), wave_filters(spectrum, energies, width)])
        sampled = _sample_level(surface, level)
        rows = surface.basis.at(sampled)
        gram = surface.basis.gram_at(sampled)
        mass = surface.operators.mass[sampled]
        at_landmarks = landmark_descriptors(rows[landmarks], filters)  # vertex i of level 0 is vertex i of every level
        projected = np.linalg.solve(gram, rows.T @ (mass @ signatures(rows, filters)))
        columns = [normalise_columns(at_landmarks), config.signature_weight * normalise_columns(projected)]
        operator = None
        if symmetry is not None:
            for subdivision in surface.refinement.matrices[:sampled]:
                symmetry = propagate_symmetry(subdivision, symmetry)
            areas = surface.operators.areas(sampled)
            operator = symmetry_operator(rows, rows[symmetry], areas, gram)
        return SpectralData(spectrum, np.hstack(columns), operator)

    return (
        one(pair.target, levels[0], pair.target_landmarks, pair.target_symmetry),
        one(pair.source, levels[1], pair.source_landmarks, pair.source_symmetry),
    )


def descend(pair: Pair, coarse: LevelMap, levels: LevelPair, config: HierarchyConfig) -> LevelMap:
    """One step down: extend C by the levels' bands, search among candidates (Fig. 9), refit C, search again."""
    functional_map = coarse.functional_map
    grown = (_basis_size(pair.target, levels[0]), _basis_size(pair.source, levels[1])) != functional_map.shape
    if grown and config.descriptor_bands:
        functional_map = extend_functional_map(functional_map, *spectral_data(pair, levels, config), config.weights)
    match = search_level(pair, functional_map, levels, coarse)
    if grown or len(match) <= SAMPLE_VERTICES:
        functional_map = refit(pair, levels, match)
        match = search_level(pair, functional_map, levels, coarse)
    return LevelMap(levels, functional_map, match)


def search_level(pair: Pair, functional_map: FloatArray, levels: LevelPair, coarse: LevelMap) -> IndexArray:
    """Nearest candidates of all target vertices of a level (paper, Fig. 9)."""
    parents = _parents(pair.target, coarse.levels[0], levels[0])
    children = _children(pair.source, coarse.levels[1], levels[1])
    rows = _both_rows(pair, functional_map, levels)
    return search_candidates(*rows, blocks(pair.target, levels[0]), parents, children, coarse.match)


def refit(pair: Pair, levels: LevelPair, match: IndexArray) -> FloatArray:
    """C12 = Phi~1^+ P12 Phi~2 with all basis functions of a level, on a sample of its vertices."""
    chosen = spread(_size(pair.target, levels[0]), SAMPLE_VERTICES)
    k1, k2 = _basis_size(pair.target, levels[0]), _basis_size(pair.source, levels[1])
    rows = spectral_rows(pair.target, levels[0], k1).at(chosen).astype(np.float64)
    values = spectral_rows(pair.source, levels[1], k2).at(match[chosen]).astype(np.float64)
    areas = pair.target.operators.areas(levels[0])[chosen]
    return fit_functional_map(Samples(rows, areas, np.zeros((len(rows), 0))), values, k1)


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
    return strongest_parents(surface.refinement.matrices[coarse])


def _children(surface: Surface, coarse: int, fine: int) -> sparse.csc_array:
    """Source vertices that a coarse source vertex offers: its column of S_2^l; its neighbours where the level stays."""
    if fine == coarse:
        return sparse.csc_array(surface.operators.stiffness[fine])
    return sparse.csc_array(surface.refinement.matrices[coarse])


def _size(surface: Surface, level: int) -> int:
    return len(surface.refinement.levels[level].positions)


def _basis_size(surface: Surface, level: int) -> int:
    return sum(surface.basis.schedule[: level + 1])


def _eigenvalues(surface: Surface, level: int) -> FloatArray:
    return np.asarray(surface.basis.eigenvalues[: _basis_size(surface, level)])


def _sample_level(surface: Surface, level: int) -> int:
    """The level whose vertices stand for a level's pointwise work: small, but with all its basis functions."""
    functions = _basis_size(surface, level)
    while level > 0 and _size(surface, level) > SAMPLE_VERTICES and _basis_size(surface, level - 1) == functions:
        level -= 1
    return level


def _samples(surface: Surface, level: int) -> Samples:
    """All vertices of a level with the row sums of its mass matrix as areas."""
    rows = surface.basis.at(level)
    return Samples(rows, surface.operators.areas(level), np.zeros((len(rows), 0)))
