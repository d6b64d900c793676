"""Images whose bilinear lookups are exact at the corners of a layout.

A texel holds what is true at its centre; what a renderer reads at a vertex is a mean of four. Where values jump, at
creases, or differ across a seam, that mean is wrong, and both sides of a seam read different ones. The least change of
the texels that makes every lookup right solves ``min |x|`` with ``B A x = B (wanted - A image)``, A the lookups'
weights and B what of an error matters at each corner:

    x = A^T B^T y,   (B A A^T B^T + trace) y = B (wanted - A image).

Where a layout is so tight that corners share their texels, not all can have their way; but displaced points are free to
slide along a surface. B counts their distance from its tangent planes, and a few rounds look for these anew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import linalg

from cagemap.mesh.udim import udim_origin
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.surface_points import nearest_facing
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.transfer.baking import Transfer
from cagemap.transfer.locate import TexelSamples
from cagemap.transfer.normal_rays import REACH
from cagemap.transfer.texture import OVERHANG, tile_cells

# Corners that share all their texels cannot all be right: lookups are weighed against this much change of texels.
_TRACE = 1e-3
_ACCURACY, _STEPS = 1e-4, 200
# Rounds of feet and texels; errors along a surface count this much against those across it.
_ROUNDS, _SLIDE = 3, 0.1


def lookup_matrix(places: FloatArray, height: int, width: int) -> sparse.csr_array:
    """(k, h w) weights of bilinear lookups at texel coordinates (k, 2), clamped to the image's edge."""
    x = np.clip(places[:, 0] - 0.5, 0.0, width - 1.0)
    y = np.clip(places[:, 1] - 0.5, 0.0, height - 1.0)
    column, row = x.astype(np.int64), y.astype(np.int64)
    fx, fy = x - column, y - row
    columns, rows = (column, np.minimum(column + 1, width - 1)), (row, np.minimum(row + 1, height - 1))
    texels = np.stack([rows[j] * width + columns[i] for j in (0, 1) for i in (0, 1)], axis=1)
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=1)
    starts = np.arange(0, 4 * len(places) + 1, 4)
    return sparse.csr_array((weights.ravel(), texels.ravel(), starts), shape=(len(places), height * width))


@dataclass(frozen=True, eq=False)
class Aim:
    """What lookups should read.

    Attributes
    ----------
    wanted : (k, c) float64
    matters : (k, c, c) float64
        What of an error counts: B, one block a corner.
    """

    wanted: FloatArray
    matters: FloatArray


def make_exact(image: NDArray[np.float32], places: FloatArray, aim: Callable[[FloatArray], Aim]) -> None:
    """Change an image of floats as little as makes its lookups right, in place.

    Parameters
    ----------
    image : (h, w, c) float32
    places : (k, 2) float64
        Texel coordinates.
    aim : callable
        From what lookups read now (k, c) to what they should; asked once a round.
    """
    if not len(places):
        return
    height, width, channels = image.shape
    texels = image.reshape(-1, channels)
    lookups = lookup_matrix(places, height, width)
    used = np.unique(lookups.indices)
    lookups = sparse.csr_array(
        (lookups.data, np.searchsorted(used, lookups.indices), lookups.indptr), shape=(len(places), len(used))
    )
    values = texels[used].astype(np.float64)
    shared, size = sparse.csr_array(lookups @ lookups.T), len(places) * channels
    for _ in range(_ROUNDS):
        read = np.asarray(lookups @ values)
        aimed = aim(read)

        def counted(errors: FloatArray, matters: FloatArray = aimed.matters) -> FloatArray:
            return np.asarray(np.einsum("kab,kb->ka", matters, errors))

        def spread(answer: FloatArray, matters: FloatArray = aimed.matters) -> FloatArray:
            return np.asarray(np.einsum("kab,ka->kb", matters, answer))

        def system(flat: FloatArray) -> FloatArray:
            answer = flat.reshape(-1, channels)
            return (counted(shared @ spread(answer)) + _TRACE * answer).ravel()

        missing = counted(aimed.wanted - read).ravel()
        operator = linalg.LinearOperator((size, size), matvec=system, dtype=np.float64)
        found, _ = linalg.cg(operator, missing, rtol=_ACCURACY, maxiter=_STEPS)
        values += lookups.T @ spread(found.reshape(-1, channels))
    texels[used] = values


@dataclass(frozen=True, eq=False)
class Landing:
    """Displaced corners that are to lie on a surface: the aim of a vector displacement.

    Attributes
    ----------
    surface : TriangleSurface
    points, normals : (k, 3) float64
        Of the corners, before they are displaced.
    offsets : (k, 3) float64
        Displacements of those that are not to slide.
    slides : (k,) bool
    coordinates : (k, 3, 3) float64
        Linear maps from displacements to what is stored.
    """

    surface: TriangleSurface
    points: FloatArray
    normals: FloatArray
    offsets: FloatArray
    slides: NDArray[np.bool_]
    coordinates: FloatArray

    def __call__(self, read: FloatArray) -> Aim:
        """What is to be read where (k, 3) is read now."""
        sound = np.abs(np.linalg.det(self.coordinates)) > 1e-9
        back = np.linalg.inv(np.where(sound[:, None, None], self.coordinates, np.eye(3)))
        now = self.points + np.einsum("kab,kb->ka", back, read)
        feet, _ = nearest_facing(self.surface, now, self.normals, REACH)
        offsets = np.where(self.slides[:, None], feet.positions - self.points, self.offsets)
        across = feet.normals[:, :, None] * feet.normals[:, None, :]
        counts = np.where(self.slides[:, None, None], _SLIDE * np.eye(3) + (1.0 - _SLIDE) * across, np.eye(3))
        wanted = np.einsum("kab,kb->ka", self.coordinates, offsets)
        return Aim(wanted, np.where(sound[:, None, None], counts @ back, 0.0))


def corner_samples(transfer: Transfer, tile: int) -> tuple[FloatArray, TexelSamples, IndexArray, FloatArray]:
    """Corners of the target's layout in a tile, as samples: where they are, and what lies there on the source.

    Returns
    -------
    uvs : (k, 2) float64
        In the tile's unit square.
    samples : TexelSamples
    triangle : (k,) int64
        A target triangle that has the corner.
    inside : (k, 3) float64
        Barycentric coordinates there.
    """
    target = transfer.target
    uvs, uv_triangles = target.layout()
    origin = np.array(udim_origin(tile))
    own = np.arange(len(uv_triangles))
    if tile:
        own = np.flatnonzero((tile_cells(target.corner_uvs()) == origin).all(axis=1))
    if target.holes is not None:
        own = own[~target.holes[own]]
    corner, first = np.unique(uv_triangles[own], return_index=True)
    there = (np.abs(uvs[corner] - origin - 0.5) <= 0.5 + OVERHANG).all(axis=1)  # what else lies outside the image
    corner, first = corner[there], first[there]
    triangle, inside = own[first // 3], np.eye(3)[first % 3]
    vertex = target.triangles[triangle, first % 3]
    count, points = len(corner), transfer.point_map
    samples = TexelSamples(
        triangle.astype(np.int32),
        np.arange(count),
        count,
        0,
        np.arange(count + 1),
        points.triangle[vertex].astype(np.int64),
        np.asarray(points.barycentric[vertex]),
    )
    return uvs[corner] - origin, samples, triangle, inside
