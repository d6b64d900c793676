"""What covers a model in the view: its own look, and on the target the source's look through the map."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace

import imageio.v3 as imageio
import numpy as np
from numpy.typing import NDArray

from cagemap.files.images.image import Pixels
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.pictures.camera import turn_angle
from cagemap.studio.file_parts import Rest
from cagemap.studio.glb import Drawn, glb
from cagemap.studio.shape import Shape
from cagemap.transfer.attributes import encode_srgb as to_display
from cagemap.transfer.locate import triangle_frames, walk_from

# Of a model without materials, as displayed.
CLAY = np.array([0.69, 0.68, 0.67])
# Trust below which a place is marked.
DOUBTFUL = 0.5
# Largest difference between a corner's texture coordinates and those predicted from the next one, relative to the
# predicted step: beyond it a seam lies between.
_SEAM = 0.6
# Samples along a side of a triangle that a seam or a border of materials crosses, and of all these triangles together.
_FEWEST, _MOST, _SAMPLES = 3, 8, 200_000


@dataclass(frozen=True, eq=False)
class Look:
    """Materials of the source.

    Attributes
    ----------
    texture : (h, w, c) array or None
        As displayed, 8 bits.
    encoded : bytes or None
        The same as a JPEG file.
    tiles : (int, int)
        How many lie beside and above each other in it.
    colors : (faces, 3) float64 or None
        Linear material colours of the control faces.
    rest : Rest or None
        Parts of the file that are left alone.
    """

    texture: Pixels | None = None
    encoded: bytes | None = None
    tiles: tuple[int, int] = (1, 1)
    colors: FloatArray | None = None
    rest: Rest | None = None

    def on_image(self, uvs: FloatArray) -> FloatArray:
        """Texture coordinates, whose tiles are of size 1, in the one image."""
        return uvs / self.tiles


@dataclass(frozen=True, eq=False)
class Images:
    """Where a map takes the vertices of a target shape on the source shape.

    Attributes
    ----------
    triangle : (n,) int64
    barycentric : (n, 3) float64
    trust : (n,) float64
    """

    triangle: IndexArray
    barycentric: FloatArray
    trust: FloatArray

    def on(self, triangles: IndexArray, values: FloatArray) -> FloatArray:
        """Evaluate values at the corners of source triangles where the map takes every vertex."""
        return np.asarray(np.einsum("nc,ncd->nd", self.barycentric, values[triangles[self.triangle]]))


def faced(source: Shape, target: Shape, images: Images | None) -> Shape:
    """The source, turned about the vertical by the quarter turns after which it faces as the target does under a map.

    A turn of both models' cameras then shows the same side of both; the shape itself where it faces so already.
    """
    if images is None:
        return source
    places = images.on(source.triangles, source.turned(source.positions))
    quarters = round(turn_angle(places, target.turned(target.positions)) / 90) % 4
    if not quarters:
        return source
    cos, sin = ((0, 1), (-1, 0), (0, -1))[quarters - 1]
    return replace(source, turn=source.turn @ [[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])


def source_skin(shape: Shape, look: Look) -> bytes:
    """The source in its own look; a binary glTF file in view coordinates.

    COLOR_1 has the colours of its materials, TEXCOORD_0 leads into the image "texture".
    """
    images = {} if look.encoded is None else {"texture": look.encoded}
    corners, _, attributes = _own(shape, look)
    layout = attributes.pop("TEXCOORD_1", None)
    if layout is not None and images:
        attributes["TEXCOORD_0"] = look.on_image(layout)
    return glb([Drawn("model", attributes, corners), *_rest(shape, look)], images)


def target_skin(
    shape: Shape, own: Look, source: Shape, look: Look, images: Images | None, baked: bytes | None = None
) -> bytes:
    """The target as it is, and with the source's look through the map; a binary glTF file in view coordinates.

    Beside the target's own colours and layout (COLOR_1, TEXCOORD_1, the image "baked"), every vertex has what the map
    gives it: ``_PLACE`` and ``_PLACE_NORMAL`` on the source, ``_TRUST``, the source's texture coordinates TEXCOORD_0 or
    colour COLOR_0. Triangles that a seam of the source's layout or a border of its materials crosses are apart, as
    "seams", with an image of that name which has a square of samples for each.
    """
    pictures = {} if baked is None else {"baked": baked}
    corners, vertex, attributes = _own(shape, own)
    if images is None:
        return glb([Drawn("model", attributes, corners), *_rest(shape, own)], pictures)
    attributes |= {
        "_PLACE": source.to_view(images.on(source.triangles, source.positions))[vertex],
        "_PLACE_NORMAL": source.turned(images.on(source.triangles, source.normals))[vertex],
        "_TRUST": images.trust[vertex],
    }
    crossing = np.zeros(len(corners), dtype=bool)
    if look.encoded is not None and source.uvs is not None and source.uv_triangles is not None:
        uvs = images.on(source.uv_triangles, source.uvs)
        crossing = crossing_triangles(shape, source, images, uvs)
        attributes["TEXCOORD_0"] = look.on_image(uvs)[vertex]
    elif look.colors is not None:
        hit = look.colors[source.faces[images.triangle]]
        crossing = (hit[shape.triangles] != hit[shape.triangles[:, :1]]).any(axis=(1, 2))
        attributes["COLOR_0"] = to_display(hit)[vertex]
    seams = []
    if crossing.any():
        uvs, pictures["seams"] = _samples(shape.triangles[crossing], source, look, images)
        apart = corners[crossing].ravel()
        split = {name: values[apart] for name, values in attributes.items()} | {"TEXCOORD_0": uvs}
        seams = [Drawn("seams", split, np.arange(len(apart)).reshape(-1, 3))]
    return glb([Drawn("model", attributes, corners[~crossing]), *seams, *_rest(shape, own)], pictures)


def _own(shape: Shape, look: Look) -> tuple[IndexArray, IndexArray, dict[str, FloatArray]]:
    """A model as it is, one vertex for each triple of point, place in the layout and colour.

    Returns triangles, the shape's vertex of each vertex, and attributes.
    """
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
    made: dict[str, FloatArray] = {
        "POSITION": shape.to_view(shape.positions[vertex]),
        "NORMAL": shape.turned(shape.normals[vertex]),
        "COLOR_1": np.broadcast_to(CLAY, (len(vertex), 3)),
    }
    if shape.uvs is not None and shape.uv_triangles is not None:
        made["TEXCOORD_1"] = shape.uvs[shape.uv_triangles.ravel()[first]]
    if look.colors is not None:
        made["COLOR_1"] = to_display(palette)[columns[-1].ravel()[first]]
    return corners.reshape(-1, 3), vertex, made


def _rest(shape: Shape, look: Look) -> list[Drawn]:
    """Parts of the file that are left alone."""
    rest = look.rest
    if rest is None:
        return []
    attributes = {"POSITION": shape.to_view(rest.positions), "NORMAL": shape.turned(rest.normals)}
    return [Drawn("rest", attributes, rest.triangles)]


def _samples(corners: IndexArray, source: Shape, look: Look, images: Images) -> tuple[FloatArray, bytes]:
    """Colours of the source at points of some target triangles, as an image; (3 t, 2) where their corners are in it."""
    side = int(np.clip(np.sqrt(_SAMPLES / len(corners)), _FEWEST, _MOST))
    column = np.tile(np.arange(side), side) / (side - 1)
    row = np.repeat(np.arange(side), side) / (side - 1)
    beyond = np.maximum(column + row - 1, 0) / 2
    column, row = column - beyond, row - beyond
    weights = np.column_stack([1 - column - row, column, row])  # (side^2, 3)
    places = images.on(source.triangles, source.positions)[corners]
    points = np.einsum("sc,tcd->tsd", weights, places)
    nearest = np.argmax(weights, axis=1)
    starts = images.triangle[corners][:, nearest]
    frames = triangle_frames(source.positions, source.triangles)
    triangle, inside = walk_from(frames, source.surface.neighbors, starts.ravel(), points.reshape(-1, 3))
    colors = _colors_at(source, look, triangle, inside).reshape(len(corners), side, side, 3)
    across = int(np.ceil(np.sqrt(len(corners))))
    squares = np.zeros((across * across, side, side, 3), dtype=np.uint8)
    squares[: len(corners)] = colors
    picture = squares.reshape(across, across, side, side, 3).swapaxes(1, 2).reshape(across * side, across * side, 3)
    data = io.BytesIO()
    imageio.imwrite(data, picture, extension=".png", compress_level=1)
    down, right = np.divmod(np.arange(len(corners)), across)
    at = side * np.column_stack([right, down])[:, None] + 0.5 + (side - 1) * np.array([[0, 0], [1, 0], [0, 1]])
    uvs = at.reshape(-1, 2) / (across * side)
    return np.column_stack([uvs[:, 0], 1.0 - uvs[:, 1]]), data.getvalue()


def _colors_at(source: Shape, look: Look, triangle: IndexArray, inside: FloatArray) -> NDArray[np.uint8]:
    """(n, 3) colours, as displayed, of the source's image or materials at points of it."""
    if look.texture is None or source.uvs is None or source.uv_triangles is None:
        assert look.colors is not None
        return np.rint(255 * to_display(look.colors[source.faces[triangle]])).astype(np.uint8)
    uvs = np.einsum("nc,ncd->nd", inside, source.uvs[source.uv_triangles[triangle]])
    return texture_colors(look, uvs)


def crossing_triangles(shape: Shape, source: Shape, images: Images, uvs: FloatArray) -> NDArray[np.bool_]:
    """(t,) target triangles with a seam of the source's layout between the images of their corners.

    The layout is affine on every source triangle; going on from one corner by it must lead near the next corner's
    texture coordinates.
    """
    assert source.uvs is not None
    assert source.uv_triangles is not None
    places = images.on(source.triangles, source.positions)
    corners = shape.triangles
    crossing = np.zeros(len(corners), dtype=bool)
    jacobians = _layout_jacobians(source)
    for k in range(3):
        here, there = corners[:, k], corners[:, (k + 1) % 3]
        step = places[there] - places[here]
        predicted = np.einsum("tij,tj->ti", jacobians[images.triangle[here]], step)
        missed = np.linalg.norm(uvs[there] - uvs[here] - predicted, axis=1)
        crossing |= missed > _SEAM * np.linalg.norm(predicted, axis=1) + 0.01
    return crossing


def texture_colors(look: Look, uvs: FloatArray) -> NDArray[np.uint8]:
    """(n, 3) colours of the texture at texture coordinates, as displayed: nearest texels."""
    assert look.texture is not None
    height, width = look.texture.shape[:2]
    across, up = look.on_image(uvs).T
    column = np.floor(across % 1.0 * width).astype(np.int64).clip(0, width - 1)
    row = np.floor((1.0 - up) % 1.0 * height).astype(np.int64).clip(0, height - 1)
    return np.asarray(look.texture[row, column, :3])


def _layout_jacobians(source: Shape) -> FloatArray:
    """(t, 2, 3) differential of the texture coordinates on every triangle."""
    assert source.uvs is not None
    assert source.uv_triangles is not None
    layout = source.uvs[source.uv_triangles]
    gradients = triangle_frames(source.positions, source.triangles)[:, 1:]
    return np.asarray(np.einsum("tki,tkj->tij", layout[:, 1:] - layout[:, :1], gradients))
