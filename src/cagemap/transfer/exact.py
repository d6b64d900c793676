"""Images whose bilinear lookups are exact at the corners of a layout.

A texel holds what is true at its centre; what a renderer reads at a vertex is a mean of four. Where values jump, at
creases, or differ across a seam, that mean is wrong, and both sides of a seam read different ones. The least change of
the texels that makes every lookup right solves ``min |x|`` with ``A x = wanted - A image``, A the lookups' weights:

    x = A^T y,   (A A^T + trace) y = wanted - A image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import linalg

from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.transfer.baking import Transfer
from cagemap.transfer.locate import Samples
from cagemap.transfer.texture import OVERHANG, tile_cells, udim_origin

# Corners that share all their texels cannot all be right: lookups are weighed against this much change of texels.
_TRACE = 1e-3
_ACCURACY, _STEPS = 1e-4, 100


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


def make_exact(image: NDArray[np.float32], places: FloatArray, wanted: FloatArray) -> None:
    """Change an image of floats as little as makes its lookups right, in place.

    Parameters
    ----------
    image : (h, w, c) float32
    places : (k, 2) float64
        Texel coordinates.
    wanted : (k, c) float64
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
    missing = wanted - lookups @ values
    normal = sparse.csr_array(lookups @ lookups.T + _TRACE * sparse.eye_array(len(places)))
    for channel in range(channels):
        found, _ = linalg.cg(normal, missing[:, channel], rtol=_ACCURACY, maxiter=_STEPS)
        values[:, channel] += lookups.T @ found
    texels[used] = values


def corner_samples(transfer: Transfer, tile: int) -> tuple[FloatArray, Samples, IndexArray, FloatArray]:
    """Corners of the target's layout in a tile, as samples: where they are, and what lies there on the source.

    Returns
    -------
    uvs : (k, 2) float64
        In the tile's unit square.
    samples : Samples
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
    samples = Samples(
        triangle.astype(np.int32),
        np.arange(count),
        count,
        0,
        np.arange(count + 1),
        points.triangle[vertex].astype(np.int64),
        np.asarray(points.barycentric[vertex]),
    )
    return uvs[corner] - origin, samples, triangle, inside
