"""What `check` says of the numbers of vertices in a file."""

from __future__ import annotations

from pathlib import Path

import pytest

from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.read import contents_of

from gltf_scenes import Maker


@pytest.mark.parametrize(("name", "said"), [("made.glb", True), ("made.fbx", False), ("made.usda", False)])
def test_vertices_that_only_gltf_splits_are_said(name: str, said: bool) -> None:
    """FBX and USD files have own indices of normals and UVs: their vertices are those that programs show."""
    made = Maker()
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    attributes = {"POSITION": made.add(corners), "NORMAL": made.add([(0, 0, 1)] * 3 + [(0, 1, 0)] * 3)}
    meshes = [{"primitives": [{"attributes": attributes}]}]
    scene = read_scene(made.document(Path(name), nodes=[{"mesh": 0}], meshes=meshes))
    text = str(contents_of(scene))
    assert ("4, made of 6 in the file: copies along seams are welded, so that later" in text) == said
    assert ("made of" in text) == said
