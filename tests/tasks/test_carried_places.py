"""Values at faces stay values at faces where the target has as many vertices as faces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import torus

from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import write_result
from cagemap.files.result.manifest import stated_inputs
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.parts import extract_faces, join_meshes

from example_result import identity_result
from transfer_command import transfer

RING = replace(torus(6, 5), name="ring.obj")
COUNT = RING.n_faces


def split_ring() -> ControlMesh:
    """The ring of quads as triangles, with more faces than vertices."""
    triangles = cage_triangles(RING)[0]
    return ControlMesh(RING.positions, np.arange(0, triangles.size + 1, 3), triangles.ravel(), name="split.obj")


@pytest.fixture
def labels(tmp_path: Path) -> Path:
    """Labels of the source's faces, which are those of the target's quads; the result is in R."""
    assert RING.n_vertices == COUNT
    write_result(tmp_path / "R", identity_result(0, (RING, split_ring())))
    np.savez(tmp_path / "labels.npz", label=np.arange(2 * COUNT) // 2)
    return tmp_path / "labels.npz"


def test_usd_gets_them_for_faces(labels: Path, tmp_path: Path) -> None:
    transfer(tmp_path / "out.npz", attribute=labels, usd=tmp_path / "out.usda", force=True)
    np.testing.assert_array_equal(np.load(tmp_path / "out.npz")["label"], np.arange(COUNT))
    text = (tmp_path / "out.usda").read_text()
    assert 'interpolation = "uniform"' in text.partition("primvars:label")[2].partition(")")[0]


def test_the_base_is_mixed_by_the_weights_of_faces(labels: Path, tmp_path: Path) -> None:
    mask = np.zeros(COUNT)
    mask[RING.face_indices[:4]] = 1.0  # the vertices of the first face
    np.savetxt(tmp_path / "mask.csv", mask)
    np.savez(tmp_path / "base.npz", label=np.full(COUNT, 99))
    bases = (("", tmp_path / "base.npz"),)
    transfer(tmp_path / "out.npz", attribute=labels, target_mask=str(tmp_path / "mask.csv"), bases=bases)
    shares = mask[RING.face_indices].reshape(COUNT, 4).mean(axis=1)
    expected = np.where(shares >= 0.5, np.arange(COUNT), 99)
    np.testing.assert_array_equal(np.load(tmp_path / "out.npz")["label"], expected)


def test_a_file_gets_those_of_a_part_at_its_faces(tmp_path: Path) -> None:
    scene = replace(join_meshes([replace(RING, name="a"), split_ring()]), name="scene.obj")
    scene = replace(scene, face_materials=None, material_names=())
    write_mesh(tmp_path / "scene.obj", scene)
    part = extract_faces(scene, np.arange(COUNT))
    assert part.n_vertices == part.n_faces
    result = identity_result(0, (part, split_ring()))
    inputs = stated_inputs({"target": tmp_path / "scene.obj"}, tmp_path / "R")
    write_result(tmp_path / "R", replace(result, provenance={**result.provenance, "inputs": inputs}))
    np.savez(tmp_path / "labels.npz", label=1 + np.arange(2 * COUNT) // 2)
    transfer(tmp_path / "o.npz", attribute=tmp_path / "labels.npz")
    found = np.load(tmp_path / "o.npz")["label"]
    np.testing.assert_array_equal(found, np.append(1 + np.arange(COUNT), np.zeros(2 * COUNT)))


def test_a_file_that_does_not_say_the_place_of_its_values_is_warned_of_once(tmp_path: Path) -> None:
    write_result(tmp_path / "R", identity_result(0, (RING, RING)))
    np.savez(tmp_path / "v.npz", one=np.arange(COUNT), two=np.arange(COUNT))
    (warning,) = transfer(tmp_path / "o.npz", attribute=tmp_path / "v.npz")[1]
    assert warning.startswith("one, two: as many rows as control vertices and as control faces")
    (tmp_path / "g.json").write_text('{"groups": [{"name": "lips", "vertices": [0, 5]}]}')
    assert transfer(tmp_path / "o.json", attribute=tmp_path / "g.json")[1] == []  # groups are of vertices
