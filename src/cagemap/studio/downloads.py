"""What the page gives out: the files that a finish wrote, by name, and all of them together."""

from __future__ import annotations

import io
import mimetypes
import tempfile
import zipfile
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from cagemap.files.gltf.document import glb_bytes, read_document
from cagemap.files.gltf.material_images import png_bytes
from cagemap.files.gltf.textures import with_images
from cagemap.files.gltf.write import write_glb
from cagemap.files.images.image import UDIM_MARK, read_image
from cagemap.files.meshes.formats import read_whole
from cagemap.studio.state import Output, Studio, layout_of

ALL = "all.zip"
# Formats that are packed already.
_PACKED = (".png", ".jpg", ".jpeg", ".exr", ".npz", ".usdz", ".zip")


def content(outputs: Iterable[Output], name: str) -> tuple[bytes, str] | None:
    """Content and media type of an output of that very name; folders, and all together, are zips; None for other names.

    The name is compared, never joined to a folder.
    """
    listed = tuple(outputs)
    if name == ALL and listed:
        return zipped(listed), "application/zip"
    folder = next((one for one in listed if one.path.is_dir() and archive_name(one.path) == name), None)
    if folder is not None:
        return zipped((folder,)), "application/zip"
    found = next((output.path for output in listed if output.path.name == name and output.path.is_file()), None)
    if found is None:
        return None
    return found.read_bytes(), mimetypes.guess_type(found.name)[0] or "application/octet-stream"


def textured_name(state: Studio) -> str | None:
    """What the target with the last bake's first image is called as one file; None without such an image."""
    image = next((one for one in state.images if UDIM_MARK not in one.name), None)
    return None if image is None or state.files is None else f"{image.stem}.glb"


def textured(state: Studio) -> bytes:
    """The target with the last bake's first image, as binary glTF."""
    assert state.files is not None
    image = next(one for one in state.images if UDIM_MARK not in one.name)
    mesh = read_whole(layout_of(state, image) or state.files.target)
    whole = np.zeros(mesh.n_faces, dtype=np.int64)
    mesh = replace(mesh, face_materials=whole, material_names=(image.stem,), material_colors=np.ones((1, 3)))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mesh.glb"
        write_glb(file, mesh)
        slots = {(image.stem, "baseColorTexture"): png_bytes(read_image(image))}
        return glb_bytes(with_images(read_document(file), slots))


def archive_name(folder: Path) -> str:
    """What a folder is called as one file."""
    return f"{folder.name}.zip"


def zipped(outputs: Iterable[Output]) -> bytes:
    """All outputs in one archive, folders with what is in them."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for output in outputs:
            for file in sorted(_files(output.path)):
                kind = zipfile.ZIP_STORED if file.suffix.lower() in _PACKED else zipfile.ZIP_DEFLATED
                archive.write(file, file.relative_to(output.path.parent), kind)
    return packed.getvalue()


def _files(path: Path) -> list[Path]:
    """The file, or the regular files of a folder."""
    if not path.is_dir():
        return [path] if path.is_file() else []
    return [file for file in path.rglob("*") if file.is_file() and not file.is_symlink()]
