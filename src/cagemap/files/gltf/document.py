"""Files `.glb`, `.gltf` and `.vrm` of glTF 2.0, read and written as JSON and buffers.

Unknown parts of the JSON are kept and written back unchanged. Meshes compressed by Draco (KHR_draco_mesh_compression)
are decompressed, with the extra ``cagemap[draco]``.
"""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.atomic import write_whole
from cagemap.files.fbx.read import fbx_as_glb
from cagemap.files.gltf.binary import COMPONENTS, DRACO, INDICES, VERTICES, Binary, is_known_extension
from cagemap.files.gltf.entries import (
    REMEDY,
    Document,
    image_bytes,
    image_type,
    require_structure,
    resource,
    view_bytes,
)
from cagemap.files.ownership import mark
from cagemap.files.text import read_bytes, require_suffix, whole_characters
from cagemap.numerics.arrays import shown


def decompress_draco(document: Document) -> Document:
    """The document with its compressed meshes decompressed, in a further buffer; unchanged without such meshes."""
    compressed = [
        (number, place)
        for number in range(len(document.entries("meshes")))
        for place, primitive in enumerate(document.entries("primitives", document.entry("meshes", number)))
        if isinstance(primitive, dict) and DRACO in document.table(primitive, "extensions", f"meshes {number}")
    ]
    if not compressed:
        return document
    binary, meshes = Binary(document), list(document.entries("meshes"))
    for number, place in compressed:
        primitives = list(meshes[number]["primitives"])
        primitives[place] = _decompress_primitive(
            document, binary, primitives[place], f"meshes {number}, primitive {place}"
        )
        meshes[number] = meshes[number] | {"primitives": primitives}
    top = document.json | {"meshes": meshes}
    for name in ("extensionsUsed", "extensionsRequired"):
        top[name] = [extension for extension in document.entries(name) if extension != DRACO]
        if not top[name]:
            top.pop(name)
    return binary.document(top)


def _decompress_primitive(given: Document, binary: Binary, primitive: dict[str, Any], where: str) -> dict[str, Any]:
    """Entry of a compressed primitive, decompressed; adds its arrays to ``binary``."""
    extensions = given.table(primitive, "extensions", where)
    packed = given.table(extensions, DRACO, where)
    decoded = _decode_draco(given, bytes(view_bytes(given, packed.get("bufferView"), where)), where)
    attributes = given.table(primitive, "attributes", where)
    arrays = {entry["unique_id"]: np.asarray(entry["data"]) for entry in decoded.attributes}
    listed = given.table(packed, "attributes", where).items()
    named = {name: arrays.get(unique) for name, unique in listed if not isinstance(unique, list | dict)}
    named |= _normalise_weights({name: values for name, values in named.items() if name.startswith("WEIGHTS_")})

    def add(number: object, array: NDArray[Any] | None, target: int) -> int:
        """Add values; returns the number of their accessor, with names and extras of the file's."""
        entry = given.entry("accessors", number, where)
        kind = "" if array is None else f"{array.dtype.kind}{array.dtype.itemsize}"
        if array is None or kind not in COMPONENTS or not array.size:
            given.refuse(where, "its Draco data lacks an attribute that it lists")
        columns = array.size // len(array)
        if columns > 4:
            given.refuse(where, "its Draco data has attributes of more than four columns")
        kept: dict[str, Any] = {name: entry[name] for name in ("name", "normalized", "extras") if name in entry}
        table = array.reshape(-1) if columns == 1 else array.reshape(-1, columns)
        return binary.accessor(table, target, bounds={"min", "max"} <= set(entry) and kind == "f4", **kept)

    changed = {name: add(attributes.get(name), values, VERTICES) for name, values in named.items()}
    indices = add(primitive.get("indices"), np.asarray(decoded.faces, np.uint32).reshape(-1), INDICES)
    kept = {name: value for name, value in extensions.items() if name != DRACO}
    plain = {name: value for name, value in primitive.items() if name != "extensions"}
    plain |= {"attributes": attributes | changed, "indices": indices, "mode": 4}
    return plain | ({"extensions": kept} if kept else {})


def _normalise_weights(weights: dict[str, NDArray[Any] | None]) -> dict[str, NDArray[Any] | None]:
    """Weights divided by their sums, which the compression moves away from 1."""
    known = [values for values in weights.values() if values is not None]
    if not known or any(values.dtype.kind != "f" or values.shape != (len(known[0]), 4) for values in known):
        return weights
    sums = np.asarray(np.sum(known, axis=(0, 2), dtype=np.float64, keepdims=True))[0]
    return {
        name: None if values is None else (values / np.where(sums > 0.0, sums, 1.0)).astype(np.float32)
        for name, values in weights.items()
    }


def _decode_draco(document: Document, data: bytes, where: str) -> Any:
    try:
        import DracoPy
    except ImportError:
        raise FormatError(
            f"{document.file}: is compressed with Draco ({DRACO}), which needs the package DracoPy. Install "
            "cagemap[draco], or write it without by `gltf-transform cp IN.glb OUT.glb` (npm package "
            "@gltf-transform/cli)."
        ) from None
    try:
        decoded = DracoPy.decode(data)
        if not len(decoded.faces):
            raise ValueError("no faces")
    except (DracoPy.FileTypeException, ValueError, AttributeError, TypeError) as error:
        document.refuse(where, f"its Draco data cannot be read ({error})")
    return decoded


GLTF_SUFFIXES = (".glb", ".gltf", ".vrm")
# Suffixes of files that are read as a glTF document.
SCENE_SUFFIXES = (*GLTF_SUFFIXES, ".fbx")
_TRANSFORM = "`gltf-transform cp IN.glb OUT.glb` (npm package @gltf-transform/cli) writes the file without it"
_WAYS_ROUND = {
    "EXT_meshopt_compression": _TRANSFORM,
    "KHR_meshopt_compression": _TRANSFORM,
    "KHR_texture_basisu": "`gltf-transform ktxdecompress IN.glb OUT.glb` (npm package @gltf-transform/cli) writes "
    "PNG textures",
    "EXT_mesh_gpu_instancing": "Export it without instancing",
}
_HEAD, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")


def read_document(path: str | Path) -> Document:
    """Read a glTF 2.0 or FBX file as a document with its buffers; nothing is fetched from a network."""
    file = Path(path)
    content = fbx_as_glb(file) if file.suffix.lower() == ".fbx" else read_bytes(file, "a glTF file")
    text, blob = _chunks(file, content) if content[:4] == b"glTF" else (content, None)
    document = Document(_parse_json(file, text), (), file)
    asset = document.table(document.json, "asset", "glTF")
    if str(asset.get("version", "")).partition(".")[0] != "2":
        document.refuse("asset", f"expected glTF version 2.0, got {shown(asset.get('version'))}", "Export it as 2.0.")
    for name in document.entries("extensionsRequired"):
        if not is_known_extension(name):
            remedy, word = _WAYS_ROUND.get(str(name), "Export it without this extension"), whole_characters(str(name))
            raise FormatError(f"{file}: requires the extension {word}, which cagemap does not read. {remedy}.")
    require_structure(document)
    buffers = tuple(_buffer(document, number, blob) for number in range(len(document.entries("buffers"))))
    return decompress_draco(Document(document.json, buffers, file))


def json_text(path: Path) -> str:
    """The JSON of a GLB, read without its buffers; '' if the file is cut short."""
    with path.open("rb") as stream:
        head = stream.read(_HEAD.size + _CHUNK.size)
        size = _CHUNK.unpack_from(head, _HEAD.size)[0] if len(head) == _HEAD.size + _CHUNK.size else 0
        return stream.read(size).decode("utf-8", errors="replace")


def _chunks(file: Path, content: bytes) -> tuple[bytes, bytes | None]:
    """JSON and binary chunk of a GLB."""
    if len(content) < _HEAD.size + _CHUNK.size:
        raise FormatError(f"{file}: expected a GLB, got {len(content)} bytes. The file is cut short. {REMEDY}")
    _, version, length = _HEAD.unpack_from(content)
    if version != 2:
        raise FormatError(f"{file}: expected GLB version 2, got {version}. Export it as glTF 2.0.")
    if length > len(content):
        raise FormatError(
            f"{file}: expected a GLB of {length} bytes, got {len(content)}. The file is cut short. {REMEDY}"
        )
    chunks: dict[bytes, bytes] = {}
    at = _HEAD.size
    while at + _CHUNK.size <= length:
        size, kind = _CHUNK.unpack_from(content, at)
        at += _CHUNK.size
        if at + size > length:
            raise FormatError(f"{file}: a chunk of {size} bytes ends after the file of {length} bytes. {REMEDY}")
        chunks.setdefault(kind, content[at : at + size])
        at += size
    if b"JSON" not in chunks:
        raise FormatError(f"{file}: expected a JSON chunk in the GLB, got none. {REMEDY}")
    return chunks[b"JSON"], chunks.get(b"BIN\0")


def _parse_json(file: Path, text: bytes) -> dict[str, Any]:
    def constant(word: str) -> NoReturn:
        raise ValueError(f"the number {word}")

    try:
        parsed = json.loads(text.decode("utf-8-sig"), parse_constant=constant)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{file}: expected glTF, a JSON document, got something else ({error}). {REMEDY}") from None
    if not isinstance(parsed, dict) or "asset" not in parsed:
        raise FormatError(f"{file}: expected glTF, a JSON object with an asset, got other JSON. {REMEDY}")
    return parsed


def _buffer(document: Document, number: int, blob: bytes | None) -> bytes:
    entry, where = document.entry("buffers", number), f"buffers {number}"
    length = document.whole(entry.get("byteLength"), f"{where}: byteLength", 1)
    uri = entry.get("uri")
    if uri is None and (number or blob is None):
        document.refuse(where, "has no data in the file")
    data = blob if uri is None else resource(document, uri, where)
    assert data is not None
    if len(data) < length:
        document.refuse(where, f"expected {length} bytes, got {len(data)}. The data is cut short")
    return data[:length]


def pack_document(document: Document) -> Document:
    """The document with one buffer that holds its images too, and with cagemap's mark."""
    parts: list[bytes] = []
    length = 0

    def add(data: bytes) -> int:
        nonlocal length
        start = length
        parts.extend((data, b"\0" * (-len(data) % 4)))
        length += len(data) + -len(data) % 4
        return start

    starts = [add(buffer) for buffer in document.buffers]
    views = []
    for number, view in enumerate(document.entries("bufferViews")):
        moved = starts[view["buffer"]] + document.whole(view.get("byteOffset", 0), f"bufferViews {number}")
        views.append(view | {"buffer": 0, "byteOffset": moved} if moved else view | {"buffer": 0})
    images = []
    for number in range(len(document.entries("images"))):
        entry = document.entry("images", number)
        if "uri" in entry:
            data, suffix = image_bytes(document, number)
            views.append({"buffer": 0, "byteOffset": add(data), "byteLength": len(data)})
            kept = {name: value for name, value in entry.items() if name != "uri"}
            entry = kept | {"bufferView": len(views) - 1, "mimeType": image_type(suffix)}
        images.append(entry)
    asset = document.table(document.json, "asset", "glTF")
    extras = asset.get("extras", {})
    marked = {"extras": extras | {"mark": mark()}} if isinstance(extras, dict) else {}
    changed: dict[str, Any] = {"bufferViews": views, "images": images}
    if parts:
        first = document.entry("buffers", 0) if document.buffers else {}
        changed["buffers"] = [{name: v for name, v in first.items() if name != "uri"} | {"byteLength": length}]
    # The asset first: readers search the mark near the start of a file.
    top = {"asset": asset | marked} | {name: value for name, value in document.json.items() if name != "asset"}
    top |= {name: value for name, value in changed.items() if value}
    return Document(top, (b"".join(parts),) if parts else (), document.file)


def glb_bytes(document: Document) -> bytes:
    """A document as a binary file (GLB)."""
    document = pack_document(document)
    text = _dump_json(document)
    text += b" " * (-len(text) % 4)
    chunks = [_CHUNK.pack(len(text), b"JSON"), text]
    for blob in document.buffers:
        chunks += [_CHUNK.pack(len(blob), b"BIN\0"), blob]
    return b"".join([_HEAD.pack(b"glTF", 2, _HEAD.size + sum(map(len, chunks))), *chunks])


def _dump_json(document: Document) -> bytes:
    try:
        return json.dumps(document.json, separators=(",", ":"), allow_nan=False).encode()
    except ValueError:
        raise FormatError(f"{document.file}: holds numbers that are not finite. {REMEDY}") from None


def write_document(path: str | Path, document: Document, *, force: bool = False) -> None:
    """Write a document as one file with buffers and images: `.glb` and `.vrm` binary, `.gltf` as text."""
    require_suffix(Path(path), GLTF_SUFFIXES)
    if Path(path).suffix.lower() != ".gltf":
        write_whole(path, glb_bytes(document), force=force)
        return
    whole = pack_document(document)
    inside = [
        entry | {"uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode()}
        for entry, data in zip(whole.entries("buffers"), whole.buffers, strict=True)
    ]
    top = whole.json | ({"buffers": inside} if inside else {})
    write_whole(path, _dump_json(Document(top, whole.buffers, whole.file)), force=force)
