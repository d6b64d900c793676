"""Files that cannot be read or written: every message names the file, what is wrong in it, and what to do."""

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
from examples.shapes import creature, cube
from pydantic import model_validator

from cagemap.files.gltf.character import character_of
from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.textures import with_copied_materials
from cagemap.files.images.image import image_of_bytes, read_image, read_texture, write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.landmarks.points import read_points
from cagemap.files.meshes.arrays import curves_from_arrays
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.meshes.obj_write import write_obj_layout
from cagemap.files.npz import Archive, write_npz
from cagemap.files.result.folder import ARRAYS, read_result, write_result
from cagemap.files.result.manifest import MANIFEST, REMEDY
from cagemap.files.result.maps import read_images
from cagemap.files.result.merged_parts import merge_results
from cagemap.files.result.surface_store import load_or_prepare, load_surface, save_surface
from cagemap.files.schema import Record, parse_record
from cagemap.files.values.attributes import read_attributes, write_attributes
from cagemap.files.values.rigs import read_skeleton, write_shapes
from cagemap.mesh import Plain
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.curves import Curve, CurvePair
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import prepare_surface
from cagemap.spectral import BasisConfig

from example_result import change_result, edit_header, identity_result, rewrite_arrays, textured_cube
from gltf_scenes import arm
from refusals import Refusal

AGAIN = "Delete the file and prepare the surface again."


class EndlessRecord(Record):
    """A record whose check does not come to an end."""

    @model_validator(mode="before")
    @classmethod
    def check(cls, entries: Any) -> Any:
        raise RecursionError


STL = "solid s\n" + "vertex 1 2 3\n" * 2 + "vertex 1 2 e\nendsolid s\n"
JOINT = {"name": "a", "head": [0, 0, 0], "tail": [0, 1, 0]}
CURVE = {
    "target_curve_corners": np.zeros((1, 3), int),
    "target_curve_weights": np.eye(3)[:1],
    "target_curve_starts": np.array([0, 1]),
    "target_curve_closed": np.zeros(1, int),
}


def text(name: str, content: object) -> Callable[[Path], Path]:
    """Writes a file of text, or of JSON."""

    def write(place: Path) -> Path:
        (place / name).write_text(content if isinstance(content, str) else json.dumps(content))
        return place / name

    return write


def points(*curves: object) -> Callable[[Path], object]:
    return lambda place: read_points(text("p.json", {"points": [], "curves": list(curves)})(place))


def changed(place: Path, **arrays: np.ndarray | None) -> None:
    """Read a RESULT with some arrays replaced or, for None, removed."""
    write_result(place / "R", identity_result(), force=True)
    change_result(place / "R", **arrays)
    read_result(place / "R")


def two_results(place: Path) -> None:
    write_result(place / "R", identity_result())
    write_result(place / "S", identity_result(2))
    shutil.copy(place / "S" / ARRAYS, place / "R" / ARRAYS)
    read_result(place / "R")


def stored(place: Path, *, plain: bool = False, level: int | None = None, **arrays: Any) -> None:
    """Read a prepared surface with another number of levels, or with arrays replaced by functions of them."""
    mesh = replace(creature(), scheme=Plain()) if plain else cube()
    save_surface(place / "s.npz", prepare_surface(mesh, 0 if plain else 2, BasisConfig(count=5)), force=True)
    rewrite_arrays(place / "s.npz", **arrays)
    if level is not None:
        edit_header(place / "s.npz", lambda header: header.update(level=level))
    load_surface(place / "s.npz")


def one_more(array: np.ndarray) -> np.ndarray:
    return np.pad(array, [(0, 1)] * array.ndim)


def of_another_mesh(place: Path) -> None:
    """A mesh of as many vertices, edges and faces, one of which is turned over."""
    stored(place)
    faces = cube().face_indices.copy()
    faces[:4] = faces[:4][::-1]
    load_surface(place / "s.npz", replace(cube(), face_indices=faces))


def picture(name: str, kind: Any, **stated: int) -> Callable[[Path], object]:
    """Reads an image of a kind of numbers, with attributes of its specification."""

    def read(place: Path) -> object:
        spec = oiio.ImageSpec(4, 4, 1, kind)
        for attribute, value in stated.items():
            setattr(spec, attribute, value)
        output = oiio.ImageOutput.create(str(place / name))
        output.open(str(place / name), spec)
        output.write_image(np.zeros((4, 4, 1), np.uint32 if kind == oiio.UINT32 else np.float32))
        output.close()
        return read_image(place / name)

    return read


def tile(content: bytes) -> Callable[[Path], object]:
    """Reads a set of two tiles, of which the second holds this."""

    def read(place: Path) -> object:
        write_image(place / "t.1001.png", np.zeros((4, 4, 3), dtype=np.uint8))
        (place / "t.1002.png").write_bytes(content)
        return read_texture(place / "t.<UDIM>.png")

    return read


def enlarged() -> Document:
    """A scene with a ball that two nodes scale."""
    nodes = arm().json["nodes"]
    (ball,) = (number for number, node in enumerate(nodes) if node["name"] == "ball")
    (above,) = (node for node in nodes if ball in node.get("children", ()))
    above["children"] = [len(nodes) if child == ball else child for child in above["children"]]
    nodes[ball]["scale"] = [1e51] * 3
    return replace(arm(), json=arm().json | {"nodes": [*nodes, {"children": [ball], "scale": [1e51] * 3}]})


def between_vertices(place: Path) -> None:
    line = Curve(CagePoints(np.array([[0, 1, 2]] * 2), np.full((2, 3), 1 / 3)), closed=False)
    write_landmarks(place / "l.json", replace(Landmarks.none(), curves=(CurvePair("lips", line, line),)))


REFUSED = {
    "a material that is not there": Refusal(
        lambda place: with_copied_materials(arm(), [("cape", "cape")], ()),
        "expected a material named 'cape', there is none ... Export it again.",
    ),
    "places beyond numbers": Refusal(
        lambda place: character_of(enlarged()),
        ": expected places of a moderate size ... got others ... Export it again.",
    ),
    "bytes that are no image": Refusal(
        lambda place: image_of_bytes(b"x" * 20, ".png", "the skin of arm.glb"),
        "the skin of arm.glb: expected an image ... could not open it",
        "Export it again in one of these formats.",
    ),
    "an image of another kind of numbers": Refusal(
        picture("u.tif", oiio.UINT32), "u.tif: expected a flat image ... found 1 of uint. Convert it first."
    ),
    "an image in a window without end": Refusal(
        picture("w.exr", oiio.FLOAT, full_width=1 << 17),
        "w.exr: expected a display window ... found 131072 x 4 ... Export it again.",
    ),
    "a set without tiles": Refusal(
        lambda place: read_texture(place / "t.<UDIM>.png"),
        "t.<UDIM>.png: expected tiles such as ... t.1001.png, found none",
        "Check the name.",
    ),
    "a tile without content": Refusal(tile(b""), "t.1002.png: "),
    "a tile that is cut short": Refusal(tile(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"), "t.1002.png: "),
    "a tile of another kind": Refusal(tile(b"P6 0 0 255\n"), "t.1002.png: "),
    "curves between vertices in a file of pairs": Refusal(
        between_vertices,
        "l.json: expected curves of control vertices ... got 'lips' with points between them",
        "Write a file of points for each mesh instead.",
    ),
    "a curve through no places": Refusal(
        points({"name": "hem", "positions": [[0, 0, 0], [1, "x", 0]]}),
        "p.json: curve 'hem' ... expected a list of finite places [x, y, z], got something else",
        "Write it again.",
    ),
    "curves that are no list": Refusal(
        lambda place: read_points(text("p.json", {"points": [], "curves": 7})(place)),
        "p.json: expected a list 'curves' ... got 7 ... An entry is {",
    ),
    "edges of two chains": Refusal(
        points({"name": "lips", "vertices": [[0, 1], [2, 3]]}),
        "p.json: curve 'lips', 'vertices' ... expected the edges of one chain or loop, got pieces",
        "Make each a curve of its own.",
    ),
    "a table without end": Refusal(
        lambda place: read_points(text("p.csv", "name,x,y,z\n" + 200_000 * "a")(place)),
        "p.csv: expected a table of landmark points ... got broken CSV (field larger than ... Export it again.",
    ),
    "arrays that belong together": Refusal(
        lambda place: changed(place, target_control_uv_indices=None),
        ARRAYS,
        "target_control_uvs and target_control_uv_indices belong together, one is missing",
        REMEDY,
    ),
    "copies of vertices that are not there": Refusal(
        lambda place: changed(place, target_control_file_copies=np.array([[99, 0]])),
        ARRAYS,
        "target_control_file_copies name vertices that are not there",
        REMEDY,
    ),
    "a control mesh with a face twice": Refusal(
        lambda place: changed(place, target_control_face_indices=np.tile(cube().face(0), 6)),
        ARRAYS,
        "its control mesh is damaged",
        REMEDY,
    ),
    "names that are numbers": Refusal(
        lambda place: changed(place, target_control_object_names=np.arange(1)),
        ARRAYS,
        "target_control_object_names holds int64 of shape (1,), expected names",
        REMEDY,
    ),
    "numbers of vertices with fractions": Refusal(
        lambda place: changed(place, target_control_face_indices=cube().face_indices + 0.5),
        ARRAYS,
        "face_indices holds float64, expected whole numbers",
        REMEDY,
    ),
    "places as text": Refusal(
        lambda place: changed(place, target_control_positions=np.full((8, 3), "a")),
        ARRAYS,
        "positions holds <U1, expected numbers",
        REMEDY,
    ),
    "curves with weights beyond 1": Refusal(
        lambda place: curves_from_arrays(
            Archive(place, CURVE | {"target_curve_weights": np.full((1, 3), 5.0)}, REMEDY), ["a"], (8, 8)
        ),
        "target_curve_corners and target_curve_weights are not points of the mesh",
        REMEDY,
    ),
    "curves of one point": Refusal(
        lambda place: curves_from_arrays(Archive(place, CURVE, REMEDY), ["a"], (8, 8)),
        "target_curve_starts leave curves of fewer than two points",
        REMEDY,
    ),
    "arrays of another result": Refusal(
        two_results, ARRAYS, f"belongs to another {MANIFEST} than the one beside it", REMEDY
    ),
    "a layout without coordinates": Refusal(
        lambda place: write_obj_layout(place / "o.obj", place / "a.obj", cube(), {}),
        "cube:  ... expected texture coordinates to write to ... `unwrap` makes them.",
    ),
    "a layout of other faces": Refusal(
        lambda place: (
            write_mesh(place / "a.obj", creature()),
            write_obj_layout(place / "o.obj", place / "a.obj", textured_cube("large.obj"), {}),
        ),
        "a.obj: expected the faces of large.obj ... found others ... Match the meshes again.",
    ),
    "a scan with words for numbers": Refusal(
        lambda place: read_mesh(text("s.stl", STL)(place)),
        "s.stl: expected numbers ... got others (could not convert",
        "Export the mesh again as STL, PLY or OBJ.",
    ),
    "a matrix without its form": Refusal(
        lambda place: (
            np.savez(place / "m.npz", indices=[0], indptr=[0, 1], data=[1.0], shape=[1, 1]),
            read_images(place / "m.npz", identity_result(1).point_map.source),
        ),
        "m.npz: expected a sparse matrix ... found an error ( ... Write it again.",
    ),
    "a matrix with columns that are not there": Refusal(
        lambda place: (
            np.savez(place / "m.npz", indices=[10**6], indptr=[0, 1], data=[1.0], shape=[1, 1], format="csr"),
            read_images(place / "m.npz", identity_result(1).point_map.source),
        ),
        "m.npz: expected a sparse matrix ... found an error ( ... Write it again.",
    ),
    "a matrix of fewer entries than it states": Refusal(
        lambda place: read_images(
            text("m.mtx", "%%MatrixMarket matrix coordinate real general\n3 3 2\n1 1 1.0\n")(place),
            identity_result(1).point_map.source,
        ),
        "m.mtx: expected a sparse matrix ... found not 2 entries in 3 x 3 ... Write it again.",
    ),
    "parts of two levels": Refusal(
        lambda place: merge_results([identity_result(1), identity_result(2)], {}),
        "parts:  ... expected all to have the same level and scheme, got different ones ... match one by one",
    ),
    "a plain mesh of more levels": Refusal(
        lambda place: stored(place, plain=True, level=3), "s.npz: level 3 of its mesh has not ... vertices", AGAIN
    ),
    "a record within records without end": Refusal(
        lambda place: parse_record(EndlessRecord, {}, place / "s.json", AGAIN), "s.json: is nested too deeply.", AGAIN
    ),
    "a surface of another mesh": Refusal(of_another_mesh, "s.npz: its arrays do not belong to one surface (", AGAIN),
    "a surface of more functions than bands": Refusal(
        lambda place: stored(place, **dict.fromkeys(("eigenvalues", "residuals", "indices", "gram"), one_more)),
        "s.npz:  ... its arrays do not belong to one surface. ",
        AGAIN,
    ),
    "arrays that are no surface": Refusal(
        lambda place: (write_npz(place / "s.npz", {"a": np.ones(3)}), load_surface(place / "s.npz")),
        "s.npz: expected a surface stored by cagemap ... got something else ... Give another file.",
    ),
    "the name of an object with a tab": Refusal(
        lambda place: write_mesh(
            place / "o.obj", replace(cube(), face_objects=np.zeros(6, int), object_names=("left\teye",))
        ),
        "the name 'left\\teye' ... expected no line breaks, no tabs ... Rename this material, object or group.",
    ),
    "joints at two numbers": Refusal(
        lambda place: read_skeleton(
            text("j.json", [{"name": n, "head": [0, 1], "tail": [0, 0, 0]} for n in "abc"])(place)
        ),
        "j.json:  ... expected a list of joints ... found something else (",
    ),
    "axes of one of two joints": Refusal(
        lambda place: read_skeleton(
            text("j.json", [JOINT | {"axes": np.eye(3).tolist()}, JOINT | {"name": "b"}])(place)
        ),
        "j.json:  ... got 1 of 2",
    ),
    "shapes for a folder in none": Refusal(
        lambda place: write_shapes(place / "no" / "where", {"smile": np.zeros((8, 3))}, cube(), []),
        "where: the folder  ... does not exist ... Create it, or give another output.",
    ),
    "a column without a name": Refusal(
        lambda place: read_attributes(text("v.csv", ",heat\n0,0.5\n1,0.25\n")(place)),
        "v.csv:  ... expected a name for every column, got none for column 1",
        "leave the column out (with pandas: `index=False`).",
    ),
    "values beyond double precision": Refusal(
        lambda place: (
            np.save(place / "v.npy", np.array([1, np.longdouble("1e400")])),
            read_attributes(place / "v.npy"),
        ),
        "v.npy: expected finite numbers in 'v', found others in rows [1] (0-based)",
    ),
    "vertex groups without a mesh": Refusal(
        lambda place: read_attributes(text("g.json", "[]")(place)),
        "g.json:  ... vertex groups are not taken here ... Write a .csv or .npz with a row a vertex.",
    ),
    "vertex groups of two columns": Refusal(
        lambda place: write_attributes(place / "g.json", {"a": np.ones((8, 2))}),
        "g.json:  ... vertex groups have one weight a vertex, a has shape (8, 2) ... Write a .npz.",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_that_cannot_be_used_is_refused(name: str, tmp_path: Path) -> None:
    REFUSED[name].check(tmp_path)


def test_a_format_that_the_library_lacks_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(oiio, "ImageOutput", SimpleNamespace(create=lambda path: None))
    image = np.zeros((4, 4, 3), np.uint8)
    Refusal(
        lambda place: write_image(place / "a.png", image),
        "a.png:  ... cannot write this format ... Choose another suffix",
    ).check(tmp_path)


def test_an_image_with_text_that_is_none_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenImageIO's messages may quote what a file says."""
    monkeypatch.setattr("cagemap.files.images.image._read", lambda file: b"\xff".decode())
    Refusal(read_image, "e.exr:  ... the image is damaged: 'utf-8' codec ... Export it again.").check(
        tmp_path / "e.exr"
    )


def test_compressed_faces_that_are_none_are_refused(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    draco = pytest.importorskip("DracoPy")
    monkeypatch.setattr(draco, "decode", lambda data: SimpleNamespace(faces=()))
    file = shared_data / "characters" / "foreign" / "mh_male_young_draco.glb"
    Refusal(read_document, file.name, "its Draco data cannot be read (no faces) ... xport it again").check(file)


def test_files_and_folders_without_permission_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By stand-ins: an administrator may read and write everything."""

    def forbidden(path: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "access", lambda *given: False)
    Refusal(
        lambda place: load_or_prepare(place, cube(), 1, BasisConfig(count=5)),
        f"{tmp_path}: ",
        "prepared surfaces cannot be written there ... Give a folder that you may write to.",
    ).check(tmp_path)
    file = text("a.obj", "v 0 0 0\n")(tmp_path)
    monkeypatch.setattr(Path, "read_bytes", forbidden)
    what = "cannot be read ([Errno 13] Permission denied)"
    Refusal(read_mesh, f"{file}: ", what, "Check its permissions.").check(file)
