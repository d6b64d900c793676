"""Meshes and landmarks as arrays, and as other libraries have them, at every public function that takes some."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature, cube

import cagemap
from cagemap.errors import InvalidLandmarksError, InvalidMeshError, ParameterError
from cagemap.mesh.inputs import control_mesh, landmark_pairs
from cagemap.mesh.structure_checks import require_structure

from quick_match import QUICK
from refusals import refuses

MESH = creature()
ARRAYS = MESH.positions, MESH.face_indices.reshape(-1, 4)


class OpenVector:
    """As Open3D's vectors: a sequence that NumPy converts, without being an array."""

    def __init__(self, rows: Any):
        self.rows = np.asarray(rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, row: int) -> Any:
        return self.rows[row]


def same(found: cagemap.ControlMesh, mesh: cagemap.ControlMesh) -> None:
    np.testing.assert_array_equal(found.positions, mesh.positions)
    np.testing.assert_array_equal(found.face_indices, mesh.face_indices)
    np.testing.assert_array_equal(found.face_offsets, mesh.face_offsets)


def test_arrays_lists_and_foreign_meshes_keep_their_numbers() -> None:
    vertices, faces = ARRAYS
    polygons = [vertices.tolist(), [[0, 1, 2], *faces[1:].tolist()]]
    assert control_mesh(polygons).face_sizes.tolist() == [3, *[4] * (len(faces) - 1)]
    for given in (ARRAYS, [vertices, faces], SimpleNamespace(vertices=vertices, faces=faces)):
        same(control_mesh(given), MESH)
    triangles = SimpleNamespace(vertices=OpenVector(vertices), triangles=OpenVector(faces[:, :3]))
    found = control_mesh(triangles, "scan")
    assert (found.name, found.n_vertices) == ("scan", len(vertices))
    np.testing.assert_array_equal(found.face_indices, faces[:, :3].ravel())


def test_texture_coordinates_of_foreign_meshes_come_along() -> None:
    vertices, faces = cube().positions, cube().face_indices.reshape(-1, 4)[:, :3]
    at_vertices = vertices[:, :2] * 0.5
    trimesh = SimpleNamespace(vertices=vertices, faces=faces, visual=SimpleNamespace(uv=at_vertices))
    open3d = SimpleNamespace(vertices=vertices, triangles=faces, triangle_uvs=OpenVector(at_vertices[faces.ravel()]))
    for given in (trimesh, open3d):
        found = control_mesh(given)
        np.testing.assert_array_equal(found.uvs[found.uv_indices], at_vertices[faces.ravel()])
    plain = SimpleNamespace(vertices=vertices, triangles=faces, triangle_uvs=OpenVector(np.zeros((0, 2))))
    assert control_mesh(plain).uvs is None


def test_trimesh_is_taken() -> None:
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box()
    found = cagemap.refine(box, 1)
    same(found.control, cagemap.ControlMesh.from_faces(box.vertices, box.faces))


@pytest.mark.slow
def test_every_public_function_that_takes_a_mesh_takes_arrays(tmp_path: Path) -> None:
    assert cagemap.check_mesh(ARRAYS).n_vertices == MESH.n_vertices
    assert cagemap.choose_level(ARRAYS, 5000) == cagemap.choose_level(MESH, 5000)
    assert cagemap.plain_mesh(ARRAYS).mesh.name == "mesh"
    same(cagemap.weld_mesh(ARRAYS).mesh, MESH)
    same(cagemap.refine(ARRAYS, 0).control, MESH)
    assert cagemap.unwrap(ARRAYS).uvs is not None
    cagemap.write_mesh(tmp_path / "mesh.obj", ARRAYS)
    np.testing.assert_array_equal(cagemap.read_mesh(tmp_path / "mesh.obj").face_indices, MESH.face_indices)
    basis = cagemap.BasisConfig(count=20)
    same(cagemap.prepare_surface(ARRAYS, 1, basis).control, MESH)
    sides = cagemap.prepare_surfaces(ARRAYS, target_and_source()[1], (1, 1), basis)
    assert [side.control.name for side in sides] == ["target", "source"]


def target_and_source() -> tuple[Any, Any]:
    vertices, faces = ARRAYS
    return ARRAYS, (2.0 * vertices[:, [2, 1, 0]] * [1, 1, -1], faces)


@pytest.mark.slow
def test_meshes_are_matched_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """A turned and scaled copy: every vertex goes to its own number."""
    monkeypatch.setattr("cagemap.pipeline.DEFAULT_VERTICES", 500)
    chosen = np.arange(0, MESH.n_vertices, 9)
    pairs = np.column_stack([chosen, chosen])
    result = cagemap.match(*target_and_source(), pairs, QUICK)
    assert result.target.finest_level == 1
    np.testing.assert_array_equal(result.nearest_vertices(), np.arange(MESH.n_vertices))
    again = cagemap.match(result.target, target_and_source()[1], pairs, QUICK)
    np.testing.assert_allclose(again.image(), result.image(), atol=1e-6)
    updated = cagemap.update_match(result, pairs[1:].tolist(), QUICK)
    assert len(updated.landmarks) == len(pairs) - 1
    prepared = cagemap.prepare_pair(result.target, result.source, QUICK)
    assert len(cagemap.match_pair(prepared, pairs, QUICK).landmarks) == len(pairs)
    assert len(cagemap.pair_of(result.target, result.source, pairs).landmarks) == len(pairs)


def test_landmarks_are_pairs_of_target_and_source_vertices() -> None:
    found = landmark_pairs([[5, 7], [1, 0]])
    assert (found.target.tolist(), found.source.tolist()) == ([5, 1], [7, 0])
    assert found.names == ("point 0", "point 1")
    assert len(landmark_pairs(np.zeros((0, 2)))) == 0
    refuses(InvalidLandmarksError, r"\(2, 3\). Transpose it", landmark_pairs, [[1, 2, 3], [4, 5, 6]])
    refuses(ParameterError, "landmarks: expected whole numbers", landmark_pairs, [[0.5, 1.0]])


def test_values_of_cagemap_and_others_are_no_meshes() -> None:
    surface = cagemap.prepare_surface(ARRAYS, 1, cagemap.BasisConfig(count=20))
    for wrong in (surface, surface.refinement.finest, 3, "a.obj", SimpleNamespace(vertices=ARRAYS[0])):
        refuses(ParameterError, "control: expected ControlMesh, got", cagemap.prepare_surface, wrong, 1)
    with pytest.raises(ParameterError, match=r"control: expected positions \(n, 3\)"):
        cagemap.prepare_surface((ARRAYS[0][:, :2], ARRAYS[1]), 1)
    refuses(TypeError, r"^refine\(\) missing 1 required", cagemap.refine, ARRAYS)


def test_faces_counted_from_one_are_refused_with_the_remedy() -> None:
    positions, faces = cube().positions, np.arange(1, 9).reshape(2, 4)
    refuses(InvalidMeshError, "Numbers start at 0: subtract 1", require_structure, control_mesh((positions, faces)))
    numbers = (faces - 1).astype(object)
    np.testing.assert_array_equal(control_mesh((positions, numbers)).face_indices, np.arange(8))
    refuses(ParameterError, "mesh: faces: expected whole numbers", control_mesh, (positions, faces / 0.3))
