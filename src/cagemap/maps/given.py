"""Maps as users have them: point maps, functional maps of any size, vertex maps of a level."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from cagemap.errors import ParameterError
from cagemap.maps.functional_maps import functional_map_of
from cagemap.maps.pair import Pair
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray, array_of, real_numbers, whole_numbers
from cagemap.numerics.threads import in_threads
from cagemap.spectral.surface import Surface
from cagemap.spectral.zoomout import (
    FIT_SAMPLES,
    Samples,
    ZoomOutSchedule,
    evenly_spaced,
    fit_functional_map,
    nearest_samples,
    zoomout,
)

MapLike = PointMap | ArrayLike

# Samples of the target, and of the source, that ZoomOut searches.
TARGET_SAMPLES, SOURCE_SAMPLES = 3000, 10_000


def checked(pair: Pair, given: MapLike) -> PointMap | FloatArray | IndexArray:
    """A point map of the finest levels, C12 (k1, k2), or source vertices (n,) of a level's target vertices.

    Raises
    ------
    ParameterError
        If it is none of these for this pair.
    """
    target, source = pair.target, pair.source
    if isinstance(given, PointMap):
        if given.target.n != len(target.vertices) or given.source.n != len(source.vertices):
            raise ParameterError(
                f"map: expected one of {len(target.vertices)} to {len(source.vertices)} vertices, the finest of the "
                f"pair, got {given}: target and source may be exchanged, or it belongs to another level"
            )
        return given
    values = array_of(given)
    counts = [len(level.positions) for level in target.hierarchy.levels]
    if values.ndim == 1 and len(values) in counts:
        vertices = whole_numbers(values, "map")
        if 0 <= vertices.min() and vertices.max() < len(source.vertices):
            return vertices
    largest = target.basis.count, source.basis.count
    if values.ndim != 2 or not values.size or not all(np.less_equal(values.shape, largest)):
        raise ParameterError(
            f"map: expected a PointMap, a functional map of at most {largest}, or a source vertex from 0 to "
            f"{len(source.vertices) - 1} for every target vertex of a level, {' or '.join(map(str, counts))} of them, "
            f"got {type(given).__name__} {values.shape}"
        )
    matrix = real_numbers(values, "functional map")
    if not np.isfinite(matrix).all():
        raise ParameterError("map: expected finite numbers in the functional map, got others")
    return matrix


def functional_map_from(pair: Pair, given: MapLike) -> FloatArray:
    """C12 of a map in any form; of a point or vertex map on all functions of both bases."""
    found = checked(pair, given)
    if isinstance(found, PointMap):
        return functional_map_of(pair.target, pair.source, found)
    if found.ndim == 2:
        return np.asarray(found, dtype=np.float64)
    levels = pair.target.hierarchy
    level = [len(one.positions) for one in levels.levels].index(len(found))
    chosen = evenly_spaced(len(found), FIT_SAMPLES)
    target = _samples(pair.target, levels.on_finest(level)[chosen])
    return fit_functional_map(
        target, _samples(pair.source, found[chosen].astype(np.int64)).rows, pair.target.basis.count
    )


def places_of(pair: Pair, given: MapLike, vertices: IndexArray) -> FloatArray:
    """(q, 3) where a map in any form takes some finest target vertices (q,), at the source's unit area."""
    found, places = checked(pair, given), pair.source.finest_triangles.positions
    if isinstance(found, PointMap):
        return found.images.at(vertices).positions
    if found.ndim == 1:
        levels = pair.target.hierarchy
        rows = levels.on_level([len(one.positions) for one in levels.levels].index(len(found)), vertices)
        if (rows >= 0).all():
            return np.asarray(places[found[rows].astype(np.int64)])
    candidates = evenly_spaced(len(places), SOURCE_SAMPLES)
    target, source = _samples(pair.target, vertices), _samples(pair.source, candidates)
    return np.asarray(places[candidates[nearest_samples(target, source, functional_map_from(pair, found))]])


def zoomed_out(pair: Pair, given: MapLike, schedule: ZoomOutSchedule) -> FloatArray:
    """C12 after ZoomOut from a map in any form, with the schedule's last number of functions."""
    sides = [(pair.target, TARGET_SAMPLES), (pair.source, SOURCE_SAMPLES)]
    chosen = [evenly_spaced(len(surface.vertices), count) for surface, count in sides]
    target, source = in_threads(lambda side: _samples(*side), [(pair.target, chosen[0]), (pair.source, chosen[1])])
    places = pair.source.finest_triangles.positions[chosen[1]]
    start = np.asarray(cKDTree(places).query(places_of(pair, given, chosen[0]))[1], dtype=np.int64)
    match = zoomout(target, source, start, schedule)
    k1, k2 = (min(schedule.last, surface.basis.count) for surface in (pair.target, pair.source))
    return fit_functional_map(target, source.rows[match][:, :k2], k1)


def _samples(surface: Surface, vertices: IndexArray) -> Samples:
    """Basis rows and areas of finest vertices."""
    rows = surface.basis.rows(surface.finest, vertices)
    return Samples(rows, surface.finest_triangles.vertex_areas[vertices], np.zeros((len(rows), 0)))
