"""Weights, joints and blend shapes of glTF files as `transfer` takes them, and what `check` says of a file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.errors import FormatError
from cagemap.files.gltf.document import write_document
from cagemap.files.gltf.read import read_gltf
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.usd.prims import JOINT_WEIGHTS
from cagemap.files.values.attributes import read_attributes
from cagemap.files.values.part_numbering import FileRows
from cagemap.files.values.rigs import read_shapes, read_skeleton, write_shapes
from cagemap.mesh.parts import extract_faces, find_part
from cagemap.tasks.mesh_commands import check_files, check_values

from gltf_scenes import Maker, arm


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "arm.glb"
    write_document(path, arm())
    return path


def test_weights_and_shapes_of_the_whole_and_of_a_part(file: Path) -> None:
    whole = read_gltf(file)
    table = read_attributes(file, whole)[JOINT_WEIGHTS]
    assert table.shape == (9, 2)
    np.testing.assert_allclose(table.sum(axis=1), 1.0)
    part = extract_faces(whole, find_part(whole, "strip").faces)
    rows = FileRows(part, whole)
    np.testing.assert_allclose(read_attributes(file, part, rows)[JOINT_WEIGHTS], table[3:])
    shapes = read_shapes([file], part, rows)
    assert list(shapes) == ["raise"]
    np.testing.assert_allclose(shapes["raise"].max(axis=0), [0, 0, 1])
    assert read_shapes([file], whole)["raise"].shape == (9, 3)
    with pytest.raises(FormatError, match="'raise'"):
        read_shapes([file], part)


@pytest.mark.parametrize("output", ["shapes", "cube.npz"])
def test_written_shapes_come_back_without_the_cage_at_rest(tmp_path: Path, output: str) -> None:
    cage = replace(cube(), name="cube.obj")
    shapes = {"smile": np.ones((8, 3)), "none": np.zeros((8, 3))}
    write_shapes(tmp_path / output, shapes, cage, [])
    found = read_shapes([tmp_path if output.endswith(".npz") else tmp_path / output], cage)
    assert sorted(found) == ["none", "smile"]
    np.testing.assert_allclose(found["smile"], 1.0)


def test_joints(file: Path) -> None:
    skeleton = read_skeleton(file)
    assert skeleton.names == ("upper", "lower")
    assert skeleton.parents == ("", "upper")
    np.testing.assert_allclose(skeleton.heads, [[0, 0, 0], [1, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(skeleton.tails, [[1, 0, 0], [1.5, 0, 0]], atol=1e-6)


def test_a_file_without_a_skin_is_refused(tmp_path: Path) -> None:
    make = Maker()
    mesh = {"primitives": [{"attributes": {"POSITION": make.add([(0, 0, 0), (1, 0, 0), (0, 1, 0)])}}]}
    path = tmp_path / "bare.glb"
    write_document(path, make.document(nodes=[{"mesh": 0}], meshes=[mesh]))
    for read in (read_skeleton, read_attributes):
        with pytest.raises(FormatError, match=r"bare\.glb.*skin"):
            read(path)


def test_check_says_what_a_file_holds(file: Path, tmp_path: Path) -> None:
    text, _ = check_files([file])
    for line in (
        "arm.glb: strip\n",
        "  vertices              6\n",
        "body        strip: is matched",
        "passengers  1 (ball): ride on the body",
        "skeleton    2 joints, at most 2 a vertex: is carried, with its weights",
        "shapes      1 (raise): are carried",
        "animations  1 (bend (2 s)): are retargeted",
    ):
        assert line in text
    for word in ("component:", "--weld", "set aside"):
        assert word not in text
    (held,) = json.loads(check_values([file])[0])
    assert held["contents"]["joints"] == 2
    write_mesh(tmp_path / "plain.obj", read_gltf(file))
    assert "holds" not in check_files([tmp_path / "plain.obj"])[0]
