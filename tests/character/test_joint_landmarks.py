"""Landmarks from joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import icosahedron
from scipy.spatial.transform import Rotation

from cagemap.character.joint_landmarks import joint_landmarks
from cagemap.character.poses import to_parents
from cagemap.character.values import Rig
from cagemap.errors import ParameterError
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import CagePoints
from cagemap.subdivision import refine

from example_rigs import person


def body() -> tuple[ControlMesh, Rig]:
    """An ellipsoid around a person with both arms."""
    shape = refine(icosahedron(), 2)
    triangles = shape.finest.faces.reshape(-1, 3)
    mesh = ControlMesh.from_faces(shape.finest.positions * (0.9, 1.6, 0.5), triangles, name="egg")
    rig = person()
    other = rig.bind[7].copy()
    other[3, 0] *= -1
    bind = np.concatenate([rig.bind, other[None]])
    parents = np.append(rig.parents, 1)
    return mesh, Rig((*rig.names, "RightArm"), parents, to_parents(bind, parents), bind)


def places_of(mesh: ControlMesh, points: CagePoints) -> np.ndarray:
    return np.einsum("qkd,qk->qd", mesh.positions[points.corners], points.weights)


def test_rays_leave_in_front_behind_and_above() -> None:
    mesh, rig = body()
    found = joint_landmarks(mesh, rig, mesh, rig)
    assert set(found.names) == {"head tip", "spine front", "spine back", "neck front", "neck back"}
    places = dict(
        zip(
            found.names,
            (mesh.positions[found.source_points.corners] * found.source_points.weights[:, :, None]).sum(1),
            strict=True,
        )
    )
    np.testing.assert_allclose(found.source_points.weights.sum(axis=1), 1)
    assert places["neck front"][2] > 0.2 > -0.2 > places["neck back"][2]
    np.testing.assert_allclose(places["head tip"][[0, 2]], 0, atol=0.02)
    assert places["head tip"][1] > 1.3
    np.testing.assert_allclose(places_of(mesh, found.target_points), list(places.values()), atol=1e-9)


def test_landmarks_turn_and_grow_with_the_body() -> None:
    mesh, rig = body()
    turn = Rotation.from_rotvec((0.3, 2.0, -0.4)).as_matrix()
    bind = rig.bind.copy()
    bind[:, :3, :3] = bind[:, :3, :3] @ turn
    bind[:, 3, :3] = 3 * bind[:, 3, :3] @ turn + 5
    other = replace(rig, bind=bind, local=to_parents(bind, rig.parents))
    moved = mesh.with_positions(3 * mesh.positions @ turn + 5)
    found = joint_landmarks(moved, other, mesh, rig)
    assert len(found) == 5
    expected = 3 * places_of(mesh, found.source_points) @ turn + 5
    np.testing.assert_allclose(places_of(moved, found.target_points), expected, atol=1e-8)


def test_rigs_without_the_bones_are_refused() -> None:
    mesh, rig = body()
    with pytest.raises(ParameterError, match="got none for rightUpperArm"):
        joint_landmarks(mesh, rig, mesh, person())
