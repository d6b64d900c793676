"""The colour texture inside a glTF, FBX or USD file, or that an OBJ or PLY file names."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cagemap.files import IMAGE_SUFFIXES
from cagemap.files.gltf.document import SCENE_SUFFIXES, read_document
from cagemap.files.gltf.entries import Document, image_bytes
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import (
    MaterialImage,
    material_images,
    read_material_image,
    write_numbered,
)
from cagemap.files.images.image import png_bytes
from cagemap.files.meshes.obj_materials import obj_document
from cagemap.files.meshes.ply import ply_document, ply_image
from cagemap.files.usd.convert import usd_document
from cagemap.files.usd.stages import USD_SUFFIXES, is_usd
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import place_text

SUFFIXES = (*SCENE_SUFFIXES, *USD_SUFFIXES, ".obj", ".ply")
_COLOR_SLOT = "baseColorTexture"


def color_image(document: Document, material: str) -> MaterialImage | None:
    """The colour texture of a material of a document; None without one."""
    return next(iter(material_images(document, material, _COLOR_SLOT)), None)


def material_document(path: Path, control: ControlMesh) -> Document | None:
    """A mesh's file, or its materials alone, as a glTF document; None if its faces cannot show an image of it."""
    if path.suffix.lower() not in SUFFIXES or control.face_materials is None or control.uvs is None:
        return None
    if path.suffix.lower() == ".obj":
        return obj_document(path)
    if path.suffix.lower() == ".ply":
        return ply_document(path, control)
    return usd_document(path) if is_usd(path) else read_document(path)


def color_texture(document: Document | None, control: ControlMesh, *, of_any: bool = False) -> MaterialImage | None:
    """The colour texture of most of a mesh's faces in its `material_document`.

    None without one, or if it belongs to another UV set than that in use.
    ``of_any``: if the material of most faces has none, take that of the next.
    """
    if document is None or control.face_materials is None:
        return None
    counts = np.bincount(control.face_materials + 1, minlength=2)[1:]
    order = np.argsort(-counts, kind="stable")[: np.count_nonzero(counts) if of_any else 1]
    names = [control.material_names[number] for number in order.tolist()]
    images = (color_image(document, name) for name in names if name in material_names(document))
    found = next((image for image in images if image is not None), None)
    return found if found is not None and is_of_set_in_use(found, document, control) else None


def is_of_set_in_use(image: MaterialImage, document: Document, control: ControlMesh) -> bool:
    """Whether a colour texture belongs to the UV set in use: by the name that a shader states, else by number."""
    stated = document.uv_names.get(image.material)
    if stated in [one.name for one in control.all_uv_sets]:
        return stated == control.uv_name
    return image.uv_set == (control.uv_name if control.uv_name.startswith("TEXCOORD_") else "TEXCOORD_0")


def tinted_materials(document: Document, control: ControlMesh) -> list[str]:
    """Materials whose image glTF multiplies by a colour (``baseColorFactor``), with that colour."""
    if control.face_materials is None or color_texture(document, control, of_any=True) is None:
        return []
    names = material_names(document)
    used = {control.material_names[number] for number in np.unique(control.face_materials).tolist() if number >= 0}
    tinted = []
    for name in sorted(used.intersection(names)):
        surface = document.table(document.entry("materials", names.index(name)), "pbrMetallicRoughness", name)
        color = document.numbers(surface.get("baseColorFactor", [1.0] * 4), f"{name}: baseColorFactor", 4)[:3]
        if _COLOR_SLOT in surface and not np.allclose(color, 1.0):
            tinted.append(f"{name} {place_text(color)}")
    return tinted


def extract_texture(path: Path, control: ControlMesh, folder: Path) -> Path | None:
    """Write the image of a mesh's `repeated_texture`; None without one.

    The image that a PLY file names is not written again.
    """
    if control.uvs is not None and (image := ply_image(path)) != path:
        return image
    document = material_document(path, control)
    found = repeated_texture(document, control)
    return None if document is None or found is None else write_texture(path, document, found, folder)


def repeated_texture(document: Document | None, control: ControlMesh) -> MaterialImage | None:
    """A mesh's `color_texture`; None if repeating its image over the UVs does not show the texture."""
    found = color_texture(document, control)
    return found if found is not None and control.uvs is not None and found.is_repeated_over(control.uvs) else None


def write_texture(path: Path, document: Document, texture: MaterialImage, folder: Path) -> Path:
    """Write an image that a document of the file ``path`` contains; of another format than `IMAGE_SUFFIXES` as PNG."""
    data, suffix = image_bytes(document, texture.image)
    if suffix not in IMAGE_SUFFIXES:
        data, suffix = png_bytes(read_material_image(document, texture)), ".png"
    return write_numbered(folder / f"{path.stem}_texture{suffix}", data)
