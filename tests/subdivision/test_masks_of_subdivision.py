"""Masks of one subdivision step, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from examples.shapes import (
    bipyramid,
    creature,
    cube,
    disk,
    grid,
    poles,
    tetrahedron,
    torus,
)

from cagemap.mesh import CatmullClark, ControlMesh
from cagemap.subdivision import refine
from cagemap.subdivision.matrices import polygon_matrix, regular_matrix
from cagemap.subdivision.refinement import state_of
from cagemap.subdivision.topology import control_topology, fixed_boundary_vertices


def test_quad_masks_are_the_general_rule_written_out() -> None:
    for mesh in (cube(), creature(), poles(3), poles(8), torus(3, 3), grid(3, 2), disk(5)):
        for boundary in ("edge_and_corner", "edge_only"):
            topology, scheme = control_topology(mesh), CatmullClark(boundary)
            corner = fixed_boundary_vertices(topology, scheme)
            general, written_out = (rule(topology, scheme, corner) for rule in (polygon_matrix, regular_matrix))
            assert abs(general - written_out).max() < 1e-15
            assert general.nnz == written_out.nnz


def test_interior_vertex_of_valence_2() -> None:
    # Two quads share the path 0-1-2 and both of vertex 1's edges; it has weight 0 in its own rule.
    positions = [(0, 0, 0), (1, 0.2, 0), (2, 0, 0), (1, -1, 0), (1, 1, 0)]
    mesh = ControlMesh.from_faces(positions, [(0, 3, 2, 1), (0, 1, 2, 4)])
    refinement = refine(mesh, 2)
    np.testing.assert_allclose(refinement.matrices[0][[1]].toarray(), [[3 / 8, 1 / 8, 3 / 8, 1 / 16, 1 / 16]])
    assert all(matrix.has_canonical_format for matrix in refinement.matrices)  # the ring meets some vertices twice
    topology = state_of(refinement, 1).topology
    again = polygon_matrix(topology, CatmullClark(), fixed_boundary_vertices(topology, CatmullClark()))
    assert abs(again - refinement.matrices[1]).max() < 1e-15


@pytest.mark.parametrize("valence", [3, 5, 8])
def test_catmull_clark_vertex_mask(valence: int) -> None:
    # A pole of valence n among quads: 1 - 7/(4n), neighbours 3/(2n^2), opposite vertices 1/(4n^2).
    weights = refine(poles(valence), 1).matrices[0][[0]].toarray()[0]
    expected = {3: (5 / 12, 1 / 6, 1 / 36), 5: (13 / 20, 3 / 50, 1 / 100), 8: (25 / 32, 3 / 128, 1 / 256)}[valence]
    ring = 2 + np.arange(2 * valence)
    assert weights[0] == pytest.approx(expected[0], abs=1e-15)
    np.testing.assert_allclose(weights[ring[::2]], expected[1], rtol=1e-14)
    np.testing.assert_allclose(weights[ring[1::2]], expected[2], rtol=1e-14)


@pytest.mark.parametrize(("valence", "weight"), [(3, 3 / 16), (5, 0.084093208), (8, 0.0400678)])
def test_loop_vertex_mask(valence: int, weight: float) -> None:
    # b of Loop's thesis: 3/16 at n = 3, else (5/8 - (3/8 + cos(2 pi/n)/4)^2)/n, worked out by hand to 7 digits.
    weights = refine(bipyramid(valence), 1).matrices[0][[0]].toarray()[0]
    np.testing.assert_allclose(weights[2:], weight, rtol=2e-6)
    assert weights[0] == pytest.approx(1 - valence * weights[2], abs=1e-15)


def test_one_step_of_the_cube() -> None:
    # Face points at distance 1, edge points 3/4 along both axes, vertices 5/9: the textbook example.
    positions = refine(cube(), 1).finest.positions
    np.testing.assert_allclose(np.abs(positions[:8]), 5 / 9, atol=1e-15)
    np.testing.assert_allclose(np.sort(np.abs(positions[8:20]), axis=1), [[0, 3 / 4, 3 / 4]] * 12, atol=1e-15)
    np.testing.assert_allclose(np.sort(np.abs(positions[20:]), axis=1), [[0, 0, 1]] * 6, atol=1e-15)


def test_one_step_of_the_tetrahedron() -> None:
    # Loop at valence 3: 7/16 v + 3/16 (sum of the others = -v) = v/4; edge points 3/8 + 3/8 + 1/8 + 1/8.
    mesh = tetrahedron()
    positions = refine(mesh, 1).finest.positions
    np.testing.assert_allclose(positions[:4], mesh.positions / 4, atol=1e-15)
    np.testing.assert_allclose(np.sort(np.abs(positions[4:]), axis=1), [[0, 0, 1 / 2]] * 6, atol=1e-15)


def test_boundary_and_corner_masks() -> None:
    sharp, round_ = (refine(grid(2, 1), 1, CatmullClark(rule)).finest for rule in ("edge_and_corner", "edge_only"))
    np.testing.assert_array_equal(sharp.positions[0], [0, 0, 0])
    np.testing.assert_allclose(round_.positions[0], [1 / 8, 1 / 8, 0])
    np.testing.assert_allclose(sharp.positions[2], [1, 0, 0])  # two faces: on the curve under either rule
    three = grid(2, 1).with_positions(grid(2, 1).positions * [1, 1, 0] + [0, 0, 1])
    np.testing.assert_allclose(refine(three, 1).finest.positions[:, 2], 1)


def test_a_triangle_under_catmull_clark_has_no_special_weights() -> None:
    weights = refine(tetrahedron(), 1, CatmullClark()).matrices[0].toarray()
    # Edge point (v + w + two face points)/4 with face points a third of each corner; vertex: 1/3 + 3 (1/9)(1/3).
    np.testing.assert_allclose(np.sort(weights[4]), [1 / 12, 1 / 12, 5 / 12, 5 / 12])
    np.testing.assert_allclose(np.sort(weights[0]), [5 / 27] * 3 + [4 / 9])
