"""Make bilinear lookups of an image exact at the corners of a layout.

At a vertex a renderer reads the mean of four texels. At creases and seams this mean is wrong, and the two sides of a
seam differ. The least change x of the texels that makes every lookup exact solves ``min |x|`` with
``B A x = B (wanted - A image)``. A are the lookups' weights and B the weights of errors at each corner:

    x = A^T B^T y,   (B A A^T B^T + trace) y = B (wanted - A image).

Corners that share their texels cannot all be exact, but displaced points may slide along the surface. B then weights
the distance from the surface's tangent planes, updated in a few rounds.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import linalg

from cagemap.mesh.udim import udim_origin
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.triangle_surface import TriangleSurface, nearest_facing
from cagemap.transfer.baking import Transfer
from cagemap.transfer.locate import TexelSamples
from cagemap.transfer.rays import MAX_DETAIL_DISTANCE
from cagemap.transfer.texture import OVERHANG, tile_cells

# Weight of the change of texels against the error of lookups.
_TRACE = 1e-3
_ACCURACY, _STEPS = 1e-4, 200
# A A^T is formed if it has at most about this many times the entries of A: small images have few, crowded texels.
_MAX_PAIRS = 16
# Rounds of closest points and texels; weight of errors along the surface against errors across it.
_ROUNDS, _TANGENTIAL_WEIGHT = 3, 0.1


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


# Values (k, c) that lookups should have, and weights (k, c, c) of errors: B, one block a corner.
LookupTargets = tuple[FloatArray, FloatArray]


def make_lookups_exact(
    image: NDArray[np.float32], places: FloatArray, targets: Callable[[FloatArray], LookupTargets]
) -> None:
    """Change a float image (h, w, c) in place, as little as possible, to make its lookups at places (k, 2) exact.

    ``targets`` is a function from the current lookups (k, c) to their targets; called once a round.
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
    spread, size = sparse.csr_array(lookups.T), len(places) * channels
    pairs = np.square(np.diff(spread.indptr).astype(np.int64)).sum()  # of corners that share a texel
    shared = None if pairs > _MAX_PAIRS * lookups.nnz else sparse.csr_array(lookups @ spread)
    for _ in range(_ROUNDS):
        read = np.asarray(lookups @ values)
        wanted, weights_of = targets(read)

        def weighted(errors: FloatArray, weights: FloatArray = weights_of) -> FloatArray:
            return np.asarray(np.einsum("kab,kb->ka", weights, errors))

        def transposed(answer: FloatArray, weights: FloatArray = weights_of) -> FloatArray:
            return np.asarray(np.einsum("kab,ka->kb", weights, answer))

        def system(flat: FloatArray) -> FloatArray:
            answer = flat.reshape(-1, channels)
            change = transposed(answer)
            moved = lookups @ (spread @ change) if shared is None else shared @ change
            return (weighted(moved) + _TRACE * answer).ravel()

        errors = weighted(wanted - read).ravel()
        operator = linalg.LinearOperator((size, size), matvec=system, dtype=np.float64)
        solution, _ = linalg.cg(operator, errors, rtol=_ACCURACY, maxiter=_STEPS)
        values += spread @ transposed(solution.reshape(-1, channels))
    texels[used] = values


def surface_targets(
    surface: TriangleSurface,
    points: FloatArray,
    normals: FloatArray,
    offsets: FloatArray,
    slides: NDArray[np.bool_],
    coordinates: FloatArray,
) -> Callable[[FloatArray], LookupTargets]:
    """Lookup targets of a vector displacement: displaced corners (k,) lie on a surface.

    ``offsets`` (k, 3) are displacements of corners that do not slide, ``coordinates`` (k, 3, 3) linear maps from
    displacements to stored values.
    """
    sound = (np.abs(np.linalg.det(coordinates)) > 1e-9)[:, None, None]
    back = np.linalg.inv(np.where(sound, coordinates, np.eye(3)))

    def targets(read: FloatArray) -> LookupTargets:
        displaced = points + np.einsum("kab,kb->ka", back, read)
        feet, _ = nearest_facing(surface, displaced, normals, MAX_DETAIL_DISTANCE)
        wanted = np.where(slides[:, None], feet.positions - points, offsets)
        across = feet.normals[:, :, None] * feet.normals[:, None, :]
        sliding = _TANGENTIAL_WEIGHT * np.eye(3) + (1.0 - _TANGENTIAL_WEIGHT) * across
        weights = np.where(slides[:, None, None], sliding, np.eye(3))
        return np.einsum("kab,kb->ka", coordinates, wanted), np.where(sound, weights @ back, 0.0)

    return targets


def corner_samples(transfer: Transfer, tile: int) -> tuple[FloatArray, TexelSamples, IndexArray, FloatArray]:
    """UVs (k, 2) of the layout's unmasked corners in a tile, in its unit square, and their source points as samples.

    If all are masked, all corners. Also returns a target triangle (k,) that has the corner, and barycentric coordinates
    (k, 3) there.
    """
    target = transfer.target
    uvs, uv_triangles = target.layout()
    origin = np.array(udim_origin(tile))
    in_tile = np.arange(len(uv_triangles))
    if tile:
        in_tile = np.flatnonzero((tile_cells(target.corner_uvs()) == origin).all(axis=1))
    if target.holes is not None:
        in_tile = in_tile[~target.holes[in_tile]]
    points = transfer.point_map
    # Masked parts of the target may be laid over others.
    weights = transfer.masks.joint(points)[target.triangles[in_tile]].ravel()
    allowed = np.flatnonzero(weights) if weights.any() else np.arange(len(weights))
    corner, first = np.unique(uv_triangles[in_tile].ravel()[allowed], return_index=True)
    first = allowed[first]
    in_image = (np.abs(uvs[corner] - origin - 0.5) <= 0.5 + OVERHANG).all(axis=1)  # others lie outside the image
    corner, first = corner[in_image], first[in_image]
    triangle, inside = in_tile[first // 3], np.eye(3)[first % 3]
    vertex = target.triangles[triangle, first % 3]
    samples = TexelSamples.of_points(triangle, points.triangle[vertex], np.asarray(points.barycentric[vertex]))
    return uvs[corner] - origin, samples, triangle, inside
