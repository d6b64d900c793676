"""The add-on for Blender: what it writes, and all its buttons where an interpreter with `bpy` is named."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cagemap.example import example_pair
from cagemap.files.images.image import write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.mesh import CatmullClark
from cagemap.subdivision import refine

from locations import FIXTURES, ROOT

ADDONS = ROOT / "examples" / "blender"


@pytest.fixture
def outgoing(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module that writes models, with empty stand-ins for Blender's own."""
    monkeypatch.syspath_prepend(str(ADDONS))
    for name in ("bpy", "mathutils"):
        monkeypatch.setitem(sys.modules, name, SimpleNamespace(Matrix=np.array))
    package = ModuleType("cagemap_blender")
    package.__path__ = [str(ADDONS / "cagemap_blender")]
    monkeypatch.setitem(sys.modules, "cagemap_blender", package)
    for name in ("outgoing", "incoming", "errors"):
        monkeypatch.delitem(sys.modules, f"cagemap_blender.{name}", raising=False)
    return importlib.import_module("cagemap_blender.outgoing")


def test_the_written_model_is_the_cage_with_its_seams_and_creases(outgoing: ModuleType, tmp_path: Path) -> None:
    mesh = example_pair(64).source
    faces = [mesh.face(i).tolist() for i in range(mesh.n_faces)]
    edges = np.array([[0, 1], faces[3][:2], faces[9][:2]])
    tags = [
        "t scheme 0/0/1 catmull-clark",
        "t interpolateboundary 1/0/0 2",
        *outgoing.crease_tags(edges, np.array([0.0, 0.5, 1.0]), np.zeros(mesh.n_vertices)),
    ]
    uvs = mesh.uvs[mesh.uv_indices]
    (tmp_path / "cage.obj").write_text(outgoing.mesh_text(mesh.positions, faces, uvs, None, tags))
    read = read_mesh(tmp_path / "cage.obj")
    np.testing.assert_allclose(read.positions, mesh.positions, atol=1e-7)
    np.testing.assert_array_equal(read.face_indices, mesh.face_indices)
    np.testing.assert_allclose(read.uvs[read.uv_indices], uvs, atol=1e-7)
    assert read.scheme == CatmullClark("edge_only")
    assert sorted(read.crease_sharpness) == [2.5, 10.0]  # 10 c^2


def test_names_of_landmarks_are_without_the_numbers_that_blender_adds(outgoing: ModuleType) -> None:
    assert [outgoing.plain_name(name) for name in ("nose", "nose.001", "toe.2", "a.b.012")] == [
        "nose",
        "nose",
        "toe.2",
        "a.b",
    ]


def test_every_pair_has_a_folder_of_its_own(outgoing: ModuleType) -> None:
    kept = ["pony", "Pony.001", "馬", "Hÿena"]
    assert [outgoing.file_name(name) for name in kept] == kept
    changed = ["a b", "a/b", "a\\b", "..", ".a", "🐎", "🐖"]
    names = [outgoing.file_name(name) for name in changed]
    assert len({*names, "a_b"}) == len(changed) + 1
    assert not any(set(name) & set("/\\ ") or name.startswith(".") for name in names)


def test_the_manifest_is_one_that_blender_takes() -> None:
    manifest = tomllib.loads((ADDONS / "cagemap_blender" / "blender_manifest.toml").read_text())
    for words in (manifest["tagline"], *manifest["permissions"].values()):
        assert len(words) <= 64
        assert words[-1].isalnum()
    oldest = tuple(map(int, manifest["blender_version_min"].split(".")))
    assert f'"blender": {oldest}' in (ADDONS / "cagemap_blender" / "__init__.py").read_text()


def test_long_names_are_cut_as_blender_cuts_them(outgoing: ModuleType) -> None:
    assert outgoing.short_name("wrapped pony") == "wrapped pony"
    assert outgoing.short_name("é" * 40) == "é" * 31  # 63 bytes


def test_a_hidden_modifier_does_not_subdivide(outgoing: ModuleType) -> None:
    def stack(*shown: bool) -> SimpleNamespace:
        kinds = zip(("SUBSURF", "MIRROR", "MULTIRES"), shown, strict=True)
        return SimpleNamespace(modifiers=[SimpleNamespace(type=kind, show_viewport=on) for kind, on in kinds])

    assert outgoing.cage_modifier(stack(False, True, False)) is None
    assert outgoing.modifier_tags(stack(False, True, False)) == ["t scheme 0/0/1 none"]
    assert outgoing.cage_modifier(stack(False, True, True)).type == "MULTIRES"


def test_tiles_that_were_written_are_found(outgoing: ModuleType, tmp_path: Path) -> None:
    incoming = importlib.import_module("cagemap_blender.incoming")
    for name in ("a+b.1001.png", "a+b.1012.png", "aab.1002.png", "a+b.10010.png", "a+b.1003.exr"):
        (tmp_path / name).touch()
    assert incoming.tile_numbers(tmp_path / "a+b.<UDIM>.png") == {1001, 1012}


@pytest.mark.slow
def test_all_buttons_in_blender(tmp_path: Path) -> None:
    blender = os.environ.get("CAGEMAP_BPY")
    if not blender:
        pytest.skip("CAGEMAP_BPY names no interpreter that has bpy (python3.11 -m venv V; V/bin/pip install bpy)")
    pair = example_pair(64)
    write_mesh(tmp_path / "deer.obj", pair.target)
    write_mesh(tmp_path / "pony.obj", pair.source)
    write_landmarks(tmp_path / "landmarks.json", pair.landmarks)
    write_image(tmp_path / "pony.png", pair.texture)
    command = shutil.which("cagemap")
    assert command is not None
    script = FIXTURES / "blender_scene.py"
    done = subprocess.run(
        [blender, str(script), str(ADDONS), str(tmp_path), command], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    said = json.loads(done.stdout.splitlines()[-1])
    for case, words in (
        ("unsaved", "Choose a mesh as target"),
        ("too early", "not matched yet"),
        ("mirror", "Mirror"),
        ("edit", "deer: is in Edit Mode"),
        ("changed", "it was changed"),
        ("taken", "shape keys of its own called mine"),
    ):
        assert words in said[case], said[case]
    *apart, size = said["wrapped"]
    assert np.abs(apart).max() < 0.1 * size  # on the source, where that stands
    assert said["wider"] == pytest.approx(1.2, abs=0.1)
    assert {"kept", "high"} == set(said["groups"])
    assert said["keys"][:2] == [["wide", 0.0], ["wrapped pony", 1.0]]
    assert said["tiles"] == [1001, 1003]
    assert said["materials"][-2:] == ["cagemap deer_pony", "cagemap tiled"]
    folder = tmp_path / "cagemap" / "pony__deer"
    result = json.loads((folder / "RESULT" / "manifest.json").read_text())
    assert len(json.loads((folder / "target_points.json").read_text())["points"]) == len(pair.landmarks.target)
    assert result["quality"]["landmark_error_mean"] < 0.01
    # What is matched is what Blender shows, creases included.
    refined = refine(read_mesh(folder / "source.obj"), 2, CatmullClark("edge_only"))
    shown = np.load(tmp_path / "refined.npy")
    assert len(shown) == refined.finest.n_vertices
    assert cKDTree(shown).query(refined.finest.positions)[0].max() < 1e-5 * np.ptp(shown)
