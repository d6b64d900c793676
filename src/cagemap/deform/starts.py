"""Starts of the coarse stage of the elastic fit: ZoomOut from landmark coordinates, and from a fit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from cagemap.deform.energy import deformed_normals
from cagemap.deform.placement import Placement
from cagemap.deform.problem import CoarseShape, Problem
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads
from cagemap.spectral.landmark_coordinates import landmark_coordinates
from cagemap.spectral.surface import Surface
from cagemap.spectral.zoomout import Samples, ZoomOutSchedule, evenly_spaced, nearest_coordinates, zoomout


def start_map(
    problem: Problem, shape: CoarseShape | None = None, held: tuple[IndexArray, IndexArray] | None = None
) -> FloatArray:
    """(k, 3) places on the source of a coarse shape's vertices: nearest coordinates of held vertices, then ZoomOut."""
    prepared, shape = problem.prepared, shape or problem.shape
    vertices, held = shape.vertices, held or problem.landmark_vertices
    levels, areas = prepared.levels, shape.rest.graph.areas
    areas = areas * prepared.rest.masks.for_vertices(vertices).of_target(len(vertices))
    n_searched = prepared.source.hierarchy.levels[levels[1]].n_vertices
    candidates = evenly_spaced(n_searched, prepared.start.samples)
    candidates = np.union1d(candidates, held[1])
    of_curves = curve_vertices(problem)

    def samples(side: int, chosen: IndexArray, areas: FloatArray) -> Samples:
        surface, level = (prepared.target, prepared.source)[side], levels[side]
        operators = surface.operators
        coordinates = landmark_coordinates(
            operators.stiffness[level], operators.mass[level], held[side], of_curves[side]
        )
        return Samples(basis_rows(surface, level, chosen), areas, coordinates[chosen])

    sides = (0, vertices, areas), (1, candidates, np.ones(len(candidates)))
    target, source = in_threads(lambda side: samples(*side), sides)
    match = zoomout(target, source, nearest_coordinates(target, source), prepared.start.zoomout)
    return prepared.source.triangles(levels[1]).positions[candidates[match]]


def curve_vertices(problem: Problem) -> tuple[list[IndexArray], list[IndexArray]]:
    """Vertices of both levels along every curve, all different; curves that landmarks or others cover are left out."""
    prepared, taken = problem.prepared, list(problem.landmark_vertices)
    found: tuple[list[IndexArray], list[IndexArray]] = ([], [])
    count = prepared.start.curve_points
    for pair in problem.pair.landmarks.curves:
        own = []
        sides = (prepared.target, prepared.levels[0], pair.target), (prepared.source, prepared.levels[1], pair.source)
        for side, (surface, level, curve) in enumerate(sides):
            places = curve.points.positions[curve.line.spread(count)]
            near = cKDTree(surface.triangles(level).positions).query(places)[1]
            own.append(np.setdiff1d(np.asarray(near, dtype=np.int64), taken[side]))
            taken[side] = np.union1d(taken[side], own[side])
        if all(len(vertices) for vertices in own):
            for listed, vertices in zip(found, own, strict=True):
                listed.append(vertices)
    return found


def spectral_starts(problem: Problem, shape: CoarseShape | None = None) -> Callable[[Placement], list[FloatArray]]:
    """A function from a fit of a coarse shape to (k, 3) places on the source by ZoomOut from its closest points.

    They find limbs in other poses. The first number of functions says how much of the fit is trusted. The shape is the
    problem's own where none is given.
    """
    prepared, shape = problem.prepared, shape or problem.shape
    config, surface = prepared.start, prepared.source_surface
    level = prepared.source.hierarchy.coarsest_level(prepared.elastic.source_vertices)
    vertices = evenly_spaced(surface.n, config.places)
    places = surface.positions[vertices]
    tree = cKDTree(np.hstack([places, config.normal_length * surface.vertex_normals[vertices]]))
    sides = (
        (prepared.target, prepared.levels[0], shape.vertices, shape.rest.graph.areas),
        (prepared.source, level, vertices, np.ones(len(vertices))),
    )
    target, source = (
        Samples(basis_rows(side, on, chosen), areas, np.zeros((len(chosen), 0))) for side, on, chosen, areas in sides
    )
    schedules = [ZoomOutSchedule(first, config.last_functions, config.growth) for first in config.trusted_functions]

    def starts(fitted: Placement) -> list[FloatArray]:
        assert fitted.graph is not None
        normals = deformed_normals(fitted.graph.normals, fitted.maps)
        near = tree.query(np.hstack([fitted.positions, config.normal_length * normals]))[1]
        match = np.asarray(near, dtype=np.int64)
        return [places[zoomout(target, source, match, schedule)] for schedule in schedules]

    return starts


def basis_rows(surface: Surface, level: int, vertices: IndexArray) -> FloatArray:
    """(q, k) values of all basis functions at vertices of a level, which are vertices of all finer ones."""
    fine = max(level, surface.basis.last_level)
    return surface.basis.rows(fine, surface.hierarchy.vertices_on(fine, level)[vertices])
