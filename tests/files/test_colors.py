"""Vertex colours as files hold them become shares of full light."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.entries import read_accessor
from cagemap.files.meshes.colors import as_shares
from cagemap.files.meshes.formats import read_mesh, write_mesh


@pytest.mark.parametrize(
    ("largest", "full"),
    [
        (1.0, 1.0),
        (2.0, 255.0),  # whole numbers beyond 1
        (1.5, 1.0),  # light brighter than white
        (15.9, 1.0),
        (16.1, 255.0),  # means of bytes
    ],
)
def test_numbers_far_beyond_1_or_whole_are_bytes(largest: float, full: float) -> None:
    colors = np.array([[0.0, 1.0, largest], [np.nan, np.nan, np.nan]])
    np.testing.assert_allclose(as_shares(colors), colors / full)


def test_the_file_says_what_is_full() -> None:
    np.testing.assert_allclose(as_shares(np.array([[0.0, 512.0, 1023.0]]), 1023.0), [[0.0, 512 / 1023, 1.0]])


def test_colours_of_gltf_and_usd_are_linear(tmp_path: Path) -> None:
    colors = np.random.default_rng(3).random((8, 3))
    colors[0] = [0.0, 0.5, 1.0]
    mesh = replace(cube(), vertex_colors=colors)
    write_mesh(tmp_path / "cube.glb", mesh)
    document = read_document(tmp_path / "cube.glb")
    (primitive,) = document.entry("meshes", 0)["primitives"]
    stored = read_accessor(document, primitive["attributes"]["COLOR_0"], "COLOR_0", ("VEC3",))
    np.testing.assert_allclose(stored[0], [0.0, 0.21404, 1.0], atol=1e-5)
    np.testing.assert_allclose(read_mesh(tmp_path / "cube.glb").vertex_colors, colors, atol=1e-6)
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    write_mesh(tmp_path / "cube.usda", mesh)
    stage = usd.Stage.Open(str(tmp_path / "cube.usda"))
    prim = stage.GetPrimAtPath("/Asset/mesh")
    np.testing.assert_allclose(prim.GetAttribute("primvars:displayColor").Get()[0], [0.0, 0.21404, 1.0], atol=1e-5)
    np.testing.assert_allclose(read_mesh(tmp_path / "cube.usda").vertex_colors, colors, atol=1e-6)
