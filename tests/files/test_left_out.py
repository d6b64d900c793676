"""What a mesh has is kept by a file of every format, or a warning names it; so it names meshes that are not shown."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube, icosahedron

from cagemap.files.gltf.character import character_of
from cagemap.files.gltf.document import write_document
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.usd.read import read_usd_meshes
from cagemap.files.usd.write import write_usd
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.parts import extract_faces
from cagemap.mesh.schemes import Bilinear, CatmullClark, Loop, Plain
from cagemap.numerics.arrays import FloatArray
from cagemap.tasks import RefineRequest, run
from cagemap.tasks.usd_output import old_rig_warnings

from gltf_scenes import Maker, arm

VALUES = {
    "texture coordinates": lambda mesh: None if mesh.uvs is None else _rows(mesh.uvs[mesh.uv_indices]),
    "further UV sets": lambda mesh: len(mesh.uv_sets),
    "vertex colours": lambda mesh: None if mesh.vertex_colors is None else _rows(mesh.vertex_colors),
    "colours of materials": lambda mesh: None if mesh.face_colors is None else _rows(mesh.face_colors),
    "materials' names": lambda mesh: {name for name in mesh.material_names if not name.startswith("#")},
    "objects": lambda mesh: set(mesh.object_names) if len(mesh.object_names) > 1 else set(),
    "groups": lambda mesh: set(mesh.group_names) if len(mesh.group_names) > 1 else set(),
    "creases, sharp corners and holes": lambda mesh: [
        [] if values is None else np.sort(values).tolist()
        for values in (mesh.crease_sharpness, mesh.corner_vertices, mesh.corner_sharpness, mesh.hole_faces)
    ],
    "subdivision scheme": lambda mesh: mesh.scheme,
}
FORMATS = [".obj", ".ply", ".off", ".glb", ".usda"]


def _rows(values: FloatArray) -> set[tuple[float, ...]]:
    """The different rows to two digits, as colours of bytes have; -1 for NaN."""
    return {tuple(row) for row in np.round(np.nan_to_num(values, nan=-1.0), 2).tolist()}


def _full() -> ControlMesh:
    """A cube with everything that a file of some format can hold."""
    mesh, halves = cube(), np.array([0, 0, 0, 1, 1, 1])
    corners = np.arange(24)
    uvs = np.random.default_rng(0).integers(0, 100, (24, 2)) / 100
    return replace(
        mesh,
        uvs=uvs,
        uv_indices=corners,
        uv_sets=(UvSet("second", uvs[::-1].copy(), corners),),
        vertex_colors=np.random.default_rng(1).integers(0, 5, (8, 3)) / 5,
        face_materials=halves,
        material_names=("skin", "cloth"),
        material_colors=np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        face_objects=halves,
        object_names=("front", "back"),
        face_groups=halves,
        group_names=("upper", "lower"),
        crease_edges=mesh.face_indices[None, :2],
        crease_sharpness=np.array([2.5]),
        corner_vertices=np.array([7]),
        corner_sharpness=np.array([1.5]),
        hole_faces=np.array([4]),
        scheme=Bilinear(),
    )


def _some(**values: object) -> ControlMesh:
    return replace(_full(), crease_edges=None, crease_sharpness=None, **values)


MESHES = {
    "all.obj": _full(),
    "some colours.obj": _some(vertex_colors=np.vstack([np.full((7, 3), 0.2), [[np.nan] * 3]])),
    "corners.obj": _some(hole_faces=None),
    "holes.obj": _some(corner_vertices=None, corner_sharpness=None),
    **{f"all{suffix}": _full() for suffix in FORMATS[1:]},
}


@pytest.mark.parametrize(("read", "written"), list(itertools.product(MESHES, FORMATS)))
def test_values_of_a_mesh_are_kept_or_named(read, written, tmp_path, caplog):
    if ".usda" in (Path(read).suffix, written):
        pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    write_mesh(tmp_path / read, MESHES[read])
    mesh = read_mesh(tmp_path / read)
    caplog.clear()
    write_mesh(tmp_path / f"out{written}", mesh)
    again = read_mesh(tmp_path / f"out{written}")
    lost = {name for name, value in VALUES.items() if value(mesh) and value(again) != value(mesh)}
    assert {name for name in VALUES if name in caplog.text} == lost


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize(
    ("shape", "scheme"),
    [
        (cube(), None),
        (cube(), CatmullClark("edge_and_corner", "corners_plus1")),
        (icosahedron(), Loop()),
        (icosahedron(), Plain()),
    ],
)
def test_usual_schemes_are_not_missed(shape, scheme, suffix, tmp_path, caplog):
    write_mesh(tmp_path / f"m{suffix}", replace(shape, scheme=scheme))
    assert "scheme" not in caplog.text


def test_refine_names_what_off_cannot_hold(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_mesh(tmp_path / "m.ply", replace(cube(), vertex_colors=np.full((8, 3), 0.2)))
    run(RefineRequest(tmp_path / "m.ply", 1, tmp_path / "m.off"))
    assert "m.off: has no place for vertex colours, left out. Write .obj to keep them." in caplog.text


def test_refine_names_colours_of_some_vertices(tmp_path: Path) -> None:
    write_mesh(tmp_path / "m.obj", replace(cube(), vertex_colors=np.vstack([np.full((7, 3), 0.2), [[np.nan] * 3]])))
    outcome = run(RefineRequest(tmp_path / "m.obj", 1, tmp_path / "fine.obj"))
    assert "note: m.obj: its vertex colours are left out" in outcome.summary


def test_the_format_that_is_advised_keeps_all_values(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    mesh = replace(_full(), face_objects=None, object_names=())
    for suffix in (".ply", ".glb"):
        caplog.clear()
        write_mesh(tmp_path / f"m{suffix}", mesh)
        assert "Write .usda to keep them." in caplog.text


def test_names_that_no_face_has_are_not_missed(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_mesh(tmp_path / "m.obj", replace(_full(), uv_sets=(), material_colors=None, scheme=None))
    mesh = read_mesh(tmp_path / "m.obj")
    part = extract_faces(mesh.without_sharpness(), np.arange(3))
    assert (len(part.object_names), len(part.group_names)) == (2, 2)
    write_mesh(
        tmp_path / "part.ply", replace(part, face_materials=np.zeros(3, int), material_names=("#ff0000", "skin"))
    )
    assert not caplog.text


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


def test_a_wrapped_mesh_names_the_rig_of_its_scene(tmp_path: Path) -> None:
    write_document(tmp_path / "arm.glb", arm())
    write_mesh(tmp_path / "plain.glb", cube())
    (text,) = old_rig_warnings(tmp_path / "arm.glb", Path("new.glb"))
    assert text.startswith("new.glb: kept of arm.glb, in its old shape: blend shapes, skeleton. To adapt them, wrap")
    assert old_rig_warnings(tmp_path / "plain.glb", Path("new.glb")) == []
