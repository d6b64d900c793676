"""Drawings of the models with their own materials, and the source's on the target."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from typing import Self

import imageio.v3 as imageio
import numba
import numpy as np
from numpy.typing import NDArray

from cagemap.files.images.image import Pixels
from cagemap.numerics.arrays import FloatArray, IndexArray, read_only
from cagemap.numerics.arrays import encode_srgb as to_display
from cagemap.numerics.threads import kept
from cagemap.pictures.camera import turn_angle
from cagemap.pictures.textures import repeated_uvs
from cagemap.studio.file_parts import OtherParts
from cagemap.studio.glb import MeshPart, pack_glb
from cagemap.studio.shape import Shape
from cagemap.transfer.locate import walk_from

# Displayed colour of a model without materials.
CLAY_COLOR = np.array([0.69, 0.68, 0.67])
# Places with less trust are marked.
DOUBTFUL_TRUST = 0.5
# A seam lies between corners whose texture coordinates differ from the predicted step by more than this share of it.
SEAM_TOLERANCE = 0.6
# Samples along a side of a triangle at a seam or material border, and of all these triangles together.
_MIN_SAMPLES_PER_SIDE, _MAX_SAMPLES_PER_SIDE, _MAX_SAMPLES = 3, 8, 50_000


@dataclass(frozen=True, eq=False)
class Look:
    """Texture and colours of a model."""

    texture: Pixels | None = None  # (h, w, c) as displayed, 8 bits; tiles side by side
    jpeg: bytes | None = None  # the texture as a JPEG file
    tiles: tuple[int, int] = (1, 1)  # columns and rows of tiles in the texture
    colors: FloatArray | None = None  # (faces, 3) linear material colours of the control faces
    other_parts: OtherParts | None = None

    def to_image_uvs(self, uvs: FloatArray) -> FloatArray:
        """Texture coordinates in the image of all tiles."""
        return uvs / self.tiles


@dataclass(frozen=True, eq=False)
class DrawnModel:
    """A model in the view."""

    shape: Shape
    look: Look

    def with_shape(self, shape: Shape) -> Self:
        """The model with another shape; itself, with all that it keeps, if it has this one."""
        return self if shape is self.shape else replace(self, shape=shape)

    @kept
    def geometry(self) -> tuple[IndexArray, IndexArray, dict[str, FloatArray]]:
        """The model as it is drawn without a map: triangles, and for each vertex its shape vertex and attributes.

        Has one vertex for each combination of point, texture coordinates and colour.
        """
        shape, look = self.shape, self.look
        columns = [shape.triangles]
        if shape.uv_triangles is not None:
            columns.append(shape.uv_triangles)
        if look.colors is not None:
            palette, color = np.unique(look.colors, axis=0, return_inverse=True)
            columns.append(np.repeat(color.ravel()[shape.faces][:, None], 3, axis=1))
        key = np.zeros(shape.triangles.size, dtype=np.int64)
        for column in columns:
            key = key * (column.max(initial=0) + 1) + column.ravel()
        _, first, corners = np.unique(key, return_index=True, return_inverse=True)
        vertex = shape.triangles.ravel()[first]
        attributes: dict[str, FloatArray] = {
            "POSITION": shape.to_view(shape.positions[vertex]),
            "NORMAL": shape.directions_to_view(shape.normals[vertex]),
            "COLOR_1": np.broadcast_to(CLAY_COLOR, (len(vertex), 3)),
        }
        if shape.uvs is not None and shape.uv_triangles is not None:
            attributes["TEXCOORD_1"] = shape.uvs[shape.uv_triangles.ravel()[first]]
        if look.colors is not None:
            attributes["COLOR_1"] = to_display(palette)[columns[-1].ravel()[first]]
        return corners.reshape(-1, 3), vertex, attributes

    @kept
    def other_part_meshes(self) -> tuple[MeshPart, ...]:
        """Parts of the file that are not open, as they are drawn."""
        parts, shape = self.look.other_parts, self.shape
        if parts is None:
            return ()
        attributes = {"POSITION": shape.to_view(parts.positions), "NORMAL": shape.directions_to_view(parts.normals)}
        return (MeshPart("other_parts", attributes, parts.triangles),)


@dataclass(frozen=True, eq=False)
class PreviewMap:
    """Images of a target shape's vertices on the source shape."""

    triangle: IndexArray  # (n,)
    barycentric: FloatArray  # (n, 3)
    trust: FloatArray  # (n,)

    def pull_back(self, triangles: IndexArray, values: FloatArray) -> FloatArray:
        """Interpolate values at corners of source triangles at the image of each target vertex."""
        corners = triangles.take(self.triangle, axis=0)
        return np.asarray(np.einsum("nc,ncd->nd", self.barycentric, values.take(corners, axis=0)))


def align_facing(source: Shape, target: Shape, preview_map: PreviewMap | None) -> Shape:
    """Rotate the source by quarter turns to face like the target under a map."""
    if preview_map is None:
        return source
    images = preview_map.pull_back(source.triangles, source.directions_to_view(source.positions))
    quarters = round(turn_angle(images, target.directions_to_view(target.positions)) / 90) % 4
    if not quarters:
        return source
    cos, sin = ((0, 1), (-1, 0), (0, -1))[quarters - 1]
    return replace(source, rotation=source.rotation @ [[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])


def source_skin(model: DrawnModel) -> bytes:
    """The source with its own materials, as binary glTF in view coordinates.

    COLOR_1: material colours; TEXCOORD_0: texture coordinates in the image "texture".
    """
    look, (corners, _, geometry) = model.look, model.geometry
    images = {} if look.jpeg is None else {"texture": look.jpeg}
    attributes = {name: values for name, values in geometry.items() if name != "TEXCOORD_1"}
    if "TEXCOORD_1" in geometry and images:
        attributes["TEXCOORD_0"] = look.to_image_uvs(geometry["TEXCOORD_1"])
    return pack_glb([MeshPart("model", attributes, corners), *model.other_part_meshes], images)


def target_skin(
    target_model: DrawnModel, source_model: DrawnModel, preview_map: PreviewMap | None, baked: bytes | None = None
) -> bytes:
    """The target with its own and the source's materials, as binary glTF in view coordinates.

    The target's own: COLOR_1, and TEXCOORD_1 in the image "baked". Under the map: ``_PLACE`` and ``_PLACE_NORMAL`` are
    image and normal on the source, ``_TRUST``, and TEXCOORD_0 or COLOR_0 of the source. Triangles across seams or
    material borders of the source form the mesh "seams", coloured by samples in the image "seams".
    """
    textures = {} if baked is None else {"baked": baked}
    corners, vertex, geometry = target_model.geometry
    if preview_map is None:
        return pack_glb([MeshPart("model", geometry, corners), *target_model.other_part_meshes], textures)
    target, source, source_look = target_model.shape, source_model.shape, source_model.look
    images = preview_map.pull_back(source.triangles, source.positions)
    attributes = geometry | {
        "_PLACE": source.to_view(images)[vertex],
        "_PLACE_NORMAL": source.directions_to_view(preview_map.pull_back(source.triangles, source.normals))[vertex],
        "_TRUST": preview_map.trust[vertex],
    }
    at_seam = np.zeros(len(corners), dtype=bool)
    if source_look.jpeg is not None and source.uvs is not None and source.uv_triangles is not None:
        uvs = preview_map.pull_back(source.uv_triangles, source.uvs)
        at_seam = seam_triangles(target, source, preview_map, images, uvs)
        attributes["TEXCOORD_0"] = source_look.to_image_uvs(uvs)[vertex]
    elif source_look.colors is not None:
        colors = source_look.colors[source.faces[preview_map.triangle]]
        at_seam = (colors[target.triangles] != colors[target.triangles[:, :1]]).any(axis=(1, 2))
        attributes["COLOR_0"] = to_display(colors)[vertex]
    seams = []
    if at_seam.any():
        uvs, textures["seams"] = _sample_image(target.triangles[at_seam], source, source_look, preview_map, images)
        seam_corners = corners[at_seam].ravel()
        seam_attributes = {name: values[seam_corners] for name, values in attributes.items()} | {"TEXCOORD_0": uvs}
        seams = [MeshPart("seams", seam_attributes, np.arange(len(seam_corners)).reshape(-1, 3))]
    model = MeshPart("model", attributes, corners[~at_seam])
    return pack_glb([model, *seams, *target_model.other_part_meshes], textures)


def _sample_image(
    corners: IndexArray, source: Shape, look: Look, preview_map: PreviewMap, images: FloatArray
) -> tuple[FloatArray, bytes]:
    """Sample source colours on target triangles: texture coordinates (3 t, 2) and a PNG.

    ``images``: (n, 3) positions of the target's vertices on the source.
    Each triangle has a square of samples; those beyond its diagonal are moved onto it.
    """
    side = int(np.clip(np.sqrt(_MAX_SAMPLES / len(corners)), _MIN_SAMPLES_PER_SIDE, _MAX_SAMPLES_PER_SIDE))
    column = np.tile(np.arange(side), side) / (side - 1)
    row = np.repeat(np.arange(side), side) / (side - 1)
    excess = np.maximum(column + row - 1, 0) / 2
    column, row = column - excess, row - excess
    weights = np.column_stack([1 - column - row, column, row])  # (side^2, 3)
    points = np.einsum("sc,tcd->tsd", weights, images[corners])
    nearest_corner = np.argmax(weights, axis=1)
    starts = preview_map.triangle[corners][:, nearest_corner]
    triangle, barycentric = walk_from(source.frames, source.surface.neighbors, starts.ravel(), points.reshape(-1, 3))
    colors = _source_colors(source, look, triangle, barycentric).reshape(len(corners), side, side, 3)
    per_row = int(np.ceil(np.sqrt(len(corners))))
    squares = np.zeros((per_row * per_row, side, side, 3), dtype=np.uint8)
    squares[: len(corners)] = colors
    pixels = squares.reshape(per_row, per_row, side, side, 3).swapaxes(1, 2).reshape(per_row * side, per_row * side, 3)
    png = io.BytesIO()
    imageio.imwrite(png, pixels, extension=".png", compress_level=1)
    down, right = np.divmod(np.arange(len(corners)), per_row)
    texels = side * np.column_stack([right, down])[:, None] + 0.5 + (side - 1) * np.array([[0, 0], [1, 0], [0, 1]])
    uvs = texels.reshape(-1, 2) / (per_row * side)
    return np.column_stack([uvs[:, 0], 1.0 - uvs[:, 1]]), png.getvalue()


def _source_colors(source: Shape, look: Look, triangle: IndexArray, barycentric: FloatArray) -> NDArray[np.uint8]:
    """(n, 3) displayed colours of the texture or materials at points of the source."""
    if look.texture is None or source.uvs is None or source.uv_triangles is None:
        assert look.colors is not None
        return np.rint(255 * to_display(look.colors[source.faces[triangle]])).astype(np.uint8)
    corners = source.uv_triangles.take(triangle, axis=0)
    return texture_colors(look, np.einsum("nc,ncd->nd", barycentric, source.uvs.take(corners, axis=0)))


def seam_triangles(
    target: Shape, source: Shape, preview_map: PreviewMap, images: FloatArray, uvs: FloatArray
) -> NDArray[np.bool_]:
    """(t,) bool: target triangles with a texture seam of the source between their corners' images.

    ``images``: (n, 3) positions of the target's vertices on the source; ``uvs``: (n, 2) the source's there.
    Texture coordinates are affine on a source triangle: extrapolated from one corner they are close to the next
    corner's, unless a seam lies between.
    """
    at_seam = np.zeros(len(target.triangles), dtype=np.bool_)
    arrays = target.triangles, source.uv_jacobians, preview_map.triangle, images, uvs
    _mark_seams(tuple(map(read_only, arrays)), at_seam)
    return at_seam


@numba.njit(cache=True, nogil=True)
def _mark_seams(arrays, at_seam):  # type: ignore[no-untyped-def]
    """Mark triangles with an edge across a seam."""
    triangles, jacobians, image_triangle, images, uvs = arrays
    for t in range(len(triangles)):
        for k in range(3):
            start, end = triangles[t, k], triangles[t, (k + 1) % 3]
            jacobian = jacobians[image_triangle[start]]
            x = images[end, 0] - images[start, 0]
            y = images[end, 1] - images[start, 1]
            z = images[end, 2] - images[start, 2]
            u = jacobian[0, 0] * x + jacobian[0, 1] * y + jacobian[0, 2] * z
            v = jacobian[1, 0] * x + jacobian[1, 1] * y + jacobian[1, 2] * z
            du, dv = uvs[end, 0] - uvs[start, 0] - u, uvs[end, 1] - uvs[start, 1] - v
            if np.sqrt(du * du + dv * dv) > SEAM_TOLERANCE * np.sqrt(u * u + v * v) + 0.01:
                at_seam[t] = True
                break


def texture_colors(look: Look, uvs: FloatArray) -> NDArray[np.uint8]:
    """(n, 3) displayed colours of the nearest texels."""
    assert look.texture is not None
    height, width = look.texture.shape[:2]
    u, v = repeated_uvs(look.to_image_uvs(uvs)).T
    column = np.floor(u * width).astype(np.int64).clip(0, width - 1)
    row = np.floor((1.0 - v) * height).astype(np.int64).clip(0, height - 1)
    return np.asarray(look.texture[row, column, :3])
