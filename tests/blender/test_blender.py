"""The extension for Blender: its zip file, its computing process, and all its buttons where `bpy` is installed."""

from __future__ import annotations

import importlib
import json
import os
import platform
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube

import cagemap
from cagemap.files.images.image import write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import write_mesh
from cagemap.mesh import ControlMesh

from curved_bar import bar
from example_once import example_pair
from locations import FIXTURES, ROOT
from mesh_faults import flip

EXTENSION = ROOT / "blender" / "cagemap_blender"
BUILD = ROOT / "blender" / "build.py"
CHECKS = Path(__file__).parent / "scene_checks.py"


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module that starts the computing process; it needs no Blender."""
    package = ModuleType("cagemap_blender")
    package.__path__ = [str(EXTENSION)]
    monkeypatch.setitem(sys.modules, "cagemap_blender", package)
    monkeypatch.delitem(sys.modules, "cagemap_blender.client", raising=False)
    return importlib.import_module("cagemap_blender.client")


def test_uvs_without_values_stay(client: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "bpy", ModuleType("bpy"))
    monkeypatch.setitem(sys.modules, "mathutils", ModuleType("mathutils"))
    writing = importlib.import_module("cagemap_blender.writing")
    stored = np.array([[0.25, 0.5], [0.75, 1.0]], dtype=np.float32)
    layer = SimpleNamespace(
        uv=SimpleNamespace(foreach_get=lambda _, values: np.copyto(values, stored.ravel())),
        data=SimpleNamespace(foreach_set=lambda _, values: np.copyto(stored, values.reshape(2, 2))),
    )
    monkeypatch.setattr(writing, "claim", lambda *_: None)
    layers = {"map": layer}
    writing.set_uvs(SimpleNamespace(data=SimpleNamespace(uv_layers=layers)), {"map": np.array([[np.nan] * 2, [0, 0]])})
    np.testing.assert_array_equal(stored, [[0.25, 0.5], [0.0, 0.0]])


@pytest.fixture
def worker(client: ModuleType) -> Iterator[Any]:
    made = client.Worker()
    yield made
    made.stop()


def answer(worker: Any, name: str, **arguments: Any) -> tuple[str, Any]:
    worker.send(name, arguments)
    while (message := worker.receive(timeout=300.0))[0] == "stage":
        assert worker.busy
    assert not worker.busy
    return message


def arrays(mesh: ControlMesh, scheme: str = "catmull-clark") -> dict[str, Any]:
    """A mesh as the extension sends it."""
    none = np.zeros((0, 2), dtype=np.int64), np.zeros(0)
    return {
        "name": mesh.name,
        "positions": mesh.positions,
        "sizes": mesh.face_sizes,
        "corners": mesh.face_indices,
        "loops": np.arange(len(mesh.face_indices)),
        "scheme": scheme,
        "options": {},
        "creases": none,
        "sharp_corners": none,
    }


def two_pieces(mesh: ControlMesh) -> ControlMesh:
    """A mesh with a small copy of itself beside it."""
    eye = 0.05 * mesh.positions + mesh.positions.max(axis=0)
    return ControlMesh(
        np.concatenate([mesh.positions, eye]),
        np.concatenate([mesh.face_offsets, mesh.face_offsets[-1] + mesh.face_offsets[1:]]),
        np.concatenate([mesh.face_indices, mesh.n_vertices + mesh.face_indices]),
        name=mesh.name,
    )


def squares(mesh: ControlMesh) -> tuple[np.ndarray, np.ndarray]:
    """UVs (c, 2) with every face in a place of its own, and the middles of the places."""
    side = int(np.ceil(np.sqrt(mesh.n_faces)))
    faces = np.arange(mesh.n_faces)
    middles = (np.column_stack([faces % side, faces // side]) + 0.5) / side
    turn = 2 * np.pi * (np.arange(len(mesh.face_indices)) - mesh.face_offsets[mesh.corner_faces])
    turn /= mesh.face_sizes[mesh.corner_faces]
    return middles[mesh.corner_faces] + 0.45 / side * np.column_stack([np.cos(turn), np.sin(turn)]), middles


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["catmull-clark", "none"])
def test_under_the_identity_values_of_all_pieces_come_back(worker: Any, scheme: str) -> None:
    mesh = two_pieces(example_pair(64).target)
    moved = mesh.with_positions(mesh.positions + np.array([3.0, -1.0, 2.0]))
    points = {name: {"nose": (one.positions[5]).tolist()} for name, one in (("target", moved), ("source", mesh))}
    kind, found = answer(
        worker,
        "match",
        target=arrays(moved, scheme),
        source=arrays(mesh, scheme),
        target_points=points["target"],
        source_points=points["source"],
        vertices=2000,
    )
    assert kind == "done", found
    numbers = np.random.default_rng(3)
    n, c, m = mesh.n_vertices, len(mesh.face_indices), mesh.n_faces
    weights, offsets = numbers.random((n, 3)), numbers.random((n, 3))
    vertices, corners = {"a": numbers.random(n), "b": numbers.random((n, 4))}, {"uv": numbers.random((c, 2))}
    _, values = answer(worker, "values", vertices=vertices, corners=corners)
    for name, array in (vertices | corners).items():
        np.testing.assert_allclose((values["vertices"] | values["corners"])[name], array, atol=1e-9)
    # Sums of weights are kept, whatever they are: Blender does not ask that they are 1.
    np.testing.assert_allclose(answer(worker, "weights", weights=weights)[1]["weights"], weights, atol=1e-9)
    np.testing.assert_allclose(answer(worker, "shapes", shapes={"s": offsets})[1]["shapes"]["s"], offsets, atol=1e-6)
    materials = numbers.integers(0, 3, m)
    np.testing.assert_array_equal(answer(worker, "materials", materials=materials)[1]["materials"], materials)
    uvs, middles = squares(mesh)
    pixels = numbers.integers(0, 255, (256, 256, 3)).astype(np.uint8)
    image = {"name": "i", "pixels": pixels, "size": (256, 256), "uvs": uvs, "normals": False}
    baked = answer(worker, "bake", images=[image], target_uvs=uvs)[1]["images"]["i"][0]
    column, row = (256 * middles).astype(int).T
    np.testing.assert_array_equal(baked[255 - row, column], pixels[255 - row, column])
    # In tiles: the source's image on 1001 and 1002, the target's layout half on each.
    shift = np.zeros_like(uvs)
    shift[np.isin(mesh.corner_faces, np.flatnonzero(np.arange(m) % 2)), 0] = 1.0
    tiled = image | {"pixels": {1001: pixels, 1002: pixels[::-1].copy()}, "uvs": uvs + shift}
    tiles = answer(worker, "bake", images=[tiled], target_uvs=uvs + shift)[1]["images"]["i"]
    for tile, own in ((1001, slice(0, None, 2)), (1002, slice(1, None, 2))):
        given = tiled["pixels"][tile][255 - row, column][own]
        np.testing.assert_array_equal(tiles[tile][255 - row, column][own], given)


@pytest.mark.slow
def test_what_is_wrong_is_said_and_the_process_goes_on(worker: Any) -> None:
    assert answer(worker, "wrap") == ("refused", "The two objects are not matched yet. Press Match.")
    mesh = arrays(ControlMesh.from_faces(np.eye(3), [[0, 1, 2]], name="corner"))
    asked = {"target_points": {}, "source_points": {}, "vertices": 2000}
    broken = mesh | {"positions": np.full((3, 3), np.nan)}
    kind, said = answer(worker, "match", target=broken, source=mesh, **asked)
    assert kind == "refused"
    assert said.startswith("corner")
    kind, said = answer(worker, "match", target=arrays(flip(cube(), 1)), source=mesh, **asked)
    assert kind == "refused"
    assert "Or use the object without its Subdivision modifier" in said
    kind, said = answer(worker, "match", target={}, source=mesh, **asked)
    assert kind == "refused"
    assert "fault of cagemap" in said
    assert answer(worker, "wrap")[0] == "refused"  # the same process answers


@pytest.mark.slow
def test_landmarks_on_pieces_that_are_not_matched_are_reported(worker: Any) -> None:
    body = example_pair(64).target
    mesh = two_pieces(body)
    points = {"nose": mesh.positions[5].tolist(), "eye": mesh.positions[body.n_vertices + 5].tolist()}
    asked = {"target_points": points, "source_points": points}
    note = "1 of 2 landmarks lie on pieces that are set aside and are left out"
    _, reply = answer(worker, "match", target=arrays(mesh), source=arrays(mesh), vertices=2000, **asked)
    assert note in reply["sentences"]
    _, reply = answer(worker, "update", **asked)
    assert note in reply["sentences"]
    _, reply = answer(worker, "update", target_points={"nose": points["nose"]}, source_points=points)
    assert note not in reply["sentences"]


@pytest.mark.slow
def test_clothes_that_are_far_from_the_source_are_reported(worker: Any) -> None:
    body = example_pair(64).target
    size, mesh = np.ptp(body.positions, axis=0), arrays(body)
    answer(worker, "match", target=mesh, source=mesh, target_points={}, source_points={}, vertices=2000)
    shirt = mesh | {"name": "shirt", "positions": body.positions + 0.01 * size}
    hat = mesh | {"name": "hat", "positions": body.positions + 5.0 * size}
    _, reply = answer(worker, "clothes", meshes=[shirt, hat], shapes=[{}, {}])
    (note,) = reply["notes"]
    assert note.startswith("hat is ")
    assert "check its place and size" in note
    large = mesh | {"name": "coat", "positions": 100.0 * body.positions}
    (note,) = answer(worker, "clothes", meshes=[large], shapes=[{}])[1]["notes"]
    assert "(0.01 times as large it would lie on it)" in note


@pytest.mark.slow
def test_a_rig_knows_whether_the_target_stands_in_another_pose(worker: Any) -> None:
    straight = bar()
    bent = straight.positions.copy()
    upper = bent[:, 2] > 3.0
    turn, joint = np.array([[1.0, 0.0, 0.0], [0.0, 0.28, 0.96], [0.0, -0.96, 0.28]]), [0.5, 0.5, 3.0]
    bent[upper] = (bent[upper] - joint) @ turn + joint
    bones = {"hips": (0.5, 0.5), "spine": (0.5, 1.5), "neck": (0.5, 3.2), "head": (0.5, 5.5)}
    bones |= {"thigh.L": (0.8, 0.4), "thigh.R": (0.2, 0.4)}
    matrices = np.tile(np.eye(4), (len(bones), 1, 1))
    matrices[:, :3, 3] = [(across, 0.5, height) for across, height in bones.values()]
    for positions, is_posed in ((straight.positions, False), (bent, True)):
        target = straight.with_positions(positions)
        points = [{f"p{row}": place for row, place in enumerate(one.positions.tolist())} for one in (target, straight)]
        asked = {"target_points": points[0], "source_points": points[1], "vertices": 2000}
        kind, reply = answer(worker, "match", target=arrays(target), source=arrays(straight), **asked)
        assert kind == "done", reply
        tails = matrices[:, :3, 3] + [0.0, 0.0, 0.5]
        rig = {"names": list(bones), "parents": np.array([-1, 0, 1, 2, 0, 0]), "matrices": matrices, "tails": tails}
        assert answer(worker, "rig", **rig)[1]["is_posed"] == is_posed


@pytest.mark.slow
def test_a_crash_is_an_error_message(worker: Any) -> None:
    mesh = arrays(example_pair(64).target)
    worker.send("match", {"target": mesh, "source": mesh, "target_points": {}, "source_points": {}, "vertices": 2000})
    assert worker.receive(timeout=300.0) == ("stage", "prepare")
    worker._process.kill()
    while (message := worker.receive(timeout=300.0))[0] == "stage":
        pass
    assert message[0] == "refused"
    assert "ended" in message[1]
    assert not worker.has_match
    assert answer(worker, "wrap")[1] == "The two objects are not matched yet. Press Match."  # by another process


@pytest.mark.slow
def test_the_computing_process_imports_only_what_is_packed() -> None:
    build = {}
    exec(BUILD.read_text(encoding="utf-8").partition("def requirements")[0], build | {"__file__": str(BUILD)}, build)
    packed = {name.replace("-", "_") for name in build["NEEDED"]} | {"numpy", "llvmlite", "cagemap"}
    script = f"import runpy, sys; runpy.run_path({str(EXTENSION / 'worker.py')!r}); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    found = {name.partition(".")[0] for name in done.stdout.split()} - set(sys.stdlib_module_names)
    ours = {
        name for name in found if name in {"OpenImageIO", "pydantic", "typer", "embreex", "xatlas", "filelock", "rich"}
    }
    assert not ours
    assert packed <= found | {"fast_simplification", "rslab"}


def test_the_manifest_is_one_that_blender_takes() -> None:
    manifest = tomllib.loads((EXTENSION / "blender_manifest.toml").read_text(encoding="utf-8"))
    for words in (manifest["tagline"], *manifest["permissions"].values()):
        assert len(words) <= 64
        assert words[-1].isalnum()
    assert manifest["version"] == cagemap.__version__


@pytest.fixture(scope="session")
def extension(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The zip file for this platform and the Python that has `bpy`."""
    system = {"Linux": "linux", "Darwin": "macos", "Windows": "windows"}[platform.system()]
    name = f"{system}-{'arm64' if platform.machine() in ('arm64', 'aarch64') else 'x64'}"
    folder = tmp_path_factory.mktemp("extension")
    said = subprocess.run([os.environ["CAGEMAP_BPY"], "--version"], check=True, capture_output=True, text=True).stdout
    python = ".".join(said.split()[1].split(".")[:2])
    words = [name, "-o", str(folder), "--python", python]
    subprocess.run([sys.executable, str(BUILD), *words], check=True, capture_output=True)
    (made,) = folder.glob("*.zip")
    return made


def require_blender() -> None:
    if not os.environ.get("CAGEMAP_BPY"):
        pytest.skip("CAGEMAP_BPY names no interpreter that has bpy: run `make test-blender`")


def run_in_blender(script: Path, extension: Path, folder: Path) -> None:
    fresh = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [os.environ["CAGEMAP_BPY"], str(script), str(extension), str(folder)],
        env=fresh | {"BLENDER_USER_RESOURCES": str(folder / "profile")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="session")
def checks(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Tracebacks of all checks by name, "" where a check holds."""
    require_blender()
    folder = tmp_path_factory.mktemp("checks")
    run_in_blender(CHECKS, request.getfixturevalue("extension"), folder)
    return json.loads((folder / "checks.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        name
        for file in sorted(CHECKS.parent.glob("*_checks.py"))
        for name in re.findall(r"^@check\ndef (\w+)", file.read_text(encoding="utf-8"), re.MULTILINE)
    ],
)
def test_check_in_blender(checks: dict[str, str], name: str) -> None:
    assert not checks[name], checks[name]


@pytest.mark.slow
def test_all_buttons_in_blender(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    require_blender()
    extension: Path = request.getfixturevalue("extension")
    with zipfile.ZipFile(extension) as packed:
        listed = tomllib.loads(packed.read("blender_manifest.toml").decode())["wheels"]
        assert {name.removeprefix("./") for name in listed} == {n for n in packed.namelist() if n.endswith(".whl")}
    pair = example_pair(64)
    write_mesh(tmp_path / "deer.obj", pair.target)
    write_mesh(tmp_path / "pony.obj", pair.source)
    write_landmarks(tmp_path / "landmarks.json", pair.landmarks)
    write_image(tmp_path / "pony.png", pair.texture)
    run_in_blender(FIXTURES / "blender_scene.py", extension, tmp_path)
    said = json.loads((tmp_path / "said.json").read_text())
    assert max(said["texels that differ"]) < 0.01  # faces smaller than a texel
    for name, apart in said.items():
        if name.startswith("identity"):
            assert max(apart.values()) <= 1e-6, (name, apart)
    for name in ("walk subdivided", "walk plain"):
        walk = said[name]
        for case, words in (
            ("nothing", "Choose a mesh as source"),
            ("follow too early", "not matched as they are now"),
            ("mirror", "Mirror"),
            ("edit", "deer is in Edit Mode"),
            ("rigged again", "deer is rigged already, by skeleton on deer"),
            ("taken", "vertex groups of its own called own"),
        ):
            assert words in walk[case], (case, walk[case])
        assert walk["still matched"]
        assert walk["groups"] == ["high", "root", "tip"]
        assert walk["wider"] == pytest.approx(1.2, abs=0.1)
        assert walk["materials"][-2:] == ["coat on deer", "hoof on deer"]
        assert walk["materials again"] == walk["materials"]  # those of the earlier run are replaced
        assert walk["images"] == ["tiled.1001.png on deer"]
        assert walk["image"][:3] == [64, 64, True]
        assert walk["image"][3] > 0.01  # not of one colour
        assert walk["tiles"] == ["TILED", [1001, 1002], 2, 64, 64]
        *apart, size = walk["wrapped"]
        assert np.abs(apart).max() < 0.1 * size  # on the source, where that stands
        assert sorted(parent for parent, _ in walk["landmarks"]) == ["deer", "pony"]
        assert walk["at cursor"] < 0.05 * size
        most, mean = walk["followed"]
        assert most > 0.01 > mean  # around the landmark alone
        assert walk["live"] > 0.01
        assert walk["rig"] == ["skeleton on deer", ["root", "tip"], True]
        assert walk["bone inside"]
        assert walk["connected"]
        assert walk["coat"][0] == "skeleton on deer"
        assert walk["coat"][1] < 0.05
