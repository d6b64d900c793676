"""Downloads: outputs of a finish, one by one or all in a zip."""

from __future__ import annotations

import io
import mimetypes
import tempfile
import zipfile
from collections.abc import Collection, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from cagemap.files.gltf.document import glb_bytes, read_document
from cagemap.files.gltf.textures import with_images
from cagemap.files.gltf.write import write_glb
from cagemap.files.images.image import UDIM_MARK, png_bytes, read_image
from cagemap.files.meshes.colors import read_material_statements
from cagemap.files.meshes.formats import read_whole
from cagemap.files.meshes.obj import MATERIAL_FILE_LINE, material_files
from cagemap.files.text import read_text
from cagemap.files.usd.space import to_standard
from cagemap.files.usd.stages import is_usd
from cagemap.studio.scene import Scene
from cagemap.studio.state import Output, StudioState, color_images, image_uv_set, layout_mesh

ARCHIVE_NAME = "all.zip"
# Material of parts that are not open.
_OTHER_PARTS, _GREY = "other parts", [0.6] * 3
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
    """File name of the target with the first baked image of colours; None without one."""
    image = _first_image(state)
    return None if image is None or state.files is None else f"{image.stem}.glb"


def textured_model(state: StudioState, scene: Scene | None) -> bytes:
    """The target with the first baked image of colours, as binary glTF; parts that are not open are grey."""
    image = _first_image(state)
    assert image is not None
    assert state.files is not None
    layout = layout_mesh(state, image)
    target = state.files.target
    upright = (read_whole(target) if scene is None else scene.target.file_mesh).upright  # a layout is an OBJ, without
    # glTF multiplies vertex colours with the image.
    mesh = replace(read_whole(layout or target), upright=upright, vertex_colors=None)
    opened = None if scene is None or mesh.n_vertices != scene.target.file_mesh.n_vertices else scene.target
    uv_set = image_uv_set(state, image) or (None if opened is None else opened.control.uv_name)
    if layout is None and uv_set:
        mesh = replace(mesh.with_uv_set(uv_set), uv_name="")  # written first: named sets keep their numbers
    materials = np.zeros(mesh.n_faces, dtype=np.int64)
    if opened is not None:
        is_open = opened.to_control_vertices(np.arange(mesh.n_vertices)) >= 0
        materials[mesh.corner_faces[~is_open[mesh.face_indices]]] = 1
    names, colors = (image.stem, _OTHER_PARTS)[: 1 + materials.max()], np.array([[1.0] * 3, _GREY])
    mesh = replace(mesh, face_materials=materials, material_names=names, material_colors=colors[: len(names)])
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mesh.glb"
        write_glb(file, mesh, to_metres=to_standard(target) if is_usd(target) else None)
        slots = {(image.stem, "baseColorTexture"): png_bytes(read_image(image))}
        return glb_bytes(with_images(read_document(file), slots))


def _first_image(state: StudioState) -> Path | None:
    """The first baked image of colours that is not tiled."""
    return next((image for image in color_images(state.outputs) if UDIM_MARK not in image.name), None)


def archive_name(folder: Path) -> str:
    """Name of a folder's zip."""
    return f"{folder.name}.zip"


def zip_outputs(outputs: Iterable[Output]) -> bytes:
    """Outputs and the files in their folders as a zip, whose OBJ files name material files in it only."""
    named = {
        file: file.relative_to(output.path.parent) for output in outputs for file in sorted(_regular_files(output.path))
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for file, name in named.items():
            contents = _with_one_library(file, named.keys()) if file.suffix.lower() == ".obj" else {}
            if not contents:
                is_compressed = file.suffix.lower() in _COMPRESSED_SUFFIXES
                archive.write(file, name, zipfile.ZIP_STORED if is_compressed else zipfile.ZIP_DEFLATED)
            for other, text in contents.items():
                archive.writestr(str(name.with_name(other)), text)
    return buffer.getvalue()


def _with_one_library(mesh: Path, archived: Collection[Path]) -> dict[str, str]:
    """An OBJ and one ``.mtl`` without images, by name; empty if the archive has all its material files."""
    text = read_text(mesh, "an OBJ file")
    files = material_files(mesh, text)
    if len(files) == len(MATERIAL_FILE_LINE.findall(text)) and all(file in archived for file in files):
        return {}
    statements = dict[str, list[str]]()
    for file in files:
        statements = read_material_statements(file) | statements
    library = f"{mesh.stem}_materials.mtl"
    materials = (f"newmtl {name}\n" + "".join(f"{line}\n" for line in lines) for name, lines in statements.items())
    return {mesh.name: f"mtllib {library}\n{MATERIAL_FILE_LINE.sub('', text)}", library: "".join(materials)}


def _regular_files(path: Path) -> list[Path]:
    """The file, or the regular files of a folder."""
    if not path.is_dir():
        return [path] if path.is_file() else []
    return [file for file in path.rglob("*") if file.is_file() and not file.is_symlink()]
