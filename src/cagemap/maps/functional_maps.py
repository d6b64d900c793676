"""Functional maps of point maps and vertex maps, and conversion to the bases of other libraries."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from cagemap.errors import ParameterError
from cagemap.maps.pair import LevelPair, Pair
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray, array_of, finite_numbers, whole_numbers
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import in_threads
from cagemap.spectral.surface import Surface
from cagemap.spectral.zoomout import (
    FIT_SAMPLES,
    ZoomOutSchedule,
    evenly_spaced_vertices,
    fit_functional_map,
    nearest_samples,
    zoomout,
)

TARGET_SAMPLES, SOURCE_SAMPLES = 3000, 10_000  # numbers of samples of target and source in ZoomOut


@dataclass(frozen=True, eq=False)
class LevelMap:
    """Functional map and vertex matches between one level of the target and one of the source."""

    levels: LevelPair  # of target and source
    functional_map: FloatArray = field(repr=False)  # (k1, k2) C12 on the basis functions of these levels
    match: IndexArray = field(repr=False)  # (n1,) the source level's vertex of every target vertex
    points: PointMap | None = None  # images as points of the source; None until the finer levels are found


MapLike = PointMap | LevelMap | ArrayLike


@kinds_checked
def functional_map_of(target: Surface, source: Surface, point_map: PointMap) -> FloatArray:
    """C12 = Phi~1^+ P12 Phi~2 of a point map of the finest levels, on a sample of its vertices (paper, 2.1.2).

    ParameterError if the map has other numbers of vertices.
    """
    _check_sides(target, source, point_map)
    chosen = evenly_spaced_vertices(len(point_map.images), FIT_SAMPLES)
    sampled = point_map.images.at(chosen)
    corners, places = np.unique(sampled.corners, return_inverse=True)
    at_vertices, at_corners = in_threads(
        lambda side: side[0].basis_rows(side[1]), [(target, chosen), (source, corners)]
    )
    weights = sampled.barycentric
    pulled = np.asarray(sum(weights[:, i, None] * at_corners[places.reshape(-1, 3)[:, i]] for i in range(3)))
    return fit_functional_map(at_vertices, target.finest_triangles.vertex_areas[chosen], pulled)


@kinds_checked
def functional_map_from(pair: Pair, given: MapLike, sizes: tuple[int, int] | None = None) -> FloatArray:
    """C12 of a map in any form; vertex maps are fitted with ``sizes`` functions (k1, k2), by default with all."""
    checked = check_map(pair, given)
    if isinstance(checked, PointMap):
        return functional_map_of(pair.target, pair.source, checked)
    if checked.ndim == 2:
        return np.array(checked, dtype=np.float64)
    k1, k2 = (None, None) if sizes is None else sizes
    chosen = evenly_spaced_vertices(len(checked), FIT_SAMPLES)
    vertices = pair.target.hierarchy.on_finest(_level_of(pair, checked))[chosen]
    areas = pair.target.finest_triangles.vertex_areas[vertices]
    values = pair.source.basis_rows(checked[chosen].astype(np.int64))
    return fit_functional_map(pair.target.basis_rows(vertices)[:, :k1], areas, values[:, :k2])


def check_map(pair: Pair, given: MapLike) -> PointMap | FloatArray | IndexArray:
    """The checked map: a PointMap, C12 (k1, k2), or (n,) a finest source vertex for each target vertex of a level."""
    target, source = pair.target, pair.source
    form = _finest_images(pair, given) if isinstance(given, LevelMap) else given
    if isinstance(form, PointMap):
        _check_sides(target, source, form)
        return form
    values = array_of(form)
    counts = [level.n_vertices for level in target.hierarchy.levels]
    if values.ndim == 1 and len(values) in counts:
        vertices = whole_numbers(values, "map")
        if 0 <= vertices.min() and vertices.max() < len(source.vertices):
            return vertices
    largest = target.basis.count, source.basis.count
    if values.ndim != 2 or not values.size or not all(np.less_equal(values.shape, largest)):
        raise ParameterError(
            f"map: expected a PointMap, a functional map of at most {largest}, a LevelMap, or a finest source vertex "
            f"(0 to {len(source.vertices) - 1}) for every target vertex of a level, {' or '.join(map(str, counts))}, "
            f"got {type(given).__name__} {values.shape}"
        )
    return finite_numbers(values, "map")


def _check_sides(target: Surface, source: Surface, given: PointMap) -> None:
    """Refuse point maps of other numbers of vertices than the finest levels have."""
    if given.target.n != len(target.vertices) or given.source.n != len(source.vertices):
        raise ParameterError(
            f"map: expected one of {len(target.vertices)} to {len(source.vertices)} vertices, the finest of the "
            f"pair, got {given}: target and source may be exchanged, or it belongs to another level"
        )


def _finest_images(pair: Pair, given: LevelMap) -> PointMap | IndexArray:
    """The point map of the finest levels, or the finest source vertices (n1,) of a coarse level's target vertices."""
    levels = pair.levels(given.levels)
    if given.points is not None and levels == pair.levels():
        return given.points
    match, on_finest = whole_numbers(given.match, "map"), pair.source.hierarchy.on_finest(levels[1])
    n = pair.target.hierarchy.levels[levels[0]].n_vertices
    if match.shape != (n,) or match.min() < 0 or match.max() >= len(on_finest):
        raise ParameterError(
            f"map: expected a vertex of level {levels[1]} of the source (0 to {len(on_finest) - 1}) for each of the "
            f"{n} vertices of level {levels[0]} of the target, got {match.size}, up to {match.max(initial=-1)}"
        )
    return on_finest[match]


def _level_of(pair: Pair, vertex_map: FloatArray | IndexArray) -> int:
    """Level of the target that has as many vertices as a vertex map has entries."""
    return [level.n_vertices for level in pair.target.hierarchy.levels].index(len(vertex_map))


def image_positions(pair: Pair, given: MapLike, vertices: IndexArray) -> FloatArray:
    """(q, 3) images of finest target vertices (q,) by a map in any form, at unit area."""
    checked, places = check_map(pair, given), pair.source.finest_triangles.positions
    if isinstance(checked, PointMap):
        return checked.images.at(vertices).positions
    if checked.ndim == 1:
        rows = pair.target.hierarchy.on_level(_level_of(pair, checked), vertices)
        if (rows >= 0).all():
            return np.asarray(places[checked[rows].astype(np.int64)])
    candidates = evenly_spaced_vertices(len(places), SOURCE_SAMPLES)
    target, source = pair.target.basis_rows(vertices), pair.source.basis_rows(candidates)
    return np.asarray(places[candidates[nearest_samples(target, source, functional_map_from(pair, checked))]])


def zoomout_of_map(pair: Pair, given: MapLike, schedule: ZoomOutSchedule) -> FloatArray:
    """C12 after ZoomOut from a map in any form, with the schedule's last number of functions."""
    counts = (pair.target, TARGET_SAMPLES), (pair.source, SOURCE_SAMPLES)
    chosen = [evenly_spaced_vertices(len(surface.vertices), count) for surface, count in counts]
    sides = [(pair.target, chosen[0]), (pair.source, chosen[1])]
    target, source = in_threads(lambda side: side[0].basis_rows(side[1]), sides)
    areas = pair.target.finest_triangles.vertex_areas[chosen[0]]
    places = pair.source.finest_triangles.positions[chosen[1]]
    start = np.asarray(cKDTree(places).query(image_positions(pair, given, chosen[0]))[1], dtype=np.int64)
    match = zoomout(target, areas, source, start, schedule)
    k1, k2 = (min(schedule.last, surface.basis.count) for surface in (pair.target, pair.source))
    return fit_functional_map(target[:, :k1], areas, source[match][:, :k2])


@kinds_checked
def from_bases(
    pair: Pair,
    functional_map: FloatArray,
    target_functions: FloatArray,
    source_functions: FloatArray,
    levels: LevelPair | None = None,
) -> FloatArray:
    """C12 on the bases of a pair, from a functional map on other functions.

    The map (q1, q2) takes coefficients of the source's functions (n2, q2 or more) to those of the target's functions
    (n1, q1 or more): values, at any scale, at the vertices of ``levels``, by default the finest. Returns (k1, k2):
    k1 = q1 and k2 = q2, or as many functions as a basis has. ParameterError if functions lack a row for each vertex of
    their level, or are fewer than the map takes.

    pyFM's ``model.FM_12`` with ``model.mesh2.eigenvectors`` as the target's functions and ``mesh1``'s as the source's;
    geomfum's matrix with those of ``basis_b.vecs`` and ``basis_a.vecs``.
    """
    matrix, functions = finite_numbers(functional_map, "map"), (target_functions, source_functions)
    (ours1, theirs1, areas1), (ours2, theirs2, areas2) = _sides(pair, matrix.shape, functions, levels)
    k1, k2 = matrix.shape  # or as many as a basis has
    to_ours = fit_functional_map(ours1[:, :k1], areas1, theirs1)
    return np.asarray(to_ours @ matrix @ fit_functional_map(theirs2, areas2, ours2[:, :k2]))


@kinds_checked
def to_bases(
    pair: Pair,
    functional_map: FloatArray,
    target_functions: FloatArray,
    source_functions: FloatArray,
    levels: LevelPair | None = None,
) -> FloatArray:
    """(q1, q2) map on functions (n1, q1), (n2, q2) from C12 of a pair.

    The inverse of `from_bases`; same errors.
    """
    matrix, functions = functional_map_from(pair, functional_map), (target_functions, source_functions)
    shape = tuple(finite_numbers(values, "functions").shape[-1] for values in functions)
    (ours1, theirs1, areas1), (ours2, theirs2, areas2) = _sides(pair, shape, functions, levels)
    k1, k2 = matrix.shape
    to_theirs = fit_functional_map(theirs1, areas1, ours1[:, :k1])
    return np.asarray(to_theirs @ matrix @ fit_functional_map(ours2[:, :k2], areas2, theirs2))


def _sides(
    pair: Pair, shape: tuple[int, ...], functions: tuple[FloatArray, FloatArray], levels: LevelPair | None
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Own basis, given functions and areas at sampled vertices, for target and source."""
    surfaces, given_levels, sides = (pair.target, pair.source), pair.levels(levels), []
    for i, name in enumerate(("target", "source")):
        surface, level = surfaces[i], given_levels[i]
        triangles, theirs = surface.triangles(level), finite_numbers(functions[i], f"{name} functions")
        if len(shape) != 2 or theirs.ndim != 2 or len(theirs) != triangles.n or theirs.shape[1] < shape[i]:
            raise ParameterError(
                f"{name} functions: expected {triangles.n} rows, the vertices of level {level}, and as many columns as "
                f"the functional map {shape} takes, got {theirs.shape}; pyFM's mesh1 is the source, mesh2 the "
                "target"
            )
        chosen = evenly_spaced_vertices(triangles.n, FIT_SAMPLES)
        rows = surface.basis_rows(surface.hierarchy.on_finest(level)[chosen])
        sides.append((rows, theirs[chosen, : shape[i]], triangles.vertex_areas[chosen]))
    return sides
