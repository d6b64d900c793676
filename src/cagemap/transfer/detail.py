"""Bakes from a detailed mesh that lies on the source: what bakers do along rays, here along the map.

    texel -> point of the target -> T12 -> point of the source -> along its normal to the detailed mesh

Its normal and the way to it turn with the map, as the source's own images do (`vectors`); its colours and its ambient
occlusion are carried as they are. The detailed mesh of a *wrapped* cage is the source itself: then target and source of
the bake are the wrapped surface, and the map is the identity (`own_transfer`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import parts
from cagemap.subdivision import Level
from cagemap.surface.surface_points import SurfacePoints
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import normalized, triangle_areas
from cagemap.transfer.baking import (
    BakeOptions,
    Canvas,
    Transfer,
    make_canvas,
    prepare_transfer,
    run_bake,
    to_dtype,
    unit,
)
from cagemap.transfer.displacement import Displacement, scale_ratio
from cagemap.transfer.exact_corners import Landing, corner_samples, make_exact
from cagemap.transfer.locate import TexelSamples
from cagemap.transfer.lookups import plan_samples
from cagemap.transfer.normal_rays import REACH, Met, meet
from cagemap.transfer.texels import texel_coordinates
from cagemap.transfer.texture import Pixels, lay_texture, look_up
from cagemap.transfer.vectors import Green, Space, Turn, bake_turned, check_space, displacement_order, normal_encoder

# Corners that follow the detail by this much may slide along it.
_WHOLE = 1.0 - 1e-9
# Rows of an image whose lengths are turned into values at a time.
_ROWS = 256


@dataclass(frozen=True, eq=False)
class Detail:
    """A detailed mesh over the source.

    Attributes
    ----------
    surface : TriangleSurface
        In the source's place and unit: at unit area *of the source*, whose scale it has.
    follow : (n2,) float64 or None
        How much of the detail counts at every vertex of the source, from 0 to 1; all of it by default.
    """

    surface: TriangleSurface
    follow: FloatArray | None = None


def detail_over(source: TriangleSurface, positions: FloatArray, triangles: IndexArray) -> Detail:
    """A detailed mesh in the source's file units.

    Parameters
    ----------
    source : TriangleSurface
        The source of the map that will be followed.
    positions : (n, 3) float64
    triangles : (t, 3) int64

    Raises
    ------
    ParameterError
        If less than half of the source has detail near it: the mesh lies elsewhere, or is in another unit.
    """
    detail = Detail(TriangleSurface(source.scale * positions, triangles, source.scale))
    share = detailed_share(detail, source)
    if share < 0.5:
        sizes = [float(np.ptp(side.positions / side.scale, axis=0).max()) for side in (source, detail.surface)]
        raise ParameterError(
            f"detail: expected a mesh that lies on the source, got one that is further away than {REACH:g} of "
            f"sqrt(area) from {100 * (1 - share):.0f} % of it (the source is {sizes[0]:.4g} large, the detail "
            f"{sizes[1]:.4g}): put it where the source is, in the same unit"
        )
    return detail


def detailed_share(detail: Detail, source: TriangleSurface) -> float:
    """Share of the source's area that has detail near it."""
    feet = SurfacePoints.nearest(detail.surface, source.positions)
    near = np.linalg.norm(feet.positions - source.positions, axis=1) <= REACH
    return float(source.vertex_areas @ near)


def own_transfer(level: Level) -> Transfer:
    """The transfer from a surface to itself: for detail that lies on the very surface whose layout is baked."""
    surface = TriangleSurface.from_faces(level.positions, np.asarray(level.faces))
    return prepare_transfer(level, level, PointMap.from_vertices(surface, surface, np.arange(surface.n)))


def bake_detail_normals(
    transfer: Transfer,
    detail: Detail,
    *,
    size: int | tuple[int, int],
    space: Space = "tangent",
    green: Green = "up",
    dtype: DTypeLike = np.uint8,
    options: BakeOptions | None = None,
) -> Pixels:
    """Bake the detail's normals as a normal map of the target: what they are to the source's, they become to its own.

    Parameters
    ----------
    transfer : Transfer
    detail : Detail
        Over the transfer's source.
    size : int or (height, width)
    space, green
        As `bake_normal_map` takes them.
    dtype : optional
        Directions are stored as half of them plus a half.
    options : BakeOptions, optional

    Returns
    -------
    (height, width, 3) array
    """
    options, kept = options or BakeOptions(), np.dtype(dtype)

    def give(samples: TexelSamples) -> FloatArray:
        met = _met(transfer, detail, samples)
        shares = (met.near * _following(transfer, detail, samples))[:, None]
        smooth = normalized(met.foot.interpolate(detail.surface.vertex_normals))
        return normalized(shares * smooth + (1.0 - shares) * met.normals)

    check_space(space)
    canvas = make_canvas(transfer, size, options)
    encode = normal_encoder(green, space, kept)
    counts = _plan(transfer, detail, canvas)
    return bake_turned(transfer, canvas, counts, give, encode, space, [0, 1, 2], kept, options)


def bake_detail_vectors(
    transfer: Transfer,
    detail: Detail,
    *,
    size: int | tuple[int, int],
    space: Space = "tangent",
    scale: float = 1.0,
    dtype: DTypeLike = np.float32,
    options: BakeOptions | None = None,
) -> Displacement:
    """Bake the way from the source to the detail as vector displacement of the target, in the target's units.

    Bilinear lookups at the vertices of the target's level, on either side of a seam, give the way from there.

    Parameters
    ----------
    transfer, detail, size, options
        As `bake_detail_normals` takes them.
    space : "tangent" or "object"
        In tangent space the channels are tangent, normal, bitangent.
    scale : float
        What a value of 1 stands for; with integers the range from -scale / 2 to scale / 2.
    dtype : optional
        Integers have their zero in the middle.
    """
    options, kept = options or BakeOptions(), np.dtype(dtype)
    middle, encode = _length_encoder(transfer, detail, scale, kept)

    def seen(samples: TexelSamples) -> tuple[Met, FloatArray]:
        met = _met(transfer, detail, samples)
        return met, met.near * _following(transfer, detail, samples)

    def give(samples: TexelSamples) -> FloatArray:
        met, shares = seen(samples)
        return np.asarray(shares[:, None] * (met.foot.positions - met.points))

    check_space(space)
    canvas = make_canvas(transfer, size, options)
    counts, order = _plan(transfer, detail, canvas), displacement_order(space)
    plain = np.dtype(np.float32)
    vectors = bake_turned(transfer, canvas, counts, give, np.asarray, space, order, plain, options)
    uvs, samples, triangle, inside = corner_samples(transfer, options.tile)
    (met, shares), turn = seen(samples), Turn.of(transfer, space)
    axes = np.broadcast_to(np.eye(3)[:, None], (3, len(uvs), 3))
    turned = np.stack([turn.back(axis, samples, triangle, inside) for axis in axes], axis=2)[:, np.argsort(order)]
    straight = shares[:, None] * (met.foot.positions - met.points)
    landing = Landing(detail.surface, met.points, met.normals, straight, shares >= _WHOLE, turned)
    make_exact(vectors, texel_coordinates(uvs, *vectors.shape[:2]), landing)
    pixels = vectors if kept == plain else np.empty(vectors.shape, dtype=kept)
    for rows in parts(len(vectors), _ROWS):
        pixels[rows] = to_dtype(encode(vectors[rows]), kept)
    return Displacement(pixels, middle, scale)


def bake_detail_heights(
    transfer: Transfer,
    detail: Detail,
    *,
    size: int | tuple[int, int],
    scale: float = 1.0,
    dtype: DTypeLike = np.float32,
    options: BakeOptions | None = None,
) -> Displacement:
    """Bake how far the detail lies above the source along its normal as displacement of the target.

    Parameters
    ----------
    transfer, detail, size, scale, dtype, options
        As `bake_detail_vectors` takes them.
    """
    options, kept = options or BakeOptions(), np.dtype(dtype)
    middle, encode = _length_encoder(transfer, detail, scale, kept)

    def shade(samples: TexelSamples) -> FloatArray:
        met = _met(transfer, detail, samples)
        heights = met.near * _following(transfer, detail, samples) * met.heights
        return encode(samples.mean(heights[:, None]))

    canvas = make_canvas(transfer, size, options)
    pixels = run_bake(transfer, canvas, _plan(transfer, detail, canvas), shade, 1, kept, options)
    return Displacement(pixels, middle, scale)


def bake_detail_values(
    transfer: Transfer,
    detail: Detail,
    values: FloatArray,
    *,
    size: int | tuple[int, int],
    dtype: DTypeLike = np.uint8,
    options: BakeOptions | None = None,
) -> Pixels:
    """Bake values at the detail's vertices: colours, ambient occlusion.

    Parameters
    ----------
    transfer, detail, size, options
        As `bake_detail_normals` takes them.
    values : (n,) or (n, q) float64
        At the detail's vertices.
    dtype : optional
        Integers stand for the range 0 to 1.

    Raises
    ------
    ParameterError
        If there is not one row a vertex.
    """
    options, kept = options or BakeOptions(), np.dtype(dtype)
    if len(values) != detail.surface.n:
        raise ParameterError(f"expected {detail.surface.n} rows, one a vertex of the detail, got {len(values)}")
    table = np.asarray(values, dtype=np.float64).reshape(len(values), -1)

    def shade(samples: TexelSamples) -> FloatArray:
        foot = _met(transfer, detail, samples).foot
        return np.asarray(samples.mean(foot.interpolate(table)) * unit(kept))

    canvas = make_canvas(transfer, size, options)
    return run_bake(transfer, canvas, _plan(transfer, detail, canvas), shade, table.shape[1], kept, options)


def bake_detail_texture(
    transfer: Transfer,
    detail: Detail,
    texture: Pixels | Mapping[int, Pixels],
    uvs: FloatArray,
    uv_triangles: IndexArray,
    *,
    size: int | tuple[int, int],
    dtype: DTypeLike | None = None,
    options: BakeOptions | None = None,
) -> Pixels:
    """Bake the detail's own texture, of a scan for example; the filter "nearest" takes single texels of labels.

    Parameters
    ----------
    transfer, detail, size, options
        As `bake_detail_normals` takes them.
    texture : (h, w, c) array, or such arrays by UDIM number
    uvs : (p, 2) float64
    uv_triangles : (t, 3) int64
        Texture coordinates of the corners of the detail's triangles.
    dtype : optional
        Number type of the result; by default the texture's.

    Raises
    ------
    ParameterError
        If there is not one row of texture coordinates a triangle, or as `bake_texture`.
    """
    options = options or BakeOptions()
    if uv_triangles.shape != detail.surface.triangles.shape:
        raise ParameterError(
            f"expected texture coordinates for {len(detail.surface.triangles)} triangles of the detail, got "
            f"{len(uv_triangles)}"
        )
    laid = lay_texture(texture, uvs, uv_triangles, wrap=options.wrap)
    kept = laid.dtype if dtype is None else np.dtype(dtype)
    scale, nearest = unit(kept) / unit(laid.dtype), options.filter == "nearest"

    def shade(samples: TexelSamples) -> FloatArray:
        foot = _met(transfer, detail, samples).foot
        met = replace(samples, triangle=foot.triangle, barycentric=foot.barycentric)
        return scale * look_up(laid, met, nearest=nearest)

    # A typical texel's side on the surface, from the areas that both see.
    corners = laid.corner_texels().reshape(-1, 2)
    in_texels = triangle_areas(corners, np.arange(len(corners)).reshape(-1, 3))
    texel = float(np.sqrt(np.median(detail.surface.areas / np.maximum(in_texels, 1e-300)))) / detail.surface.scale
    canvas = make_canvas(transfer, size, options)
    once = np.ones((len(transfer.target.triangles), 2), dtype=np.int32)
    counts = once if nearest else _plan_lengths(transfer, texel, canvas)
    return run_bake(transfer, canvas, counts, shade, laid.channels, kept, options)


def _length_encoder(
    transfer: Transfer, detail: Detail, scale: float, kept: np.dtype[Any]
) -> tuple[float, Callable[[FloatArray], FloatArray]]:
    """The value that means no way, and how lengths at unit area of the source are stored."""
    middle = 0.5 if kept.kind == "u" else 0.0
    factor = scale_ratio(transfer) / (detail.surface.scale * scale)
    return middle, lambda lengths: np.asarray((factor * lengths + middle) * unit(kept))


def _met(transfer: Transfer, detail: Detail, samples: TexelSamples) -> Met:
    """Where the detail is, seen from the source points of samples."""
    source = transfer.point_map.source
    corners = source.triangles[samples.triangle]
    points = np.einsum("sc,scd->sd", samples.barycentric, source.positions[corners])
    normals = normalized(np.einsum("sc,scd->sd", samples.barycentric, source.vertex_normals[corners]))
    return meet(detail.surface, points, normals)


def _following(transfer: Transfer, detail: Detail, samples: TexelSamples) -> FloatArray:
    """(s,) how much of the detail counts at samples."""
    if detail.follow is None:
        return np.ones(len(samples.triangle))
    corners = transfer.source.triangles[samples.triangle]
    return np.asarray(np.einsum("sc,sc->s", samples.barycentric, detail.follow[corners]))


def _plan(transfer: Transfer, detail: Detail, canvas: Canvas) -> NDArray[np.int32]:
    """(t1, 2) samples in a texel: one for every edge of the detail that it spans."""
    surface = detail.surface
    # A typical edge of the detail, in the source's file units: triangles of area a have edges of about sqrt(2 a).
    return _plan_lengths(transfer, float(np.sqrt(2.0 * np.median(surface.areas))) / surface.scale, canvas)


def _plan_lengths(transfer: Transfer, length: float, canvas: Canvas) -> NDArray[np.int32]:
    """(t1, 2) samples in a texel: one for every such length, in the source's file units, that it spans."""
    source = transfer.source
    corners = source.positions[source.triangles]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    side = np.linalg.norm(one, axis=1)
    along = np.einsum("td,td->t", one, two) / np.maximum(side, 1e-300)
    up = np.sqrt(np.maximum(np.einsum("td,td->t", two, two) - along**2, 0.0))
    flat = np.zeros((len(corners), 3, 2))
    flat[:, 1, 0], flat[:, 2, 0], flat[:, 2, 1] = side, along, up
    return plan_samples(transfer.mapped, canvas.corners, flat / max(length, 1e-300))
