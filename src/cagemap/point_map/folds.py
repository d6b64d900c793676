"""Remove the folds of a map: flipped triangles are relaxed together with their neighbourhood and projected again.

Inside a patch around the flips the image points move to the means of their neighbours while the rest of the map holds
the patch's boundary: a discrete harmonic map, which is one-to-one where the patch's image is close to flat and convex
(Tutte 1963).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from cagemap.basis.threads import in_threads, parts
from cagemap.mesh import FloatArray, IndexArray
from cagemap.point_map.quality import flipped_triangles, map_positions
from cagemap.point_map.surface_points import CACHED, TriangleTree, closest_points, normalized

ROUNDS = 8
SWEEPS = 10
# Share of the flipped triangles that a round must mend for another one to be worth it.
LEAST_GAIN = 0.02


@dataclass(frozen=True)
class Images:
    """Where the vertices of a piece of the target go.

    Attributes
    ----------
    triangle, barycentric : (n,), (n, 3)
    positions : (n, 3) float64
    """

    triangle: IndexArray
    barycentric: FloatArray
    positions: FloatArray


def unfold(
    triangle: IndexArray,
    barycentric: FloatArray,
    target_triangles: IndexArray,
    source: FloatArray,
    source_triangles: IndexArray,
    tree: TriangleTree,
    held: IndexArray,
    *,
    normal_weight: float,
    rounds: int = ROUNDS,
) -> tuple[IndexArray, FloatArray]:
    """Reduce the flipped triangles of a map; vertices far from a flip and held ones keep their image.

    A connected patch keeps its new image only if fewer of its triangles are flipped than before; the patches grow by a
    ring a round, until a round mends little.

    Parameters
    ----------
    triangle, barycentric : (n1,), (n1, 3)
        The map.
    target_triangles : (t1, 3) int64
    source, source_triangles : (n2, 3), (t2, 3)
        At unit area.
    tree : TriangleTree
        Of the source.
    held : (p,) int64
        Target vertices that may not move (landmarks).
    normal_weight : float
        Of the projection, see `closest_points`.

    Returns
    -------
    triangle, barycentric : (n1,), (n1, 3)
    """
    image = map_positions(source, source_triangles, triangle, barycentric)
    flipped = flipped_triangles(image, target_triangles, tree.normals_of(triangle))
    if not flipped.any():
        return triangle, barycentric
    # Nothing outside the last round's patch is looked at: go on with the triangles around it, renumbered.
    region = _touched(target_triangles, _patch(target_triangles, flipped, rounds, len(image)))
    vertices, near = np.unique(target_triangles[region], return_inverse=True)
    near = near.reshape(-1, 3)
    movable = ~np.isin(vertices, held)
    local = Images(triangle[vertices], barycentric[vertices], image[vertices])
    before = np.inf
    for ring in range(1, rounds + 1):
        flipped = flipped_triangles(local.positions, near, tree.normals_of(local.triangle))
        if flipped.sum() > (1.0 - LEAST_GAIN) * before or not flipped.any():
            break
        before = flipped.sum()
        inside = _patch(near, flipped, ring, len(vertices)) & movable
        local = _relaxed(local, near, inside, flipped, source, source_triangles, tree, normal_weight)
    triangle, barycentric = triangle.copy(), barycentric.copy()
    triangle[vertices], barycentric[vertices] = local.triangle, local.barycentric
    return triangle, barycentric


def _relaxed(
    images: Images,
    near: IndexArray,
    inside: np.ndarray,
    flipped: np.ndarray,
    source: FloatArray,
    source_triangles: IndexArray,
    tree: TriangleTree,
    normal_weight: float,
) -> Images:
    """Images of the vertices inside after some sweeps of averaging, where that leaves fewer triangles flipped."""
    vertices = np.flatnonzero(inside)
    touched = _touched(near, inside)
    means = _neighbour_means(near[touched], inside)
    moved, directions = images.positions.copy(), tree.normals_of(images.triangle)
    for _ in range(SWEEPS):
        moved[vertices] = means @ moved
        directions[vertices] = normalized(means @ directions)
    found, weights, _ = closest_points(
        tree,
        moved[vertices],
        directions[vertices],
        normal_weight=normal_weight,
        guess=images.triangle[vertices],
    )
    triangle, barycentric, positions = images.triangle.copy(), images.barycentric.copy(), images.positions.copy()
    triangle[vertices], barycentric[vertices] = found, weights
    positions[vertices] = map_positions(source, source_triangles, found, weights)
    still = flipped_triangles(positions, near[touched], tree.normals_of(triangle))
    kept = _improved(near[touched], inside, flipped[touched], still)
    chosen = kept[:, None]
    return Images(
        np.where(kept, triangle, images.triangle),
        np.where(chosen, barycentric, images.barycentric),
        np.where(chosen, positions, images.positions),
    )


def _patch(triangles: IndexArray, flipped: np.ndarray, rings: int, n: int) -> np.ndarray:
    """(n,) vertices of flipped triangles and of some rings around them."""
    inside = np.zeros(n, dtype=bool)
    inside[triangles[flipped].ravel()] = True
    for _ in range(rings):
        inside[triangles[_touched(triangles, inside)].ravel()] = True
    return inside


def _touched(triangles: IndexArray, inside: np.ndarray) -> np.ndarray:
    """(t,) triangles with a corner inside."""
    touched = np.empty(len(triangles), dtype=np.bool_)

    def fill(part: slice) -> None:
        first, second, third = (inside.take(corner) for corner in triangles[part].T)
        touched[part] = first | second | third

    in_threads(fill, parts(len(triangles), CACHED))
    return touched


def _improved(near: IndexArray, inside: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(n,) vertices of those connected patches in which fewer of the touched triangles are flipped than before."""
    n = len(inside)
    pairs = np.concatenate([near[:, [0, 1]], near[:, [1, 2]], near[:, [2, 0]]])
    pairs = pairs[inside[pairs].all(axis=1)]
    graph = sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    count, patch = csgraph.connected_components(graph.tocsr(), directed=False)
    # The inside corners of a triangle are neighbours, so that any of them names its patch.
    corner = np.argmax(inside[near], axis=1)
    patch_of = patch[near[np.arange(len(near)), corner]]
    gain = np.bincount(patch_of, before.astype(float) - after, minlength=count)
    return np.asarray(inside & (gain[patch] > 0))


def _neighbour_means(near: IndexArray, inside: np.ndarray) -> sparse.csr_array:
    """(v, n) matrix that averages the neighbours of every inside vertex."""
    n = len(inside)
    rows, columns = near[:, [0, 1, 2, 0, 1, 2]].ravel(), near[:, [1, 2, 0, 2, 0, 1]].ravel()
    kept = inside[rows]
    number = np.cumsum(inside) - 1
    ones = np.ones(int(kept.sum()))
    adjacency = sparse.csr_array((ones, (number[rows[kept]], columns[kept])), shape=(int(inside.sum()), n))
    return sparse.csr_array(sparse.diags_array(1.0 / np.asarray(adjacency.sum(axis=1)).ravel()) @ adjacency)
