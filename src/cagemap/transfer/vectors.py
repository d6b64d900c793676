"""Bake normal maps and vector displacement: vectors of the source rotated by the map's differential.

At a point of the target, the differential of the map takes the tangent plane with normal n1 to the tangent plane of
the image with normal n2. Q is the rotation nearest to the differential that takes n1 to n2. A vector v of the source
becomes ``Q^T v`` on the target: flat normal maps stay flat, and the identity map changes nothing.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import DTypeLike

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.triangles import normalize_rows, vertex_normals
from cagemap.transfer.baking import Bake, BakeOptions, Transfer, bake_of_texture, output_dtype, unit
from cagemap.transfer.displacement import Displacement, stored_lengths
from cagemap.transfer.locate import TexelSamples, target_barycentric
from cagemap.transfer.mip_maps import MipMaps
from cagemap.transfer.texture import Pixels, each_tile, lay_texture
from cagemap.transfer.textured_surface import plane_basis, tangent_frames

Space = Literal["tangent", "object"]
Green = Literal["up", "down"]
# Vector displacement in tangent space is stored as tangent, normal, bitangent (Blender, Mudbox).
_DISPLACEMENT_ORDER = [0, 2, 1]

_log = logging.getLogger(__name__)


def bake_normal_map(
    transfer: Transfer,
    texture: Pixels | Mapping[int, Pixels],
    *,
    size: int | tuple[int, int],
    space: Space = "tangent",
    green: Green = "up",
    dtype: DTypeLike | None = None,
    options: BakeOptions | None = None,
) -> Pixels:
    """Bake the source's normal map into the target's layout, in the target's own frames.

    ``texture`` (h, w, 3), or such arrays by UDIM number, holds directions n as (n + 1) / 2; floats with values below
    -0.05 hold n itself. Alpha is left out. Tangent space is MikkTSpace's, of both refined surfaces. ``green``, in
    tangent space: whether the green channel increases with v (OpenGL, Blender) or decreases (DirectX), in both images.
    ``size``, ``dtype`` and ``options`` are as in `bake_texture`. ParameterError if the image has fewer than three
    channels, or as `bake_texture`.
    """
    laid = lay_texture(each_tile(texture, _first_three_channels), *transfer.source.layout())
    kept = output_dtype(dtype, laid.dtype)
    signed = any(map(holds_signed_directions, laid.tiles.values()))
    flip = green_flip(green, space)

    def decode(values: FloatArray) -> FloatArray:
        values = values / unit(laid.dtype)
        return np.asarray(flip * (values if signed else 2.0 * values - 1.0))

    # Mean directions are shorter than 1 on rough surfaces: they are not rounded, and normalised once, at the end.
    bake, mips = bake_of_texture(transfer, laid, size, kept, options, exact=True)
    return _bake_texture_vectors(bake, mips, decode, normal_encoder(flip, kept, signed=signed), space)


def green_flip(green: Green, space: Space) -> FloatArray:
    """(3,) signs of the channels of a normal map; refuses unknown kinds of green and spaces."""
    if green not in ("up", "down"):
        raise ParameterError(f"green: expected up or down, got {green!r}")
    _check_space(space)
    return np.array([1.0, -1.0 if green == "down" and space == "tangent" else 1.0, 1.0])


def normal_encoder(
    flip: FloatArray, dtype: np.dtype[Any], *, signed: bool = False
) -> Callable[[FloatArray], FloatArray]:
    """Encoder of directions n (k, 3) as colours: (n + 1) / 2, or n itself in signed floats."""

    def encode(vectors: FloatArray) -> FloatArray:
        vectors = flip * normalize_rows(vectors)
        return np.asarray((vectors if signed and dtype.kind == "f" else 0.5 * vectors + 0.5) * unit(dtype))

    return encode


def bake_vector_displacement(
    transfer: Transfer,
    texture: Pixels | Mapping[int, Pixels],
    *,
    size: int | tuple[int, int],
    space: Space = "tangent",
    midlevel: float | None = None,
    scale: float = 1.0,
    dtype: DTypeLike | None = None,
    options: BakeOptions | None = None,
) -> Displacement:
    """Bake the source's vector displacement into the target's layout; lengths grow with the surfaces.

    ``texture`` (h, w, 3), or such arrays by UDIM number: vector = (value - midlevel) * scale, in the source's units; in
    tangent space the channels are tangent, normal, bitangent. ``midlevel`` is by default 0.5 for integers and 0 for
    floats, ``dtype`` and ``options`` are as in `bake_texture`. As in `bake_displacement`, floats get new values and
    integers a new scale; a warning counts the texels that the rotation moves outside their range.
    """
    laid = lay_texture(each_tile(texture, _first_three_channels), *transfer.source.layout())
    kept = output_dtype(dtype, laid.dtype)
    middle, factor, out_scale = stored_lengths(transfer, laid, kept, midlevel, scale)
    order = displacement_order(space)
    clipped: list[int] = []  # texels outside the range of integers, by call of `encode`

    def decode(values: FloatArray) -> FloatArray:
        return np.asarray(values / unit(laid.dtype) - middle)[:, order]

    def encode(vectors: FloatArray) -> FloatArray:
        values = np.asarray((factor * vectors[:, order] + middle) * unit(kept))
        if kept.kind == "u":  # half a level outside is rounding
            clipped.append(int(np.any((values < -0.5) | (values > unit(kept) + 0.5), axis=1).sum()))
        return values

    bake, mips = bake_of_texture(transfer, laid, size, kept, options, exact=True)
    pixels = _bake_texture_vectors(bake, mips, decode, encode, space)
    if sum(clipped):
        _log.warning(
            "vector displacement: %d texels of rotated vectors lie outside 0 to 1 and are clipped. Write floats "
            "(.exr or .tif), or halve the vectors around the midlevel and double the scale.",
            sum(clipped),
        )
    return Displacement(pixels, middle, out_scale)


def displacement_order(space: Space) -> list[int]:
    """Channels of tangent, bitangent and normal in a vector displacement, or of x, y and z; its own inverse."""
    _check_space(space)
    return _DISPLACEMENT_ORDER if space == "tangent" else [0, 1, 2]


def _bake_texture_vectors(
    bake: Bake,
    mips: MipMaps,
    decode: Callable[[FloatArray], FloatArray],
    encode: Callable[[FloatArray], FloatArray],
    space: Space,
) -> Pixels:
    """Bake vectors stored in a texture of the source."""
    frames = None if space == "object" else tangent_frames(bake.transfer.source)

    def vectors_at(samples: TexelSamples) -> FloatArray:
        vectors = decode(mips.look_up(samples))
        if frames is None:
            return vectors
        return np.asarray(np.einsum("sab,sb->sa", frames.at(samples.triangle, samples.barycentric), vectors))

    return bake_vectors(bake, vectors_at, encode, space)


def _check_space(space: str) -> None:
    """Require tangent or object space."""
    if space not in ("tangent", "object"):
        raise ParameterError(f"space: expected tangent or object, got {space!r}")


def bake_vectors(
    bake: Bake,
    vectors_at: Callable[[TexelSamples], FloatArray],
    encode: Callable[[FloatArray], FloatArray],
    space: Space,
) -> Pixels:
    """Bake vectors of the source, rotated to the target per sample and averaged in the target's frame.

    ``vectors_at`` gives source vectors (s, 3) in object space of samples, each a texel of its own. ``encode`` gives
    values of mean vectors (k, 3): tangent, bitangent and normal, or x, y and z.
    """
    pull_back = vector_pullback(bake.transfer, space)

    def shade(samples: TexelSamples) -> FloatArray:
        repeats = np.diff(samples.first)
        inside = np.repeat(target_barycentric(bake.layout.corners, samples), repeats, axis=0)
        triangle = np.repeat(samples.target_triangle.astype(np.int64), repeats)
        return samples.mean(pull_back(vectors_at(samples.single()), samples, triangle, inside))

    return bake.run(shade, 3, encode)


def vector_pullback(
    transfer: Transfer, space: Space
) -> Callable[[FloatArray, TexelSamples, IndexArray, FloatArray], FloatArray]:
    """Function that rotates source vectors (s, 3) of samples into tangent or object space of the target.

    Its further arguments are target triangles (s,) and barycentric coordinates (s, 3) in them.
    """
    target, source, mapped = transfer.target, transfer.source, transfer.mapped.mapped
    frames = None if space == "object" else tangent_frames(target)
    normals, source_normals = (vertex_normals(side.positions, side.triangles) for side in (target, source))

    def pull_back(vectors: FloatArray, samples: TexelSamples, triangle: IndexArray, inside: FloatArray) -> FloatArray:
        corners = target.triangles[triangle]
        edges = target.positions[corners[:, 1:]] - target.positions[corners[:, :1]]
        images = mapped[corners[:, 1:]] - mapped[corners[:, :1]]
        n1 = np.einsum("sc,scd->sd", inside, normals[corners])
        n2 = np.einsum("sc,scd->sd", samples.barycentric, source_normals[source.triangles[samples.triangle]])
        rotated = _rotate_to_target(vectors, n1, n2, edges, images)
        return rotated if frames is None else _solve(frames.at(triangle, inside), rotated)

    return pull_back


def _rotate_to_target(
    vectors: FloatArray, n1: FloatArray, n2: FloatArray, edges: FloatArray, images: FloatArray
) -> FloatArray:
    """(s, 3) ``Q^T v``; the map takes edges (s, 2, 3) of target triangles to their images."""
    target_basis, source_basis = plane_basis(n1, edges[:, 0]), plane_basis(n2, images[:, 0])
    flat, image = edges @ target_basis, images @ source_basis  # (s, edge, coordinate)
    determinant = flat[:, 0, 0] * flat[:, 1, 1] - flat[:, 0, 1] * flat[:, 1, 0]
    adjugate = np.stack(
        [np.stack([flat[:, 1, 1], -flat[:, 0, 1]], axis=1), np.stack([-flat[:, 1, 0], flat[:, 0, 0]], axis=1)], axis=1
    )
    # Row coordinates transform by M^T = flat^-1 image; for its nearest rotation only the determinant's sign matters.
    transposed = np.where(determinant < 0, -1.0, 1.0)[:, None, None] * (adjugate @ image)
    sine, cosine = transposed[:, 0, 1] - transposed[:, 1, 0], transposed[:, 0, 0] + transposed[:, 1, 1]
    length = np.hypot(sine, cosine)
    sine, cosine = np.where(length > 0, sine, 0.0), np.where(length > 0, cosine, 1.0)
    length = np.where(length > 0, length, 1.0)
    sine, cosine = sine / length, cosine / length
    x, y = np.einsum("sab,sa->sb", source_basis, vectors).T
    height = np.einsum("sd,sd->s", normalize_rows(n2), vectors)
    rotated = np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=1)
    return np.asarray(np.einsum("sab,sb->sa", target_basis, rotated) + height[:, None] * normalize_rows(n1))


def _solve(frames: FloatArray, vectors: FloatArray) -> FloatArray:
    """(s, 3) coordinates of vectors in frames that need not be orthogonal; zero if a frame is flat."""
    a, b, c = (frames[:, :, k] for k in range(3))
    volume = np.einsum("sd,sd->s", a, np.cross(b, c))
    safe = np.where(np.abs(volume) > 1e-12, volume, np.inf)
    duals = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    return np.asarray(np.einsum("skd,sd->sk", duals, vectors) / safe[:, None])


def _first_three_channels(pixels: Pixels) -> Pixels:
    """The first three channels."""
    if pixels.ndim != 3 or pixels.shape[2] < 3:
        raise ParameterError(
            f"expected three channels of directions, got an image of shape {pixels.shape}. Heights in one channel "
            "are a displacement map."
        )
    return np.ascontiguousarray(pixels[:, :, :3])


# Least share of painted texels that decode to outward unit vectors; tolerance of their length; texels that are tested.
_SHARE = 0.9
_LENGTH = 0.08
_TEXELS = 100_000
# Floats below it mean that a map holds directions themselves. Filters of images overshoot 0 by less.
_MIN_UNSIGNED_CHANNEL = -0.05


def holds_signed_directions(pixels: Pixels) -> bool:
    """Whether floats (h, w, c) hold directions n themselves instead of (n + 1) / 2."""
    return pixels.dtype.kind == "f" and float(np.nanmin(pixels[:, :, :3])) < _MIN_UNSIGNED_CHANNEL


def looks_like_normal_map(pixels: Pixels) -> bool:
    """Whether nearly all texels (h, w, c) are unit vectors that point out of the surface.

    They are stored as `bake_normal_map` takes them.
    Every colour counts once: a large uniform background does not decide. Black, transparent and NaN texels are ignored.
    """
    normals = _normals(pixels)
    if not len(normals):
        return False
    outwards = _unit(normals) & (normals[:, 2] > 0)
    return bool(outwards.mean() > _SHARE and np.median(normals[:, 2]) > 0.5)


def share_of_normals(pixels: Pixels) -> float:
    """Share of an image's colours that are unit vectors of any direction; 1 for an unpainted image."""
    normals = _normals(pixels)
    return float(_unit(normals).mean()) if len(normals) else 1.0


def _unit(normals: FloatArray) -> np.ndarray[Any, np.dtype[np.bool_]]:
    return np.asarray(np.abs(np.linalg.norm(normals, axis=1) - 1.0) < _LENGTH)


def _normals(pixels: Pixels) -> FloatArray:
    """Distinct colours of painted texels as directions; none for fewer than three channels."""
    if pixels.ndim != 3 or pixels.shape[2] < 3:
        return np.zeros((0, 3))
    step = max(1, int(np.sqrt(pixels.shape[0] * pixels.shape[1] / _TEXELS)))
    values = pixels[::step, ::step].reshape(-1, pixels.shape[2]).astype(np.float64) / unit(pixels.dtype)
    painted = values[:, :3].any(axis=1) & np.isfinite(values[:, :3]).all(axis=1)
    if pixels.shape[2] > 3:
        painted &= values[:, 3] > 0
    colors = np.unique(values[painted, :3], axis=0)
    return np.asarray(colors if holds_signed_directions(pixels) else 2.0 * colors - 1.0)
