"""RESULT folders: what is written comes back, and what is broken is refused by name."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube, icosahedron

from cagemap.deform.placement import Placement
from cagemap.errors import FormatError
from cagemap.files.result.folder import ARRAYS, read_result, write_result
from cagemap.files.result.manifest import MANIFEST, file_hash, landmark_messages, mesh_hash, note_transfer, sure_message
from cagemap.files.result.merged_parts import _title, merge_results
from cagemap.maps.hypotheses.confidence import LOOK, SIGN_BOUNDS, SURE, TWO, Confidence
from cagemap.maps.landmarks.check import DISTANCES, LandmarkCheck, LandmarkSuspect
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import QualityFigures
from cagemap.maps.result import MatchResult, SpectralMap
from cagemap.mesh import CatmullClark, Loop
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.mesh_report import FileVertex
from cagemap.spectral import BasisConfig, Surface
from cagemap.subdivision import refine

from example_result import edit_manifest, identity_result
from refusals import refuses


@pytest.fixture(scope="module")
def result() -> MatchResult:
    rng = np.random.default_rng(17)
    textured = replace(
        cube(),
        uvs=rng.random((24, 2)),
        uv_indices=np.arange(24),
        face_materials=np.array([0, 0, 0, 1, 1, 1]),
        material_names=("skin", "höof"),
        material_colors=np.array([[0.1, 0.2, 0.3], [np.nan] * 3]),
        name="box.obj",
    ).with_creases([[0, 1]], np.inf)
    target = Surface(refine(textured, 2, CatmullClark("edge_only")), BasisConfig(count=4))
    source = Surface(refine(icosahedron(), 1, Loop()), BasisConfig(count=6))
    places = target.triangles(2), source.triangles(1)
    n1 = places[0].n
    vertices = np.array([0, 3, 5], np.int64)
    return MatchResult(
        target,
        source,
        Landmarks(("nose", "tail", "toe"), vertices, vertices, textured.name, source.control.name),
        PointMap.from_arrays(*places, rng.integers(0, len(places[1].triangles), n1), rng.dirichlet([1, 1, 1], n1)),
        QualityFigures.of_summary({"coverage": 0.5}, rng.random(3), rng.random(n1)),
        {"map": 1.25},
        known_spectral=SpectralMap(rng.normal(size=(4, 6)), np.linspace(0, 9, 4), np.linspace(0, 9, 6)),
    )


@pytest.fixture
def folder(result: MatchResult, tmp_path: Path) -> Path:
    write_result(tmp_path / "R", result)
    return tmp_path / "R"


def test_everything_comes_back_bit_for_bit(result: MatchResult, folder: Path) -> None:
    back = read_result(folder)
    for name in ("source_triangles", "triangle", "barycentric", "functional_map", "trust", "landmark_errors"):
        np.testing.assert_array_equal(getattr(back, name), getattr(result, name))
    for ours, theirs in ((back.target, result.target), (back.source, result.source)):
        assert mesh_hash(ours.control) == mesh_hash(theirs.control)
        assert ours.control.name == theirs.control.name
        assert ours.control.material_names == theirs.control.material_names
        assert (ours.refinement.scheme, ours.finest_level) == (theirs.refinement.scheme, theirs.finest_level)
        assert ours.config == theirs.config
        for name in ("vertices", "faces"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert back.landmarks.names == result.landmarks.names
    np.testing.assert_array_equal(back.landmarks.source, result.landmarks.source)
    for name in ("target_eigenvalues", "source_eigenvalues"):
        np.testing.assert_array_equal(getattr(back.spectral, name), getattr(result.spectral, name))
    assert back.manifest == result.manifest


def test_numbers_have_32_bits_and_those_of_older_folders_64(result: MatchResult, folder: Path) -> None:
    names = "source_triangles", "triangle", "target_faces", "source_faces"
    with np.load(folder / ARRAYS) as stored:
        arrays = dict(stored)
    assert {arrays[name].dtype for name in names} == {np.dtype(np.int32)}
    np.savez(folder / ARRAYS, **(arrays | {name: arrays[name].astype(np.int64) for name in names}))
    back = read_result(folder)
    np.testing.assert_array_equal(back.triangle, result.triangle)
    np.testing.assert_array_equal(back.source.faces, result.source.faces)
    assert back.triangle.dtype == back.source.faces.dtype == np.int64


def test_vertices_of_messages_come_back_and_those_of_older_folders_without_places(result, folder):
    control = result.source.control
    suspect = LandmarkSuspect("tail", 1, 0.5, control.file_vertex(4), control.file_vertex(3), DISTANCES)
    quality = replace(result.quality, landmark_errors=result.quality.landmark_errors[[0, 2]])
    judged = replace(result, landmark_check=LandmarkCheck((suspect,)), quality=quality)
    write_result(folder, judged)
    (back,) = read_result(folder).landmark_check.suspects
    assert (back.nearest_vertex, back.source_vertex) == (suspect.nearest_vertex, suspect.source_vertex)
    record = json.loads((folder / MANIFEST).read_text())
    record["landmark_check"]["suspects"][0] |= {"nearest_vertex": 4, "source_vertex": 3}
    (folder / MANIFEST).write_text(json.dumps(record))
    (older,) = read_result(folder).landmark_check.suspects
    assert (older.nearest_vertex, older.source_vertex) == (FileVertex(4), FileVertex(3))


def test_without_a_functional_map_the_folder_is_read(result: MatchResult, tmp_path: Path) -> None:
    write_result(tmp_path / "R", replace(result, known_spectral=None))
    back = read_result(tmp_path / "R")
    assert not back.has_spectral
    assert back.functional_map.shape == (4, 6)  # made now


def test_map_file_has_the_documented_arrays(result: MatchResult, folder: Path) -> None:
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
    assert manifest["quality"]["coverage"] == 0.5
    assert manifest["quality"]["dirichlet"] is None
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


def test_transfers_are_noted_once_per_output(result: MatchResult, folder: Path) -> None:
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


def test_merged_parts_state_the_seconds_and_the_memory_of_all_parts() -> None:
    parts = [
        replace(identity_result(1), timings={"match": seconds}, provenance={"peak_memory_bytes": memory, "notes": []})
        for seconds, memory in ((2.0, 100), (5.0, 300))  # both count from the start of the command
    ]
    merged = merge_results(parts, {"parts": []}).manifest
    assert merged["timings"] == {"match": 5.0}
    assert merged["peak_memory_bytes"] == 300


def test_a_part_is_named_by_its_object_if_its_file_has_several() -> None:
    box = replace(cube(), face_objects=np.zeros(6, dtype=int), object_names=("box",))
    mixed = replace(box, face_objects=np.arange(6) % 2, object_names=("box", "lid"))
    named = box, replace(box, object_names=("box", "lid")), mixed, cube()
    of_box = "part 'box' of 6 faces"
    assert [_title(mesh) for mesh in named] == [of_box if mesh is named[1] else "the part of 6 faces" for mesh in named]


def test_image_is_on_the_source(result: MatchResult) -> None:
    corners = result.source.vertices[result.source_triangles[result.triangle]]
    np.testing.assert_allclose(result.image()[7], result.barycentric[7] @ corners[7])


def test_nothing_is_left_behind_when_writing_fails(result: MatchResult, tmp_path: Path) -> None:
    broken = replace(
        result, quality=replace(result.quality, trust=np.array([object()]))
    )  # cannot be stored without pickling
    refuses(ValueError, "allow_pickle", write_result, tmp_path / "R", broken)
    assert list(tmp_path.iterdir()) == []


def test_missing_folder_manifest_or_arrays_are_named(folder: Path, tmp_path: Path) -> None:
    refuses(FormatError, r"nowhere.*nothing of that name", read_result, tmp_path / "nowhere")
    (folder / ARRAYS).unlink()
    refuses(FormatError, r"map\.npz: is missing", read_result, folder)
    (folder / MANIFEST).unlink()
    refuses(FormatError, r"no manifest\.json", read_result, folder)


def test_newer_and_foreign_manifests_are_refused(folder: Path) -> None:
    edit_manifest(folder, format_version=99, versions={"cagemap": "9.1"})
    refuses(FormatError, r"version 99.*cagemap 9\.1", read_result, folder)
    edit_manifest(folder, format="holiday")
    refuses(FormatError, "cagemap-result", read_result, folder)
    (folder / MANIFEST).write_text('{"format": "cagemap-res')
    refuses(FormatError, "cannot be read", read_result, folder)


@pytest.mark.parametrize("keep", [0, 100, 5000, None])
def test_arrays_that_are_half_written_or_have_a_flipped_bit_are_refused(folder: Path, keep: int | None) -> None:
    data = bytearray((folder / ARRAYS).read_bytes())
    if keep is None:
        data[len(data) // 2] ^= 0xFF
    (folder / ARRAYS).write_bytes(data[:keep])
    refuses(FormatError, "damaged", read_result, folder)


def test_hashes_depend_on_content_only(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    assert file_hash(tmp_path / "a") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert mesh_hash(cube()) == mesh_hash(cube())
    assert mesh_hash(cube()) != mesh_hash(cube().with_positions(cube().positions * 2))


def test_landmarks_that_seem_exchanged_come_back(result: MatchResult, tmp_path: Path) -> None:
    places = result.point_map.images.positions
    answers = (
        Placement(places, 1e-4, name="as given"),
        Placement(places, 2e-4, name="mirrored", exchange=((0, 2), (2, 0))),
    )
    unsure = Confidence(TWO, answers)
    write_result(tmp_path / "R", replace(result, confidence=unsure))
    back = read_result(tmp_path / "R").confidence
    assert [reading.exchange for reading in back.answers] == [(), ((0, 2), (2, 0))]


def test_a_result_of_before_is_sure_only_if_its_map_may_be_now(result: MatchResult, tmp_path: Path) -> None:
    """Bounds of signs change, and older results have none."""
    answers, bound = (Placement(result.point_map.images.positions, 1e-4, name=""),), SIGN_BOUNDS["stretched"]
    for name, value, verdict in (("much", bound + 0.1, LOOK), ("little", bound, SURE)):
        given = Confidence(SURE, answers, {"cost": 1.0, "stretched": value})
        write_result(tmp_path / name, replace(result, confidence=given))
        back = read_result(tmp_path / name).confidence
        assert (back.verdict, back.signs) == (verdict, given.signs)
        assert back.message.startswith(verdict)
        # What the report shows is what was read, not the sentence of then.
        old = json.loads((tmp_path / name / MANIFEST).read_text())
        old["confidence"] |= {"verdict": SURE, "message": "the sentence of then: sure"}
        (tmp_path / name / MANIFEST).write_text(json.dumps(old))
        again = read_result(tmp_path / name).manifest
        # Being sure is nothing to warn of.
        assert (landmark_messages(again)[:1], sure_message(again)) == (
            ([back.message], "") if verdict == LOOK else ([], back.message)
        )
    del old["confidence"]["signs"]
    (tmp_path / name / MANIFEST).write_text(json.dumps(old))
    back = read_result(tmp_path / name).confidence
    assert back.verdict == LOOK
    assert "match again" in back.message


def test_all_uv_sets_come_back(result: MatchResult, tmp_path: Path) -> None:
    """`wrap RESULT` and `transfer` write them again."""
    control = result.target.control
    second = UvSet("light", np.random.default_rng(1).random((30, 2)), control.uv_indices[::-1])
    target = Surface(refine(replace(control, uv_sets=(second,)), 2, CatmullClark("edge_only")), BasisConfig(count=4))
    write_result(tmp_path / "R", replace(result, target=target))
    (found,) = read_result(tmp_path / "R").target.control.uv_sets
    assert found.name == "light"
    np.testing.assert_array_equal(found.uvs, second.uvs)
    np.testing.assert_array_equal(found.uv_indices, second.uv_indices)
    with np.load(tmp_path / "R" / ARRAYS) as stored:
        arrays = dict(stored)
    np.savez(tmp_path / "R" / ARRAYS, **(arrays | {"target_control_uv_set_0_indices": np.full(24, 30)}))
    refuses(FormatError, "target_control_uv_set_0_indices counts past 0 to 29", read_result, tmp_path / "R")
