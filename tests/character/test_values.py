"""Linear blend skinning of a part."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from cagemap.character.values import Part, Rig, skinned_positions
from cagemap.mesh import ControlMesh


def _arm() -> tuple[Part, Rig]:
    """A strip of two quads along x, its outer half moved by a second joint at x = 1."""
    positions = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0), (2, 1, 0)]
    mesh = ControlMesh.from_faces(positions, [(0, 1, 4, 3), (1, 2, 5, 4)])
    weights = sparse.csr_array(np.array([(1, 0), (0.5, 0.5), (0, 1)] * 2))
    local = np.tile(np.eye(4), (2, 1, 1))
    local[1, 3, 0] = 1
    return Part("arm", mesh, weights), Rig(("root", "tip"), np.array([-1, 0]), local, local)


def test_bind_pose_leaves_vertices_where_they_are() -> None:
    part, rig = _arm()
    np.testing.assert_allclose(skinned_positions(part, rig, rig.bind), part.mesh.positions, atol=1e-15)


def test_vertices_turn_about_their_joint_and_blend_between_joints() -> None:
    part, rig = _arm()
    turned = rig.bind.copy()
    turned[1, :3, :3] = [(0, 1, 0), (-1, 0, 0), (0, 0, 1)]  # x becomes y: rows are images of the axes
    moved = skinned_positions(part, rig, turned)
    np.testing.assert_allclose(moved[[0, 3]], part.mesh.positions[[0, 3]], atol=1e-15)
    np.testing.assert_allclose(moved[[2, 5]], [(1, 1, 0), (0, 1, 0)], atol=1e-15)
    np.testing.assert_allclose(moved[4], (0.5, 0.5, 0), atol=1e-15)
