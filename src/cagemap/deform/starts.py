"""Starts of the coarse stage of the elastic fit: ZoomOut from landmark coordinates, and from a fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cagemap.deform.config import SpectralStartConfig
from cagemap.deform.energy import deformed_normals
from cagemap.deform.placement import Placement
from cagemap.deform.prepared import CoarseShape
from cagemap.deform.problem import Problem
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads
from cagemap.spectral.landmark_coordinates import landmark_coordinates
from cagemap.spectral.surface import Surface
from cagemap.spectral.zoomout import Samples, ZoomOutSchedule, evenly_spaced, nearest_coordinates, zoomout


def start_map(
    problem: Problem, shape: CoarseShape | None = None, held: tuple[IndexArray, IndexArray] | None = None
) -> FloatArray:
    """(k, 3) places on the source of a coarse shape's vertices: nearest landmark coordinates, refined by ZoomOut.

    The shape and the vertices of both levels that correspond are the problem's own where none are given.
    """
    prepared, shape = problem.prepared, shape or problem.shape
    vertices, held = shape.vertices, held or problem.landmark_vertices
    levels, areas = prepared.levels, shape.rest.graph.areas
    areas = areas * prepared.rest.masks.for_vertices(vertices).of_target(len(vertices))
    n_searched = prepared.source.hierarchy.levels[levels[1]].n_vertices
    candidates = evenly_spaced(n_searched, prepared.elastic.spectral_starts.samples)
    candidates = np.union1d(candidates, held[1])
    of_curves = curve_vertices(problem)
    sides = [
        (prepared.target, levels[0], held[0], of_curves[0], vertices, areas),
        (prepared.source, levels[1], held[1], of_curves[1], candidates, np.ones(len(candidates))),
    ]
    target, source = in_threads(lambda side: _with_coordinates(*side), sides)
    match = zoomout(target, source, nearest_coordinates(target, source), prepared.start.zoomout)
    return prepared.source.triangles(levels[1]).positions[candidates[match]]


def curve_vertices(problem: Problem) -> tuple[list[IndexArray], list[IndexArray]]:
    """Vertices of both levels along every curve, all different; curves that landmarks or others cover are left out."""
    prepared, taken = problem.prepared, list(problem.landmark_vertices)
    found: tuple[list[IndexArray], list[IndexArray]] = ([], [])
    count = prepared.elastic.spectral_starts.curve_points
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


@dataclass(frozen=True, eq=False)
class SpectralSides:
    """Basis rows of the coarse graph's vertices and of some places of the source, for `spectral_starts`.

    Attributes
    ----------
    target, source : Samples
    places : (m, 3) float64
        Of the source's samples.
    tree : cKDTree
        Of rows (position, `SpectralStartConfig.normal_length` times normal).
    config : SpectralStartConfig
    """

    target: Samples
    source: Samples
    places: FloatArray
    tree: cKDTree
    config: SpectralStartConfig

    @classmethod
    def build(cls, problem: Problem, shape: CoarseShape | None = None) -> SpectralSides:
        """Evaluate the bases for a coarse shape, the problem's own if none is given."""
        prepared, shape = problem.prepared, shape or problem.shape
        config = prepared.elastic.spectral_starts
        level = prepared.source.hierarchy.coarsest_level(prepared.elastic.source_vertices)
        vertices = evenly_spaced(prepared.source_surface.n, config.places)
        places, normals = prepared.source_surface.positions[vertices], prepared.source_surface.vertex_normals[vertices]
        sides = (
            (prepared.target, prepared.levels[0], shape.vertices, shape.rest.graph.areas),
            (prepared.source, level, vertices, np.ones(len(vertices))),
        )
        target, source = (
            Samples(basis_rows(surface, level, chosen), areas, np.zeros((len(chosen), 0)))
            for surface, level, chosen, areas in sides
        )
        return cls(target, source, places, cKDTree(np.hstack([places, config.normal_length * normals])), config)


def spectral_starts(fitted: Placement, sides: SpectralSides) -> list[FloatArray]:
    """(k, 3) places on the source by ZoomOut from a fit's closest points: they find limbs in other poses.

    The first number of functions says how much of the fit is trusted.
    """
    assert fitted.graph is not None
    config, normals = sides.config, deformed_normals(fitted.graph.normals, fitted.maps)
    wanted = np.hstack([fitted.positions, config.normal_length * normals])
    match = np.asarray(sides.tree.query(wanted)[1], dtype=np.int64)
    schedules = [ZoomOutSchedule(first, config.last_functions, config.growth) for first in config.trusted_functions]
    return [sides.places[zoomout(sides.target, sides.source, match, schedule)] for schedule in schedules]


def basis_rows(surface: Surface, level: int, vertices: IndexArray) -> FloatArray:
    """(q, k) values of all basis functions at vertices of a level, which are vertices of all finer ones."""
    fine = max(level, surface.basis.last_level)
    return surface.basis.rows(fine, surface.hierarchy.vertices_on(fine, level)[vertices])


def _with_coordinates(
    surface: Surface,
    level: int,
    landmarks: IndexArray,
    curves: list[IndexArray],
    vertices: IndexArray,
    areas: FloatArray,
) -> Samples:
    """Some vertices of a level, with the coordinates of landmarks and curves."""
    operators = surface.operators
    coordinates = landmark_coordinates(operators.stiffness[level], operators.mass[level], landmarks, curves)
    return Samples(basis_rows(surface, level, vertices), areas, coordinates[vertices])
