"""The colour texture inside a glTF, FBX or USD file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cagemap.files import IMAGE_SUFFIXES
from cagemap.files.gltf.document import SCENE_SUFFIXES, read_document
from cagemap.files.gltf.entries import image_bytes
from cagemap.files.gltf.material_images import MaterialImage, material_images, write_numbered
from cagemap.files.gltf.primitives import material_names
from cagemap.files.usd.convert import usd_document
from cagemap.files.usd.stages import USD_SUFFIXES, is_usd
from cagemap.mesh import ControlMesh

SUFFIXES = (*SCENE_SUFFIXES, *USD_SUFFIXES)
_COLOR_SLOT = "baseColorTexture"


def extract_texture(path: Path, control: ControlMesh, folder: Path) -> Path | None:
    """Write the colour texture of most of a mesh's faces from its file.

    None if its image, repeated over the mesh's UV set in use, does not show the texture, or for a file without images.
    """
    if path.suffix.lower() not in SUFFIXES or control.face_materials is None or control.uvs is None:
        return None
    document = usd_document(path) if is_usd(path) else read_document(path)
    most = control.material_names[int(np.bincount(control.face_materials + 1, minlength=2)[1:].argmax())]
    slots = material_images(document, most) if most in material_names(document) else ()
    texture = next((slot for slot in slots if slot.slot == _COLOR_SLOT and _is_repeated_over(slot, control)), None)
    if texture is None:
        return None
    data, suffix = image_bytes(document, texture.image)
    if suffix not in IMAGE_SUFFIXES:
        return None
    return write_numbered(folder / f"{path.stem}_texture{suffix}", data)


def _is_repeated_over(texture: MaterialImage, control: ControlMesh) -> bool:
    """Whether a texture's image, repeated over a mesh's UV set in use, shows the texture."""
    in_use = control.uv_name if control.uv_name.startswith("TEXCOORD_") else "TEXCOORD_0"
    assert control.uvs is not None
    is_plain = np.allclose(texture.transform, np.eye(3)) and texture.repeats(control.uvs)
    return texture.uv_set == in_use and is_plain
