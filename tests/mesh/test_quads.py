"""Triangles joined to the quads that they were."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, cube, grid

from cagemap.errors import InvalidMeshError
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import require_valid
from cagemap.mesh.faces import with_corners_of
from cagemap.mesh.quads import join_quads
from cagemap.surface.triangles import fan_triangles
from cagemap.tasks.mesh_commands import run_refine
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.mesh_commands import RefineRequest

SHEAR = np.array([[1.0, 0.1, 0.2], [0.0, 1.0, 0.1], [0.0, 0.0, 1.0]])


def split(mesh: ControlMesh, shift: int = 0) -> ControlMesh:
    corners, faces = fan_triangles(mesh.face_offsets, np.arange(len(mesh.face_indices)))
    corners, faces = np.roll(corners.reshape(-1, 3), shift, axis=0), np.roll(faces, shift)
    return with_corners_of(mesh, faces, np.arange(0, 3 * len(faces) + 1, 3), corners.ravel())


def faces_of(mesh: ControlMesh) -> set[tuple[int, ...]]:
    return {tuple(sorted(mesh.face(number).tolist())) for number in range(mesh.n_faces)}


SHEARED = cube().with_positions(9.0 * cube().positions @ SHEAR)
# One face has a corner of almost 180 degrees: only the order of its triangles says that they were a quad.
FLAT = grid(4, 4).with_positions(np.where(np.arange(25)[:, None] == 12, (2.48, 2.48, 0.0), grid(4, 4).positions))


@pytest.mark.parametrize(("mesh", "shift"), [(cube(), 0), (creature(), 0), (SHEARED, 1), (FLAT, 0)])
def test_quads_come_back(mesh: ControlMesh, shift: int) -> None:
    uvs = np.random.default_rng(2).uniform(size=(mesh.n_vertices, 2))
    mesh = replace(mesh, uvs=uvs, uv_indices=mesh.face_indices)
    joined, count = join_quads(split(mesh, shift))
    assert count == int((mesh.face_sizes == 4).sum())
    assert faces_of(joined) == faces_of(mesh)
    require_valid(joined)
    np.testing.assert_array_equal(joined.uv_indices, joined.face_indices)


def test_what_divides_is_kept() -> None:
    box = cube()
    triangles = split(box)
    diagonals = np.array([(box.face(number)[0], box.face(number)[2]) for number in range(6)])
    creased = triangles.with_creases(diagonals, 1.0)
    numbers = np.arange(12) % 2
    named = replace(triangles, face_materials=numbers, material_names=("a", "b"))
    parted = triangles.with_uvs(np.zeros((36, 2)), np.arange(36))
    open_half = replace(triangles, hole_faces=np.arange(1, 12, 2))
    for mesh in (creased, named, parted, open_half):
        assert join_quads(mesh) == (mesh, 0)


def test_a_tetrahedron_is_left_alone() -> None:
    points = [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]
    mesh = ControlMesh.from_faces(points, [(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)])
    assert join_quads(mesh) == (mesh, 0)
    with pytest.raises(InvalidMeshError):
        join_quads(ControlMesh.from_faces(points, [(0, 1, 9)]))


def test_refine_makes_the_cage_of_a_glb(tmp_path: Path) -> None:
    body = creature()
    write_mesh(tmp_path / "body.glb", body)
    said, _ = run_refine(RefineRequest(tmp_path / "body.glb", 0, tmp_path / "cage.obj", quads=True), Stages())
    assert "0 triangles stay" in said
    cage = read_mesh(tmp_path / "cage.obj")
    assert (cage.n_vertices, cage.n_faces) == (body.n_vertices, body.n_faces)


@pytest.mark.slow
def test_a_body_as_games_have_it(shared_data: Path) -> None:
    for name in ("male1591_neutral", "soma18056_neutral"):
        mesh = read_mesh(shared_data / "humans" / f"{name}.obj").with_uvs(None, None)
        mesh = replace(mesh, uv_sets=())
        joined, _ = join_quads(split(mesh))
        quads = {one for one in faces_of(mesh) if len(one) == 4}
        assert len(quads & faces_of(joined)) > 0.99 * len(quads)
