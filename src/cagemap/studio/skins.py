"""What covers a model in the view: the source's look on the source, and through the map on the target."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cagemap.files.images.image import Pixels
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.pictures.camera import turn_between
from cagemap.pictures.colors import position_colors, to_linear
from cagemap.studio.file_parts import Rest
from cagemap.studio.glb import Primitive, glb
from cagemap.studio.shape import Shape
from cagemap.studio.state import Mode, View
from cagemap.transfer.locate import triangle_frames

WHITE = np.ones(3)
CLAY = np.array([0.42, 0.41, 0.40])
DOUBT = np.array([0.85, 0.02, 0.02])
DOUBT_OPACITY = 0.45
# Parts that are left alone.
REST = np.array([0.5, 0.5, 0.5])
REST_OPACITY = 0.3
# Light on a matt model: from all sides, more from above, and from two lamps, before it to the left and behind it.
AMBIENT, ABOVE = 0.34, 0.10
LAMPS = ((np.array([-0.45, 0.75, 0.85]), 0.52), (np.array([0.6, 0.25, -0.9]), 0.30))
# Trust below which a place is marked.
DOUBTFUL = 0.5
# Doubtful triangles float this far above the model, of its radius.
_LIFT = 0.004
CHECKER_CELLS = 24
# Largest difference between a corner's texture coordinates and those predicted from the next one, relative to the
# predicted step: beyond it a seam lies between.
_SEAM = 0.6


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
    quarters = round(turn_between(places, target.turned(target.positions)) / 90) % 4
    if not quarters:
        return source
    cos, sin = ((0, 1), (-1, 0), (0, -1))[quarters - 1]
    return replace(source, turn=source.turn @ [[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])


def source_skin(shape: Shape, look: Look, view: View) -> bytes:
    """The source in its own look, or painted with a pattern; a binary glTF file in view coordinates."""
    mode, beside = view.mode, _beside(shape, look, view)
    if mode == "texture" and look.encoded is not None and shape.uvs is not None and shape.uv_triangles is not None:
        return glb([_split_at_seams(shape, look.on_image(shape.uvs), shape.uv_triangles), *beside], look.encoded)
    painted = mode in ("colours", "checker")
    return glb([_painted(shape, _vertex_pattern(shape, mode)) if painted else _own(shape, look), *beside])


def target_skin(shape: Shape, own: Look, source: Shape, look: Look, images: Images | None, view: View) -> bytes:
    """The target as it is, or with the source's look through the map; a binary glTF file in view coordinates."""
    mode, beside = view.mode, _beside(shape, own, view)
    if images is None or mode == "plain":
        return glb([_own(shape, own), *beside])
    doubtful = [*beside, *([_doubtful(shape, images)] if view.doubts else [])]
    if mode == "texture" and look.encoded is not None and source.uvs is not None and source.uv_triangles is not None:
        uvs = images.on(source.uv_triangles, source.uvs)
        crossing = crossing_triangles(shape, source, images, uvs)
        inner, seam = (_part(shape.triangles[chosen]) for chosen in (~crossing, crossing))
        textured = _drawn(shape, *inner, uvs=look.on_image(uvs[inner[0]]))
        colored = _drawn(shape, *seam, texture_colors(look, uvs[seam[0]]))
        return glb([textured, colored, *doubtful], look.encoded)
    if mode == "texture":
        if look.colors is None:
            return glb([_own(shape, own), *doubtful])
        corners = shape.triangles
        faces = source.faces[images.triangle[corners]]  # (t, 3)
        votes = np.where(faces[:, 1] == faces[:, 2], faces[:, 1], faces[:, 0])
        return glb([_flat(shape, look.colors[votes]), *doubtful])
    return glb([_painted(shape, images.on(source.triangles, _vertex_pattern(source, mode))), *doubtful])


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


def texture_colors(look: Look, uvs: FloatArray) -> FloatArray:
    """(n, 3) linear colours of the texture at texture coordinates, nearest texel."""
    assert look.texture is not None
    height, width = look.texture.shape[:2]
    across, up = look.on_image(uvs).T
    column = np.floor(across % 1.0 * width).astype(np.int64).clip(0, width - 1)
    row = np.floor((1.0 - up) % 1.0 * height).astype(np.int64).clip(0, height - 1)
    return to_linear(look.texture[row, column, :3] / 255.0)


def _layout_jacobians(source: Shape) -> FloatArray:
    """(t, 2, 3) differential of the texture coordinates on every triangle."""
    assert source.uvs is not None
    assert source.uv_triangles is not None
    layout = source.uvs[source.uv_triangles]
    gradients = triangle_frames(source.positions, source.triangles)[:, 1:]
    return np.asarray(np.einsum("tki,tkj->tij", layout[:, 1:] - layout[:, :1], gradients))


def light_on(normals: FloatArray) -> FloatArray:
    """(n,) what a matt white surface gives back: light from everywhere, and Lambert's law for each lamp."""
    lamps = sum(strength * np.maximum(normals @ (place / np.linalg.norm(place)), 0.0) for place, strength in LAMPS)
    return np.asarray(AMBIENT + ABOVE * normals[:, 1] + lamps)


def _vertex_pattern(shape: Shape, mode: Mode) -> FloatArray:
    """(n, 3) linear colours of a pattern that positions on the shape decide."""
    cells = CHECKER_CELLS if mode == "checker" else 0
    colors = position_colors(shape.positions, shape.positions, cells=0)
    if cells:
        steps = np.floor(shape.to_view(shape.positions) * (cells / 2)).astype(np.int64).sum(axis=1)
        colors = np.where((steps % 2 == 0)[:, None], 0.25 + 0.7 * colors, 0.25 * colors)
    return to_linear(colors)


def _own(shape: Shape, look: Look) -> Primitive:
    if look.colors is not None:
        return _flat(shape, look.colors[shape.faces])
    return _painted(shape, np.broadcast_to(CLAY, shape.positions.shape))


def _painted(shape: Shape, colors: FloatArray) -> Primitive:
    return _drawn(shape, np.arange(len(shape.positions)), shape.triangles, colors)


def _flat(shape: Shape, colors: FloatArray) -> Primitive:
    """One colour a triangle; one vertex for every pair of vertex and colour that occurs."""
    palette, color = np.unique(colors, axis=0, return_inverse=True)
    vertices, own, triangles = _pairs(shape.triangles, np.repeat(color.ravel(), 3).reshape(-1, 3))
    return _drawn(shape, vertices, triangles, palette[own])


def _split_at_seams(shape: Shape, uvs: FloatArray, uv_triangles: IndexArray) -> Primitive:
    """One vertex for every pair of vertex and texture coordinates that occurs."""
    vertices, texture, triangles = _pairs(shape.triangles, uv_triangles)
    return _drawn(shape, vertices, triangles, uvs=uvs[texture])


def _doubtful(shape: Shape, images: Images) -> Primitive:
    """Triangles where the map is in doubt, a little above the model."""
    chosen = (images.trust[shape.triangles] < DOUBTFUL).sum(axis=1) >= 2
    vertices, triangles = _part(shape.triangles[chosen])
    drawn = _drawn(shape, vertices, triangles, DOUBT, opacity=DOUBT_OPACITY)
    return replace(drawn, positions=drawn.positions + _LIFT * shape.turned(shape.normals[vertices]))


def _beside(shape: Shape, look: Look, view: View) -> list[Primitive]:
    """Parts of the file that are left alone, grey and seen through, so that they hide nothing."""
    rest = look.rest
    if rest is None or not view.rest:
        return []
    lit = light_on(shape.turned(rest.normals))[:, None] * REST
    return [Primitive(shape.to_view(rest.positions), rest.triangles, lit, opacity=REST_OPACITY)]


def _part(triangles: IndexArray) -> tuple[IndexArray, IndexArray]:
    """The vertices that some triangles use, and the triangles in their numbers."""
    vertices, corners = np.unique(triangles, return_inverse=True)
    return vertices, corners.reshape(-1, 3)


def _pairs(one: IndexArray, other: IndexArray) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Pairs of numbers that occur at triangles' corners, each once, and the triangles in the pairs' numbers."""
    count = other.max(initial=0) + 1
    pairs, corners = np.unique(one.ravel() * count + other.ravel(), return_inverse=True)
    return *np.divmod(pairs, count), corners.reshape(-1, 3)


def _drawn(
    shape: Shape,
    vertices: IndexArray,
    triangles: IndexArray,
    colors: FloatArray = WHITE,
    uvs: FloatArray | None = None,
    opacity: float = 1.0,
) -> Primitive:
    """Triangles between some vertices of a shape, in its light."""
    lit = light_on(shape.turned(shape.normals[vertices]))[:, None] * colors
    return Primitive(
        shape.to_view(shape.positions[vertices]), triangles, lit, uvs, opacity, two_sided=not shape.encloses
    )
