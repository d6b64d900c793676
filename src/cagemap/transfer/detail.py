"""Bake from a detailed mesh over the source, along the map and then along the source's normals.

    texel -> point of the target -> T12 -> point of the source -> along its normal to the detailed mesh

Normals and displacement vectors rotate with the map (`vectors`); colours and ambient occlusion do not change. For
a *wrapped* cage the detailed mesh is the source itself: target and source of the bake are the wrapped surface, and the
map is the identity (`own_transfer`).
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
from cagemap.numerics.threads import row_slices
from cagemap.subdivision import Level
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import normalize_rows, triangle_areas
from cagemap.transfer.baking import (
    Bake,
    BakeOptions,
    Transfer,
    make_layout,
    output_dtype,
    prepare_transfer,
    single_samples,
    to_dtype,
    unit,
)
from cagemap.transfer.displacement import Displacement, scale_ratio
from cagemap.transfer.exact_corners import corner_samples, make_lookups_exact, surface_targets
from cagemap.transfer.locate import TexelSamples
from cagemap.transfer.lookups import plain_lookups, plan_samples
from cagemap.transfer.mip_maps import MipMaps
from cagemap.transfer.rays import MAX_DETAIL_DISTANCE, NormalHits, intersect_normals
from cagemap.transfer.texels import Layout, texel_coordinates
from cagemap.transfer.texture import Pixels, lay_texture
from cagemap.transfer.vectors import (
    Green,
    Space,
    bake_vectors,
    displacement_order,
    green_flip,
    normal_encoder,
    vector_pullback,
)

# Corners with at least this weight may slide along the detailed surface.
_FULL_WEIGHT = 1.0 - 1e-9
# Rows of an image that are encoded at a time.
_ROWS = 256


@dataclass(frozen=True, eq=False)
class Detail:
    """A detailed mesh over the source."""

    surface: TriangleSurface  #: scaled to unit area *of the source*
    follow: FloatArray | None = None  #: (n2,) weight of the detail at every vertex of the source, 0 to 1; default 1


def detail_over(source: TriangleSurface, positions: FloatArray, triangles: IndexArray) -> Detail:
    """`Detail` over the source of a map, of positions (n, 3) in the source's file units and triangles (t, 3).

    ParameterError if less than half of the source has detail near it: the mesh has another position or unit.
    """
    detail = Detail(TriangleSurface(source.scale * positions, triangles, source.scale))
    share = detailed_share(detail, source)
    if share < 0.5:
        sizes = [float(np.ptp(side.positions / side.scale, axis=0).max()) for side in (source, detail.surface)]
        raise ParameterError(
            f"detail: expected a mesh that lies on the source, got one that is further away than "
            f"{MAX_DETAIL_DISTANCE:g} of sqrt(area) from {100 * (1 - share):.0f} % of it (the source is "
            f"{sizes[0]:.4g} large, the detail {sizes[1]:.4g}): put it where the source is, in the same unit"
        )
    return detail


def detailed_share(detail: Detail, source: TriangleSurface) -> float:
    """Share of the source's area with detail closer than `MAX_DETAIL_DISTANCE`."""
    feet = SurfacePoints.nearest(detail.surface, source.positions)
    near = np.linalg.norm(feet.positions - source.positions, axis=1) <= MAX_DETAIL_DISTANCE
    return float(source.vertex_areas @ near)


def own_transfer(level: Level, holes: NDArray[np.bool_] | None = None) -> Transfer:
    """Transfer from a surface to itself, for detail over the surface whose layout is baked.

    ``holes``: (m,), faces that get no texels.
    """
    surface = TriangleSurface.from_faces(level.positions, np.asarray(level.faces))
    point_map = PointMap.from_vertices(surface, surface, np.arange(surface.n))
    return prepare_transfer(level, level, point_map, holes=holes)


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
    """Bake the detail's normals, relative to the source's, as a normal map (height, width, 3) of the target.

    ``detail`` lies over the transfer's source; ``size``, ``space``, ``green`` and ``options`` are as in
    `bake_normal_map`. Directions n are stored as (n + 1) / 2.
    """
    flip = green_flip(green, space)
    bake = _detail_bake(transfer, detail, size, dtype, options)

    def normals_at(samples: TexelSamples) -> FloatArray:
        hits, weights = _weighted_hits(transfer, detail, samples)
        smooth = normalize_rows(hits.foot.interpolate(detail.surface.vertex_normals))
        return normalize_rows(weights[:, None] * smooth + (1.0 - weights[:, None]) * hits.normals)

    return bake_vectors(bake, normals_at, normal_encoder(flip, bake.dtype), space)


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
    """Bake offsets from source to detail as vector displacement of the target, in the target's units.

    Bilinear lookups at the vertices of the target's level are exact, on both sides of a seam. ``transfer``, ``detail``,
    ``size`` and ``options`` are as in `bake_detail_normals`; in tangent space the channels are tangent, normal,
    bitangent. ``scale`` is the length of a value of 1, not 0. Integers hold the range from -scale / 2 to scale / 2.
    """
    kept = np.dtype(dtype)
    middle, encode = _length_encoder(transfer, detail, scale, kept)

    def offsets_at(samples: TexelSamples) -> FloatArray:
        hits, weights = _weighted_hits(transfer, detail, samples)
        return np.asarray(weights[:, None] * (hits.foot.positions - hits.points))

    order, bake = displacement_order(space), _detail_bake(transfer, detail, size, np.float32, options)
    vectors = bake_vectors(bake, offsets_at, lambda means: means[:, order], space)
    uvs, samples, triangle, inside = corner_samples(transfer, bake.options.tile)
    hits, weights = _weighted_hits(transfer, detail, samples)
    pull_back = vector_pullback(transfer, space)
    axes = np.broadcast_to(np.eye(3)[:, None], (3, len(uvs), 3))
    coordinates = np.stack([pull_back(axis, samples, triangle, inside) for axis in axes], axis=2)[:, order]
    offsets = weights[:, None] * (hits.foot.positions - hits.points)
    slides = weights >= _FULL_WEIGHT
    targets = surface_targets(detail.surface, hits.points, hits.normals, offsets, slides, coordinates)
    make_lookups_exact(vectors, texel_coordinates(uvs, *vectors.shape[:2]), targets)
    pixels = vectors if kept == vectors.dtype else np.empty(vectors.shape, dtype=kept)
    for rows in row_slices(len(vectors), _ROWS):
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
    """Bake the detail's height along the source's normals as displacement of the target.

    The parameters are as in `bake_detail_vectors`.
    """
    middle, encode = _length_encoder(transfer, detail, scale, np.dtype(dtype))

    def shade(samples: TexelSamples) -> FloatArray:
        hits, weights = _weighted_hits(transfer, detail, samples)
        return encode(samples.mean((weights * hits.heights)[:, None]))

    return Displacement(_detail_bake(transfer, detail, size, dtype, options).run(shade, 1), middle, scale)


def bake_detail_values(
    transfer: Transfer,
    detail: Detail,
    values: FloatArray,
    *,
    size: int | tuple[int, int],
    dtype: DTypeLike = np.uint8,
    options: BakeOptions | None = None,
) -> Pixels:
    """Bake values at the detail's vertices, such as colours or ambient occlusion.

    ``values`` (n,) or (n, q) are at the detail's vertices; a ParameterError refuses other numbers of rows. Integers of
    ``dtype`` stand for the range 0 to 1. Other parameters are as in `bake_detail_normals`.
    """
    if len(values) != detail.surface.n:
        raise ParameterError(f"expected {detail.surface.n} rows, one a vertex of the detail, got {len(values)}")
    table = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    bake = _detail_bake(transfer, detail, size, dtype, options)

    def shade(samples: TexelSamples) -> FloatArray:
        foot = _normal_hits(transfer, detail, samples).foot
        return np.asarray(samples.mean(foot.interpolate(table)) * unit(bake.dtype))

    return bake.run(shade, table.shape[1])


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
    lookups: MipMaps | None = None,
) -> Pixels:
    """Bake the detail's own texture, as of a scan; the filter "nearest" is for labels.

    ``texture`` (h, w, c), or such arrays by UDIM number, has the coordinates ``uvs`` (p, 2) at the corners
    ``uv_triangles`` (t, 3) of the detail's triangles. ``lookups``: `plain_lookups` of the texture, made once for
    several tiles of the target. ``dtype`` is by default the texture's; others are as in `bake_detail_normals`.
    ParameterError if the number of rows of ``uv_triangles`` is not that of triangles, or as `bake_texture`.
    """
    options = options or BakeOptions()
    if uv_triangles.shape != detail.surface.triangles.shape:
        raise ParameterError(
            f"expected texture coordinates for {len(detail.surface.triangles)} triangles of the detail, got "
            f"{len(uv_triangles)}"
        )
    laid = lay_texture(texture, uvs, uv_triangles)
    kept = output_dtype(dtype, laid.dtype)
    scale = unit(kept) / unit(laid.dtype)
    values = lookups or plain_lookups(laid, options.filter)

    def shade(samples: TexelSamples) -> FloatArray:
        foot = _normal_hits(transfer, detail, samples).foot
        on_detail = replace(samples, triangle=foot.triangle, barycentric=foot.barycentric)
        return scale * values.look_up(on_detail)

    # Side of a typical texel on the surface: square root of the median ratio of triangle areas.
    corners = laid.corner_texels().reshape(-1, 2)
    in_texels = triangle_areas(corners, np.arange(len(corners)).reshape(-1, 3))
    texel = float(np.sqrt(np.median(detail.surface.areas / np.maximum(in_texels, 1e-300)))) / detail.surface.scale
    layout = make_layout(transfer, size, options)
    counts = single_samples(transfer) if values.nearest else _plan_lengths(transfer, texel, layout)
    return Bake(transfer, layout, options, kept, counts).run(shade, laid.channels)


def _length_encoder(
    transfer: Transfer, detail: Detail, scale: float, kept: np.dtype[Any]
) -> tuple[float, Callable[[FloatArray], FloatArray]]:
    """Value of length 0, and the encoder of lengths at unit area of the source."""
    if scale == 0:
        raise ParameterError("scale: expected a number other than 0")
    middle = 0.5 if kept.kind == "u" else 0.0
    factor = scale_ratio(transfer) / (detail.surface.scale * scale)
    return middle, lambda lengths: np.asarray((factor * lengths + middle) * unit(kept))


def _normal_hits(transfer: Transfer, detail: Detail, samples: TexelSamples) -> NormalHits:
    """Hits of the normals at samples' source points on the detail."""
    source = transfer.point_map.source
    corners = source.triangles[samples.triangle]
    points = np.einsum("sc,scd->sd", samples.barycentric, source.positions[corners])
    normals = normalize_rows(np.einsum("sc,scd->sd", samples.barycentric, source.vertex_normals[corners]))
    return intersect_normals(detail.surface, points, normals)


def _weighted_hits(transfer: Transfer, detail: Detail, samples: TexelSamples) -> tuple[NormalHits, FloatArray]:
    """Hits of samples' normals on the detail, and the (s,) weights of the detail."""
    hits = _normal_hits(transfer, detail, samples)
    if detail.follow is None:
        return hits, hits.near.astype(np.float64)
    corners = transfer.source.triangles[samples.triangle]
    return hits, hits.near * np.einsum("sc,sc->s", samples.barycentric, detail.follow[corners])


def _detail_bake(
    transfer: Transfer, detail: Detail, size: int | tuple[int, int], dtype: DTypeLike, options: BakeOptions | None
) -> Bake:
    """A bake with a sample for every detail edge that a texel spans."""
    options, surface = options or BakeOptions(), detail.surface
    layout = make_layout(transfer, size, options)
    # A typical edge of the detail, in the source's file units: triangles of area a have edges of about sqrt(2 a).
    edge = float(np.sqrt(2.0 * np.median(surface.areas))) / surface.scale
    return Bake(transfer, layout, options, np.dtype(dtype), _plan_lengths(transfer, edge, layout))


def _plan_lengths(transfer: Transfer, length: float, layout: Layout) -> NDArray[np.int32]:
    """(t1, 2) samples in a texel: one for every ``length``, in the source's file units, that it spans."""
    source = transfer.source
    corners = source.positions[source.triangles]
    first_edge, second_edge = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    side = np.linalg.norm(first_edge, axis=1)
    along = np.einsum("td,td->t", first_edge, second_edge) / np.maximum(side, 1e-300)
    up = np.sqrt(np.maximum(np.einsum("td,td->t", second_edge, second_edge) - along**2, 0.0))
    flat = np.zeros((len(corners), 3, 2))
    flat[:, 1, 0], flat[:, 2, 0], flat[:, 2, 1] = side, along, up
    return plan_samples(transfer.mapped, layout.corners, flat / max(length, 1e-300))
