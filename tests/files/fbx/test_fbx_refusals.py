"""FBX files that are refused or repaired, and a library that stops."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from cagemap.errors import FormatError
from cagemap.files.fbx import read as fbx_read
from cagemap.files.gltf.character import read_character
from cagemap.files.meshes.formats import read_mesh

from fbx_scenes import TO_FBX, Fbx, add_layer, fbx_arm, fbx_file, layer, properties
from refusals import refuses

pytest.importorskip("ufbx")
pytestmark = pytest.mark.usefixtures("fbx_server")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty file"),
        (b"no FBX at all" * 9, r"cannot be read as FBX \(Not an FBX file\). Export it again as binary FBX 7\.4"),
        (fbx_arm().bytes()[:-100], "Truncated file"),
        (b"; FBX 6.1.0 project file\nObjects: {{{\n", "Failed to load.*Export it again as binary FBX"),
        (Fbx().bytes(), "expected triangles"),
    ],
)
def test_what_is_no_fbx_is_refused_by_name(content: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "broken.fbx"
    path.write_bytes(content)
    refuses(FormatError, rf"broken\.fbx.*{message}", read_mesh, path)


def test_weights_of_vertices_that_are_not_there_are_refused_by_name(tmp_path: Path) -> None:
    made = fbx_arm()
    cluster = made.named("Deformer", "Cluster")
    next(one for one in cluster.inside if one.name == "Indexes").properties[0][0] = 29445
    refuses(FormatError, "strip: a skin or shape of 6 vertices lists 29445", read_mesh, fbx_file(tmp_path, made))


@pytest.mark.parametrize(
    ("kind", "entry", "said"),
    [
        ("Mesh", "Vertices", "mesh strip: positions"),
        ("Mesh", "UV", "mesh strip: UVs map"),
        ("Mesh", "Colors", "mesh strip: colors"),
        ("Shape", "Vertices", "mesh strip: shape raise"),
        ("Cluster", "Weights", "mesh strip: skinning weights"),
        ("Cluster", "Transform", "mesh strip: bind pose of the skin"),
        ("AnimationCurve", "KeyValueFloat", "animation bend: keys"),
        ("LimbNode", "Lcl_Translation", "node lower: transform"),
        ("Material", "EmissiveColor", "material skin"),
    ],
)
def test_numbers_that_are_not_finite_are_refused_by_name(kind: str, entry: str, said: str, tmp_path: Path) -> None:
    made = fbx_arm()
    add_layer(made, layer("Color", "", "ByPolygonVertex", Colors=np.ones(32)))
    changed = next(one for one in reversed(made.objects) if kind in (one.name, one.properties[2]))
    if kind in ("LimbNode", "Material"):
        changed.inside[0].inside += properties(**{entry: (np.nan, 0.0, 0.0)}).inside
    else:
        inside = [inner for one in changed.inside for inner in (one, *one.inside)]
        next(one for one in inside if one.name == entry).properties[0][0] = np.nan
    refuses(FormatError, rf"arm\.fbx: .*\({said} .* not finite\)", read_mesh, fbx_file(tmp_path, made))


def test_normals_that_are_not_finite_are_computed_from_the_faces(tmp_path, caplog):
    """Some exporters write such normals where a face has no area."""
    made = fbx_arm()
    normals = np.tile(np.array([0.6, 0.0, 0.8]) @ TO_FBX / 100.0, (8, 1))
    normals[7] = np.nan
    add_layer(made, layer("Normal", "", "ByPolygonVertex", Normals=normals.ravel()))
    (part,) = read_character(fbx_file(tmp_path, made)).parts
    np.testing.assert_allclose(part.normals, [[0.6, 0.0, 0.8]] * 7 + [[0.0, 0.0, 1.0]], atol=1e-6)
    assert "strip: 1 normals are not finite and are computed from the faces" in caplog.text


@pytest.mark.parametrize("child", ["import os; os.abort()", "raise RuntimeError"])
def test_a_crash_of_the_library_is_an_error_message(child, tmp_path, monkeypatch):
    monkeypatch.setattr(fbx_read, "_CHILD", child)
    with pytest.raises(FormatError, match=r"arm\.fbx: the FBX library stopped.*Export it again"):
        read_mesh(fbx_file(tmp_path, fbx_arm()))


def test_a_file_that_takes_too_long_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fbx_read, "_CHILD", "import time; time.sleep(60)")
    monkeypatch.setattr(fbx_read, "_SECONDS", 0.5)
    refuses(FormatError, "given up", read_mesh, fbx_file(tmp_path, fbx_arm()))


def test_without_its_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fbx_read.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(FormatError, match=r"needs the package ufbx. Install cagemap\[fbx\], or export"):
        read_mesh(fbx_file(tmp_path, fbx_arm()))


@pytest.mark.slow
def test_a_new_process_answers_as_the_server_and_runs_no_modules_of_the_working_folder(tmp_path, monkeypatch, caplog):
    """A folder of downloads may hold anything."""
    monkeypatch.setattr(fbx_read, "subprocess", subprocess)
    (tmp_path / "ufbx.py").write_text("raise SystemExit(9)")
    monkeypatch.chdir(tmp_path)
    made = fbx_arm()
    made.add("NodeAttribute", "lamp", "Light", to=made.add("Model", "lamp", "Light"))
    assert read_mesh(fbx_file(tmp_path, made)).n_faces == 2
    assert "left out: 1 light" in caplog.text
    (tmp_path / "arm.fbx").write_bytes(made.bytes()[:900])
    refuses(FormatError, "cannot be read as FBX", read_mesh, tmp_path / "arm.fbx")
