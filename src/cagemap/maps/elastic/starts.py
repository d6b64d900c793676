"""Where the coarse stage of the elastic fit starts: the spectral map of the landmarks, and what a fit makes of one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cagemap.basis import Surface
from cagemap.maps.elastic.constants import (
    FURTHER_GROWTH,
    LAST_FUNCTIONS,
    NORMAL_LENGTH,
    PLACES,
    SHEET_VERTICES,
    START_SAMPLES,
    TRUSTED_FUNCTIONS,
)
from cagemap.maps.elastic.data import deformed_normals
from cagemap.maps.elastic.fit import CoarseFit
from cagemap.maps.elastic.problem import FitProblem
from cagemap.maps.spectral.constraints import gather_constraints
from cagemap.maps.spectral.hierarchical import grown_map, search_samples
from cagemap.maps.spectral.landmark_coordinates import landmark_coordinates
from cagemap.maps.spectral.samples import Samples, fit_functional_map, sizes_between, spread
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads


def start_map(problem: FitProblem) -> FloatArray:
    """(k, 3) places on the source where the spectral map sends the coarse shape's vertices.

    That is all that the elastic fit needs to know of it.
    """
    prepared, pair, vertices = problem.prepared, problem.pair, problem.shape.vertices
    levels, config, areas = prepared.levels, prepared.start, problem.shape.rest.graph.areas
    areas = areas * prepared.rest.masks.for_vertices(vertices).of_target(len(vertices))
    constraints = gather_constraints(pair, config.descriptors)
    candidates = spread(len(pair.source.refinement.levels[levels[1]].positions), START_SAMPLES)
    held = problem.near
    candidates = np.union1d(candidates, held[1])
    sides = [
        (pair.target, levels[0], held[0], vertices, areas),
        (pair.source, levels[1], held[1], candidates, np.ones(len(candidates))),
    ]
    target, source = in_threads(lambda side: _samples(*side), sides)
    _, match = grown_map(constraints, target, source, config.weights, config.growth, config.searched_functions)
    return prepared.on_source.positions[candidates[match]]


@dataclass(frozen=True, eq=False)
class SpectralSides:
    """Basis rows of the coarse graph's vertices and of some places of the source, for `spectral_starts`.

    Attributes
    ----------
    target, source : Samples
    places : (m, 3) float64
        Of the source's samples.
    tree : cKDTree
        Over the places and their normals times `NORMAL_LENGTH`.
    """

    target: Samples
    source: Samples
    places: FloatArray
    tree: cKDTree

    @classmethod
    def build(cls, problem: FitProblem) -> SpectralSides:
        """Evaluate the bases."""
        prepared, shape = problem.prepared, problem.shape
        sheet_level = prepared.source.refinement.coarsest_level(SHEET_VERTICES)
        vertices = spread(prepared.sheet.n, PLACES)
        places, normals = prepared.sheet.positions[vertices], prepared.sheet.vertex_normals[vertices]
        sides = (
            (prepared.target, prepared.levels[0], shape.vertices, shape.rest.graph.areas),
            (prepared.source, sheet_level, vertices, np.ones(len(vertices))),
        )
        target, source = (
            Samples(surface.basis.rows(level, chosen), areas, np.zeros((len(chosen), 0)))
            for surface, level, chosen, areas in sides
        )
        return cls(target, source, places, cKDTree(np.hstack([places, NORMAL_LENGTH * normals])))


def spectral_starts(fitted: CoarseFit, sides: SpectralSides) -> list[FloatArray]:
    """(k, 3) places on the source that spectral upsampling makes of a fit: limbs find limbs wherever they are posed.

    The fit's closest points are trusted as far as few basis functions see them, and grown from there (Melzi et al.
    2019).

    Parameters
    ----------
    fitted : CoarseFit
    sides : SpectralSides
    """
    target, source = sides.target, sides.source
    normals = deformed_normals(fitted.graph.normals, fitted.maps)
    match = np.asarray(sides.tree.query(np.hstack([fitted.positions, NORMAL_LENGTH * normals]))[1], dtype=np.int64)
    found = []
    for start in TRUSTED_FUNCTIONS:
        better = match
        for k in sizes_between(start, LAST_FUNCTIONS, FURTHER_GROWTH):
            k1, k2 = min(k, target.rows.shape[1]), min(k, source.rows.shape[1])
            functional_map = fit_functional_map(target, source.rows[better][:, :k2], k1)
            better = search_samples(target, source, functional_map)
        found.append(sides.places[better])
    return found


def _samples(surface: Surface, level: int, landmarks: IndexArray, vertices: IndexArray, areas: FloatArray) -> Samples:
    """Some vertices of a level, with their landmark coordinates."""
    operators = surface.operators
    coordinates = landmark_coordinates(operators.stiffness[level], operators.mass[level], landmarks)
    return Samples(surface.basis.rows(level, vertices), areas, coordinates[vertices])
