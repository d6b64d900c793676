"""Build coarse levels of a plain mesh, in place of the hierarchy that subdivision gives a cage.

A dense mesh is simplified step by step (quadric error metrics, Garland and Heckbert 1997, by `fast_simplification`).
Coarse vertices are vertices of the finer mesh. S^l prolongs functions as a subdivision matrix does: its rows are
smoothed barycentric coordinates of the finer vertices in coarse triangles.
"""

from __future__ import annotations

import threading
from typing import NamedTuple

import fast_simplification
import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.errors import InvalidMeshError
from cagemap.numerics.arrays import FloatArray, IndexArray, pair_keys
from cagemap.numerics.threads import in_threads, row_slices
from cagemap.operators.laplacian import stiffness
from cagemap.subdivision import Level, Refinement, level_triangles
from cagemap.surface.closest_points import closest_among
from cagemap.surface.triangles import normalize_rows, triangle_neighbors, triangle_normals

COARSE_SIZES = (1500, 6000, 24_000)  # vertices of levels for the basis, the deformation, the search
MAX_SHARE = 0.7  # largest share of the next finer level's vertices
MIN_LEVEL_VERTICES = 100  # fewest vertices of a level
AGGRESSIVENESS = 3  # `agg` of fast_simplification: growth rate of its threshold; slower makes better triangles
DAMPING = 2 / 3  # omega of the Jacobi step that smooths prolonged functions
LOCATE_BLOCK = 65_536  # number of vertices that a thread locates on the coarser mesh at once
MAX_FLIP_ROUNDS = 20  # most rounds of edge flips; each round flips at most one edge of a triangle
MIN_NORMAL_COSINE = 0.8  # least cosine between the normals on both sides of a flipped edge; sharper edges are features
MIN_DOUBLED_AREA = 1e-12  # least doubled area of a triangle, as a share of a squared edge: keeps cotangents finite
MAX_COTANGENT_SUM = -1e-9  # largest sum of the cotangents opposite to an edge that is flipped: below 0 by rounding
_SIMPLIFICATION_LOCK = threading.Lock()  # the library keeps its mesh in global variables: threads must take turns


class Simplified(NamedTuple):
    """A coarser mesh: finer vertex of every coarse one (k,), coarse vertex of every finer one (n,), triangles."""

    kept: IndexArray
    cluster: IndexArray
    triangles: IndexArray


def build_coarse_levels(plain: Refinement) -> Refinement:
    """Add coarse levels to a plain mesh (a Refinement without steps), which stays the finest level.

    The mesh keeps its numbers. Vertex i of a coarse level is vertex i of every finer coarse level, and vertex
    ``coarse_vertices[i]`` of the mesh. Time and memory are linear in the mesh's size.
    """
    control, dense = plain.control, plain.finest
    if dense.faces is None:
        raise InvalidMeshError(
            f"{control.name}: expected a plain mesh of triangles or of quads alone, got faces of different sizes. "
            "Triangulate them, as cagemap.plain_mesh does."
        )
    surfaces, steps = [(control.positions, level_triangles(plain, 0))], list[Simplified]()
    for size in reversed([size for size in COARSE_SIZES if size <= MAX_SHARE * control.n_vertices]):
        step = simplify_mesh(*surfaces[-1], size)
        if not MIN_LEVEL_VERTICES <= len(step.kept) <= MAX_SHARE * len(step.cluster):
            break
        steps.append(step)
        surfaces.append((surfaces[-1][0][step.kept], step.triangles))
    if not steps:
        return plain
    # From the coarsest level up; `order` are the vertices of a step's mesh in the order of its level.
    positions, faces = surfaces[-1]
    order, levels, matrices = np.arange(len(positions)), [Level(positions, faces, np.arange(len(faces)))], []
    for step, (positions, faces) in zip(reversed(steps), reversed(surfaces[:-1]), strict=True):
        matrix, coarse = sparse.csr_array(prolongation(positions, faces, step)[:, order]), step.kept[order]
        if step is not steps[0]:
            order = np.concatenate([coarse, np.delete(np.arange(len(positions)), step.kept)])
            matrix = sparse.csr_array(matrix[order])
            levels.append(Level(positions[order], np.argsort(order)[faces], np.arange(len(faces))))
        matrix.sort_indices()
        matrices.append(matrix)
    return Refinement(control, plain.scheme, tuple(matrices), (*levels, dense), coarse)


def simplify_mesh(positions: FloatArray, triangles: IndexArray, count: int) -> Simplified:
    """Simplify a mesh to about ``count`` of its vertices by edge collapses; edges of thin triangles are flipped.

    With the thin triangles that collapses leave, elastic maps were 25 % worse.
    """
    low = positions.min(axis=0)
    unit = (positions - low) / np.max(positions.max(axis=0) - low)  # the library's thresholds are absolute
    faces = triangles.astype(np.int32)
    with _SIMPLIFICATION_LOCK:
        _, _, collapses = fast_simplification.simplify(
            unit, faces, target_count=2 * count, agg=AGGRESSIVENESS, return_collapses=True
        )
        places, coarse, cluster = fast_simplification.replay_simplification(unit, faces, collapses)
    used = np.isin(cluster, coarse)
    if not used.all():  # vertices of clusters without triangles join the nearest other cluster
        cluster[~used] = cluster[used][cKDTree(unit[used]).query(unit[~used])[1]]
    distance = np.linalg.norm(unit - places[cluster], axis=1)
    by_cluster = np.lexsort((distance, cluster))
    clusters, first = np.unique(cluster[by_cluster], return_index=True)
    kept = by_cluster[first]
    flipped = flip_to_delaunay(positions[kept], np.searchsorted(clusters, coarse))
    return Simplified(kept, np.searchsorted(clusters, cluster), flipped)


def prolongation(positions: FloatArray, triangles: IndexArray, step: Simplified) -> sparse.csr_array:
    """(n, k) smoothed barycentric coordinates in triangles around a vertex's own coarse vertex; rows sum to 1.

    Other triangles may belong to another part of the surface that is near in space.
    """
    around = np.argsort(step.triangles.ravel(), kind="stable") // 3  # triangles by coarse vertex
    counts = np.bincount(step.triangles.ravel(), minlength=len(step.kept))
    starts = np.cumsum(counts) - counts
    kept, ranges = positions[step.kept], np.column_stack([starts, starts + counts])
    vertices, weights = np.empty((len(positions), 3), dtype=np.int64), np.empty((len(positions), 3))

    def locate(part: slice) -> None:
        near = ranges[step.cluster[part]]
        triangle, weights[part] = closest_among(kept, step.triangles, near, around, positions[part])
        vertices[part] = step.triangles[triangle]

    in_threads(locate, row_slices(len(positions), LOCATE_BLOCK))
    # Vertices of both meshes have exact coordinates.
    vertices[step.kept], weights[step.kept] = np.arange(len(step.kept))[:, None], [1.0, 0.0, 0.0]
    rows = 3 * np.arange(len(positions) + 1)
    matrix = sparse.csr_array((weights.ravel(), vertices.ravel(), rows), shape=(len(positions), len(step.kept)))
    matrix.sum_duplicates()
    return sparse.csr_array(smoothing_matrix(positions, triangles) @ matrix)


def smoothing_matrix(positions: FloatArray, triangles: IndexArray) -> sparse.csr_array:
    """(n, n) damped Jacobi step ``1 - omega D^-1 W`` of smoothed aggregation (Vanek et al. 1996), not negative.

    It divides the error of coarse levels' eigenvalues by several times.
    """
    upper = sparse.triu(stiffness(positions, triangles), 1).tocoo()
    rows, columns = (upper.coords[i].astype(np.int64) for i in (0, 1))
    weights = sparse.coo_array((np.maximum(-upper.data, 0.0), (rows, columns)), shape=upper.shape)
    neighbours = sparse.csr_array(weights + weights.T)
    total = np.asarray(neighbours.sum(axis=1)).ravel()
    share = np.divide(DAMPING, total, out=np.zeros_like(total), where=total > 0)
    return sparse.csr_array(sparse.diags_array(np.where(total > 0, 1.0 - DAMPING, 1.0)) + share[:, None] * neighbours)


def flip_to_delaunay(positions: FloatArray, triangles: IndexArray) -> IndexArray:
    """Triangles (t, 3) with edges of negative cotangent weight flipped where flat, for the elastic graph's energy."""
    triangles = triangles.copy()
    for _ in range(MAX_FLIP_ROUNDS):
        first, corner, second, second_corner = _to_flip(positions, triangles)
        if not len(first):
            break
        # Edge (a, b) between the apexes p and q becomes (p, q); orientations are unchanged.
        p, a = triangles[first, corner], triangles[first, (corner + 1) % 3]
        q, b = triangles[second, second_corner], triangles[second, (second_corner + 1) % 3]
        triangles[first] = np.column_stack([p, a, q])
        triangles[second] = np.column_stack([q, b, p])
    return triangles


def _to_flip(positions: FloatArray, triangles: IndexArray) -> tuple[IndexArray, IndexArray, IndexArray, IndexArray]:
    """Edges to flip together, at most one per triangle: both triangles, and their corners opposite the edge."""
    neighbors = triangle_neighbors(triangles).astype(np.int64)
    first, corner = np.nonzero(neighbors > np.arange(len(triangles))[:, None])
    second = neighbors[first, corner]
    second_corner = np.argmax(neighbors[second] == first[:, None], axis=1)
    apex, left = triangles[first, corner], triangles[first, (corner + 1) % 3]
    right, top = triangles[first, (corner + 2) % 3], triangles[second, second_corner]
    # Both triangles have the same orientation.
    oriented = triangles[second, (second_corner + 1) % 3] == right
    cotangents = _cotangent(positions, apex, left, right) + _cotangent(positions, top, left, right)
    normals = normalize_rows(triangle_normals(positions, triangles))
    flat = np.einsum("ed,ed->e", normals[first], normals[second]) > MIN_NORMAL_COSINE
    count = len(positions)
    known = pair_keys(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), count)
    keys = pair_keys(np.column_stack([apex, top]), count)
    fresh = ~np.isin(keys, known)
    new = np.column_stack([apex, left, top]), np.column_stack([top, right, apex])
    upright = np.all([np.einsum("ed,ed->e", triangle_normals(positions, t), normals[first]) > 0 for t in new], axis=0)
    wanted = np.flatnonzero(oriented & flat & fresh & upright & (cotangents < MAX_COTANGENT_SUM))
    worst = np.full(len(triangles), np.inf)
    for side in (first, second):
        np.minimum.at(worst, side[wanted], cotangents[wanted])
    chosen = wanted[(cotangents[wanted] == worst[first[wanted]]) & (cotangents[wanted] == worst[second[wanted]])]
    # Coinciding new edges, and ties in one triangle, are left to the next round.
    chosen = chosen[np.unique(keys[chosen], return_index=True)[1]]
    taken = np.bincount(np.concatenate([first[chosen], second[chosen]]), minlength=len(triangles))
    chosen = chosen[(taken[first[chosen]] == 1) & (taken[second[chosen]] == 1)]
    return first[chosen], corner[chosen], second[chosen], second_corner[chosen]


def _cotangent(positions: FloatArray, apex: IndexArray, left: IndexArray, right: IndexArray) -> FloatArray:
    """(e,) cotangents of the angles at the apexes opposite edges."""
    u, v = positions[left] - positions[apex], positions[right] - positions[apex]
    area = np.linalg.norm(np.cross(u, v), axis=1)
    return np.einsum("ed,ed->e", u, v) / np.maximum(area, MIN_DOUBLED_AREA * np.einsum("ed,ed->e", u, u) + 1e-300)
