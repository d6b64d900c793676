"""A USD asset with creases, parts, UV sets, tiles, weights and a blend shape: every command, and back to USD."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, poles

from cagemap.character.joints import Skeleton
from cagemap.files.images.image import read_texture, udim_path, write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.mesh import CatmullClark, ControlMesh
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.parts import extract_faces, find_part
from cagemap.tasks.match import MatchRequest, run_match
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.tasks.transfer import run_transfer
from cagemap.tasks.wrap import run_wrap

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from pxr import Gf, Usd, UsdGeom

from cagemap.files.usd.read import read_usd, read_usd_meshes
from cagemap.files.usd.skeleton import read_usd_skeleton
from cagemap.files.usd.write import UsdResults, write_usd

from usd_scenes import complaints, usd_mesh

pytestmark = pytest.mark.slow


def _body() -> ControlMesh:
    """A creased creature whose faces lie in two tiles, and again in one square."""
    mesh = creature()
    edges = np.column_stack([mesh.face_indices, mesh.face_indices[mesh.next_corners]])
    edges = np.unique(np.sort(edges, axis=1), axis=0)[::6]
    corners = np.arange(len(mesh.face_indices))
    size = int(np.ceil(np.sqrt(mesh.n_faces)))
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])[corners % 4]
    place = np.column_stack([mesh.corner_faces % size, mesh.corner_faces // size])
    square = (place + 0.1 + 0.8 * unit) / size
    return replace(
        mesh.with_creases(edges, np.resize([0.5, 2, 10], len(edges))),
        uvs=square * [2, 1],
        uv_indices=corners,
        uv_name="st",
        uv_sets=(UvSet("square", square, corners),),
        scheme=CatmullClark("edge_and_corner", "corners_plus1"),
    )


def _write_asset(path: Path, stretch: float, up: str = "Y", unit: float = 1.0) -> None:
    """A rigged body and an eye, the whole of it turned up and scaled as its units say."""
    body = _body().with_positions(_body().positions * [1, stretch, 1])
    weights = np.zeros((body.n_vertices, 2))
    weights[:, 0] = np.clip(body.positions[:, 1] / np.ptp(body.positions[:, 1]) + 0.5, 0, 1)
    weights[:, 1] = 1 - weights[:, 0]
    smile = np.zeros((body.n_vertices, 3))
    smile[3:9] = [0, 0.1, 0]
    low, high = body.positions.min(axis=0), body.positions.max(axis=0)
    middle = body.positions.mean(axis=0)
    heads, tails = (
        np.array([[middle[0], y, middle[2]] for y in ends]) for ends in ((middle[1], low[1]), (high[1], middle[1]))
    )
    skeleton = Skeleton(("chest", "hips"), ("hips", ""), heads, tails, np.stack([np.eye(3)] * 2))
    results = UsdResults(attributes={"skel:jointWeights": weights, "blendShape:smile": smile}, skeleton=skeleton)
    write_usd(path, body, results)
    stage = Usd.Stage.Open(str(path))
    usd_mesh(stage, "/Asset/eye", poles(6).with_positions(poles(6).positions + np.array([9.0, 0, 0])))
    place = np.eye(4)
    place[:3, :3] = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]) if up == "Z" else np.eye(3)
    place[:3, :3] /= unit
    UsdGeom.Xformable(stage.GetPrimAtPath("/Asset")).AddTransformOp().Set(Gf.Matrix4d(*place.ravel().tolist()))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    stage.Save()


def _part(path: Path) -> ControlMesh:
    """The body of an asset, as `--part mesh` takes it."""
    whole = read_usd(path)
    return extract_faces(whole, find_part(whole, "mesh").faces)


def test_every_command_and_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quick_fit: None) -> None:
    monkeypatch.chdir(tmp_path)
    _write_asset(tmp_path / "source.usda", 1.0)
    _write_asset(tmp_path / "target.usda", 1.05, "Z", 0.01)
    assert read_usd(tmp_path / "target.usda").object_names == ("/Asset/mesh", "/Asset/eye")
    picked = np.linspace(0, creature().n_vertices - 1, 9).astype(int)
    names = tuple(f"point {number}" for number in range(len(picked)))
    write_landmarks(tmp_path / "landmarks.json", Landmarks(names, picked, picked, "target.usda", "source.usda"))
    for tile in (1001, 1002):
        pixels = np.full((64, 64, 3), 40 if tile == 1001 else 220, dtype=np.uint8)
        write_image(udim_path(tmp_path / "skin.<UDIM>.png", tile), pixels)
    request = MatchRequest(
        *(tmp_path / name for name in ("target.usda", "source.usda", "RESULT", "landmarks.json")),
        level=2,
        k=40,
        part="mesh",
    )
    _, warnings = run_match(request, Stages())
    assert any("target.usda has 0.01 m a unit, Z up" in text for text in warnings)
    folder = tmp_path / "RESULT"
    skin, layer = tmp_path / "skin.<UDIM>.png", tmp_path / "look.usda"
    run_transfer(TransferRequest(folder, tmp_path / "baked.<UDIM>.png", texture=skin, usd=layer), Stages())
    baked = read_texture(tmp_path / "baked.<UDIM>.png")
    assert list(baked) == [1001, 1002]
    assert abs(int(np.median(baked[1001].pixels)) - 40) <= 1
    assert abs(int(np.median(baked[1002].pixels)) - 220) <= 1
    source = tmp_path / "source.usda"
    run_transfer(TransferRequest(folder, tmp_path / "w.npz", weights=source, usd=tmp_path / "rig.usda"), Stages())
    shapes = TransferRequest(folder, tmp_path / "s.npz", blend_shapes=(source,), usd=tmp_path / "shaped.usda")
    run_transfer(shapes, Stages())
    body, rigged = read_usd_meshes(source)[0], read_usd_meshes(tmp_path / "rig.usda")[0]
    assert rigged.path == "/Asset/mesh"
    # The assets differ by a stretch: weights, joints and the shape's reach are those of the source, nearly.
    source_weights = body.attributes["skel:jointWeights"]
    assert np.median(np.abs(rigged.attributes["skel:jointWeights"] - source_weights)) < 0.05
    own, given = (read_usd_skeleton(path, _part(path)) for path in (tmp_path / "rig.usda", source))
    assert own.names == given.names
    # Meshes of several prims are read in world space: the target's stands upright along z, in centimetres.
    expected = 100 * (given.heads * [1, 1.05, 1]) @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    size = 100 * np.ptp(body.control.positions, axis=0).max()
    assert np.abs(own.heads - expected).max() < 0.05 * size
    smile = read_usd_meshes(tmp_path / "shaped.usda")[0].attributes["blendShape:smile"]
    assert 0.05 < smile[:, 1].max() < 0.15  # in the prim's own space, as it was made
    run_wrap(WrapRequest((folder,), tmp_path / "wrapped.usda"), Stages())
    wrapped = read_usd_meshes(tmp_path / "wrapped.usda")[0].control
    assert wrapped.n_vertices == creature().n_vertices
    np.testing.assert_array_equal(wrapped.crease_sharpness, _body().crease_sharpness)
    assert np.abs(wrapped.positions - body.control.positions).mean() < 0.02 * size / 100
    for name in ("look.usda", "rig.usda", "shaped.usda", "wrapped.usda"):
        assert complaints(tmp_path / name) == [], name
    # The target's own file is as it was, and every layer still has both parts.
    assert len(read_usd_meshes(layer)) == 2


def test_a_uv_set_is_chosen_by_name(tmp_path: Path) -> None:
    from cagemap.tasks.match import read_inputs

    _write_asset(tmp_path / "asset.usda", 1.0)
    path = tmp_path / "asset.usda"
    request = MatchRequest(path, path, tmp_path / "R", part="mesh", target_uv_set="square")
    (part,) = read_inputs(request).parts
    assert (part.target.uv_name, part.source.uv_name) == ("square", "st")
    assert part.target.uvs.max() <= 1 < part.source.uvs.max()
    with pytest.raises(ValueError, match="expected a UV set named 'none'"):
        read_inputs(replace(request, target_uv_set="none"))
