"""Normals of face corners: hard edges and edited ones stay when a part is read, moved and written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, cube
from scipy.spatial.transform import Rotation

from cagemap.character.normals import move_vertices
from cagemap.character.values import Character, Part
from cagemap.files.gltf.character import character_of, read_character
from cagemap.files.gltf.document import read_document, write_document
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.mesh import ControlMesh

from gltf_scenes import Maker


def _flat(mesh: ControlMesh, positions: np.ndarray) -> np.ndarray:
    """Normals of quads' corners: those of the faces."""
    a, b, c, d = positions[mesh.face_indices].reshape(-1, 4, 3).transpose(1, 0, 2)
    normals = np.cross(c - a, d - b)
    return np.repeat(normals / np.linalg.norm(normals, axis=1, keepdims=True), 4, axis=0)


def _unit(rng: np.random.Generator, count: int) -> np.ndarray:
    normals = rng.normal(size=(count, 3))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_flat_normals_are_flat_on_the_moved_part() -> None:
    box = cube()
    part = move_vertices(
        Part("box", box, normals=_flat(box, box.positions)),
        box.positions @ np.array([[2, 0.5, 0], [0, 1, 0.3], [-0.4, 0, 1]]),
    )
    np.testing.assert_allclose(part.normals, _flat(box, part.mesh.positions), atol=1e-9)


def test_edited_normals_stay_or_keep_their_tilt() -> None:
    body, rng = creature(), np.random.default_rng(4)
    part = Part("body", body, normals=_unit(rng, len(body.face_indices)))
    still = move_vertices(part, body.positions)
    np.testing.assert_allclose(still.normals, part.normals, atol=1e-9)
    turn = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    turned = move_vertices(part, body.positions @ turn.T)
    # A corner with a normal of its own has one face's geometry: compare with that.
    before, after = (_corner_normals(body, mesh.positions) for mesh in (body, turned.mesh))
    np.testing.assert_allclose(
        np.einsum("cd,cd->c", turned.normals, after), np.einsum("cd,cd->c", part.normals, before), atol=1e-9
    )


def _corner_normals(mesh: ControlMesh, positions: np.ndarray) -> np.ndarray:
    """Mean of the normals of the fan triangles at each corner of quads."""
    a, b, c, d = positions[mesh.face_indices].reshape(-1, 4, 3).transpose(1, 0, 2)
    first, second = np.cross(b - a, c - a), np.cross(c - a, d - a)
    sums = np.stack([first + second, first, first + second, second], axis=1).reshape(-1, 3)
    return sums / np.linalg.norm(sums, axis=1, keepdims=True)


def test_normals_turned_over_take_the_new_direction() -> None:
    box = cube()
    part = move_vertices(Part("box", box, normals=_flat(box, box.positions)), -box.positions)
    np.testing.assert_allclose(part.normals, _flat(box, -box.positions), atol=1e-9)


def test_normals_of_a_file_come_back(tmp_path: Path) -> None:
    body, rng = creature(), np.random.default_rng(5)
    part = Part("body", body, normals=_unit(rng, len(body.face_indices)))
    write_document(tmp_path / "body.glb", character_glb(Character((part,))))
    (read,) = read_character(tmp_path / "body.glb").parts
    assert read.mesh.n_vertices == body.n_vertices
    np.testing.assert_array_equal(read.mesh.face_indices, body.face_indices)
    np.testing.assert_allclose(read.normals, part.normals, atol=2e-3)
    document = read_document(tmp_path / "body.glb")
    assert document.json["accessors"][0]["count"] == len(body.face_indices)


@pytest.mark.parametrize("scale", [[1, 1, 1], [3, 1, 0.5], [-1, 1, 1]])
def test_a_node_turns_normals_as_its_surface(scale: list[float]) -> None:
    make, box = Maker(), cube()
    corners = box.face_indices
    indices = np.arange(24).reshape(6, 4)[:, [0, 1, 2, 0, 2, 3]].ravel()
    attributes = {"POSITION": make.add(box.positions[corners]), "NORMAL": make.add(_flat(box, box.positions))}
    mesh = {"primitives": [{"attributes": attributes, "indices": make.add(indices, "<u2")}]}
    document = make.document(nodes=[{"mesh": 0, "scale": scale, "rotation": [0.5, 0.5, 0.5, 0.5]}], meshes=[mesh])
    (part,) = character_of(document).parts
    assert part.mesh.n_vertices == 8
    a, b, c = part.mesh.positions[part.mesh.face_indices].reshape(-1, 3, 3).transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    np.testing.assert_allclose(part.normals.reshape(-1, 3, 3), np.repeat(normals[:, None], 3, axis=1), atol=1e-6)
    again = character_of(character_glb(character_of(document), document)).parts[0]
    assert again.normals is not None


def test_files_without_normals_get_smooth_ones(tmp_path: Path) -> None:
    write_mesh(tmp_path / "box.glb", cube())
    assert read_document(tmp_path / "box.glb").json["accessors"][0]["count"] == 8
    assert read_mesh(tmp_path / "box.glb").n_vertices == 8
