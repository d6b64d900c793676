"""USD files that hold more than the matched part, other units or a moved prim: layers fit what they lie over."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.cli.match import MatchRequest, run_match
from cagemap.cli.mesh_commands import refine_file
from cagemap.cli.progress import Stages
from cagemap.cli.transfer import run_transfer
from cagemap.cli.transfer_request import TransferRequest
from cagemap.cli.wrap import run_wrap
from cagemap.cli.wrap_request import WrapRequest
from cagemap.files.images import write_image
from cagemap.files.landmarks import write_landmarks
from cagemap.mesh import CatmullClark, ControlMesh, creature, cube, poles
from cagemap.mesh.join import join_meshes
from cagemap.mesh.landmarks import Landmarks

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from pxr import Gf, Usd, UsdGeom

from cagemap.files.usd import read_usd, read_usd_meshes
from cagemap.files.usd_write import write_usd
from test_usd import complaints

PLACE = np.array([[0, 2.0, 0, 0], [-2.0, 0, 0, 0], [0, 0, 2.0, 0], [5, 6, 7, 1]])


def _stage(path: Path, mesh: ControlMesh) -> None:
    """A mesh in a turned and enlarged prim, Z up, in centimetres."""
    write_usd(path, mesh)
    stage = Usd.Stage.Open(str(path))
    UsdGeom.Xformable(stage.GetPrimAtPath("/Asset")).AddTransformOp().Set(Gf.Matrix4d(*PLACE.ravel().tolist()))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.Save()


def _scene() -> ControlMesh:
    ball = poles(6)
    eye = ball.with_positions(ball.positions + np.array([9.0, 0, 0]))
    both = replace(join_meshes([eye, creature()]), name="hero.usda", scheme=CatmullClark(), uv_name="st")
    flat = both.positions[:, :2]
    return both.with_uvs((flat - flat.min(axis=0)) / np.ptp(flat, axis=0), both.face_indices)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("usd parts")
    scene, hero = _scene(), place / "hero.usda"
    _stage(hero, scene)
    first = scene.n_vertices - creature().n_vertices
    picked = first + np.linspace(0, creature().n_vertices - 1, 9).astype(int)
    names = tuple(f"point {number}" for number in range(9))
    write_landmarks(place / "landmarks.json", Landmarks(names, picked, picked, "hero", "hero"))
    request = MatchRequest(hero, hero, place / "landmarks.json", place / "R", level=1, k=30, part="component:1")
    run_match(request, Stages())
    return place


def test_layers_about_a_part_of_a_prim_fit_the_prim(folder: Path) -> None:
    scene = _scene()
    first = scene.n_vertices - creature().n_vertices
    side = np.linspace(0.1, 0.9, scene.n_vertices)
    np.savez(folder / "side.npz", side=side)
    np.savez(folder / "skin.npz", hip=side, head=1 - side)
    smile = np.zeros((scene.n_vertices, 3))
    smile[first + 4] = (0, 0.1, 0)
    np.savez(folder / "smile.npz", smile=smile)
    result = folder / "R"
    for name, options in (
        ("side", {"attribute": folder / "side.npz"}),
        ("weights", {"weights": folder / "skin.npz"}),
        ("shapes", {"blend_shapes": (folder / "smile.npz",)}),
    ):
        layer = folder / f"{name}.usda"
        run_transfer(TransferRequest(result, folder / f"{name}_out.npz", usd=layer, **options), Stages())
        assert complaints(layer) == [], name
    read = {name: read_usd_meshes(folder / f"{name}.usda")[0] for name in ("side", "weights", "shapes")}
    np.testing.assert_allclose(read["side"].attributes["side"][first:], side[first:], atol=1e-5)
    assert not read["side"].attributes["side"][:first].any()
    weights = read["weights"].attributes["skel:jointWeights"]
    np.testing.assert_allclose(weights[first:, 0], side[first:], atol=1e-5)
    np.testing.assert_allclose(read["shapes"].attributes["blendShape:smile"], smile, atol=1e-5)
    run_wrap(WrapRequest((result,), folder / "wrapped.usda"), Stages())
    assert complaints(folder / "wrapped.usda") == []
    wrapped = read_usd(folder / "wrapped.usda")
    np.testing.assert_allclose(wrapped.positions[:first], scene.positions[:first], atol=1e-6)
    assert np.abs(wrapped.positions - scene.positions).max() < 0.05 * np.ptp(scene.positions)


def test_a_new_layout_of_a_part_fits_the_prim(folder: Path) -> None:
    write_image(folder / "grey.png", np.full((32, 32, 3), 99, dtype=np.uint8))
    images = {"texture": folder / "grey.png", "output": folder / "colors.png"}
    run_transfer(TransferRequest(folder / "R", **images, unwrap=True, usd=folder / "look.usda"), Stages())
    assert complaints(folder / "look.usda") == []
    (mesh,) = read_usd_meshes(folder / "look.usda")
    layout = mesh.control.with_uv_set("cagemap_st")
    outside = layout.face_indices < _scene().n_vertices - creature().n_vertices
    assert np.ptp(layout.uvs[layout.uv_indices[~outside]], axis=0).min() > 0.5
    assert not np.ptp(layout.uvs[layout.uv_indices[outside]], axis=0).any()


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
def test_refined_files_keep_units_axis_and_place(suffix: str, tmp_path: Path) -> None:
    _stage(tmp_path / "box.usda", replace(cube(), scheme=CatmullClark()))
    refine_file(tmp_path / "box.usda", 1, tmp_path / f"fine{suffix}")
    stage = Usd.Stage.Open(str(tmp_path / f"fine{suffix}"))
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Z", 0.01)
    (fine,), (coarse,) = (read_usd_meshes(path) for path in (tmp_path / f"fine{suffix}", tmp_path / "box.usda"))
    np.testing.assert_allclose(fine.to_world, coarse.to_world, atol=1e-12)
    assert fine.control.n_vertices == 26
    assert complaints(tmp_path / f"fine{suffix}") == []
