"""Limit positions and normals: consistent between levels, and where the refinement really goes."""

import numpy as np
import pytest
from examples.shapes import bipyramid, creature, cube, disk, grid, icosahedron, poles, pyramid, triangulated

from cagemap.errors import ParameterError
from cagemap.mesh import CatmullClark, ControlMesh, Loop
from cagemap.subdivision import limit_matrix, limit_normals, limit_positions, refine, triangles
from cagemap.subdivision.limit import limit_tangents

from refusals import refuses

SHAPES = [
    cube(),
    pyramid(),
    creature(),
    poles(3),
    poles(8),
    disk(3),
    grid(3, 2),
    bipyramid(3),
    bipyramid(9),
    icosahedron(),
]
SHAPES += [triangulated(disk(6)), triangulated(grid(3, 2))]


def _bent(mesh: ControlMesh) -> ControlMesh:
    """The mesh with its positions disturbed, so that no symmetry hides an error."""
    rng = np.random.default_rng(918)
    return mesh.with_positions(mesh.positions + 0.1 * rng.standard_normal(mesh.positions.shape))


@pytest.mark.parametrize("boundary", ["edge_and_corner", "edge_only"])
@pytest.mark.parametrize("mesh", SHAPES, ids=lambda mesh: mesh.name)
def test_limits_do_not_depend_on_the_level(mesh: ControlMesh, boundary: str) -> None:
    # Triangles are Loop's, but Catmull-Clark must take them too.
    schemes = [CatmullClark(boundary), *([Loop(boundary)] if mesh.is_triangle_mesh else [])]
    for scheme in schemes:
        refinement = refine(_bent(mesh), 3, scheme)
        for level in range(3):
            kept = refinement.levels[level].n_vertices
            coarse, fine = limit_positions(refinement, level), limit_positions(refinement, level + 1)
            np.testing.assert_allclose(coarse, fine[:kept], rtol=0, atol=1e-13)
            coarse, fine = limit_normals(refinement, level), limit_normals(refinement, level + 1)
            # Tangents shrink by 2 to 4 with every level while positions do not: rounding over tangent length.
            np.testing.assert_allclose(coarse, fine[:kept], rtol=0, atol=1e-11)


@pytest.mark.parametrize("mesh", SHAPES, ids=lambda mesh: mesh.name)
def test_refined_vertices_converge_to_the_limit(mesh: ControlMesh) -> None:
    refinement = refine(_bent(mesh), 4)
    limit = limit_positions(refinement, 0)
    gaps = [np.abs(level.positions[: len(limit)] - limit).max() for level in refinement.levels]
    # The gap shrinks by the leading eigenvalue of the mode that moves the vertex itself: 0.44 at valence 8, mostly 1/4.
    assert gaps[4] < 0.5 * gaps[3] < 0.25 * gaps[2]


@pytest.mark.parametrize("mesh", [_bent(poles(5)), _bent(disk(6)), _bent(bipyramid(7))], ids=lambda mesh: mesh.name)
def test_normals_are_those_of_the_refined_triangles(mesh: ControlMesh) -> None:
    refinement = refine(mesh, 5)
    normals = limit_normals(refinement, 5)
    faces = triangles(refinement.finest.faces)
    a, b, c = limit_positions(refinement, 5)[faces].transpose(1, 0, 2)
    flat = np.cross(b - a, c - a)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    cosine = np.einsum("fkx,fx->fk", normals[faces], flat)
    # 2^-5 of a control edge subtends a few degrees of a curved shape.
    assert np.rad2deg(np.arccos(cosine.min())) < 12
    assert np.rad2deg(np.arccos(np.minimum(cosine, 1)).mean()) < 2


def _boundary_ring_matrix(valence: int, scheme: CatmullClark | Loop) -> np.ndarray:
    """Local subdivision matrix at a boundary vertex: the vertex, ``valence + 1`` neighbours, opposite vertices."""
    quads = isinstance(scheme, CatmullClark)
    edge, face = 1 + np.arange(valence + 1), 2 + valence + np.arange(valence)
    local = np.zeros((2 * valence + 2 if quads else valence + 2,) * 2)
    local[0, [0, 1, valence + 1]] = 3 / 4, 1 / 8, 1 / 8
    for k in (0, valence):
        local[edge[k], [0, edge[k]]] = 1 / 2
    end, other = scheme.edge_weights()
    for k in range(1, valence):
        local[edge[k], [0, edge[k]]] = end
        local[edge[k], [edge[k - 1], edge[k + 1]]] = other
        if quads:
            local[edge[k], [face[k - 1], face[k]]] = other
    for k in range(valence if quads else 0):
        local[face[k], [0, edge[k], edge[k + 1], face[k]]] = 1 / 4
    return local


@pytest.mark.parametrize("scheme", [CatmullClark(), Loop()], ids=["CatmullClark", "Loop"])
@pytest.mark.parametrize("valence", [2, 3, 4, 5, 7])
def test_inward_tangent_is_the_leading_left_eigenvector(scheme: CatmullClark | Loop, valence: int) -> None:
    # The slow definition: the local matrix of the vertex and its ring, and its eigenvectors.
    local = _boundary_ring_matrix(valence, scheme)
    np.testing.assert_allclose(local.sum(axis=1), 1, atol=1e-15)
    weights = np.concatenate([np.atleast_1d(part) for part in scheme.inward_tangent(valence)])
    value = (weights @ local @ weights) / (weights @ weights)
    np.testing.assert_allclose(weights @ local, value * weights, atol=1e-13)
    assert abs(weights.sum()) < 1e-13  # translations do not move a tangent
    inner = np.delete(np.delete(local, [0, 1, valence + 1], axis=0), [0, 1, valence + 1], axis=1)
    assert value == pytest.approx(np.linalg.eigvals(inner).real.max())


@pytest.mark.parametrize("mesh", [disk(5), triangulated(disk(5))], ids=["quads", "triangles"])
def test_normals_turn_with_the_shape(mesh: ControlMesh) -> None:
    turn = np.linalg.qr(np.random.default_rng(5150).standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    before = limit_normals(refine(_bent(mesh), 1), 1)
    bent = _bent(mesh)
    after = limit_normals(refine(bent.with_positions(1e6 * bent.positions @ turn.T + 3e5), 1), 1)
    np.testing.assert_allclose(after, before @ turn.T, atol=1e-9)


def test_normal_at_interior_valence_2_is_that_of_the_ring() -> None:
    # Both tangents of the closed formula vanish there, so rounding would choose the direction.
    positions = [(0, 0, 0), (1, 0.2, 0.3), (2, 0, 0.4), (1, -1, 0.1), (1, 1, 0.7)]
    mesh = ControlMesh.from_faces(positions, [(0, 3, 2, 1), (0, 1, 2, 4)])
    ring = mesh.positions[[0, 3, 2, 4]]
    expected = np.cross(ring[2] - ring[0], ring[3] - ring[1])
    assert all(np.linalg.norm(tangent[1]) > 1 for tangent in limit_tangents(refine(mesh, 0), 0))
    normal = limit_normals(refine(mesh, 0), 0)[1]
    np.testing.assert_allclose(normal, expected / np.linalg.norm(expected), atol=1e-14)


def test_normal_at_a_boundary_vertex_of_many_faces_is_still_outward() -> None:
    fan = [(0.0, 0.0, 0.0), *((np.cos(a), np.sin(a), 0.0) for a in np.linspace(0, np.pi, 13))]
    mesh = ControlMesh.from_faces(fan, [(0, 1 + 2 * k, 2 + 2 * k, 3 + 2 * k) for k in range(6)])
    normals = limit_normals(refine(mesh, 1), 1)
    np.testing.assert_allclose(normals, [[0, 0, 1]] * len(normals), atol=1e-12)


def test_a_collapsed_shape_has_zero_normals_not_nan() -> None:
    mesh = cube()
    normals = limit_normals(refine(mesh.with_positions(np.zeros((8, 3))), 1), 1)
    np.testing.assert_array_equal(normals, 0)


def test_levels_that_are_not_there_are_refused() -> None:
    refinement = refine(pyramid(), 1)
    refuses(ParameterError, "expected 0 to 1, got 2", limit_positions, refinement, 2)
    refuses(ParameterError, "use level 1", limit_matrix, refinement, 0)
    refuses(ParameterError, "refine once", limit_positions, refine(pyramid(), 0), 0)
