"""Plain meshes that tests share."""

from __future__ import annotations

import numpy as np
from examples.shapes import creature, icosahedron

from cagemap.mesh import ControlMesh, Loop, Plain
from cagemap.refinement import finest_mesh, level_triangles, refine


def ball(level: int = 3) -> ControlMesh:
    return finest_mesh(refine(icosahedron(), level, Loop()))


def animal(level: int) -> ControlMesh:
    """A creature as triangles, as a scanner would give it."""
    refinement = refine(creature(), level)
    triangles = level_triangles(refinement, level)
    offsets = np.arange(0, triangles.size + 1, 3)
    return ControlMesh(refinement.finest.positions, offsets, triangles.ravel(), scheme=Plain(), name="animal")


def soup(mesh: ControlMesh) -> ControlMesh:
    """Every triangle with vertices of its own."""
    return ControlMesh(mesh.positions[mesh.face_indices], mesh.face_offsets, np.arange(len(mesh.face_indices)))


def far_apart(positions: np.ndarray, count: int) -> np.ndarray:
    chosen = [0]
    for _ in range(count - 1):
        distance = np.linalg.norm(positions[:, None] - positions[chosen], axis=2).min(axis=1)
        chosen.append(int(distance.argmax()))
    return np.array(chosen)
