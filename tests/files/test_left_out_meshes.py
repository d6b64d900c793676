"""Meshes of a file that programs do not show are left out, with a warning that names them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.files.gltf.character import character_of
from cagemap.files.usd.read import read_usd_meshes
from cagemap.files.usd.write import write_usd

from gltf_scenes import Maker


@pytest.mark.parametrize("displayed", [None, 1])
def test_meshes_of_other_gltf_scenes(displayed: int | None, caplog: pytest.LogCaptureFixture) -> None:
    made = Maker()
    attributes = {"POSITION": made.add(np.eye(3))}
    document = made.document(
        scenes=[{"nodes": [0]}, {"nodes": [1]}],
        nodes=[{"name": "shirt", "mesh": 0}, {"name": "body", "mesh": 0}],
        meshes=[{"primitives": [{"attributes": attributes}]}],
        **({} if displayed is None else {"scene": displayed}),
    )
    (part,) = character_of(document).parts
    shown, other = ("body", "shirt") if displayed else ("shirt", "body")
    assert part.name == shown
    assert f"made.glb: left out meshes that its scene {displayed or 0} does not show: {other};" in caplog.text


def test_prototypes_of_a_usd_instancer(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    from pxr import Usd, UsdGeom

    path = tmp_path / "meadow.usda"
    write_usd(path, cube())
    stage = Usd.Stage.Open(str(path))
    UsdGeom.PointInstancer.Define(stage, "/Asset/grass")
    blade = UsdGeom.Mesh.Define(stage, "/Asset/grass/blade")
    ground = UsdGeom.Mesh(next(prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)))
    for name in ("points", "faceVertexCounts", "faceVertexIndices"):
        blade.GetPrim().GetAttribute(name).Set(ground.GetPrim().GetAttribute(name).Get())
    stage.GetRootLayer().Save()
    del stage, blade, ground
    (mesh,) = read_usd_meshes(path)
    assert mesh.path != "/Asset/grass/blade"
    assert "/Asset/grass/blade" in caplog.text
