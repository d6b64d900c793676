"""Results and passengers of USD files in other units and axes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from examples.shapes import triangulated

from cagemap.files.images.image import read_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import write_result
from cagemap.files.result.manifest import file_hash
from cagemap.files.values.rigs import read_skeleton
from cagemap.mesh import CatmullClark, ControlMesh
from cagemap.mesh.plain import turn_faces
from cagemap.subdivision import refine
from cagemap.surface.alignment import Z_UP
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer
from cagemap.tasks.wrap import WrapRequest, run_wrap

from example_result import identity_result, textured_cube

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")


from usd_rigs import write_rigged

from cagemap.files.usd.prims import transform_points
from cagemap.files.usd.read import read_usd_meshes
from cagemap.files.usd.skeleton import read_usd_skeleton
from cagemap.files.usd.space import StageSpace, between_spaces, to_standard, unit_notes
from cagemap.files.usd.write import write_usd

from usd_scenes import complaints


def _lifted_cube() -> ControlMesh:
    """A cube that fits no turn of itself."""
    cube = textured_cube("hat", 1.1)
    return cube.with_positions(cube.positions * [1.0, 1.2, 1.4] + [0.0, 0.2, 0.5])


def test_rigs_of_a_file_in_other_units_and_axes_are_converted(folder: Path) -> None:
    """The same rig a hundred times as large in centimetres, Z up: heads, axes and offsets as the source's file."""
    write_rigged(folder / "cm.usda", "small.usda", 100.0, None, ("Z", 0.01))
    to_y_up = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    given = read_usd_skeleton(folder / "small.usda")
    weighed = TransferRequest(
        folder / "RESULT", folder / "weights.npz", weights=folder / "cm.usda", usd=folder / "rig.usda"
    )
    run_transfer(weighed, Stages())
    joints = TransferRequest(folder / "RESULT", folder / "rig.json", joints=folder / "cm.usda")
    assert run_transfer(joints, Stages())[1] == []
    for found in (read_usd_skeleton(folder / "rig.usda"), read_skeleton(folder / "rig.json")):
        np.testing.assert_allclose(found.heads, 2 * given.heads @ to_y_up, atol=1e-5)
        np.testing.assert_allclose(found.tails, 2 * given.tails @ to_y_up, atol=1e-5)
        np.testing.assert_allclose(found.axes, given.axes @ to_y_up, atol=1e-5)
    shapes = TransferRequest(folder / "RESULT", folder / "shapes.npz", blend_shapes=(folder / "cm.usda",))
    run_transfer(shapes, Stages())
    with np.load(folder / "shapes.npz") as carried:
        np.testing.assert_allclose(carried["smile"][2], [0, 2, 0], atol=1e-5)
    detail = textured_cube("fine.usda", 100.0)
    write_usd(folder / "fine.usda", detail, space=StageSpace("Z", 0.01))
    baked = TransferRequest(folder / "RESULT", folder / "n.png", bake=("normal",), detail=folder / "fine.usda", size=8)
    run_transfer(baked, Stages())


def test_a_wrapped_cage_is_in_the_targets_own_units_and_axes(folder: Path) -> None:
    (note,) = unit_notes(folder / "large.usda", folder / "small.usda")
    assert "0.01 m a unit, Z up" in note
    assert "results are in the target's own" in note
    assert unit_notes(folder / "small.usda", folder / "small.usda") == ()
    assert unit_notes(folder / "large.usda", folder / "x.obj") == ()
    assert "x.glb 1 m a unit, Y up" in unit_notes(folder / "large.usda", folder / "x.glb")[0]
    warnings = run_wrap(WrapRequest((folder / "RESULT",), folder / "wrapped.usda"), Stages())[1]
    (rig,) = (text for text in warnings if "skeleton" in text)
    assert rig.startswith("wrapped.usda: kept of large.usda, in its old shape: blend shapes, skeleton. To")
    assert complaints(folder / "wrapped.usda") == []
    mesh = read_usd_meshes(folder / "wrapped.usda")[0]
    source = read_usd_meshes(folder / "small.usda")[0].control.positions
    # In the world, in metres with Y up, the cage lies on the source.
    world = transform_points(mesh.control.positions, mesh.to_world)
    upright = 0.01 * np.column_stack([world[:, 0], world[:, 2], -world[:, 1]])
    np.testing.assert_allclose(upright, source, atol=2e-3)
    np.testing.assert_allclose(between_spaces(folder / "large.usda", folder / "x.obj"), np.eye(4))


@pytest.mark.parametrize(("output", "unit"), [("w.usda", "100"), ("w.obj", "100"), ("w.glb", "")])
def test_units_of_baked_lengths_are_compared_with_those_of_the_written_cage(
    folder: Path, output: str, unit: str
) -> None:
    """A .glb is in metres with Y up, as the source here."""
    warnings = run_wrap(
        WrapRequest((folder / "RESULT",), folder / output, displacement=folder / "d.exr", size=16), Stages()
    )[1]
    expected = [f"images are in the source's units and axes; one of its units is {unit} of {output}"] if unit else []
    assert [text for text in warnings if "units and axes" in text] == expected


@pytest.mark.parametrize("given", ["hat.usda", "hat.glb", "hat.obj"])
@pytest.mark.parametrize("output", ["worn.usda", "worn.glb", "worn.obj"])
def test_a_passenger_is_at_its_place_in_the_world(folder: Path, given: str, output: str) -> None:
    """Read and written in the units, axes and transform that each file states; others have those of the models."""
    hat = textured_cube(given, 1.1)
    shift = np.eye(4)
    shift[3, :3] = [0, 3, 0]
    if given == "hat.usda":
        write_usd(folder / given, hat.with_positions(hat.positions - [0, 3, 0]), space=StageSpace("Y", 1.0, shift))
    else:
        write_mesh(folder / given, hat)
    run_transfer(TransferRequest(folder / "RESULT", folder / output, passenger=folder / given), Stages())
    found = read_mesh(folder / output).positions
    expected = 2.2 * textured_cube("").positions
    if output != "worn.obj":
        found = transform_points(found, to_standard(folder / output)) if output == "worn.usda" else found
        expected = transform_points(expected, to_standard(folder / "large.usda"))
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(expected, axis=0), atol=1e-5)
    assert (folder / "worn.mtl").exists() == (output == "worn.obj" and given != "hat.obj"), "materials of hat.mtl"


@pytest.mark.parametrize("output", ["worn.usda", "worn.glb"])
@pytest.mark.parametrize("z_up", ["hat.stl", "target.stl"])
def test_a_written_passenger_has_the_up_axis_of_its_places(z_up: str, output: str, tmp_path: Path) -> None:
    """Of the target's file: the places are in its axes."""
    target, source = textured_cube("target.stl", 2.0), textured_cube("small.obj")
    upright = Z_UP if z_up == "target.stl" else None
    write_result(tmp_path / "RESULT", identity_result(2, (replace(target, upright=upright), source)))
    hat = triangulated(_lifted_cube())
    write_mesh(tmp_path / "hat.obj", hat)
    trimesh.Trimesh(hat.positions, hat.face_indices.reshape(-1, 3)).export(tmp_path / "hat.stl")
    given = tmp_path / (z_up if z_up == "hat.stl" else "hat.obj")
    request = TransferRequest(tmp_path / "RESULT", tmp_path / output, passenger=given, kind="rigid")
    run_transfer(request, Stages())
    found = transform_points(read_mesh(tmp_path / output).positions, to_standard(tmp_path / output))
    run_transfer(replace(request, output=tmp_path / "worn.obj"), Stages())
    expected = read_mesh(tmp_path / "worn.obj").positions @ (np.eye(3) if upright is None else upright)
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(expected, axis=0), atol=1e-5)


def test_a_cage_wrapped_on_a_glb_is_in_the_targets_own_units(folder: Path) -> None:
    write_mesh(folder / "small.glb", textured_cube("small.glb"))
    glb_source = Path("small.glb")
    np.testing.assert_allclose(
        between_spaces(Path("large.usda"), glb_source), np.linalg.inv(to_standard(Path("large.usda")))
    )
    np.testing.assert_allclose(between_spaces(glb_source, Path("large.usda")), to_standard(Path("large.usda")))


@pytest.mark.parametrize("output", ["worn.usda", "worn.glb"])
@pytest.mark.parametrize("given", ["hat.usda", "hat.glb"])
def test_a_passenger_with_units_fits_a_target_that_has_only_an_up_axis(given: str, output: str, tmp_path: Path) -> None:
    """Its places are in the axes of its own file, as a cage that is wrapped."""
    target, source = textured_cube("target.stl", 2.0), textured_cube("small.obj")
    write_result(tmp_path / "RESULT", identity_result(2, (replace(target, upright=Z_UP), source)))
    shift = np.eye(4)
    shift[3, :3] = [0, 3, 0]
    if given == "hat.usda":
        write_usd(tmp_path / given, _lifted_cube(), space=StageSpace("Z", 0.01, shift))
    else:
        write_mesh(tmp_path / given, _lifted_cube())
    request = TransferRequest(tmp_path / "RESULT", tmp_path / "worn.obj", passenger=tmp_path / given, kind="rigid")
    run_transfer(request, Stages())
    expected = read_mesh(tmp_path / "worn.obj").positions @ Z_UP * (0.01 if given == "hat.usda" else 1.0)
    run_transfer(replace(request, output=tmp_path / output), Stages())
    found = transform_points(read_mesh(tmp_path / output).positions, to_standard(tmp_path / output))
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(expected, axis=0), atol=1e-5)


@pytest.mark.parametrize("given", ["hat.usda", "hat.glb", "hat.obj"])
@pytest.mark.parametrize("upright", [None, Z_UP])
def test_a_passenger_of_equal_bodies_keeps_its_places(given: str, upright: np.ndarray | None, tmp_path: Path) -> None:
    """It is transformed from the units and axes of its file and back; not at all if the body states none."""
    body, shift = replace(textured_cube("body.stl"), upright=upright), np.eye(4)
    write_result(tmp_path / "RESULT", identity_result(2, (body, body)))
    shift[3, :3] = [0, 3, 0]
    if given == "hat.usda":
        write_usd(tmp_path / given, _lifted_cube(), space=StageSpace("Z", 0.01, shift))
    else:
        write_mesh(tmp_path / given, _lifted_cube())
    before = read_mesh(tmp_path / given)
    worn, own = tmp_path / "worn.obj", tmp_path / f"own{Path(given).suffix}"
    request = TransferRequest(tmp_path / "RESULT", own, passenger=tmp_path / given, kind="rigid")
    run_transfer(request, Stages())
    np.testing.assert_allclose(read_mesh(own).positions, before.positions, atol=1e-5)
    run_transfer(replace(request, output=worn), Stages())
    is_turned = given == "hat.glb" and upright is not None
    expected = before.positions @ Z_UP.T if is_turned else before.positions
    expected = expected + shift[3, :3] if given == "hat.usda" and upright is not None else expected
    np.testing.assert_allclose(read_mesh(worn).positions, expected, atol=1e-5)


def test_a_detailed_mesh_of_a_wrap_is_in_the_units_that_its_file_states(folder: Path) -> None:
    write_rigged(folder / "cm.usda", "small.usda", 100.0, None, ("Z", 0.01))
    request = WrapRequest((folder / "RESULT",), folder / "wrapped.usda", detail=folder / "cm.usda", size=16)
    run_wrap(replace(request, normal_map=folder / "n.png"), Stages())
    assert np.median(read_image(folder / "n.png").pixels[:, :, 2] / 65535) > 0.9


def _mirrored(mesh: ControlMesh) -> ControlMesh:
    """The mirror image of a mesh, with outward faces."""
    flipped = mesh.with_positions(mesh.positions * [-1.0, 1.0, 1.0])
    return turn_faces(flipped, np.ones(mesh.n_faces, dtype=bool))


def _signed_volume(mesh: ControlMesh) -> float:
    corners = mesh.positions[mesh.face_indices.reshape(mesh.n_faces, -1)[:, :3]]
    return float(np.linalg.det(corners - mesh.positions.mean(axis=0)).sum())


def test_what_lies_on_a_mirrored_source_keeps_its_faces_outwards(folder: Path) -> None:
    """The transform of the source's prim mirrors; its points are taken as they are."""
    write_rigged(folder / "small.usda", "small.usda", 1.0, np.diag([-1.0, 1, 1, 1]), ("Y", 1.0))
    result = identity_result()
    inputs = {"source": {"file": "small.usda", "path": "../small.usda", "sha256": file_hash(folder / "small.usda")}}
    provenance = {**result.provenance, "inputs": inputs}
    write_result(folder / "RESULT", replace(result, provenance=provenance), force=True)
    surface = refine(textured_cube("small"), 3, CatmullClark()).finest
    write_mesh(folder / "detail.glb", _mirrored(ControlMesh.from_faces(surface.positions, surface.faces.tolist())))
    options = {"bake": ("normal",), "detail": folder / "detail.glb", "size": 32}
    run_transfer(TransferRequest(folder / "RESULT", folder / "n.png", **options), Stages())
    assert np.median(read_image(folder / "n.png").pixels[:, :, 2] / 65535) > 0.9
    write_mesh(folder / "hat.glb", _mirrored(_lifted_cube()))
    run_transfer(TransferRequest(folder / "RESULT", folder / "hat.obj", passenger=folder / "hat.glb"), Stages())
    assert _signed_volume(read_mesh(folder / "hat.obj")) > 0
