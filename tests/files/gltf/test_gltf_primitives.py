"""Polygons, colours of corners and normals of shapes in glTF primitives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube, icosahedron

from cagemap.character.normals import move_vertices
from cagemap.errors import FormatError
from cagemap.files.gltf.character import character_of
from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.entries import Document, read_accessor
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.mesh import ControlMesh

from gltf_scenes import Maker
from refusals import refuses


def _faces(mesh: ControlMesh) -> list[tuple[int, ...]]:
    return [tuple(mesh.face(number).tolist()) for number in range(mesh.n_faces)]


def test_polygons_come_back_as_polygons(tmp_path: Path) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(12)])
    faces = [(0, 1, 2, 3), (0, 3, 4), (0, 4, 5, 6), (0, 6, 7, 8, 9, 10), (0, 10, 11), (0, 11, 12, 1)]
    disk = ControlMesh.from_faces(np.vstack([np.zeros(3), rim]), faces)
    disk = replace(disk, face_materials=np.array([0, 1, 0, 0, 1, 0]), material_names=("a", "b"))
    write_mesh(tmp_path / "disk.glb", disk)
    read = read_mesh(tmp_path / "disk.glb")
    # The primitives of the materials follow each other.
    assert _faces(read) == [_faces(disk)[number] for number in (0, 2, 3, 5, 1, 4)]
    np.testing.assert_allclose(read.positions, disk.positions, atol=1e-6)
    assert read_document(tmp_path / "disk.glb").json["extensionsUsed"] == ["FB_ngon_encoding"]
    rng = np.random.default_rng(3)
    for number in range(20):  # begun anywhere, in any order
        turned = [tuple(np.roll(face, rng.integers(len(face)))) for face in faces]
        other = ControlMesh.from_faces(disk.positions, [turned[k] for k in rng.permutation(6)])
        write_mesh(tmp_path / f"{number}.glb", other)
        assert _faces(read_mesh(tmp_path / f"{number}.glb")) == _faces(other)


@pytest.mark.parametrize("stated", [3, [[0]], [[0, 1], [2]], [[9, 1]], [[0, 4]], [[-1, 0]], [[0.5, 1]], "a", [{}]])
def test_corners_of_polygons_that_are_none_are_refused(stated: Any, tmp_path: Path) -> None:
    write_mesh(tmp_path / "box.glb", cube())
    document = read_document(tmp_path / "box.glb")
    document.json["meshes"][0]["primitives"][0]["extras"] = {"cagemap_fan_starts": stated}
    refuses(FormatError, "expected faces and their corners", character_of, document)


def test_triangles_need_no_extension(tmp_path: Path) -> None:
    write_mesh(tmp_path / "ball.glb", icosahedron())
    assert "extensionsUsed" not in read_document(tmp_path / "ball.glb").json


def _painted(**targets: Any) -> Document:
    """Two triangles of a square, split along their common edge: red and half transparent blue."""
    maker = Maker()
    places = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
    normals = np.tile([0.0, 0.0, 1.0], (6, 1))
    attributes = {
        "POSITION": maker.add(places),
        "NORMAL": maker.add(normals),
        "COLOR_0": maker.add(np.repeat([[255, 0, 0, 255], [0, 0, 255, 51]], 3, axis=0), "u1", normalized=True),
    }
    primitive: dict[str, Any] = {"attributes": attributes}
    if targets:
        primitive["targets"] = [{name: maker.add(offsets) for name, offsets in targets.items()}]
    node = {"name": "square", "mesh": 0, "scale": [2.0, 2.0, -2.0]}
    return maker.document(meshes=[{"primitives": [primitive]}], nodes=[node], scenes=[{"nodes": [0]}], scene=0)


def _corner_colors(document: Document) -> dict[tuple[float, ...], list[float]]:
    """Linear colour with opacity of every corner, by the corner's place and the centre of its triangle."""
    (primitive,) = document.json["meshes"][0]["primitives"]
    places, colors = (
        read_accessor(document, primitive["attributes"][name], name, ("VEC3", "VEC4"))
        for name in ("POSITION", "COLOR_0")
    )
    corners = np.arange(len(places))
    if "indices" in primitive:
        corners = read_accessor(document, primitive["indices"], "indices", ("SCALAR",))
    centres = places[corners].reshape(-1, 3, 3).mean(axis=1).round(3)
    return {
        (*places[corner], *centre): colors[corner].round(6).tolist()
        for corner, centre in zip(corners, np.repeat(centres, 3, axis=0), strict=True)
    }


def test_colours_of_corners_and_opacity_come_back() -> None:
    """Colours that differ at a weld are not averaged; `read_mesh` has one for each vertex."""
    document = _painted()
    character = character_of(document)
    assert character.parts[0].mesh.n_vertices == 4
    given, found = (_corner_colors(one) for one in (document, character_glb(character, document)))
    assert given == found
    assert len({tuple(color) for color in found.values()}) == 2


def test_tangents_of_blend_shapes_are_said_to_be_left_out(caplog: pytest.LogCaptureFixture) -> None:
    character_of(_painted(POSITION=np.ones((6, 3)), TANGENT=np.ones((6, 3))))
    assert caplog.messages == ["made.glb: tangents of blend shapes are left out; programs compute them"]


def test_a_mesh_that_no_node_uses_may_be_damaged() -> None:
    document = _painted()
    document.json["meshes"].append({"primitives": 7})
    assert len(character_of(document).parts) == 1


def test_normals_of_blend_shapes_come_back_and_turn_with_moved_faces() -> None:
    raised = np.zeros((6, 3))
    raised[:, 2] = [0.0, 0.5, 0.5, 0.0, 0.5, 0.0]  # x + 2 z = 0: the plane tilts about y
    stated = np.tile([-0.3, 0.1, -0.2], (6, 1))
    document = _painted(POSITION=raised, NORMAL=stated)
    character = character_of(document)
    again = character_glb(character, document)
    target = again.json["meshes"][0]["primitives"][0]["targets"][0]
    offsets = read_accessor(again, target["NORMAL"], "NORMAL", ("VEC3",))
    np.testing.assert_allclose(offsets, np.tile(stated[0], (len(offsets), 1)), atol=1e-6)
    (part,) = character.parts
    moved = move_vertices(part, part.mesh.positions * [2.0, 1.0, 1.0])
    (offsets,) = moved.shape_normals.values()
    (shape,) = moved.shapes.values()
    slope = moved.normals + offsets
    edges = (moved.mesh.positions + shape)[moved.mesh.face_indices[[0, 1, 2]]]
    np.testing.assert_allclose(slope[0] @ (edges[1:] - edges[0]).T, 0.0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(slope, axis=1), 1.0, atol=1e-6)


@pytest.mark.parametrize("where", ["primitive", "accessors"])
def test_names_of_blend_shapes_are_also_those_of_the_primitive_or_of_the_accessors(where: str) -> None:
    """Early VRM files name them in the extras of primitives; written again, they are those of the mesh."""
    document = _painted(POSITION=np.ones((6, 3)))
    (primitive,) = document.json["meshes"][0]["primitives"]
    if where == "primitive":
        primitive["extras"] = {"targetNames": ["joy"]}
    else:
        document.json["accessors"][primitive["targets"][0]["POSITION"]]["name"] = "joy"
    character = character_of(document)
    assert list(character.parts[0].shapes) == ["joy"]
    assert character_glb(character, document).json["meshes"][0]["extras"] == {"targetNames": ["joy"]}


def test_equal_names_of_accessors_name_no_blend_shapes() -> None:
    document = _painted(POSITION=np.ones((6, 3)))
    (primitive,) = document.json["meshes"][0]["primitives"]
    primitive["targets"] *= 2
    document.json["accessors"][primitive["targets"][0]["POSITION"]]["name"] = "offsets"
    assert list(character_of(document).parts[0].shapes) == ["shape 0", "shape 1"]
