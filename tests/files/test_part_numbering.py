"""A result about a part: values come and go in the numbers of the whole file, which are the ones a person has."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, poles

from cagemap.errors import ParameterError
from cagemap.files.landmarks.pairs import read_landmarks, write_landmarks
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import read_result, write_result
from cagemap.files.result.manifest import stated_inputs
from cagemap.files.values.attributes import read_attributes
from cagemap.files.values.part_numbering import FileRows
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.parts import extract_faces, find_part, join_meshes
from cagemap.mesh.weld import weld_mesh
from cagemap.tasks.match import MatchRequest, run_match
from cagemap.tasks.progress import Stages
from cagemap.tasks.report import carried_data
from cagemap.tasks.requests.suggest import SuggestRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.tasks.suggest import run_suggest
from cagemap.tasks.transfer import run_transfer
from cagemap.tasks.wrap import run_wrap

from example_result import identity_result, textured_cube
from plain_meshes import marks_at, named, split_at_seams
from refusals import refuses

BODY_START = poles(6).n_vertices  # vertices of the eye come first


def _scene() -> ControlMesh:
    """An eye, then a body, so that the body's numbers begin somewhere."""
    eye = poles(6).with_positions(poles(6).positions + np.array([9.0, 0, 0]))
    return replace(join_meshes([named(eye, "eye"), named(creature(), "body")]), name="hero.obj")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("parts")
    scene = _scene()
    write_mesh(place / "hero.obj", scene)
    picked = BODY_START + np.linspace(0, creature().n_vertices - 1, 9).astype(int)
    write_landmarks(place / "landmarks.json", marks_at(picked, "hero", "hero"))
    hero = place / "hero.obj"
    run_match(MatchRequest(hero, hero, place / "R", place / "landmarks.json", level=2, k=30, part="body"), Stages())
    return place


def test_rows_of_a_part_in_any_order() -> None:
    scene = _scene()
    rows = FileRows(extract_faces(scene, find_part(scene, "body").faces[::-1]), scene)
    corners = np.arange(len(scene.face_indices))
    sizes = (scene.n_vertices, rows.vertices), (scene.n_faces, rows.faces), (len(corners), rows.to_part(corners))
    for count, own in sizes:
        values = np.arange(count)
        np.testing.assert_array_equal(rows.to_part(values), own)
        below = -np.ones(count, dtype=np.int64)
        np.testing.assert_array_equal(rows.to_file(own, below)[own], own)
        assert (np.delete(rows.to_file(own, below), own) == -1).all()
        fractions = rows.to_file(own, below + 0.5)  # whole numbers over fractions
        assert (np.delete(fractions, own) == -0.5).all()
        np.testing.assert_array_equal(fractions[own], own)
    np.testing.assert_array_equal(scene.face_indices[rows.to_part(corners)], rows.vertices[rows.part.face_indices])
    np.testing.assert_array_equal(rows.placed(rows.part.positions), scene.positions)


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".json"])
def test_values_of_the_whole_file_come_back_in_its_numbers(folder: Path, suffix: str) -> None:
    scene = _scene()
    body = np.arange(scene.n_vertices) >= BODY_START
    height = np.where(body, scene.positions[:, 1] - scene.positions[:, 1].min() + 1, 7.0)
    given, output = folder / f"height{suffix}", folder / f"carried{suffix}"
    if suffix == ".json":
        group = {"name": "height", "vertices": list(range(scene.n_vertices)), "weights": height.tolist()}
        given.write_text(json.dumps({"groups": [group]}))
    elif suffix == ".csv":
        given.write_text("\n".join(["height", *map(str, height)]))
    else:
        np.savez(given, height=height)
    run_transfer(TransferRequest(folder / "R", output, attribute=given, force=True), Stages())
    found = read_attributes(output, scene)["height"]
    assert found.shape == (scene.n_vertices,)
    assert np.abs(found - height)[body].max() < 1e-6 * np.abs(height).max()
    assert (found[~body] == 0).all()
    np.save(folder / "under.npy", np.full(scene.n_vertices, 0.5))  # the only values, whatever they are called
    over = TransferRequest(folder / "R", output, attribute=given, bases=(("", folder / "under.npy"),), force=True)
    run_transfer(over, Stages())
    assert (read_attributes(output, scene)["height"][~body] == 0.5).all()
    np.save(folder / "under.npy", np.full(scene.n_vertices - 1, 0.5))
    refuses(ParameterError, r"of shape \(\d+,\), one row a vertex of hero.obj, got", run_transfer, over, Stages())


@pytest.mark.parametrize("suffix", [".npz", ".usda"])
def test_a_base_without_the_carried_values_is_refused(folder: Path, suffix: str) -> None:
    scene = _scene()
    np.savez(folder / "two.npz", a=np.ones(scene.n_vertices), b=np.ones(scene.n_vertices))
    base = folder / f"base{suffix}"
    if suffix == ".usda":
        pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
        write_mesh(base, scene)
    else:
        np.savez(base, a=np.ones(scene.n_vertices), c=np.ones(scene.n_vertices))
    request = TransferRequest(folder / "R", folder / "never.npz", attribute=folder / "two.npz", bases=(("", base),))
    with pytest.raises(ParameterError, match=r"--base .* expected values of (a, )?b, as what is carried, got"):
        run_transfer(request, Stages())
    assert not (folder / "never.npz").exists()


def test_the_columns_of_a_base_of_one_table_are_in_the_carried_order(folder: Path) -> None:
    scene = _scene()
    body = np.arange(scene.n_vertices) >= BODY_START
    np.savez(folder / "pair.npz", a=np.ones(scene.n_vertices), b=np.ones(scene.n_vertices))
    np.save(folder / "table.npy", np.tile([0.25, 0.75], (scene.n_vertices, 1)))
    bases = (("", folder / "table.npy"),)
    request = TransferRequest(folder / "R", folder / "o.npz", attribute=folder / "pair.npz", bases=bases)
    run_transfer(request, Stages())
    for name, expected in (("a", 0.25), ("b", 0.75)):
        assert (read_attributes(folder / "o.npz")[name][~body] == expected).all()


def test_shapes_of_the_whole_file_are_written_as_meshes_of_it(folder: Path) -> None:
    scene = _scene()
    offsets = np.zeros((scene.n_vertices, 3))
    offsets[BODY_START + 4] = (0, 0.1, 0)
    offsets[2] = 5  # of the eye
    np.savez(folder / "smile.npz", smile=offsets)
    write_mesh(folder / "frown.obj", scene.with_positions(scene.positions - offsets))
    given = (folder / "smile.npz", folder / "frown.obj")
    run_transfer(TransferRequest(folder / "R", folder / "shapes", blend_shapes=given), Stages())
    rest = read_mesh(folder / "shapes" / "hero.obj")
    np.testing.assert_array_equal(rest.face_indices, scene.face_indices)
    for name, sign in (("smile", 1), ("frown", -1)):
        moved = read_mesh(folder / "shapes" / f"{name}.obj").positions - rest.positions
        np.testing.assert_allclose(moved[BODY_START:], sign * offsets[BODY_START:], atol=1e-6)
        assert not moved[:BODY_START].any()


def test_values_of_neither_are_refused_with_what_to_do(folder: Path, tmp_path: Path) -> None:
    np.savez(tmp_path / "short.npz", a=np.zeros(5))
    count = _scene().n_vertices
    for option in ("attribute", "weights"):
        request = TransferRequest(folder / "R", tmp_path / "o.npz", **{option: tmp_path / "short.npz"})
        refuses(ParameterError, f"matched in part, for each of the file's {count}", run_transfer, request, Stages())
    assert not (tmp_path / "o.npz").exists()


def test_values_of_a_part_whose_file_has_changed_say_whose_numbers_they_have(folder, tmp_path, caplog):
    place = shutil.copytree(folder, tmp_path / "moved")
    with (place / "hero.obj").open("a") as file:
        file.write("v 0 0 0\n")
    np.save(place / "own.npy", np.ones(creature().n_vertices))
    run_transfer(TransferRequest(place / "R", place / "o.npz", attribute=place / "own.npy"), Stages())
    assert len(read_attributes(place / "o.npz")["own"]) == creature().n_vertices
    for side in ("target", "source"):
        assert (
            f"hero.obj: was matched in part, and is not where the match read it, or has changed: values of the {side}"
            in (caplog.text)
        )


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".off"])
def test_a_wrapped_part_stays_in_its_file(folder: Path, suffix: str) -> None:
    scene = _scene()
    summary, warnings = run_wrap(WrapRequest((folder / "R",), folder / f"wrapped{suffix}"), Stages())
    wrapped = read_mesh(folder / f"wrapped{suffix}")
    np.testing.assert_array_equal(wrapped.face_indices, scene.face_indices)
    np.testing.assert_array_equal(wrapped.positions[:BODY_START], scene.positions[:BODY_START])
    assert np.abs(wrapped.positions - scene.positions).max() < 0.05 * np.ptp(scene.positions)
    shown = carried_data(folder / "R", read_result(folder / "R")).wrapped
    np.testing.assert_array_equal(shown.positions, wrapped.positions[BODY_START:])
    assert any("stay where they are" in text for text in warnings)
    assert f"wrapped{suffix}: {scene.n_vertices} vertices, {creature().n_vertices} of them wrapped (level 0)" in summary
    _, warnings = run_wrap(WrapRequest((folder / "R",), folder / f"fine{suffix}", fit_level=1), Stages())
    assert "hero.obj: 24 faces that were not matched are not written. Give --fit-level 0" in warnings


@pytest.mark.slow
def test_suggested_landmarks_can_be_matched_again(folder: Path) -> None:
    run_suggest(SuggestRequest(folder / "R", folder / "more.json", 3), Stages())
    landmarks, _ = read_landmarks(folder / "more.json", "hero", "hero")
    assert landmarks.target.min() >= BODY_START
    np.testing.assert_array_equal(landmarks.target[:9], landmarks.source[:9])
    hero = folder / "hero.obj"
    request = MatchRequest(hero, hero, folder / "R2", folder / "more.json", level=1, k=30, part="body")
    _, warnings = run_match(request, Stages())
    assert not any("left out" in text for text in warnings)


@pytest.mark.slow
def test_parts_matched_one_by_one_keep_the_order_of_the_file(folder: Path) -> None:
    scene = _scene()
    picked = np.concatenate([np.arange(5), BODY_START + np.linspace(0, creature().n_vertices - 1, 9).astype(int)])
    write_landmarks(folder / "both.json", marks_at(picked, "hero", "hero"))
    hero = folder / "hero.obj"
    run_match(MatchRequest(hero, hero, folder / "E", folder / "both.json", level=1, k=6, part="each"), Stages())
    np.savez(folder / "numbers.npz", a=scene.positions)
    run_transfer(TransferRequest(folder / "E", folder / "numbers_out.npz", attribute=folder / "numbers.npz"), Stages())
    # The larger part comes first in the result.
    found = np.load(folder / "numbers_out.npz")["a"]
    np.testing.assert_allclose(
        found[BODY_START:], scene.positions[BODY_START:], atol=0.1
    )  # six functions make no exact map
    assert np.abs(found[:BODY_START] - scene.positions[:BODY_START]).max() < 0.2 * np.ptp(scene.positions[:BODY_START])


@pytest.mark.parametrize("own", [True, False])
def test_the_source_s_uvs_are_written_into_the_whole_file(tmp_path: Path, own: bool) -> None:
    cubes = [textured_cube(name, size) for name, size in (("one", 1.0), ("two", 2.0))]
    one, two = (named(cube, cube.name) for cube in cubes)
    scene = join_meshes([one, two.with_positions(two.positions + 9.0)])
    write_mesh(tmp_path / "source.obj", scene)
    target = scene if own else scene.with_uvs(None, None)
    write_mesh(tmp_path / "target.obj", target)
    files = tmp_path / "target.obj", tmp_path / "source.obj"
    run_match(MatchRequest(*files, tmp_path / "R", level=2, part="two"), Stages())
    summary, _ = run_transfer(TransferRequest(tmp_path / "R", tmp_path / "laid.obj", source_uvs=True), Stages())
    laid = read_mesh(tmp_path / "laid.obj")
    np.testing.assert_array_equal(laid.face_indices, scene.face_indices)
    half = len(scene.face_indices) // 2
    found, wanted = laid.uvs[laid.uv_indices], scene.uvs[scene.uv_indices]
    np.testing.assert_allclose(found[half:], wanted[half:], atol=1e-5)
    np.testing.assert_allclose(found[:half], wanted[:half] if own else 0.0, atol=1e-5)
    assert f"6 faces that were not matched {'keep theirs' if own else 'have them all at (0, 0)'}" in summary


def test_the_source_s_uvs_of_a_part_are_written_into_the_set_in_use() -> None:
    cube = replace(textured_cube("one"), uv_name="TEXCOORD_0")
    cube = replace(cube, uv_sets=(UvSet("TEXCOORD_1", cube.uvs / 2, cube.uv_indices),))
    whole = join_meshes([cube, cube.with_positions(cube.positions + 9.0)])
    part = extract_faces(whole.with_uv_set("TEXCOORD_1"), np.arange(6, 12))
    laid = FileRows(part, whole).laid_out(part.uvs / 2, part.uv_indices)
    for name, factors in (("TEXCOORD_0", (1, 1)), ("TEXCOORD_1", (1, 0.5))):
        found, own = (mesh.with_uv_set(name) for mesh in (laid, whole))
        expected = own.uvs[own.uv_indices] * np.repeat(factors, 24)[:, None]
        np.testing.assert_allclose(found.uvs[found.uv_indices], expected, atol=1e-6)
    assert laid.uv_name == "TEXCOORD_1"


def _follower(path: Path, base: ControlMesh) -> np.ndarray:
    """Positions of the vertices of a MakeHuman file for the base mesh of another file."""
    lines = [line.split() for line in path.read_text().splitlines()]
    rows = np.array([line for line in lines if len(line) == 9], dtype=float)
    ends = np.array([line[1:] for line in lines if line and line[0].endswith("_scale")], dtype=float)
    corners = base.positions[ends[:, :2].astype(int), np.arange(3)[:, None]]
    np.testing.assert_allclose(np.abs(corners[:, 0] - corners[:, 1]), ends[:, 2])
    return np.einsum("nk,nkd->nd", rows[:, 3:6], base.positions[rows[:, :3].astype(int)]) + rows[:, 6:]


def test_a_makehuman_file_has_the_numbers_of_both_files(tmp_path: Path) -> None:
    scene, split = _scene(), replace(split_at_seams(creature()), name="split.obj")
    write_mesh(tmp_path / "split.obj", split)
    part, welded = extract_faces(scene, find_part(scene, "body").faces), weld_mesh(split).mesh
    result = identity_result(2, (welded, part))
    inputs = stated_inputs({"target": tmp_path / "split.obj"}, tmp_path / "R")
    write_result(tmp_path / "R", replace(result, provenance={**result.provenance, "inputs": inputs}))
    run_transfer(TransferRequest(tmp_path / "R", tmp_path / "a.mhclo", write_map=True), Stages())
    np.testing.assert_allclose(_follower(tmp_path / "a.mhclo", scene), split.positions, atol=1e-9)
    run_wrap(WrapRequest((tmp_path / "R",), tmp_path / "w.obj", mhclo=tmp_path / "w.mhclo"), Stages())
    wrapped = read_mesh(tmp_path / "w.obj").positions
    np.testing.assert_allclose(_follower(tmp_path / "w.mhclo", scene), wrapped, atol=1e-6)
    (tmp_path / "split.obj").unlink()
    with pytest.raises(ParameterError, match="expected the file that was matched"):
        run_transfer(TransferRequest(tmp_path / "R", tmp_path / "b.mhclo", write_map=True), Stages())


def test_a_part_does_not_follow_a_body_in_makehuman(folder: Path) -> None:
    with pytest.raises(ParameterError, match="vertices that were not matched"):
        run_transfer(TransferRequest(folder / "R", folder / "never.mhclo", write_map=True), Stages())
    with pytest.raises(ParameterError, match="vertices that were not matched"):
        run_wrap(WrapRequest((folder / "R",), folder / "never.obj", mhclo=folder / "never.mhclo"), Stages())
    assert not list(folder.glob("never.*"))
