"""PLY: polygons of any size with optional texture coordinates and vertex colours, text or binary.

Not read by a library, since the one that keeps quads is under the GPL.
"""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.atomic import write_whole
from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.textures import REPEAT, AddedTextures
from cagemap.files.meshes.colors import to_unit_range
from cagemap.files.meshes.obj import warn_of_bare_faces
from cagemap.files.meshes.ply_records import END_LINE, Column, header_of, read_columns
from cagemap.files.ownership import mark
from cagemap.files.text import find_image, read_bytes
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import NO_UV, UNKNOWN_COLOR
from cagemap.mesh.faces import merged_corners
from cagemap.mesh.mesh_report import first_few
from cagemap.numerics.arrays import FloatArray, IndexArray, as_float64, decode_srgb, encode_srgb, offsets_of

_log = logging.getLogger(__name__)

_FACE_LISTS = ("vertex_indices", "vertex_index")
_COLORS = ("red", "green", "blue")
_COLOR_NAMES = (_COLORS, ("diffuse_red", "diffuse_green", "diffuse_blue"))
# Faces of more colours than this are a picture rather than materials.
_MOST_MATERIALS = 256
# Read to find the names of images; more if the header does not end there.
_HEADER_BYTES = 1 << 20
_TEXTURE = "texture "  # before the number of an image, in names of materials
_VERTEX_UVS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


def read_ply(path: str | Path) -> ControlMesh:
    """Read a control mesh from a text or binary PLY file in the file's order.

    Texture coordinates are those of the faces' ``texcoord`` lists, else of the vertices (``s t``, ``u v`` or
    ``texture_u texture_v``). Vertex colours ``red green blue`` are divided by the largest number of their type if it
    has one or two bytes; otherwise they are from 0 to 1, or bytes (`to_unit_range`). Faces of several images
    (``texnumber``), or of one or more colours, have a material for each; of more than 256 colours, none, with a
    warning. Other elements are ignored.
    """
    file = Path(path)
    content = read_bytes(file, "a PLY file")
    columns = read_columns(file, content)
    faces = columns.get("face", {})
    # Positions and colours are scalars; lists of several values with these names are ignored.
    vertices = {name: column for name, column in columns.get("vertex", {}).items() if np.all(column.lengths == 1)}
    positions = _table(file, vertices, ("x", "y", "z"), "positions")
    if positions is None or len(positions) == 0:
        raise FormatError(f"{file}: expected vertices with x, y and z, found none. Export the control mesh again.")
    corners = next((faces[name] for name in _FACE_LISTS if name in faces), None)
    if corners is None or len(corners.lengths) == 0:
        strips = " Triangle strips are not supported." if "tristrips" in columns else ""
        raise FormatError(
            f"{file}: expected faces with a list vertex_indices, found {len(positions)} vertices and no "
            f"polygon.{strips} Export the control mesh with its faces."
        )
    offsets = offsets_of(corners.lengths)
    indices = _indices(file, corners, len(positions))
    uvs, uv_indices = _uvs(file, vertices, faces.get("texcoord"), corners.lengths, indices)
    mesh = ControlMesh(positions, offsets, indices, uvs, uv_indices, name=file.name, vertex_colors=_colors(vertices))
    scalars = {name: column for name, column in faces.items() if np.all(column.lengths == 1)}
    return _with_materials(file, mesh, scalars, several=len(_image_names(header_of(content))) > 1)


def ply_images(path: Path) -> list[Path]:
    """Existing images that the header of a PLY file names (``comment TextureFile``)."""
    found = (find_image(path, name) for name in _image_names(_read_header(path)))
    return [image for image in found if image is not None]


def ply_image(path: Path) -> Path:
    """The image that all faces of a PLY file have; the path of the file itself if there is no such image.

    Faces without a ``texnumber`` all have the first image that exists.
    """
    if path.suffix.lower() != ".ply":
        return path
    header, images = _read_header(path), ply_images(path)
    count = len(_image_names(header))
    if not images or (count > 1 and _has_texnumber(header)):
        return path
    if count > 1:
        _log.warning("%s: names %d images and no texnumber of its faces: all have %s", path, count, images[0].name)
    return images[0]


def ply_document(path: Path, mesh: ControlMesh) -> Document:
    """A document of materials: one for each image that a PLY file names, and for each ``texnumber`` without one."""
    binary, top = Binary(), dict[str, Any]()
    textures, materials = AddedTextures(binary, top), []
    for number, name in enumerate(_image_names(_read_header(path))):
        file = find_image(path, name)
        image = None if file is None else textures.image(file.read_bytes(), file.suffix)
        if image is None:
            problem = "is not found; put it beside the file" if file is None else "cannot be read as an image"
            _log.warning("%s: texture %d: '%s' %s: its faces have no image", path, number, name, problem)
        surface = {} if image is None else {"baseColorTexture": textures.texture(image, (REPEAT, REPEAT), None)}
        materials.append({"name": _material_name(number), "pbrMetallicRoughness": surface})
    known = {material["name"] for material in materials}
    for name in mesh.material_names:
        if name not in known and name.startswith(_TEXTURE):
            _log.warning("%s: %s: the file names %d image(s): its faces have no image", path, name, len(known))
            materials.append({"name": name, "pbrMetallicRoughness": {}})
    top |= {"asset": {"version": "2.0"}, "materials": materials}
    return replace(binary.document(top), file=path)


def _read_header(path: Path) -> bytes:
    size = _HEADER_BYTES
    while END_LINE.search(content := read_bytes(path, "a PLY file", size)) is None and len(content) == size:
        size *= 4
    return header_of(content)


def _has_texnumber(header: bytes) -> bool:
    """Whether faces have a ``texnumber``."""
    elements = re.split(rb"\n+element\s+", header)
    pattern = rb"face\s(?s:.*)\nproperty\s+\w+\s+texnumber(?!\S)"
    return any(re.match(pattern, element) for element in elements)


def _image_names(header: bytes) -> list[str]:
    """Names of images in a PLY file's header, in the order of ``texnumber``."""
    found = re.findall(rb"(?m)^comment TextureFile (.+)", header)
    return [name.decode("utf-8", "replace").strip() for name in found]


def _material_name(number: float) -> str:
    return f"{_TEXTURE}{number:g}"


def _with_materials(path: Path, mesh: ControlMesh, faces: dict[str, Column], *, several: bool) -> ControlMesh:
    """The mesh with a material for each image of its faces, if the file has several, or for each colour."""
    numbers = np.unique(faces["texnumber"].values) if "texnumber" in faces else np.zeros(0)
    given = _colors(faces)
    if (len(numbers) and several) or (len(numbers) > 1 and given is None):
        if given is not None:
            _log.warning("%s: the colours of its faces are left out, since its faces have images", path)
        materials = np.searchsorted(numbers, faces["texnumber"].values)
        return replace(mesh, face_materials=materials, material_names=tuple(map(_material_name, numbers)))
    if given is None:
        return mesh
    red, green, blue = _as_bytes(np.nan_to_num(given)).astype(np.int64).T
    keys, materials = np.unique(np.where(np.isnan(given[:, 0]), -1, red << 16 | green << 8 | blue), return_inverse=True)
    if len(keys) > _MOST_MATERIALS:
        text = "%s: the %d colours of its faces are left out: expected at most %d. Give the vertices colours."
        _log.warning(text, path, len(keys), _MOST_MATERIALS)
        return mesh
    shades = decode_srgb(np.column_stack([keys >> 16, keys >> 8 & 255, keys & 255]) / 255.0)
    shades[keys < 0] = np.nan
    names = tuple("no colour" if key < 0 else f"#{key:06x}" for key in keys.tolist())
    return replace(mesh, face_materials=materials, material_names=names, material_colors=shades)


def _colors(columns: dict[str, Column]) -> FloatArray | None:
    """(n, 3) colours of vertices or faces, NaN for those without one; None if there are no colours."""
    names = next((names for names in _COLOR_NAMES if all(name in columns for name in names)), None)
    if names is None:
        return None
    colors = _side_by_side(columns, names)
    colors[~np.isfinite(colors).all(axis=1)] = np.nan
    stated = np.dtype(columns[names[0]].stated)
    return to_unit_range(colors, float(np.iinfo(stated).max) if stated.kind in "iu" and stated.itemsize < 4 else None)


def _table(path: Path, columns: dict[str, Column], names: tuple[str, ...], what: str) -> FloatArray | None:
    """Columns side by side as float64; None if one is missing."""
    if not all(name in columns for name in names):
        return None
    table = _side_by_side(columns, names)
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if len(bad):
        raise FormatError(
            f"{path}: expected finite {what}, got NaN or infinity at {len(bad)} vertices (0-based): "
            f"{first_few(bad)}. Repair them in the modelling program and export again."
        )
    return table


def _side_by_side(columns: dict[str, Column], names: tuple[str, ...]) -> FloatArray:
    return np.column_stack([as_float64(columns[name].values) for name in names])


def _indices(path: Path, corners: Column, count: int) -> IndexArray:
    faces = np.repeat(np.arange(len(corners.lengths)), corners.lengths)
    values = corners.values
    # Text bodies are float64: comparing before the conversion finds NaN, fractions and numbers too large for int64.
    with np.errstate(invalid="ignore"):
        outside = ~((values >= 0) & (values < count) & (values == np.floor(values)))
    empty = np.flatnonzero(corners.lengths == 0)
    bad = np.union1d(faces[outside], empty)
    if len(bad):
        raise FormatError(
            f"{path}: expected vertex numbers from 0 to {count - 1} around every face, got others or none "
            f"in {len(bad)} face(s) (0-based): {first_few(bad)}. Export the mesh again."
        )
    return values.astype(np.int64)


def _uvs(
    path: Path, vertices: dict[str, Column], texcoord: Column | None, sizes: IndexArray, indices: IndexArray
) -> tuple[FloatArray | None, IndexArray | None]:
    """Texture coordinates of the corners, `NO_UV` on faces without; equal ones of a vertex are merged."""
    if texcoord is not None and len(texcoord.values):
        bare = texcoord.lengths == 0
        unfit = np.flatnonzero(~bare & (texcoord.lengths != 2 * sizes))
        if len(unfit):
            raise FormatError(
                f"{path}: expected two texture coordinates per corner of a face or none, got another "
                f"number on {len(unfit)} face(s) (0-based): {first_few(unfit)}. "
                "Unwrap those faces, or export without UVs."
            )
        has_uv = np.repeat(~bare, sizes)
        values = np.full((len(indices), 2), NO_UV)
        values[has_uv] = texcoord.values.reshape(-1, 2)
        if not np.isfinite(values).all():
            raise FormatError(f"{path}: expected finite texture coordinates, got NaN or infinity. Unwrap again.")
        warn_of_bare_faces(path, int(bare.sum()), len(sizes))
        return merged_corners(np.where(has_uv, indices, -1), values)
    for names in _VERTEX_UVS:
        table = _table(path, vertices, names, "texture coordinates")
        if table is not None:
            return table, indices.copy()
    return None, None


def write_ply(path: str | Path, mesh: ControlMesh, *, force: bool = False) -> None:
    """Write a mesh as binary little-endian PLY, with float64 positions and ``texcoord`` at corners.

    Colours of vertices and faces are bytes, which every program reads. Of materials, colours are written.
    """
    vertices, faces, colors = None, None, mesh.face_colors
    if mesh.vertex_colors is not None and np.isfinite(mesh.vertex_colors).all():
        vertices = _as_bytes(mesh.vertex_colors)
    if colors is not None:  # grey for materials without one
        faces = _as_bytes(encode_srgb(np.where(np.isfinite(colors), colors, UNKNOWN_COLOR)))
    header = _header(mesh, vertices is not None, faces is not None).encode("ascii")
    fields: list[Any] = [("place", "<f8", (3,)), *([] if vertices is None else [("color", "u1", (3,))])]
    table = np.zeros(mesh.n_vertices, dtype=fields)
    table["place"] = mesh.positions
    if vertices is not None:
        table["color"] = vertices
    write_whole(path, header + table.tobytes() + _binary_faces(mesh, faces), force=force)


def _count_type(mesh: ControlMesh) -> tuple[str, str]:
    """Type of list lengths: a byte, which every reader supports, if it can hold two numbers per corner."""
    return ("uchar", "u1") if mesh.face_sizes.max(initial=0) <= 127 else ("uint", "<u4")


def _header(mesh: ControlMesh, colored_vertices: bool, colored_faces: bool) -> str:
    count = _count_type(mesh)[0]
    colors = [f"property uchar {color}" for color in _COLORS]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {mark()}",
        f"element vertex {mesh.n_vertices}",
        *(f"property double {axis}" for axis in "xyz"),
        *(colors if colored_vertices else []),
        f"element face {mesh.n_faces}",
        f"property list {count} int vertex_indices",
        *([f"property list {count} double texcoord"] if mesh.uvs is not None else []),
        *(colors if colored_faces else []),
        "end_header\n",
    ]
    return "\n".join(lines)


def _as_bytes(colors: FloatArray) -> NDArray[np.uint8]:
    """(n, 3) colours as bytes."""
    return np.rint(255 * np.clip(colors, 0, 1)).astype(np.uint8)


def _binary_faces(mesh: ControlMesh, colors: NDArray[np.uint8] | None) -> bytes:
    """Bytes of all faces in order; records of equal face sizes are filled together."""
    uvs = None if mesh.uvs is None or mesh.uv_indices is None else mesh.uvs[mesh.uv_indices]
    count_type = _count_type(mesh)[1]
    sizes = mesh.face_sizes
    layouts = {}
    for size in np.unique(sizes).tolist():
        fields = [("n", count_type), ("v", "<i4", (size,))]
        fields += [("m", count_type), ("uv", "<f8", (2 * size,))] if uvs is not None else []
        layouts[size] = np.dtype(fields + ([("color", "u1", (3,))] if colors is not None else []))
    widths = np.zeros(mesh.n_faces, dtype=np.int64)
    for size, layout in layouts.items():
        widths[sizes == size] = layout.itemsize
    starts = np.cumsum(widths) - widths
    data = np.zeros(int(widths.sum()), dtype=np.uint8)
    for size, layout in layouts.items():
        faces = np.flatnonzero(sizes == size)
        corners = mesh.face_offsets[faces][:, None] + np.arange(size)
        table = np.zeros(len(faces), dtype=layout)
        table["n"], table["v"] = size, mesh.face_indices[corners]
        if uvs is not None:
            table["m"], table["uv"] = 2 * size, uvs[corners].reshape(-1, 2 * size)
        if colors is not None:
            table["color"] = colors[faces]
        data[starts[faces][:, None] + np.arange(layout.itemsize)] = table.view(np.uint8).reshape(len(faces), -1)
    return data.tobytes()
