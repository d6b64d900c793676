"""Coarse graphs of surfaces whose parts touch: nothing that only lies close together is joined."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from cagemap.deform.config import GraphConfig
from cagemap.deform.graph import ElasticGraph, cluster_graph, connected_cells, mesh_graph
from cagemap.surface.triangle_surface import TriangleSurface

TURNS = 4.0
PITCH = 0.004  # between the turns of the ramp, of sqrt(area): far below a cell's width, with like normals


def ramp() -> tuple[ElasticGraph, np.ndarray]:
    """A ribbon wound up like a spiral ramp, at unit area, and the angle of every vertex."""
    around, across = 161, 6
    angle, radius = np.meshgrid(np.linspace(0, TURNS * 2 * np.pi, around), np.linspace(1.0, 1.5, across), indexing="ij")
    area = np.pi * (1.5**2 - 1.0**2) * TURNS
    height = PITCH * np.sqrt(area) * angle / (2 * np.pi)
    positions = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1).reshape(-1, 3)
    corner = (np.arange(around - 1)[:, None] * across + np.arange(across - 1)).ravel()
    quads = np.stack([corner, corner + across, corner + across + 1, corner + 1], axis=1)
    triangles = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return mesh_graph(TriangleSurface(positions / np.sqrt(area), triangles), quads), angle.ravel()


def distances_from(graph: ElasticGraph, vertex: int) -> np.ndarray:
    lengths = np.linalg.norm(graph.edges, axis=1)
    edges = sparse.csr_array((lengths, (graph.heads, graph.tails)), shape=(graph.n, graph.n))
    return np.asarray(dijkstra(edges, indices=[vertex]))[0]


def test_ways_on_the_coarse_graph_do_not_jump_where_parts_touch() -> None:
    fine, angle = ramp()
    coarse, vertices = cluster_graph(fine, 150, np.array([0, fine.n - 1]))
    # The ends lie above each other, a hundredth apart, and four turns of radius 1 or more away from each other.
    assert distances_from(coarse, 0)[1] > 0.9 * distances_from(fine, 0)[-1]
    turned = np.abs(angle[vertices][coarse.heads] - angle[vertices][coarse.tails])
    assert turned.max() < np.pi / 2


def test_cells_are_connected_cover_all_and_none_is_tiny() -> None:
    fine, _ = ramp()
    rng = np.random.default_rng(5)
    given = rng.integers(0, 40, fine.n)  # cells that are anything but connected
    cell = connected_cells(fine, given)
    assert set(cell) == set(range(cell.max() + 1))
    inside = cell[fine.heads] == cell[fine.tails]
    within = sparse.coo_array((np.ones(inside.sum()), (fine.heads[inside], fine.tails[inside])), shape=(fine.n,) * 2)
    assert connected_components(within, directed=False)[0] == cell.max() + 1
    areas = np.bincount(cell, fine.areas)
    assert (areas < GraphConfig.min_cell * areas.mean()).mean() < 0.02


def test_cells_that_are_connected_and_large_stay_as_they_are() -> None:
    fine, angle = ramp()
    given = (angle / (TURNS * 2 * np.pi / 19.999)).astype(np.int64)
    cell = connected_cells(fine, given)
    assert len(np.unique(np.column_stack([given, cell]), axis=0)) == len(np.unique(given)) == cell.max() + 1
