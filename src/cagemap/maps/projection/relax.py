"""Remove the folds of a map: flipped triangles are relaxed together with their neighbourhood and projected again.

Inside a patch around the flips the image points move to the means of their neighbours while the rest of the map holds
the patch's boundary: a discrete harmonic map, which is one-to-one where the patch's image is close to flat and convex
(Tutte 1963).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.geometry.points import SurfacePoints
from cagemap.geometry.triangles import CACHED, normalized
from cagemap.maps.projection.constants import LEAST_MENDED, ROUNDS, SWEEPS
from cagemap.maps.quality import flipped_triangles
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.graphs import components
from cagemap.numerics.threads import in_threads, parts

BoolArray = NDArray[np.bool_]


def relax_folds(
    images: SurfacePoints,
    triangles: IndexArray,
    held: IndexArray,
    *,
    normal_weight: float,
    rounds: int = ROUNDS,
) -> tuple[SurfacePoints, NDArray[np.bool_]]:
    """Reduce the flipped triangles of a map; vertices far from a flip and held ones keep their image.

    A connected patch keeps its new image only if fewer of its triangles are flipped than before; the patches grow by a
    ring a round, until a round mends little.

    Parameters
    ----------
    images : SurfacePoints
        Where the map takes the target's vertices.
    triangles : (t1, 3) int64
        Of the target.
    held : (p,) int64
        Target vertices that may not move (landmarks).
    normal_weight : float
        Of the projection, see `closest_points`.

    Returns
    -------
    images : SurfacePoints
    flipped : (t1,) bool
        Target triangles that still are.
    """
    flipped = flipped_triangles(images, triangles)
    if not flipped.any():
        return images, flipped
    # Nothing outside the last round's patch is looked at: go on with the triangles around it, renumbered.
    inner = around(triangles, flipped, rounds, len(images))
    region = touched_triangles(triangles, inner)
    vertices, near = np.unique(triangles[region], return_inverse=True)
    near = near.reshape(-1, 3)
    # Folds may spread while they are relaxed; what lies at the border has triangles beyond it.
    movable = inner[vertices] & ~np.isin(vertices, held)
    local, folded = images.at(vertices), flipped[region]
    for ring in range(1, rounds + 1):
        before = folded.sum()
        inside = around(near, folded, ring, len(vertices)) & movable
        local = _relaxed(local, near, inside, folded, normal_weight)
        folded = flipped_triangles(local, near)
        if folded.sum() > (1.0 - LEAST_MENDED) * before or not folded.any():
            break
    flipped[region] = folded
    return images.replaced(vertices, local), flipped


def _relaxed(
    images: SurfacePoints, near: IndexArray, inside: BoolArray, flipped: BoolArray, normal_weight: float
) -> SurfacePoints:
    """Images of the vertices inside after some sweeps of averaging, where that leaves fewer triangles flipped."""
    vertices = np.flatnonzero(inside)
    touched = touched_triangles(near, inside)
    means = neighbour_means(near[touched], inside)
    moved, directions = images.positions.copy(), images.normals.copy()
    for _ in range(SWEEPS):
        moved[vertices] = means @ moved
        directions[vertices] = normalized(means @ directions)
    guess = images.triangle[vertices]
    found = SurfacePoints.nearest(
        images.surface, moved[vertices], directions[vertices], normal_weight=normal_weight, guess=guess
    )
    new = images.replaced(vertices, found)
    still = flipped_triangles(new, near[touched])
    kept = np.flatnonzero(_improved(near[touched], inside, flipped[touched], still))
    return images.replaced(kept, new.at(kept))


def around(triangles: IndexArray, flipped: BoolArray, rings: int, n: int) -> NDArray[np.bool_]:
    """(n,) which vertices are those of flipped triangles and of some rings around them."""
    inside = np.zeros(n, dtype=bool)
    inside[triangles[flipped].ravel()] = True
    for _ in range(rings):
        inside[triangles[touched_triangles(triangles, inside)].ravel()] = True
    return inside


def touched_triangles(triangles: IndexArray, inside: BoolArray) -> BoolArray:
    """(t,) triangles with a corner inside."""
    touched = np.empty(len(triangles), dtype=np.bool_)

    def fill(part: slice) -> None:
        first, second, third = (inside.take(corner) for corner in triangles[part].T)
        touched[part] = first | second | third

    in_threads(fill, parts(len(triangles), CACHED))
    return touched


def _improved(near: IndexArray, inside: BoolArray, before: BoolArray, after: BoolArray) -> BoolArray:
    """(n,) vertices of those connected patches in which fewer of the touched triangles are flipped than before."""
    patch = patches(near, inside)
    # The inside corners of a triangle are neighbours, so that any of them names its patch.
    corner = np.argmax(inside[near], axis=1)
    patch_of = patch[near[np.arange(len(near)), corner]]
    gain = np.bincount(patch_of, before.astype(float) - after, minlength=len(inside))
    return np.asarray(inside & (gain[patch] > 0))


def patches(triangles: IndexArray, inside: BoolArray) -> IndexArray:
    """(n,) connected patch of every vertex, below n; vertices outside are patches of their own."""
    n = len(inside)
    near = triangles[touched_triangles(triangles, inside)]
    pairs = near[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    pairs = pairs[inside[pairs].all(axis=1)]
    return components(pairs[:, 0], pairs[:, 1], n)


def convex_rows(rows: IndexArray, columns: IndexArray, weights: FloatArray, inside: BoolArray) -> sparse.csr_array:
    """(v, n) convex combinations for the v vertices inside: weights, summed where they meet, in rows of sum 1."""
    kept = inside[rows]
    number = np.cumsum(inside) - 1
    shape = (int(inside.sum()), len(inside))
    matrix = sparse.csr_array((weights[kept], (number[rows[kept]], columns[kept])), shape=shape)
    return sparse.csr_array(sparse.diags_array(1.0 / np.asarray(matrix.sum(axis=1)).ravel()) @ matrix)


def neighbour_means(triangles: IndexArray, inside: BoolArray) -> sparse.csr_array:
    """(v, n) matrix that averages the neighbours of every inside vertex."""
    rows, columns = triangles[:, [0, 1, 2, 0, 1, 2]].ravel(), triangles[:, [1, 2, 0, 2, 0, 1]].ravel()
    return convex_rows(rows, columns, np.ones(len(rows)), inside)
