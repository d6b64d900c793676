"""What is written to files, and read from them, is what it was when it was recorded."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature, cube, triangulated

from cagemap.character.values import Character
from cagemap.files.gltf.character import read_character
from cagemap.files.gltf.document import write_document
from cagemap.files.gltf.entries import Document, read_accessor
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.ownership import mark
from cagemap.mesh import CatmullClark, ControlMesh, Loop
from recorded import check

from example_result import textured_cube
from usd_characters import lively, painted, with_shape_track

SHAPES = ("SCALAR", "VEC2", "VEC3", "VEC4", "MAT4")


def moving() -> Character:
    return with_shape_track(lively(), "raise", np.array([[0.0, 0.5], [1.0, 0.25]]))


def document_values(document: Document) -> dict[str, Any]:
    """The entries of a document and the numbers of its accessors."""
    compressed = ("asset", "buffers", "bufferViews", "images")  # sizes of images depend on the library
    top = {name: value for name, value in document.json.items() if name not in compressed}
    return top | {"numbers": [read_accessor(document, k, "recorded", SHAPES) for k in range(len(top["accessors"]))]}


def detailed_cube(name: str) -> ControlMesh:
    """Creases, sharp corners, a hole, objects, vertex colours, a second UV set."""
    mesh = textured_cube(name)
    second = replace(mesh.all_uv_sets[0], name="second", uvs=1.0 - mesh.uvs)
    return replace(
        mesh,
        crease_edges=np.array([[0, 1], [1, 3]]),
        crease_sharpness=np.array([2.0, 0.5]),
        corner_vertices=np.array([7]),
        corner_sharpness=np.array([3.0]),
        hole_faces=np.array([5]),
        face_objects=np.array([0, 0, 0, 1, 1, 1]),
        object_names=("left", "right"),
        uv_name="st",
        uv_sets=(second,),
        scheme=CatmullClark(boundary="edge_only"),
    )


@pytest.mark.parametrize(("name", "made"), [("lively", moving), ("painted", lambda: painted()[0])])
def test_a_character_as_gltf(name: str, made: Callable[[], Character], tmp_path: Path) -> None:
    document = painted()[1] if name == "painted" else character_glb(made())
    check(f"gltf_{name}", document_values(document))
    write_document(tmp_path / "c.glb", document)
    check(f"gltf_{name}_again", read_character(tmp_path / "c.glb"))


@pytest.mark.parametrize("name", ["lively", "painted", "bare"])
def test_a_character_as_usd(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    from cagemap.files.usd.character import write_usd_character
    from cagemap.files.usd.convert import usd_document

    made, document = (moving(), character_glb(moving())) if name == "lively" else painted()
    if name == "bare":  # materials of defaults
        bare = [{"name": one["name"]} for one in document.json["materials"]]
        document = replace(document, json=document.json | {"materials": bare})
    notes = write_usd_character(tmp_path / "c.usda", made, read_scene(document))
    text = (tmp_path / "c.usda").read_text(encoding="utf-8").replace(mark(), "")
    check(f"usd_{name}", [*notes, *[line for line in text.splitlines() if "checksum" not in line]])
    check(f"usd_{name}_again", document_values(usd_document(tmp_path / "c.usda")))


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".off", ".glb", ".usda"])
def test_meshes_of_every_format(suffix: str, tmp_path: Path) -> None:
    if suffix == ".usda":
        pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    colored = replace(triangulated(creature()), scheme=Loop())
    colored = replace(colored, vertex_colors=np.clip(colored.positions - colored.positions.min(axis=0), 0.0, 1.0))
    found = []
    for number, mesh in enumerate((detailed_cube("a"), colored, cube())):
        file = tmp_path / f"m{number}{suffix}"
        write_mesh(file, mesh)
        content = b"" if suffix == ".glb" else file.read_bytes()
        lines = [line for line in content.decode("utf-8", "replace").splitlines() if "checksum" not in line]
        found += [lines if number == 0 and suffix != ".ply" else len(lines), replace(read_mesh(file), name="")]
    check(f"mesh{suffix}", found)
