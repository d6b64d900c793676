"""RESULT folders: what is written comes back, and what is broken is refused by name."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.errors import FormatError
from cagemap.files.result import (
    ARRAYS,
    MANIFEST,
    Result,
    Side,
    file_hash,
    mesh_hash,
    note_transfer,
    read_result,
    write_result,
)
from cagemap.mesh import ControlMesh, cube, icosahedron
from cagemap.refinement import CatmullClark, Loop, refine, triangles


def side(control: ControlMesh, scheme: CatmullClark | Loop, level: int, k: int) -> Side:
    finest = refine(control, level, scheme).finest
    assert finest.faces is not None
    return Side(
        control, scheme, level, finest.positions, finest.faces, np.linspace(0, 9, k), np.array([0, 3, 5], np.int64)
    )


@pytest.fixture(scope="module")
def result() -> Result:
    rng = np.random.default_rng(17)
    textured = replace(
        cube(),
        uvs=rng.random((24, 2)),
        uv_indices=np.arange(24),
        face_materials=np.array([0, 0, 0, 1, 1, 1]),
        material_names=("skin", "höof"),
        material_colors=np.array([[0.1, 0.2, 0.3], [np.nan] * 3]),
        name="box.obj",
    )
    target, source = side(textured, CatmullClark("edge_only"), 2, 4), side(icosahedron(), Loop(), 1, 6)
    split = triangles(source.faces)
    n1 = len(target.vertices)
    return Result(
        target=target,
        source=source,
        source_triangles=split,
        triangle=rng.integers(0, len(split), n1),
        barycentric=rng.dirichlet([1, 1, 1], n1),
        functional_map=rng.normal(size=(4, 6)),
        trust=rng.random(n1),
        landmark_errors=rng.random(3),
        landmark_names=("nose", "tail", "toe"),
        manifest={"timings": {"map": 1.25}, "quality": {"coverage": np.float64(0.5), "worst": np.nan}},
    )


@pytest.fixture
def folder(result: Result, tmp_path: Path) -> Path:
    write_result(tmp_path / "R", result)
    return tmp_path / "R"


def test_everything_comes_back_bit_for_bit(result: Result, folder: Path) -> None:
    back = read_result(folder)
    for name in ("source_triangles", "triangle", "barycentric", "functional_map", "trust", "landmark_errors"):
        np.testing.assert_array_equal(getattr(back, name), getattr(result, name))
    for ours, theirs in ((back.target, result.target), (back.source, result.source)):
        assert mesh_hash(ours.control) == mesh_hash(theirs.control)
        assert ours.control.name == theirs.control.name
        assert ours.control.material_names == theirs.control.material_names
        assert (ours.scheme, ours.level) == (theirs.scheme, theirs.level)
        for name in ("vertices", "faces", "eigenvalues", "landmarks"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert back.landmark_names == result.landmark_names


def test_refining_again_gives_the_stored_vertices(folder: Path) -> None:
    back = read_result(folder)
    for stored in (back.target, back.source):
        np.testing.assert_array_equal(stored.refinement.finest.positions, stored.vertices)


def test_map_file_has_the_documented_arrays(result: Result, folder: Path) -> None:
    n1, n2 = len(result.target.vertices), len(result.source.vertices)
    with np.load(folder / ARRAYS, allow_pickle=False) as stored:
        shapes = {name: stored[name].shape for name in stored.files}
    assert shapes["target_vertices"] == (n1, 3)
    assert shapes["source_vertices"] == (n2, 3)
    assert shapes["source_triangles"] == result.source_triangles.shape
    assert shapes["triangle"] == (n1,)
    assert shapes["barycentric"] == (n1, 3)
    assert shapes["functional_map"] == (4, 6)
    assert {"target_faces", "source_faces", "target_eigenvalues", "source_eigenvalues"} <= set(shapes)
    assert {"target_landmarks", "source_landmarks"} <= set(shapes)


def test_manifest_is_plain_json_with_versions_and_figures(folder: Path) -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"), parse_constant=refuse)
    assert manifest["quality"] == {"coverage": 0.5, "worst": None}
    assert manifest["timings"] == {"map": 1.25}
    assert {"cagemap", "python", "numpy"} <= set(manifest["versions"])
    assert manifest["target"]["scheme"] == {
        "name": "catmull-clark",
        "boundary": "edge_only",
        "uv_interpolation": "all",
        "creasing": "uniform",
        "triangles": "catmull_clark",
    }
    assert manifest["source"]["vertices"] == 42


def test_transfers_are_noted_once_per_output(result: Result, folder: Path) -> None:
    for source in ("old.png", "new.png"):
        note_transfer(folder, {"kind": "texture", "image": source, "output": "baked.png"})
    note_transfer(folder, {"kind": "texture", "image": "new.png", "output": "other.png"})
    back = read_result(folder)
    assert [(t["image"], t["output"]) for t in back.manifest["transfers"]] == [
        ("new.png", "baked.png"),
        ("new.png", "other.png"),
    ]
    np.testing.assert_array_equal(back.triangle, result.triangle)
    write_result(folder, result)
    assert "transfers" not in read_result(folder).manifest


def test_image_is_on_the_source(result: Result) -> None:
    corners = result.source.vertices[result.source_triangles[result.triangle]]
    np.testing.assert_allclose(result.image()[7], result.barycentric[7] @ corners[7])


def test_an_older_result_is_replaced_and_other_folders_are_not(result: Result, folder: Path, tmp_path: Path) -> None:
    write_result(folder, replace(result, landmark_names=("a", "b", "c")))
    assert read_result(folder).landmark_names == ("a", "b", "c")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.txt").write_text("meow")
    with pytest.raises(FormatError, match="photos"):
        write_result(tmp_path / "photos", result)
    assert (tmp_path / "photos" / "cat.txt").read_text() == "meow"


def test_nothing_is_left_behind_when_writing_fails(result: Result, tmp_path: Path) -> None:
    broken = replace(result, trust=np.array([object()]))  # cannot be stored without pickling
    with pytest.raises(ValueError, match="allow_pickle"):
        write_result(tmp_path / "R", broken)
    assert list(tmp_path.iterdir()) == []


def edit(folder: Path, **changes: object) -> None:
    manifest = json.loads((folder / MANIFEST).read_text())
    (folder / MANIFEST).write_text(json.dumps(manifest | changes))


def test_missing_folder_manifest_or_arrays_are_named(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"nowhere.*manifest\.json"):
        read_result(tmp_path / "nowhere")
    (folder / ARRAYS).unlink()
    with pytest.raises(FormatError, match=r"map\.npz: is missing"):
        read_result(folder)
    (folder / MANIFEST).unlink()
    with pytest.raises(FormatError, match=r"no manifest\.json"):
        read_result(folder)


def test_newer_and_foreign_manifests_are_refused(folder: Path) -> None:
    edit(folder, format_version=99, versions={"cagemap": "9.1"})
    with pytest.raises(FormatError, match=r"version 99.*cagemap 9\.1"):
        read_result(folder)
    edit(folder, format="holiday")
    with pytest.raises(FormatError, match="cagemap-result"):
        read_result(folder)
    (folder / MANIFEST).write_text('{"format": "cagemap-res')
    with pytest.raises(FormatError, match="cannot be read"):
        read_result(folder)


@pytest.mark.parametrize("keep", [0, 100, 5000])
def test_half_written_arrays_are_refused(folder: Path, keep: int) -> None:
    data = (folder / ARRAYS).read_bytes()
    (folder / ARRAYS).write_bytes(data[:keep])
    with pytest.raises(FormatError, match="damaged"):
        read_result(folder)


def test_flipped_bits_are_noticed(folder: Path) -> None:
    data = bytearray((folder / ARRAYS).read_bytes())
    data[len(data) // 2] ^= 0xFF
    (folder / ARRAYS).write_bytes(data)
    with pytest.raises(FormatError, match="damaged"):
        read_result(folder)


def test_arrays_of_another_result_are_refused(result: Result, folder: Path) -> None:
    arrays = dict(np.load(folder / ARRAYS))
    for name, value, words in (
        ("triangle", result.triangle[:-1], "triangle has shape"),
        ("triangle", np.where(np.arange(len(result.triangle)) == 5, 80, result.triangle), "counts past"),
        ("barycentric", result.barycentric[:, :2], "barycentric has shape"),
        ("functional_map", np.zeros((2, 2)), "functional_map has shape"),
    ):
        np.savez(folder / ARRAYS, **(arrays | {name: value}))
        with pytest.raises(FormatError, match=words):
            read_result(folder)
    del arrays["trust"]
    np.savez(folder / ARRAYS, **arrays)
    with pytest.raises(FormatError, match="lacks 'trust'"):
        read_result(folder)


def test_hashes_depend_on_content_only(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    assert file_hash(tmp_path / "a") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert mesh_hash(cube()) == mesh_hash(cube())
    assert mesh_hash(cube()) != mesh_hash(cube().with_positions(cube().positions * 2))
