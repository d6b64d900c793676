"""Update a map after landmarks were added, moved or removed: a linear elastic response.

The map is an equilibrium of the fit. A moved landmark displaces its surroundings along the surface by d. The coarse
graph resolves d: E(d, A) is quadratic, the data terms keep d in the source's tangent planes, and neither closest points
nor the fine mesh are needed. The result is close to that of the whole fit, at a fraction of its time
(docs/lab/fit_experiments.md).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.deform.config import ElasticConfig
from cagemap.deform.energy import ElasticEnergy, VertexTerms, any_map, minimise
from cagemap.deform.graph import ElasticGraph, extrapolate
from cagemap.deform.problem import Problem
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.triangles import vertex_normals


def linear_update(problem: Problem, before: PointMap) -> FloatArray:
    """(n, 3) positions of the deformed level, by a map moved to meet landmarks and curves."""
    prepared, landmarks, clusters = problem.prepared, problem.landmarks, problem.coarse_clusters
    coarse, vertices, config = clusters.energy.graph, clusters.vertices, prepared.elastic
    positions = before.images.at(prepared.vertices).positions
    normals = vertex_normals(positions, prepared.mesh.triangles)[vertices]
    offsets = landmarks.source.positions - landmarks.target.interpolate(before.images.positions)
    blocks, right = np.zeros((coarse.n, 3, 3)), np.zeros((coarse.n, 3))
    clusters.constraints.add_curves(blocks, right, positions[vertices], config)
    terms = blocks, right - np.einsum("nab,nb->na", blocks, positions[vertices])
    response = displacement_response(coarse, normals, np.arange(len(offsets)), offsets, config, terms)
    return positions + extrapolate(coarse, *response, prepared.energy.graph, config.graph)


def displacement_response(
    graph: ElasticGraph,
    normals: FloatArray,
    vertices: IndexArray,
    offsets: FloatArray,
    config: ElasticConfig = ElasticConfig(),
    terms: tuple[FloatArray, FloatArray] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Displacements (n, 3) of a graph's vertices and their differentials (n, 3, 3), for given offsets of some.

    The given vertices (p,) move by offsets (p, 3), the others in the tangent planes of normals (n, 3). Other terms are
    blocks B (n, 3, 3) and B y (n, 3) of ``(d - y)^T B (d - y)`` for displacements d.
    """
    stage, landmark_weight = config.response, config.landmark_weight
    energy = ElasticEnergy(graph, stage.smoothing, any_map)
    blocks = graph.areas[:, None, None] * normals[:, :, None] * normals[:, None, :]
    right = np.zeros((graph.n, 3))
    if terms is not None:
        blocks, right = blocks + terms[0], right + terms[1]
    blocks[vertices] = landmark_weight * np.eye(3)
    right[vertices] = landmark_weight * offsets
    constant = replace(stage, stiffness=(stage.stiffness[-1], stage.stiffness[-1]))  # one factorisation
    both = VertexTerms(energy, blocks, right, constant=True)
    displacements = minimise(graph, energy.differentials, both, np.zeros((graph.n, 3)), constant)
    return displacements, energy.maps(displacements)
