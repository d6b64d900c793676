"""Where every texel of a creature's texture lies on its refined surface, so that paint can be a function of space."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from examples.creatures.modelling import CHANNELS, Creature
from numpy.typing import NDArray

from cagemap.numerics.arrays import FloatArray
from cagemap.subdivision import refine
from cagemap.surface.triangles import triangle_areas, triangle_neighbors, vertex_normals
from cagemap.transfer.texels import lay_out, rasterize_band
from cagemap.transfer.textured_surface import TexturedSurface

Float32Array = NDArray[np.float32]
LEVEL = 3
"""Refinement level that is painted on; finer ones move the surface by less than a texel."""
GUTTER = 8.0
"""Texels beyond an island's border that are painted too, so that filters and mipmaps find no background there."""
BAND_ROWS = 128


@dataclass(frozen=True)
class Samples:
    """Surface points under some texels.

    Attributes
    ----------
    points : (q, 3) float32
    channels : dict of (q,) float32
        The anatomy's scalars, see `modelling.CHANNELS`.
    softness : float
        Length of a texel on the surface: how far a brush's edge is blurred.
    """

    points: Float32Array
    channels: dict[str, Float32Array]
    softness: float

    def near(self, point: FloatArray, radius: float) -> tuple[NDArray[np.int64], Samples]:
        """Return the numbers of the samples inside a ball, and those samples."""
        offset = self.points - point.astype(np.float32)
        here = np.flatnonzero(np.einsum("qd,qd->q", offset, offset) < radius**2)
        return here, self.select(here)

    def select(self, here: NDArray[np.int64]) -> Samples:
        """Return some of the samples."""
        channels = {name: values[here] for name, values in self.channels.items()}
        return Samples(self.points[here], channels, self.softness)


@dataclass(frozen=True)
class Anatomy:
    """What brushes need to know of the landmarks.

    Attributes
    ----------
    points, normals : dict of (3,) float64
        Landmark name to its point and unit normal on the refined surface.
    spine : dict of float
        Landmark name to its arc length from the rump.
    """

    points: dict[str, FloatArray]
    normals: dict[str, FloatArray]
    spine: dict[str, float]


def fill_texture(
    creature: Creature, size: int, n_channels: int, brush: Callable[[Samples, Anatomy], Float32Array]
) -> Float32Array:
    """Evaluate a brush at every texel of a creature's islands and their gutters; zero elsewhere.

    Parameters
    ----------
    size : int
        Texture side in texels.
    brush : callable
        (Samples of q points, Anatomy) to (q, n_channels) float32.

    Returns
    -------
    (size, size, n_channels) float32
        Row 0 is v = 1.
    """
    refinement = refine(creature.mesh, LEVEL)
    surface = TexturedSurface.from_level(refinement.finest)
    normals = vertex_normals(surface.positions, surface.triangles)
    anatomy = Anatomy(
        {name: surface.positions[vertex] for name, vertex in creature.landmarks.items()},
        {name: normals[vertex] for name, vertex in creature.landmarks.items()},
        {name: float(creature.channels[vertex, 0]) for name, vertex in creature.landmarks.items()},
    )
    values = np.hstack([surface.positions, refinement.prolong(creature.channels, 0, LEVEL)])
    texture = np.zeros((size * size, n_channels), dtype=np.float32)
    for texels, samples in _bands(surface, values, size):
        texture[texels] = brush(samples, anatomy)
    return texture.reshape(size, size, n_channels)


def _bands(surface: TexturedSurface, values: FloatArray, size: int) -> Iterator[tuple[NDArray[np.int64], Samples]]:
    """Yield (texel numbers, samples) a band of rows at a time."""
    if surface.uvs is None or surface.uv_triangles is None:
        raise AssertionError("creatures are unwrapped when they are built")
    neighbors = triangle_neighbors(surface.uv_triangles)
    layout = lay_out(surface.corner_uvs(), neighbors, size, size, band_rows=BAND_ROWS, gutter=GUTTER)
    area = triangle_areas(surface.positions, surface.triangles).sum()
    softness = float(np.sqrt(area / triangle_areas(surface.uvs, surface.uv_triangles).sum()) / size)
    base, slope = _affine(layout.corners, values[surface.triangles])
    for band in range(len(layout.band_triangles)):
        triangle = rasterize_band(layout, band).ravel()
        inside = np.flatnonzero(triangle >= 0)
        triangle = triangle[inside]
        row, column = np.divmod(inside, size)
        row += band * BAND_ROWS
        x, y = (column + 0.5).astype(np.float32), (row + 0.5).astype(np.float32)
        sampled = (base[triangle] + slope[0][triangle] * x[:, None] + slope[1][triangle] * y[:, None]).T
        channels = dict(zip(CHANNELS, sampled[3:], strict=True))
        yield row * size + column, Samples(np.ascontiguousarray(sampled[:3].T), channels, softness)


def _affine(corners: FloatArray, values: FloatArray) -> tuple[Float32Array, tuple[Float32Array, Float32Array]]:
    """Return c, (a, b) with value = c + a x + b y in every triangle, from (t,3,2) texel corners and (t,3,k) values."""
    edge, rise = corners[:, 1:] - corners[:, :1], values[:, 1:] - values[:, :1]
    determinant = edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0]
    a = (rise[:, 0] * edge[:, 1, 1, None] - rise[:, 1] * edge[:, 0, 1, None]) / determinant[:, None]
    b = (rise[:, 1] * edge[:, 0, 0, None] - rise[:, 0] * edge[:, 1, 0, None]) / determinant[:, None]
    c = values[:, 0] - a * corners[:, 0, 0, None] - b * corners[:, 0, 1, None]
    return c.astype(np.float32), (a.astype(np.float32), b.astype(np.float32))
