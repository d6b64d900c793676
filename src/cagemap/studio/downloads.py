"""Downloads: outputs of a finish, one by one or all in a zip."""

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
from cagemap.studio.state import Output, StudioState, layout_mesh

ARCHIVE_NAME = "all.zip"
# Not compressed again.
_COMPRESSED_SUFFIXES = (".png", ".jpg", ".jpeg", ".exr", ".npz", ".usdz", ".zip")


def output_content(outputs: Iterable[Output], name: str) -> tuple[bytes, str] | None:
    """Content and media type of an output by its name, or None; folders are zips.

    The name is only compared, never used as a path.
    """
    listed = tuple(outputs)
    if name == ARCHIVE_NAME and listed:
        return zip_outputs(listed), "application/zip"
    folder = next((output for output in listed if output.path.is_dir() and archive_name(output.path) == name), None)
    if folder is not None:
        return zip_outputs((folder,)), "application/zip"
    file = next((output.path for output in listed if output.path.name == name and output.path.is_file()), None)
    if file is None:
        return None
    return file.read_bytes(), mimetypes.guess_type(file.name)[0] or "application/octet-stream"


def textured_model_name(state: StudioState) -> str | None:
    """File name of the target with the first baked image; None without an image."""
    image = _first_image(state)
    return None if image is None or state.files is None else f"{image.stem}.glb"


def textured_model(state: StudioState) -> bytes:
    """The target with the first baked image, as binary glTF."""
    image = _first_image(state)
    assert image is not None
    assert state.files is not None
    layout = layout_mesh(state, image)
    mesh = read_whole(layout or state.files.target)
    if layout is None and state.uv_set is not None:
        mesh = replace(mesh.with_uv_set(state.uv_set), uv_name="")  # written first: named sets keep their numbers
    materials = np.zeros(mesh.n_faces, dtype=np.int64)
    mesh = replace(mesh, face_materials=materials, material_names=(image.stem,), material_colors=np.ones((1, 3)))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mesh.glb"
        write_glb(file, mesh)
        slots = {(image.stem, "baseColorTexture"): png_bytes(read_image(image))}
        return glb_bytes(with_images(read_document(file), slots))


def _first_image(state: StudioState) -> Path | None:
    """The first baked image that is not tiled."""
    return next((image for image in state.baked_images if UDIM_MARK not in image.name), None)


def archive_name(folder: Path) -> str:
    """Name of a folder's zip."""
    return f"{folder.name}.zip"


def zip_outputs(outputs: Iterable[Output]) -> bytes:
    """Outputs and the files in their folders as a zip."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for output in outputs:
            for file in sorted(_regular_files(output.path)):
                is_compressed = file.suffix.lower() in _COMPRESSED_SUFFIXES
                compression = zipfile.ZIP_STORED if is_compressed else zipfile.ZIP_DEFLATED
                archive.write(file, file.relative_to(output.path.parent), compression)
    return buffer.getvalue()


def _regular_files(path: Path) -> list[Path]:
    """The file, or the regular files of a folder."""
    if not path.is_dir():
        return [path] if path.is_file() else []
    return [file for file in path.rglob("*") if file.is_file() and not file.is_symlink()]
