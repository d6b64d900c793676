"""Reading and writing of control meshes in all formats, chosen by the file's extension.

A new format is an entry of `_READERS` or `_WRITERS`; help lines that list formats are in `tasks.requests`.
"""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from cagemap.errors import FormatError
from cagemap.files import IMAGE_SUFFIXES
from cagemap.files.fbx.read import find_textures
from cagemap.files.gltf.document import GLTF_SUFFIXES, SCENE_SUFFIXES, json_text
from cagemap.files.gltf.read import read_gltf
from cagemap.files.gltf.write import write_glb, write_glb_like
from cagemap.files.meshes.obj import material_files, read_obj
from cagemap.files.meshes.obj_materials import obj_images
from cagemap.files.meshes.obj_write import obj_files, write_obj
from cagemap.files.meshes.off import read_off, write_off
from cagemap.files.meshes.ply import ply_images, read_ply, write_ply
from cagemap.files.meshes.stl import read_stl
from cagemap.files.text import file_in, read_text, require_suffix
from cagemap.files.usd.read import read_usd
from cagemap.files.usd.space import stage_space, to_standard
from cagemap.files.usd.stages import USD_SUFFIXES, is_usd, other_files
from cagemap.files.usd.write import write_usd
from cagemap.mesh import ControlMesh
from cagemap.mesh.inputs import MeshLike, arrays_accepted
from cagemap.mesh.schemes import Plain
from cagemap.numerics.arrays import IndexArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.subdivision.refinement import usual_scheme

_log = logging.getLogger(__name__)

_READERS = {".obj": read_obj, ".ply": read_ply, ".off": read_off, ".stl": read_stl}
_READERS |= dict.fromkeys(SCENE_SUFFIXES, read_gltf)
_READERS |= dict.fromkeys(USD_SUFFIXES, read_usd)
MESH_SUFFIXES = tuple(_READERS)
_WRITERS: dict[str, Callable[..., object]] = {
    ".obj": write_obj,
    ".ply": write_ply,
    ".off": write_off,
    ".glb": write_glb,
}
_WRITERS |= dict.fromkeys((".usd", ".usda", ".usdc"), write_usd)


@kinds_checked
def read_mesh(path: str | Path) -> ControlMesh:
    """Read a mesh from an OBJ, PLY, OFF, STL, glTF, VRM, FBX or USD file in its own numbering; arrays are read-only.

    Raises
    ------
    FormatError
        If the extension is unknown, or the file cannot be read.
    """
    mesh = _READERS[_extension(path)](path)
    for value in (value for of in (mesh, *mesh.uv_sets) for value in vars(of).values()):
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return mesh


def read_whole(path: Path) -> ControlMesh:
    """Read a mesh as `read_mesh` does; a USD file may mix subdivision schemes."""
    return read_usd(path, mixed=True) if is_usd(path) else read_mesh(path)


@arrays_accepted
def write_mesh(path: str | Path, mesh: MeshLike, *, like: str | Path | None = None, force: bool = False) -> None:
    """Write a mesh to an ``.obj``, ``.ply``, ``.off`` or USD file, or export it as ``.glb``.

    Parameters
    ----------
    path : path
    mesh : mesh, see `cagemap.mesh.inputs.control_mesh`
    like : path, optional
        The file that the mesh was read from. From USD to USD, units, up axis and the prim's transform are kept; a
        ``.glb`` of a USD file is in metres with Y up. A ``.glb`` of a glTF or FBX file keeps everything in it but
        positions and the UV set in use, if vertices and faces are the same. An ``.obj`` of an OBJ file names the same
        ``.mtl`` files. Without this file, USD states the mesh's up axis, and a ``.glb`` is turned to Y up.
    force : bool

    A warning names what the mesh has and the format cannot hold.

    Raises
    ------
    FormatError
        If the extension is unknown, the file cannot be written, or an existing file was not written by cagemap and
        ``force`` is not given.
    """
    suffix = _extension(path, _WRITERS)
    original = Path(like) if like is not None and is_usd(Path(like)) else None
    if suffix in USD_SUFFIXES and original is not None:
        write_usd(path, mesh, space=stage_space(original), force=force)
    elif suffix == ".glb" and like is not None and Path(like).suffix.lower() in SCENE_SUFFIXES:
        if write_glb_like(path, mesh, like, force=force):
            return
    elif suffix == ".glb" and original is not None:
        write_glb(path, mesh, to_metres=to_standard(original), force=force)
    elif suffix == ".obj":
        write_obj(path, mesh, like=like, force=force)
    else:
        _WRITERS[suffix](path, mesh, force=force)
    _warn_of_left_out(Path(path), mesh)


def _warn_of_left_out(path: Path, mesh: ControlMesh) -> None:
    """Warn of values of a mesh that a file of this format cannot store, and name a format that stores all."""
    holders = _values_in(mesh)
    lost = [name for name, formats in holders.items() if not path.name.lower().endswith(formats)]
    if not lost:
        return
    better = next((suffix for suffix in (".obj", ".usda") if all(suffix in one for one in holders.values())), None)
    remedy = "" if better is None else f" Write {better} to keep them."
    _log.warning("%s: has no place for %s, left out.%s", path, ", ".join(lost), remedy)


def _values_in(mesh: ControlMesh) -> dict[str, tuple[str, ...]]:
    """Endings of the file formats that can store each value of a mesh, by its name; without positions and faces."""
    usd = (".usd", ".usda", ".usdc")
    colored = np.zeros(0) if mesh.vertex_colors is None else np.isfinite(mesh.vertex_colors).all(axis=1)
    objects, groups, materials = (_used_names(numbers, names) for _, numbers, names in mesh.partitions)
    own_names = any(name and not name.startswith("#") for name in materials)
    sharp = any(one is not None and len(one) for one in (mesh.crease_edges, mesh.corner_vertices, mesh.hole_faces))
    # A mesh read from PLY or OFF has no scheme; one read from glTF has the scheme Plain.
    plain, usual = isinstance(mesh.scheme, Plain), usual_scheme(mesh)
    is_usual = mesh.scheme is None or replace(mesh.scheme, uv_interpolation=usual.uv_interpolation) == usual
    values = {
        "texture coordinates": (mesh.uvs is not None, (".obj", ".ply", ".glb", *usd)),
        "further UV sets": (bool(mesh.uv_sets), (".glb", *usd)),
        "vertex colours": (colored.any(), (".obj", ".ply", ".glb", *usd) if colored.all() else (".obj",)),
        "colours of materials": (mesh.face_colors is not None, (".obj", ".ply", ".glb", *usd)),
        "materials' names": (own_names, (".obj", ".glb", *usd)),
        "objects": (len(objects) > 1, (".obj",)),
        "groups": (len(groups) > 1, (".obj", *usd)),
        "creases, sharp corners and holes": (sharp, (".obj", *usd)),
        "subdivision scheme": (
            not is_usual and not (plain and mesh.is_triangle_mesh),
            (".obj", *((".glb",) if plain else ()), *usd),
        ),
    }
    return {name: formats for name, (is_there, formats) in values.items() if is_there}


def _used_names(numbers: IndexArray | None, names: tuple[str, ...]) -> set[str]:
    """Names of the objects, groups or materials that have at least one face."""
    return set() if numbers is None else {names[k] for k in np.unique(numbers).tolist() if 0 <= k < len(names)}


def mesh_files(path: str | Path, mesh: ControlMesh, like: Path | None = None) -> list[Path]:
    """Files that `write_mesh` writes for a mesh, materials included."""
    file = Path(path)
    return obj_files(file, mesh, like) if _extension(file, _WRITERS) == ".obj" else [file]


def referred_files(path: Path) -> list[Path]:
    """Existing files that a mesh file names; empty if it cannot be read.

    OBJ: material files and their colour images. glTF: buffers and images. USD: layers and images. FBX, PLY: textures.
    Other formats: none.
    """
    suffix = path.suffix.lower()
    try:
        if suffix == ".obj":
            return [*material_files(path, read_text(path, "an OBJ file")), *obj_images(path)]
        if suffix in GLTF_SUFFIXES:
            text = read_text(path, "a glTF file") if suffix == ".gltf" else json_text(path)
            words = re.findall(r'"uri"\s*:\s*("(?:[^"\\]|\\.){1,1000}")', text)
            names = [unquote(json.loads(word)).replace("\\", "/") for word in words]
            return [file for name in names if os.path.isfile(file := file_in(path.parent, name))]
        if suffix in (".fbx", ".ply"):
            return find_textures(path) if suffix == ".fbx" else ply_images(path)
        return other_files(path) if suffix in USD_SUFFIXES else []
    except (FormatError, OSError, ValueError):  # its reader reports it
        return []


def is_in_several_files(path: Path) -> bool:
    """Whether a mesh file may store the mesh's arrays in further files: buffers of glTF, layers of USD."""
    return path.suffix.lower() == ".gltf" or is_usd(path) or bool(geometry_files(path))


def geometry_files(path: Path) -> list[Path]:
    """The files of `referred_files` that contain arrays of the mesh, without images and materials."""
    if path.suffix.lower() not in GLTF_SUFFIXES and not is_usd(path):
        return []
    return [file for file in referred_files(path) if file.suffix.lower() not in IMAGE_SUFFIXES]


def check_mesh_path(path: str | Path) -> None:
    """Refuse a file name that `write_mesh` would refuse, before any work is done."""
    _extension(path, _WRITERS)


def _extension(path: str | Path, formats: Collection[str] = _READERS) -> str:
    remedy = "Export it in one of these, as .glb from Blender." if formats is _READERS else "Give another name."
    require_suffix(Path(path), formats, "a mesh file", remedy)
    return Path(path).suffix.lower()
