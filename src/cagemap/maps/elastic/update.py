"""What added, moved or removed landmarks do to a map that is there already: a linear elastic response.

The map is an equilibrium of the fit. A landmark that pulls at it moves its surroundings along the surface, by a
displacement d that the coarse graph resolves: E(d, A) of `cagemap.maps.elastic.graph` is quadratic, the data
hold d in the source's tangent planes, and neither closest points nor the fine mesh are needed. Its end is close to that
of the whole fit (docs/accuracy.md), at a fraction of its time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.geometry.triangles import vertex_normals
from cagemap.maps.elastic.fit import ElasticConfig
from cagemap.maps.elastic.graph import DifferentialField, ElasticGraph, cluster_graph, extrapolate
from cagemap.numerics.arrays import FloatArray, IndexArray


@dataclass(frozen=True)
class UpdateConfig:
    """Parameters of the response; the defaults are the measured ones.

    Attributes
    ----------
    iterations : int
    stiffness : float
        alpha of the energy against the data, as at the end of the coarse stage of the fit.
    momentum : float
        See `cagemap.maps.elastic.fit.Stage`.
    """

    iterations: int = 8
    stiffness: float = 2e-4
    momentum: float = 0.6


def landmark_response(
    graph: ElasticGraph,
    normals: FloatArray,
    held: IndexArray,
    offsets: FloatArray,
    smoothing: float,
    landmark_weight: float,
    config: UpdateConfig = UpdateConfig(),
) -> tuple[FloatArray, FloatArray]:
    """Displacements (n, 3) of a graph's vertices, and their differentials (n, 3, 3), when some of them are moved.

    Parameters
    ----------
    graph : ElasticGraph
    normals : (n, 3) float64
        Unit normals of the source where the vertices are: the data let them move in the tangent planes.
    held : (p,) int64
    offsets : (p, 3) float64
        Displacements of the vertices held, zero for those that stay.
    smoothing : float
        epsilon of the energy.
    landmark_weight : float
    config : UpdateConfig
    """
    laplacian = graph.laplacian()
    field = DifferentialField.build(graph, laplacian, smoothing)
    blocks = graph.areas[:, None, None] * normals[:, :, None] * normals[:, None, :]
    blocks[held] = landmark_weight * np.eye(3)
    pulled = np.zeros((graph.n, 3))
    pulled[held] = landmark_weight * offsets
    factors = field.system.factor(config.stiffness, blocks, field.factors)
    before, maps = np.zeros((graph.n, 3)), np.zeros((graph.n, 3, 3))
    for iteration in range(config.iterations):
        after = factors.solve((pulled + config.stiffness * field.divergence(maps)).ravel()).reshape(-1, 3)
        goes_on = 0 < iteration < config.iterations - 1
        maps = field.solve(after + config.momentum * (after - before) if goes_on else after)
        before = after
    return before, maps


def respond(
    graph: ElasticGraph,
    triangles: IndexArray,
    positions: FloatArray,
    landmarks: IndexArray,
    landmark_positions: FloatArray,
    elastic: ElasticConfig = ElasticConfig(),
    config: UpdateConfig = UpdateConfig(),
) -> FloatArray:
    """Move a fitted mesh so that its landmarks are where they should be.

    Parameters
    ----------
    graph : ElasticGraph
        Of the target's mesh.
    triangles : (t, 3) int64
        Of that mesh.
    positions : (n, 3) float64
        Of its vertices on the source.
    landmarks : (p,) int64
    landmark_positions : (p, 3) float64
    elastic : ElasticConfig
        Of the fit that made the positions.
    config : UpdateConfig

    Returns
    -------
    (n, 3) float64
        Positions near the source; project them for a map.
    """
    coarse, vertices = cluster_graph(graph, min(elastic.coarse_vertices, graph.n), landmarks)
    normals = vertex_normals(positions, triangles)[vertices]
    offsets = landmark_positions - positions[landmarks]
    held = np.arange(len(landmarks))
    response = landmark_response(
        coarse, normals, held, offsets, elastic.coarse.smoothing, elastic.landmark_weight, config
    )
    return positions + extrapolate(coarse, *response, graph)
