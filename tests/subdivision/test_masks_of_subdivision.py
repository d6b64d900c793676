"""Masks of one Catmull-Clark step: quads against faces of any size, and interior valence 2."""

from __future__ import annotations

import numpy as np
from examples.shapes import creature, cube, disk, grid, poles, torus

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
