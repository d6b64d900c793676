"""Small shapes, changes that break them, and what the checks say of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import bipyramid, cube, disk, grid, icosahedron, pyramid, tetrahedron, torus, voxels

from cagemap.errors import InvalidMeshError
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import check_mesh, require_valid

SHAPES: dict[str, tuple[Callable[[], ControlMesh], int, int]] = {  # genus, boundary loops
    "cube": (cube, 0, 0),
    "tetrahedron": (tetrahedron, 0, 0),
    "icosahedron": (icosahedron, 0, 0),
    "torus": (torus, 1, 0),
    "grid": (grid, 0, 1),
    "disk": (lambda: disk(7), 0, 1),
    "bipyramid": (lambda: bipyramid(5), 0, 0),
    "pyramid": (pyramid, 0, 0),
    "ring of voxels": (lambda: voxels([(i, j, 0) for i in range(3) for j in range(3) if (i, j) != (1, 1)]), 1, 0),
}


def faces_of(mesh: ControlMesh) -> list[list[int]]:
    return [mesh.face(i).tolist() for i in range(mesh.n_faces)]


def flip(mesh: ControlMesh, faces: object) -> ControlMesh:
    chosen = set(np.atleast_1d(np.asarray(faces)).tolist())
    turned = [face[::-1] if i in chosen else face for i, face in enumerate(faces_of(mesh))]
    return replace(ControlMesh.from_faces(mesh.positions, turned), name=mesh.name)


def with_faces(mesh: ControlMesh, *extra: list[int]) -> ControlMesh:
    return ControlMesh.from_faces(mesh.positions, [*faces_of(mesh), *extra], name=mesh.name)


def kinds(mesh: ControlMesh) -> list[str]:
    return [problem.kind for problem in check_mesh(mesh).problems]


def elements(mesh: ControlMesh, kind: str) -> tuple[object, ...]:
    """Elements of a problem, which also `require_valid` must name together with a remedy."""
    report = check_mesh(mesh)
    found = [problem for problem in report.problems if problem.kind == kind]
    assert len(found) == 1, report
    with pytest.raises(InvalidMeshError) as caught:
        require_valid(mesh)
    message = str(caught.value)
    for part in (mesh.name, kind, found[0].remedy, *map(str, found[0].elements[:8])):
        assert part in message
    assert "expected" in found[0].found
    return found[0].elements
