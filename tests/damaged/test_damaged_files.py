"""Damaged files of every kind end in a named error or are read: never in another exception, a crash or a warning."""

import json
import re
import shutil
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples import shapes
from examples.shapes import icosahedron
from scipy.io import mmwrite

from cagemap.character.joints import Skeleton
from cagemap.errors import CagemapError, FormatError
from cagemap.files.atomic import atomic_path
from cagemap.files.images.image import read_image, read_image_form, write_image
from cagemap.files.landmarks.pairs import read_landmarks, write_landmarks
from cagemap.files.landmarks.points import read_points, read_symmetry
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.meshes.ply import write_ply
from cagemap.files.ownership import mark
from cagemap.files.result.folder import ARRAYS, read_result, write_result
from cagemap.files.result.manifest import MANIFEST
from cagemap.files.result.maps import read_images, write_map
from cagemap.files.result.surface_store import load_or_prepare, load_surface, save_surface
from cagemap.files.values.attributes import read_attributes, write_attributes
from cagemap.files.values.rigs import read_shapes, read_skeleton, write_shapes, write_skeleton
from cagemap.jobs.consistency import Consistency, read_consistency, write_consistency
from cagemap.jobs.job import read_job
from cagemap.jobs.plan import Task
from cagemap.jobs.run import kept_outcome
from cagemap.maps.functional_maps import LevelMap
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import on_cage
from cagemap.mesh.checks import check_mesh
from cagemap.mesh.parts import extract_faces, list_parts
from cagemap.pipeline import prepare_surface
from cagemap.report import build_page
from cagemap.report.figures import Gallery
from cagemap.spectral import BasisConfig
from cagemap.studio.autosave import read_autosave, read_autosave_parts, write_autosave
from cagemap.studio.landmarks import Landmark, LandmarkList, Place
from cagemap.studio.opening import result_files
from cagemap.subdivision import refine
from cagemap.tasks.masks import read_mask
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.catalogue import COMMANDS, WRITTEN
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.run_job import cycle_notes
from cagemap.tasks.transfer import run_transfer

from damage import mutated_arrays, mutated_bytes, mutated_entries, outcome, refused_share
from example_once import example_pair
from example_result import change_result, identity_result, rewrite_arrays, textured_cube
from ply_text import write_text_ply
from refusals import refuses
from usd_scenes import full_cube

TASK = Task("match", "a", "k", (), {}, ())
MATCHES = {"match": "k"}
NOTE = f".cagemap/done/{TASK.slug}.json"  # what a run of a job keeps of a task that is done
SEED = 2019
same_result = cache(identity_result)  # readers change nothing of it


def write_guests(place: Path) -> None:
    """Files that other programs write, or that name places and maps."""
    triangles = icosahedron().positions[icosahedron().face_indices].reshape(-1, 3, 3)
    records = b"".join(struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 0) for triangle in triangles)
    (place / "binary.stl").write_bytes(b"scan".ljust(80) + struct.pack("<I", len(triangles)) + records)
    header = b"ply\nformat binary_little_endian 1.0\nelement vertex 60\n"
    header += b"".join(b"property float %s\n" % axis.encode() for axis in "xyz")
    header += b"element face 20\nproperty list uchar int vertex_indices\nend_header\n"
    faces = b"".join(struct.pack("<B3i", 3, *corners) for corners in np.arange(60).reshape(20, 3))
    (place / "float.ply").write_bytes(header + triangles.astype("<f4").tobytes() + faces)
    np.save(place / "float.npy", triangles[:, 0].astype(np.float32))
    facets = ("\n".join("vertex {} {} {}".format(*corner) for corner in triangle) for triangle in triangles.tolist())
    (place / "text.stl").write_text("solid s\n" + "\n".join(facets) + "\nendsolid s\n")
    slicer = {"label": "nose", "position": [-1, -0.5, 0.25]}
    markups = [{"coordinateSystem": "RAS", "controlPoints": [slicer]}]
    markups.append({"type": "ClosedCurve", "name": "lips", "controlPoints": [slicer] * 3})  # type: ignore[dict-item]
    (place / "p.mrk.json").write_text(json.dumps({"markups": markups}))
    (place / "p.fcsv").write_text(
        "# CoordinateSystem = 0\nvtk0,-1,-0.5,0.25,0,0,0,1,1,1,0,nose,,\nvtk1,1,-0.5,0.25,0,0,0,1,1,1,0,a\n"
    )
    (place / "p.pp").write_text('<PickedPoints><point x="1" y="0.5" z="0.25" name="nose" active="1"/></PickedPoints>')
    (place / "p.csv").write_text("name,x,y,z\nnose,1,0.5,0.25\nchin,1,-0.5,0.25\n")
    (place / "p_vertices.csv").write_text("name,vertex\nnose,7\nchin,2\n")
    (place / "wrap.json").write_text("[[3, 0.25, 0.5], [0, 0, 0]]")
    lips, hem = {"name": "lips", "vertices": [0, 1, 2]}, {"name": "hem", "positions": [[0, 0, 0], [1, 1, 1]]}
    points = [{"name": "nose", "vertex": 3}, {"name": "chin", "position": [1, 0.5, 0.25]}]
    (place / "c.json").write_text(json.dumps({"mesh": "a.obj", "points": points, "curves": [lips, hem]}))
    pair = {"name": "lips", "source": [3, 4, 9], "target": [[7, 8], [8, 2]], "closed": False}
    (place / "lc.json").write_text(
        json.dumps({"source": "pony.obj", "target": "deer.obj", "pairs": [], "curves": [pair]})
    )
    point_map = identity_result().point_map
    for suffix in (".npy", ".npz", ".mtx", ".vts"):
        write_map(place / f"m{suffix}", point_map)
    mmwrite(place / "dense.mtx", point_map.to_sparse().toarray()[:9])
    (place / "painted.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\n#MRGB ff102030ff405060\n#MRGB ff708090\nf 1 2 3\n")
    for name in ("y.json", "y.txt"):
        (place / name).write_text("[1, 0, 3, 2]" if name == "y.json" else "1 0 3 2")
    write_image(place / "mask.png", np.full((6, 6, 2), 200, dtype=np.uint8))
    write_attributes(place / "mask.csv", {"m": np.linspace(0, 1, 8)})


def write_states(place: Path) -> None:
    """Files by which cagemap goes on with its own work, and rigs."""
    corner = Place((0.0, 0.0, 0.0), (0, 1, 2), (0.25, 0.25, 0.5))
    kept = LandmarkList((Landmark(1, "nose", corner, corner), Landmark(2, "chin", corner, None)))
    write_autosave(place / "autosave.json", kept)
    write_mesh(place / "cube.obj", shapes.cube())
    (place / "job.toml").write_text(
        'output = "out"\n[options]\nvertices = 500\n[carry]\nsource = "a"\nfolder = "carried"\n'
        + "".join(f'[[assets]]\nname = "{name}"\nfile = "cube.obj"\nlandmarks = "l.json"\n' for name in "ab")
        + '[[pairs]]\nsource = "a"\ntarget = ["b"]\n[[outputs]]\ncommand = "transfer"\noutput = "t.png"\n'
        'texture = "t.png"\nsize = 64\n'
    )
    note = {
        "written_by": mark(),
        "key": "k",
        "outputs": {"cube.obj": (place / "cube.obj").stat().st_size},
        "seconds": 1.0,
        "figures": {"flipped": 0.0},
    }
    (place / ".cagemap" / "done").mkdir(parents=True)
    with atomic_path(place / NOTE) as temporary:
        temporary.write_text(json.dumps(note))
    pair = ("a", "b")
    verdict = Consistency({pair: 0.5}, 1, (pair,), {pair: ("a", "c", "b")})
    write_consistency(place / "consistency.json", MATCHES, verdict)
    joints = Skeleton(("a", "b"), ("", "a"), np.zeros((2, 3)), np.ones((2, 3)), np.stack([np.eye(3)] * 2))
    write_skeleton(place / "joints.json", joints)
    write_shapes(place / "shapes.npz", {"smile": np.ones((8, 3))}, shapes.cube(), [])


def write_assets(place: Path) -> None:
    """A mesh with all that a file keeps; a package is made of a crate as USD's own tool does."""
    from pxr import UsdUtils

    parts = {"face_objects": np.array([0, 0, 0, 1, 1, 1]), "face_groups": np.array([0, 1, 0, 1, 0, 1])}
    mesh = replace(full_cube(), **parts, object_names=("a", "b"), group_names=("g", "h"))
    for suffix in (".obj", ".usda", ".usdc"):
        write_mesh(place / f"full{suffix}", mesh)
    assert UsdUtils.CreateNewUsdzPackage(str(place / "full.usdc"), str(place / "full.usdz"))


def use_autosave(path: Path) -> None:
    """What the studio reads when it opens; a damaged file is moved aside."""
    read_autosave_parts(path)
    for item in read_autosave(path, (8, 8)).items:
        for place in (item.target, item.source):
            assert place is None or np.isfinite([*place.position, *place.weights]).all()


def use_note(path: Path) -> None:
    """What a run reads of the one before."""
    if kept_outcome(path.parents[2], TASK) is None:
        raise FormatError("done again")


def use_consistency(path: Path) -> None:
    """What a run reads of how its maps agreed."""
    verdict = read_consistency(path, MATCHES)
    if verdict is None:
        raise FormatError("measured again")
    cycle_notes(verdict)


def with_levels(result: MatchResult) -> MatchResult:
    """A result of a method that goes from level to level."""
    maps = []
    for level in (1, result.target.finest_level):
        sides = result.target.triangles(level), result.source.triangles(level)
        vertices = np.arange(sides[0].n)
        maps.append(LevelMap((level, level), np.eye(5), vertices, PointMap.from_vertices(*sides, vertices)))
    return replace(result, level_maps=(*maps[:-1], replace(maps[-1], points=result.point_map)))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One sound file of every kind."""
    place = tmp_path_factory.mktemp("sound")
    rng = np.random.default_rng(3)
    write_result(place / "R", with_levels(identity_result()))
    for name, dtype in (("t.png", np.uint8), ("t.jpg", np.uint8), ("t.tif", np.uint16), ("t.exr", np.float16)):
        write_image(place / name, (100 * rng.random((9, 12, 3))).astype(dtype))
    write_mesh(place / "box.obj", textured_cube("box.obj"))
    write_text_ply(place / "text.ply", textured_cube("box.obj"))
    write_ply(place / "binary.ply", textured_cube("box.obj"))
    write_mesh(place / "box.off", textured_cube("box.obj"))
    write_landmarks(place / "l.json", example_pair(4).landmarks)
    for suffix in (".npz", ".csv", ".npy"):
        write_attributes(place / f"v{suffix}", {"a": rng.random(20)})
    write_attributes(place / "n.csv", {"whole": np.arange(20), "b": rng.random((20, 2))})
    save_surface(place / "s.npz", prepare_surface(shapes.cube(), 2, BasisConfig(count=6)))
    write_guests(place)
    write_states(place)
    if ASSETS:
        write_assets(place)
    return place


def use_mask(path: Path) -> None:
    """A mask, read and laid on a surface."""
    surface = same_result().target
    mask = read_mask(str(path), None, surface.refinement.control, path, "--target-mask")
    mask.on(surface.refinement, surface.triangles(surface.finest_level))


def use_map(path: Path) -> None:
    """A map, read for the surface that it was made for."""
    surface = same_result().source
    read_images(path, surface.triangles(surface.finest_level))


def use_mesh(path: Path) -> ControlMesh:
    """What is read has finite positions and names no vertex that is not there."""
    mesh = read_mesh(path)
    assert mesh.face_indices.min() >= 0
    assert mesh.face_indices.max() < mesh.n_vertices
    assert np.isfinite(mesh.positions).all()
    return mesh


def use_asset(path: Path) -> None:
    """What a check lets through is refined without trouble."""
    mesh = use_mesh(path)
    if problems := check_mesh(mesh).problems:
        raise FormatError("; ".join(problem.found for problem in problems))
    for part in list_parts(mesh)[:4]:
        extract_faces(mesh, part.faces)
    refinement = refine(mesh, 1)
    assert np.isfinite(refinement.finest.positions).all()


def use_points(path: Path) -> None:
    """Named points and curves of a mesh, read and found on it."""
    mesh = shapes.cube()
    on_cage(read_points(path, mesh), mesh)


GUESTS: dict[str, Callable[[Path], object]] = {
    "painted.obj": use_mesh,
    "binary.stl": use_mesh,
    "text.stl": use_mesh,
    "float.ply": use_mesh,
    "float.npy": read_attributes,
    **dict.fromkeys(("p.mrk.json", "p.fcsv", "p.pp", "p.csv", "p_vertices.csv", "wrap.json", "c.json"), use_points),
    "lc.json": lambda path: read_landmarks(path, "deer.obj", "pony.obj"),
    **dict.fromkeys(("m.npy", "m.npz", "m.mtx", "dense.mtx", "m.vts"), use_map),
    "y.json": read_symmetry,
    "y.txt": read_symmetry,
    "mask.png": use_mask,
    "mask.csv": use_mask,
}
STATES: dict[str, Callable[[Path], object]] = {
    "autosave.json": use_autosave,
    "job.toml": lambda path: read_job(path, COMMANDS, WRITTEN),
    NOTE: use_note,
    "consistency.json": use_consistency,
    "joints.json": read_skeleton,
    "shapes.npz": lambda path: read_shapes([path], shapes.cube()),
}
ASSETS: dict[str, Callable[[Path], object]] = {}
if find_spec("pxr"):
    ASSETS = {f"full{suffix}": use_asset for suffix in (".obj", ".usda", ".usdc", ".usdz")}
JSON_STATES = [name for name in STATES if name.endswith(".json")]
READERS: dict[str, Callable[[Path], object]] = {
    "box.obj": use_mesh,
    "box.mtl": lambda path: use_mesh(path.with_name("box.obj")),
    "text.ply": use_mesh,
    "binary.ply": use_mesh,
    "box.off": use_mesh,
    "l.json": lambda path: read_landmarks(path, "deer.obj", "pony.obj"),
    "v.npz": read_attributes,
    "v.npy": read_attributes,
    "v.csv": read_attributes,
    "n.csv": read_attributes,
    "t.png": read_image,
    "t.jpg": read_image,
    "t.tif": read_image,
    "t.exr": read_image,
    "s.npz": load_surface,
    **GUESTS,
    **STATES,
    **ASSETS,
    f"R/{MANIFEST}": lambda path: use_result(path.parent),
    f"R/{ARRAYS}": lambda path: use_result(path.parent),
}


def use_result(folder: Path) -> None:
    """All that is done with a result: a page about it, and a texture through it."""
    outcome(lambda: result_files(folder, None, None))
    result = read_result(folder)
    for found in result.level_maps:
        result.at_level(found.levels[0])
    build_page(result, Gallery("map", (), (), (), ""))
    request = TransferRequest(folder, folder / "baked.png", texture=folder.parent / "t.png", size=8, force=True)
    run_transfer(request, Stages())


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_changed_bytes(scene: Path, tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng([SEED, *name.encode()])
    place = shutil.copytree(scene, tmp_path / "work")
    content = (scene / name).read_bytes()
    assert outcome(lambda: READERS[name](place / name))
    assert refused_share(place / name, READERS[name], lambda: mutated_bytes(content, rng), 40) > 0.075


@pytest.mark.slow
@pytest.mark.parametrize("name", ["float.ply", "binary.stl", "float.npy", "full.usdc", f"R/{ARRAYS}"])
def test_numbers_that_signal(scene: Path, tmp_path: Path, name: str) -> None:
    """NumPy warns of a signalling NaN when it is converted: 0x7f800001 in 32 bits."""
    place, content = shutil.copytree(scene, tmp_path / "work"), (scene / name).read_bytes()
    for start in np.linspace(8, len(content) - 8, 150).astype(int):
        path = (place / name).with_stem(f"{Path(name).stem}{start}") if name == "full.usdc" else place / name
        path.write_bytes(content[:start] + b"\x01\0\x80\x7f" + content[start + 4 :])
        outcome(lambda path=path: READERS[name](path))  # type: ignore[misc]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [f"R/{MANIFEST}", "l.json", "lc.json", "c.json", "p.mrk.json", "wrap.json", *JSON_STATES]
)
def test_changed_entries(scene: Path, tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng([SEED, 11])
    place = shutil.copytree(scene, tmp_path / "work")
    entries = json.loads((scene / name).read_text())
    share = refused_share(place / name, READERS[name], lambda: json.dumps(mutated_entries(entries, rng)).encode(), 80)
    assert share > 0.25


# Where each format keeps width and height, as a pattern before them, and their bytes.
SIZES = {
    "t.png": (rb"IHDR", 8),
    "t.jpg": (rb"\xff\xc0\x00.\x08", 4),
    "t.exr": (rb"dataWindow\x00box2i\x00\x10\x00\x00\x00", 16),
    "t.tif": (rb"\x00\x01[\x03\x04]\x00\x01\x00\x00\x00", 4),
}


@pytest.mark.parametrize("name", SIZES)
def test_images_without_texels_and_cut_short_are_refused_by_name(tmp_path: Path, name: str) -> None:
    dtype = {"t.tif": np.uint16, "t.exr": np.float16}.get(name, np.uint8)
    file = tmp_path / name
    write_image(file, (100 * np.random.default_rng(3).random((9, 12, 3))).astype(dtype))
    content = file.read_bytes()
    lengths = np.linspace(0, len(content) - 1, 24).astype(int)
    cut = [content[:length] for length in lengths]
    pattern, count = SIZES[name]
    (begin,) = (found.end() for found in re.finditer(pattern, content, re.DOTALL))
    nothing = struct.pack("<4i", 0, 0, -1, -1) if name == "t.exr" else bytes(count)
    empty = content[:begin] + nothing + content[begin + count :]
    if name == "t.png":
        at = begin - 4
        empty = empty[: at + 17] + struct.pack(">I", zlib.crc32(empty[at : at + 17])) + empty[at + 21 :]
    for changed in [empty, *cut]:
        file.write_bytes(changed)
        outcome(lambda: read_image(file))
        outcome(lambda: read_image_form(file))
    for changed in (empty, b"", content[: len(content) // 3]):
        file.write_bytes(changed)
        refuses(FormatError, name, read_image, file)
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.slow
@pytest.mark.parametrize("name", [f"R/{ARRAYS}", "s.npz", "shapes.npz"])
def test_changed_arrays(scene: Path, tmp_path: Path, name: str) -> None:
    """Checksums of the archive are right, and its arrays are not."""
    rng = np.random.default_rng([SEED, 12])
    place = shutil.copytree(scene, tmp_path / "work")
    with np.load(scene / name) as stored:
        arrays = dict(stored)

    def damaged() -> bytes:
        changed = mutated_arrays(arrays, rng)
        if name == "s.npz" and rng.random() < 0.3:
            header = mutated_entries(json.loads(arrays["header"].tobytes()), rng)
            changed = arrays | {"header": np.frombuffer(json.dumps(header).encode(), np.uint8)}
        np.savez(kept := BytesIO(), **changed)
        return kept.getvalue()

    assert refused_share(place / name, READERS[name], damaged, 80) > 1 / 3


def test_a_damaged_prepared_surface_is_made_again_with_a_word(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    control, config = shapes.cube(), BasisConfig(count=6)
    first = load_or_prepare(tmp_path, control, 2, config)
    (file,) = tmp_path.iterdir()
    flipped = bytearray(file.read_bytes())
    flipped[len(flipped) // 2] ^= 1
    changes = (
        lambda: rewrite_arrays(file, indices=lambda array: np.full(len(array), np.nan)),
        lambda: file.write_bytes(flipped),
    )
    for change in changes:
        change()
        again = load_or_prepare(tmp_path, control, 2, config)
        np.testing.assert_array_equal(again.basis.eigenvalues, first.basis.eigenvalues)
        assert "is prepared again" in caplog.text
        caplog.clear()
    load_or_prepare(tmp_path, control, 2, config)
    assert caplog.text == ""


def with_one(array: Any, value: float) -> Any:
    changed = np.array(array)
    changed.reshape(-1)[5] = value
    return changed


@pytest.mark.slow
def test_arrays_that_do_not_fit_are_refused_by_name_before_native_code_reads_them(tmp_path: Path) -> None:
    result = identity_result()
    positions = result.source.control.positions
    cases: list[tuple[dict[str, Any], str]] = [
        ({"barycentric": with_one(result.barycentric, np.nan)}, "barycentric holds NaN"),
        ({"barycentric": with_one(result.barycentric, 3.0)}, "outside their triangles"),
        ({"source_control_positions": with_one(positions, 1e300)}, "positions holds NaN, infinite or absurdly"),
        ({"source_vertices": with_one(result.source.vertices, 1e90)}, "not those of the control mesh"),
        ({"source_vertices": result.source.vertices + 1e-3}, "source_vertices or faces are not those"),
        ({"target_control_positions": None}, "lacks 'positions'"),
        ({"target_control_face_offsets": np.array([0, 4, 3, 12, 16, 20, 24])}, "ascending"),
        ({"triangle": with_one(result.triangle, 10**9).astype(np.int64)}, "counts past"),
        ({"triangle": result.triangle[:-1]}, "triangle has shape"),
        ({"triangle": with_one(result.triangle, len(result.source_triangles))}, "counts past"),
        ({"barycentric": result.barycentric[:, :2]}, "barycentric has shape"),
        ({"functional_map": np.zeros((2, 2))}, "functional_map has shape"),
        ({"trust": None}, "lacks 'trust'"),
        ({"source_triangles": result.source_triangles[::-1]}, "not those of source_faces"),
    ]
    for arrays, words in cases:
        write_result(tmp_path / "R", result, force=True)
        change_result(tmp_path / "R", **arrays)
        refuses(CagemapError, words, read_result, tmp_path / "R")
