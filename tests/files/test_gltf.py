"""glTF export: what another reader finds in it, and mirrored nodes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube, icosahedron
from scipy.spatial import cKDTree

from cagemap.character.values import Character, Part
from cagemap.files.gltf.character import read_character
from cagemap.files.gltf.document import write_document
from cagemap.files.gltf.write import character_glb, write_glb
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.ownership import is_own
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import NO_UV, UvSet
from cagemap.subdivision import finest_mesh, refine
from cagemap.transfer import unwrap

from example_result import textured_cube


def test_a_refined_mesh_with_uvs_and_materials(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    mesh = finest_mesh(refine(textured_cube("box.obj"), 2))
    path = tmp_path / "box.glb"
    write_mesh(path, mesh)
    assert is_own(path)
    pieces = list(trimesh.load(path, process=False).geometry.values())
    assert [piece.visual.material.name for piece in pieces] == ["red", "unknown"]
    np.testing.assert_array_equal(pieces[0].visual.material.baseColorFactor, [204, 13, 13, 255])
    found = np.concatenate([np.column_stack([one.vertices, one.visual.uv])[one.faces.ravel()] for one in pieces])
    assert len(found) == 3 * 2 * mesh.n_faces
    # Every corner of every quad is there with its own UV.
    expected = np.column_stack([mesh.positions[mesh.face_indices], mesh.uvs[mesh.uv_indices]])
    for one, other in ((found, expected), (expected, found)):
        assert cKDTree(one).query(other)[0].max() < 1e-6
    normals = pieces[0].vertex_normals
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    assert np.einsum("nx,nx->n", normals, pieces[0].vertices).min() > 0  # a cube about the origin: outwards


def test_polygons_below_a_mirrored_node_are_reversed_with_their_uvs(tmp_path: Path) -> None:
    """A pentagon and a triangle: eight corners, which are not two quads."""
    positions = np.array([(0, 0, 0), (1, 0, 0), (1.5, 0.5, 0), (1, 1, 0), (0, 1, 0), (2, 2, 0)])
    mesh = ControlMesh.from_faces(positions, [[0, 1, 2, 3, 4], [2, 5, 3]]).with_uvs(
        positions[:, :2], [0, 1, 2, 3, 4, 2, 5, 3]
    )
    write_glb(tmp_path / "mirrored.glb", mesh, to_metres=np.diag([-1.0, 1.0, 1.0, 1.0]))
    again = read_mesh(tmp_path / "mirrored.glb")
    expected = [positions[face] * [-1, 1, 1] for face in ([0, 4, 3, 2, 1], [2, 3, 5])]
    np.testing.assert_array_equal(again.positions[again.face_indices], np.concatenate(expected))
    np.testing.assert_array_equal(again.uvs[again.uv_indices] * [-1, 1], np.concatenate(expected)[:, :2])


def test_new_uvs_are_written_into_a_document(tmp_path: Path) -> None:
    box, ball = unwrap(cube()), icosahedron()
    sets = (UvSet("TEXCOORD_1", box.uvs / 4, box.uv_indices),)
    parts = (Part("box", replace(box, uv_name="TEXCOORD_0", uv_sets=sets)), Part("ball", ball))
    write_document(tmp_path / "pair.glb", character_glb(Character(parts)))
    mesh = read_mesh(tmp_path / "pair.glb")
    corners = len(box.face_indices)
    changed = np.where(np.arange(len(mesh.uv_indices))[:, None] < corners, 0.5 * mesh.uvs[mesh.uv_indices], NO_UV)
    laid_out = mesh.with_uvs(changed, np.arange(len(changed)))
    write_mesh(tmp_path / "new.glb", laid_out, like=tmp_path / "pair.glb")
    box_again, ball_again = (part.mesh for part in read_character(tmp_path / "new.glb").parts)
    assert ball_again.uvs is None
    np.testing.assert_allclose(box_again.uvs[box_again.uv_indices], changed[:corners], atol=1e-7)
    (other,) = box_again.uv_sets
    np.testing.assert_allclose(other.uvs[other.uv_indices], (box.uvs / 4)[box.uv_indices], atol=1e-7)
