"""Remove small folds of a map: relax flipped triangles with their neighbourhood and project again.

Inside a patch around the flips the image points move to the means of their neighbours; the patch's boundary is fixed.
This is a discrete harmonic map, one-to-one where the patch's image is close to flat and convex (Tutte 1963).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.deform.config import ProjectionConfig
from cagemap.maps.quality import flipped_triangles, inverted_triangles
from cagemap.numerics.arrays import FloatArray, IndexArray, label_components, mask_of
from cagemap.numerics.threads import in_threads, row_slices
from cagemap.surface.triangle_surface import SurfacePoints
from cagemap.surface.triangles import CACHED, normalize_rows

BoolArray = NDArray[np.bool_]


def relax_folds(
    images: SurfacePoints,
    triangles: IndexArray,
    held: IndexArray,
    *,
    normal_weight: float,
    config: ProjectionConfig = ProjectionConfig(),
) -> tuple[SurfacePoints, NDArray[np.bool_]]:
    """Images with fewer flipped triangles, and which target triangles (t1,) are still flipped.

    Vertices far from a flip and held vertices (p,) keep their images. A connected patch keeps its new images only if
    fewer of its triangles are flipped. Patches grow in every round, until a round removes few flips.
    """
    flipped = flipped_triangles(images, triangles)
    if not flipped.any():
        return images, flipped
    # Only vertices within the largest number of rings can change: continue with the triangles around them, renumbered.
    inner = flipped_rings(triangles, flipped, config.rings[-1], len(images))
    region = touched_triangles(triangles, inner)
    used = mask_of(triangles[region], len(images))
    vertices, local_triangles = np.flatnonzero(used), (np.cumsum(used) - 1)[triangles[region]]
    # Folds may spread while they are relaxed. Border vertices stay fixed: some of their triangles are outside.
    movable = inner[vertices] & ~np.isin(vertices, held)
    local, flipped[region] = _relax_region(
        images.at(vertices), local_triangles, flipped[region], movable, normal_weight, config
    )
    return images.replaced(vertices, local), flipped


def _relax_region(
    local: SurfacePoints,
    local_triangles: IndexArray,
    folded: BoolArray,
    movable: BoolArray,
    normal_weight: float,
    config: ProjectionConfig,
) -> tuple[SurfacePoints, BoolArray]:
    """New images of the vertices of a region, and which of its triangles are still flipped."""
    means = neighbour_means(local_triangles, np.ones(len(local), dtype=bool))
    places = np.hstack([local.positions, local.normals])
    for ring in config.rings:
        before = folded.sum()
        inside = flipped_rings(local_triangles, folded, ring, len(local)) & movable
        moved = np.flatnonzero(inside)
        rows, tried = means[moved], places.copy()
        for _ in range(config.sweeps):
            averaged = rows @ tried
            averaged[:, 3:] = normalize_rows(averaged[:, 3:])
            tried[moved] = averaged
        positions, normals, guess = tried[moved, :3], tried[moved, 3:], local.triangle[moved]
        new = SurfacePoints.nearest(local.surface, positions, normals, normal_weight=normal_weight, guess=guess)
        tried[moved] = np.hstack([new.positions, new.normals])
        touched = touched_triangles(local_triangles, inside)
        positions, normals = np.ascontiguousarray(tried[:, :3]), np.ascontiguousarray(tried[:, 3:])
        still = inverted_triangles(positions, normals, local_triangles[touched])
        kept = _improved_patches(local_triangles[touched], inside, folded[touched], still)
        # A triangle's moved corners belong to one patch: all of them are kept, or none.
        settled = touched_triangles(local_triangles[touched], kept)
        folded[touched] = np.where(settled, still, folded[touched])
        local = local.replaced(np.flatnonzero(kept), new.at(np.flatnonzero(kept[moved])))
        places[kept] = tried[kept]
        if folded.sum() > (1.0 - config.min_gain) * before or not folded.any():
            break
    return local, folded


def _improved_patches(near: IndexArray, inside: BoolArray, before: BoolArray, after: BoolArray) -> BoolArray:
    """(n,) vertices of the connected patches with fewer flipped triangles than before."""
    patch = label_patches(near, inside)
    # The inside corners of a triangle are neighbours, so that any of them gives its patch.
    corner = np.argmax(inside[near], axis=1)
    patch_of = patch[near[np.arange(len(near)), corner]]
    gain = np.bincount(patch_of, before.astype(float) - after, minlength=len(inside))
    return np.asarray(inside & (gain[patch] > 0))


def flipped_rings(triangles: IndexArray, flipped: BoolArray, rings: int, n: int) -> NDArray[np.bool_]:
    """(n,) which vertices are in flipped triangles or in the rings around them."""
    inside = mask_of(triangles[flipped], n)
    for _ in range(rings):
        inside[triangles[touched_triangles(triangles, inside)]] = True
    return inside


def touched_triangles(triangles: IndexArray, inside: BoolArray) -> BoolArray:
    """(t,) triangles with a corner inside."""
    touched = np.empty(len(triangles), dtype=np.bool_)

    def fill(part: slice) -> None:
        first, second, third = (inside.take(corner) for corner in triangles[part].T)
        touched[part] = first | second | third

    in_threads(fill, row_slices(len(triangles), CACHED))
    return touched


def label_patches(triangles: IndexArray, inside: BoolArray) -> IndexArray:
    """(n,) connected patch of every vertex, below n; vertices outside are patches of their own."""
    n = len(inside)
    near = triangles[touched_triangles(triangles, inside)].astype(np.int32)
    heads, tails = near.T.ravel(), near[:, [1, 2, 0]].T.ravel()
    joined = inside[heads] & inside[tails]
    return label_components(heads[joined], tails[joined], n)


def neighbour_means(triangles: IndexArray, inside: BoolArray) -> sparse.csr_array:
    """(v, n) matrix that averages the neighbours of every inside vertex."""
    corners = triangles.astype(np.int32)
    rows, columns = corners[:, [0, 1, 2, 0, 1, 2]].ravel(), corners[:, [1, 2, 0, 2, 0, 1]].ravel()
    return convex_rows(rows, columns, np.ones(len(rows)), inside)


def convex_rows(
    rows: NDArray[np.integer], columns: NDArray[np.integer], weights: FloatArray, inside: BoolArray
) -> sparse.csr_array:
    """(v, n) convex combinations for the v vertices inside: weights, duplicates summed, rows scaled to sum 1."""
    kept = slice(None) if inside.all() else inside[rows]  # a slice copies nothing
    number = np.cumsum(inside, dtype=np.int32) - 1
    shape = (int(inside.sum()), len(inside))
    matrix = sparse.csr_array((weights[kept], (number[rows[kept]], columns[kept])), shape=shape)
    return sparse.csr_array(sparse.diags_array(1.0 / np.asarray(matrix.sum(axis=1)).ravel()) @ matrix)
