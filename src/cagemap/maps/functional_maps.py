"""Functional maps of point maps, and the same maps in the bases of other libraries."""

from __future__ import annotations

import numpy as np

from cagemap.errors import ParameterError
from cagemap.maps.pair import LevelPair, Pair
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, real_numbers
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import in_threads
from cagemap.spectral.surface import Surface
from cagemap.spectral.zoomout import FIT_SAMPLES, Samples, evenly_spaced, fit_functional_map


@kinds_checked
def functional_map_of(target: Surface, source: Surface, point_map: PointMap) -> FloatArray:
    """C12 = Phi~1^+ P12 Phi~2 of a point map of the finest levels, on a sample of its vertices (paper, 2.1.2)."""
    chosen = evenly_spaced(len(point_map.images), FIT_SAMPLES)
    sampled = point_map.images.at(chosen)
    corners, places = np.unique(sampled.corners, return_inverse=True)
    at_vertices, at_corners = in_threads(
        lambda side: side[0].basis.rows(side[0].finest, side[1]), [(target, chosen), (source, corners)]
    )
    weights = sampled.barycentric
    pulled = np.asarray(sum(weights[:, i, None] * at_corners[places.reshape(-1, 3)[:, i]] for i in range(3)))
    samples = Samples(at_vertices, target.finest_triangles.vertex_areas[chosen], np.zeros((len(chosen), 0)))
    return fit_functional_map(samples, pulled, target.basis.count)


@kinds_checked
def from_bases(
    pair: Pair,
    functional_map: FloatArray,
    target_functions: FloatArray,
    source_functions: FloatArray,
    levels: LevelPair | None = None,
) -> FloatArray:
    """C12 on the bases of a pair, from a functional map on other functions.

    pyFM's ``model.FM_12`` with ``model.mesh2.eigenvectors`` as the target's functions and ``mesh1``'s as the source's;
    geomfum's matrix with those of ``basis_b.vecs`` and ``basis_a.vecs``.

    Parameters
    ----------
    pair : Pair
    functional_map : (q1, q2) array
        Takes coefficients of the source's functions to those of the target's.
    target_functions, source_functions : (n1, q1 or more), (n2, q2 or more) arrays
        At the vertices of the levels, any scale.
    levels : (int, int), optional
        Of target and source; default: the finest.

    Returns
    -------
    (k1, k2) array
        k1 = q1 and k2 = q2, or as many functions as a basis has.

    Raises
    ------
    ParameterError
        If the functions are not those of the levels' vertices, or fewer than the map takes.
    """
    matrix, (target, source) = _sides(pair, functional_map, (target_functions, source_functions), levels)
    k1, k2 = min(matrix.shape[0], pair.target.basis.count), min(matrix.shape[1], pair.source.basis.count)
    ours, theirs, areas = target
    to_ours = _coefficients(ours[:, :k1], theirs, areas)
    ours, theirs, areas = source
    return np.asarray(to_ours @ matrix @ _coefficients(theirs, ours[:, :k2], areas))


@kinds_checked
def to_bases(
    pair: Pair,
    functional_map: FloatArray,
    target_functions: FloatArray,
    source_functions: FloatArray,
    levels: LevelPair | None = None,
) -> FloatArray:
    """A functional map C12 of a pair on other functions (n1, q1) and (n2, q2): the inverse of `from_bases`; (q1, q2).

    Raises
    ------
    ParameterError
        As `from_bases`.
    """
    matrix = real_numbers(functional_map, "functional map")
    given = [real_numbers(one, "functions") for one in (target_functions, source_functions)]
    shape = tuple(one.shape[-1] for one in given)
    _, (target, source) = _sides(pair, np.zeros(shape), (given[0], given[1]), levels)
    ours, theirs, areas = target
    to_theirs = _coefficients(theirs, ours[:, : matrix.shape[0]], areas)
    ours, theirs, areas = source
    return np.asarray(to_theirs @ matrix @ _coefficients(ours[:, : matrix.shape[1]], theirs, areas))


def _sides(
    pair: Pair, functional_map: FloatArray, functions: tuple[FloatArray, FloatArray], levels: LevelPair | None
) -> tuple[FloatArray, list[tuple[FloatArray, FloatArray, FloatArray]]]:
    """The map, and of both sides our functions, theirs and areas, at sampled vertices."""
    matrix = real_numbers(functional_map, "functional map")
    surfaces = pair.target, pair.source
    found = []
    for i, name in enumerate(("target", "source")):
        surface, level = surfaces[i], surfaces[i].finest if levels is None else levels[i]
        triangles, theirs = surface.triangles(level), real_numbers(functions[i], f"{name} functions")
        if matrix.ndim != 2 or theirs.ndim != 2 or len(theirs) != triangles.n or theirs.shape[1] < matrix.shape[i]:
            raise ParameterError(
                f"{name} functions: expected {triangles.n} rows, the vertices of level {level}, and as many columns as "
                f"the functional map {matrix.shape} takes, got {theirs.shape}; pyFM's mesh1 is the source, mesh2 the "
                "target"
            )
        chosen = evenly_spaced(triangles.n, FIT_SAMPLES)
        rows = surface.basis.rows(surface.finest, surface.hierarchy.on_finest(level)[chosen])
        found.append((rows, theirs[chosen, : matrix.shape[i]], triangles.vertex_areas[chosen]))
    return matrix, found


def _coefficients(basis: FloatArray, functions: FloatArray, areas: FloatArray) -> FloatArray:
    """Coefficients of functions (m, q) in a basis (m, k), in the least-squares sense; (k, q)."""
    return fit_functional_map(Samples(basis, areas, np.zeros((len(basis), 0))), functions, basis.shape[1])
