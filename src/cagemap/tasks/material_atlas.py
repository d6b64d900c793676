"""The colour images of all materials of a mesh file as one image, and the mesh's UVs on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import read_material_image
from cagemap.files.images.image import Image, Pixels
from cagemap.files.inner_texture import color_image, color_texture, is_of_set_in_use
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import UNKNOWN_COLOR
from cagemap.numerics.arrays import FloatArray, IndexArray, encode_srgb
from cagemap.transfer.baking import convert_dtype, to_dtype, unit

# Width in texels of the border around each image, which repeats its edge: neighbours do not mix when it is filtered.
_BORDER = 16
_COLOR_SIDE = 8  # texels a side for a material without an image
_MAX_SIDE = 16_384
_ROUNDING = 1e-4  # UVs that leave an image by less do not repeat it


@dataclass(frozen=True, eq=False)
class MaterialAtlas:
    """The images of several materials side by side, and the mesh with its UVs on them."""

    image: Image
    control: ControlMesh
    size: int  # largest side of a material's image, in texels


def material_atlas(document: Document | None, control: ControlMesh) -> MaterialAtlas | None:
    """The colour images of a mesh's `material_document`, side by side; colours for materials without an image.

    Materials that the file does not have get the image that most faces have. None if all faces have the same image,
    without UVs or materials, if an image belongs to another UV set than that in use or holds floats, or if the images,
    as often as UVs repeat them, take too many texels.
    """
    most = color_texture(document, control, of_any=True)
    if document is None or most is None or control.face_materials is None:
        return None
    if control.uvs is None or control.uv_indices is None:
        return None
    used, material_of_face = np.unique(control.face_materials, return_inverse=True)
    named = [number >= 0 and control.material_names[number] in material_names(document) for number in used.tolist()]
    found = [
        color_image(document, control.material_names[number]) if known else most
        for number, known in zip(used.tolist(), named, strict=True)
    ]
    if any(image is not None and not is_of_set_in_use(image, document, control) for image in found):
        return None
    colors = [_color(control, material) for material in used.tolist()]
    keys = [  # equal for the same image with the same wrapping and transform
        color if image is None else (image.image, image.wraps, *image.transform.ravel().tolist())
        for image, color in zip(found, colors, strict=True)
    ]
    looks = dict(zip(keys, found, strict=True))
    if len(looks) < 2:
        return None
    images = [None if image is None else read_material_image(document, image) for image in looks.values()]
    read = [image for image in images if image is not None]
    dtype = max((image.pixels.dtype for image in read), key=lambda one: one.itemsize)
    if any(image.pixels.dtype.kind != "u" for image in read):
        return None
    channels = 4 if any(image.pixels.shape[2] in (2, 4) for image in read) else 3

    cell_of_face = np.array([list(looks).index(key) for key in keys])[material_of_face.ravel()]
    corners = np.column_stack([control.uv_indices, np.repeat(cell_of_face, control.face_sizes)])
    places, uv_indices = np.unique(corners, axis=0, return_inverse=True)
    uvs, cells = control.uvs[places[:, 0]], list[Pixels]()
    for cell, ((key, laid), image) in enumerate(zip(looks.items(), images, strict=True)):
        inside = places[:, 1] == cell
        if image is None or laid is None:
            color = np.tile(np.array(key), (_COLOR_SIDE, _COLOR_SIDE, 1)) * unit(dtype)
            pixels, uvs[inside] = to_dtype(color, dtype), 0.5
        elif (repeated := _tile_image(*laid.repeating(image.pixels, laid.on_image(uvs[inside])))) is not None:
            pixels, uvs[inside] = repeated
        else:
            return None
        cells.append(_with_channels(convert_dtype(pixels, dtype), channels))
    laid_out = _join_images(cells, uvs, places[:, 1])
    if laid_out is None:
        return None
    atlas, uvs = laid_out
    size = max(max(image.size) for image in read)
    return MaterialAtlas(
        replace(read[0], pixels=atlas, channel_names=()), control.with_uvs(uvs, uv_indices.ravel()), size
    )


def _color(control: ControlMesh, material: int) -> tuple[object, ...]:
    """The colour of a material, in sRGB from 0 to 1."""
    known = None if control.material_colors is None or material < 0 else control.material_colors[material]
    color = np.full(3, UNKNOWN_COLOR) if known is None or not np.isfinite(known).all() else known
    return tuple(encode_srgb(color).tolist())


def _tile_image(pixels: Pixels, uvs: FloatArray) -> tuple[Pixels, FloatArray] | None:
    """An image tiled as often as UVs (m, 2) repeat it, and these scaled to 0 to 1; None if it gets too large."""
    first = np.floor(uvs.min(axis=0) + _ROUNDING)
    times = np.maximum(np.ceil(uvs.max(axis=0) - _ROUNDING) - first, 1.0)
    if (times * pixels.shape[1::-1] > _MAX_SIDE).any():
        return None
    return np.tile(pixels, (int(times[1]), int(times[0]), 1)), (uvs - first) / times


def _with_channels(pixels: Pixels, channels: int) -> Pixels:
    """Pixels with 3 or 4 channels: grey becomes RGB, missing alpha is opaque."""
    color = pixels[..., :3] if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    opaque = np.full_like(color[..., :1], unit(pixels.dtype))
    alpha = pixels[..., -1:] if pixels.shape[2] in (2, 4) else opaque
    return color if channels == 3 else np.concatenate([color, alpha], axis=2)


def _join_images(cells: list[Pixels], uvs: FloatArray, cell_of_uv: IndexArray) -> tuple[Pixels, FloatArray] | None:
    """One image of several, each with a border of its edge texels, and the UVs on it; None if it gets too large."""
    columns = int(np.ceil(np.sqrt(len(cells))))
    height, width = (max(cell.shape[axis] for cell in cells) + 2 * _BORDER for axis in (0, 1))
    rows = -(-len(cells) // columns)
    if max(rows * height, columns * width) > _MAX_SIDE:
        return None
    atlas = np.zeros((rows * height, columns * width, cells[0].shape[2]), dtype=cells[0].dtype)
    placed = np.empty_like(uvs)
    for number, cell in enumerate(cells):
        row, column = divmod(number, columns)
        h, w = cell.shape[:2]
        border = ((_BORDER, height - h - _BORDER), (_BORDER, width - w - _BORDER), (0, 0))
        atlas[row * height :, column * width :][:height, :width] = np.pad(cell, border, mode="edge")
        inside = cell_of_uv == number
        left, top = column * width + _BORDER, row * height + _BORDER
        placed[inside, 0] = (left + uvs[inside, 0] * w) / atlas.shape[1]
        placed[inside, 1] = 1.0 - (top + (1.0 - uvs[inside, 1]) * h) / atlas.shape[0]
    return atlas, placed
