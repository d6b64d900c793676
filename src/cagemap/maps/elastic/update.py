"""What added, moved or removed landmarks do to a map that is there already: a linear elastic response.

The map is an equilibrium of the fit. A landmark that pulls at it moves its surroundings along the surface, by a
displacement d that the coarse graph resolves: E(d, A) of `cagemap.maps.elastic.graph` is quadratic, the data
hold d in the source's tangent planes, and neither closest points nor the fine mesh are needed. Its end is close to that
of the whole fit (docs/accuracy.md), at a fraction of its time.
"""

from __future__ import annotations

import numpy as np

from cagemap.geometry.triangles import vertex_normals
from cagemap.maps.elastic.config import ElasticConfig
from cagemap.maps.elastic.constants import CURVE_SHARE
from cagemap.maps.elastic.curves import curves_on_mesh, pull_curves, with_clusters
from cagemap.maps.elastic.graph import DifferentialField, ElasticGraph, cluster_graph, extrapolate
from cagemap.maps.elastic.problem import FitProblem
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray


def landmark_response(
    graph: ElasticGraph,
    normals: FloatArray,
    held: IndexArray,
    offsets: FloatArray,
    config: ElasticConfig = ElasticConfig(),
    pull: tuple[FloatArray, FloatArray] | None = None,
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
    config : ElasticConfig
    pull : (n, 3, 3) and (n, 3) float64, optional
        Blocks B and forces B y of what else pulls: the term (d - y)^T B (d - y) of every displacement d.
    """
    stage, landmark_weight = config.response, config.landmark_weight
    field = DifferentialField.build(graph, graph.laplacian(), stage.smoothing)
    blocks = graph.areas[:, None, None] * normals[:, :, None] * normals[:, None, :]
    pulled = np.zeros((graph.n, 3))
    if pull is not None:
        blocks, pulled = blocks + pull[0], pulled + pull[1]
    blocks[held] = landmark_weight * np.eye(3)
    pulled[held] = landmark_weight * offsets
    stiffness = stage.stiffness[-1]
    factors = field.system.factor(stiffness, blocks, field.factors)
    before, maps = np.zeros((graph.n, 3)), np.zeros((graph.n, 3, 3))
    for iteration in range(stage.iterations):
        after = factors.solve((pulled + stiffness * field.divergence(maps)).ravel()).reshape(-1, 3)
        goes_on = 0 < iteration < stage.iterations - 1
        maps = field.solve(after + stage.momentum * (after - before) if goes_on else after)
        before = after
    return before, maps


def respond(problem: FitProblem, before: PointMap) -> FloatArray:
    """Move a map so that its landmarks are where they should be, and its curves where they are straight enough.

    Parameters
    ----------
    problem : FitProblem
        With the landmarks as they are now.
    before : PointMap
        Of the finest levels.

    Returns
    -------
    (n, 3) float64
        Positions near the source of the target's vertices of the level that is deformed; project them for a map.
    """
    prepared, landmarks, held = problem.prepared, problem.pair.landmarks, problem.near[0]
    graph, mesh = prepared.rest.graph, prepared.mesh
    size = min(prepared.elastic.coarse_vertices, graph.n)
    every, curves = with_clusters(curves_on_mesh(mesh, landmarks.curves), held, size // CURVE_SHARE)
    coarse, vertices = cluster_graph(graph, size, every)
    positions = before.images.at(slice(0, graph.n)).positions
    normals = vertex_normals(positions, mesh.triangles)[vertices]
    offsets = landmarks.source.positions - landmarks.target.interpolate(before.images.positions)
    blocks, right = np.zeros((coarse.n, 3, 3)), np.zeros((coarse.n, 3))
    pull_curves(curves, blocks, right, positions[vertices], prepared.elastic.curve_weight)
    pull = blocks, right - np.einsum("nab,nb->na", blocks, positions[vertices])
    response = landmark_response(coarse, normals, np.arange(len(held)), offsets, prepared.elastic, pull)
    return positions + extrapolate(coarse, *response, graph)
