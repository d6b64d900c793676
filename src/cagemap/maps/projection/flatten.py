"""Remove large folds of a map: match the discs around them one-to-one in a plane.

A part that the source lacks or has much smaller (a fin, a tail) collapses onto it with one side flipped. Relaxation
does not remove such folds. Take a ball around the fold: the part of the target with its image in the ball is a disc,
and so is the source in the ball. The source's disc is flattened with its rim on a circle. In this plane every vertex of
the target's disc becomes a convex combination of its neighbours while its rim is fixed; this is one-to-one (Tutte 1963;
Floater 2003). Around vertices that are not folded the weights are mean value coordinates, which leave the map unchanged
there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import Delaunay

from cagemap.deform.config import ProjectionConfig
from cagemap.errors import SolverError
from cagemap.maps.projection.relax import (
    BoolArray,
    convex_rows,
    flipped_rings,
    label_patches,
    neighbour_means,
    touched_triangles,
)
from cagemap.maps.quality import flipped_triangles
from cagemap.numerics.arrays import FloatArray, IndexArray, mask_of, places_of
from cagemap.numerics.sparse_algebra import factor_general
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import row_lengths


@dataclass(frozen=True, eq=False)
class Disc:
    """A piece of a surface that is topologically a disc."""

    vertices: IndexArray  # (n,) of the surface
    chosen: IndexArray  # (t,) triangles of the surface
    triangles: IndexArray  # (t, 3) vertices of these triangles, numbered within the piece
    rim: IndexArray  # (r,) vertices on its border in counter-clockwise order, numbered within the piece

    @property
    def inside(self) -> BoolArray:
        """(n,) which vertices are not on the rim."""
        return ~mask_of(self.rim, len(self.vertices))


def flatten_folded_parts(
    images: SurfacePoints,
    flipped: BoolArray,
    target: TriangleSurface,
    held: IndexArray,
    config: ProjectionConfig = ProjectionConfig(),
) -> SurfacePoints:
    """Unfold the parts with the largest folds, each within a disc.

    A result is kept if it removes at least ``min_unfolded`` of the fold and displaces not much more area than is
    folded. Held vertices (p,) keep their images (landmarks).
    """
    for part in folded_parts(target, flipped, config):
        for growth in config.growths:
            flattened = _flatten_part(images, part, growth, target, held, config)
            if flattened is None:
                continue
            chosen, new = flattened
            still = flipped_triangles(new, target.triangles[chosen])
            areas = target.areas[chosen]
            folded = areas @ flipped[chosen]
            far = row_lengths(new.positions - images.positions) > config.max_move
            moved_too_far = target.vertex_areas[far].sum() > config.max_displaced * folded
            if areas @ still < (1.0 - config.min_unfolded) * folded and not moved_too_far:
                images, flipped = new, flipped.copy()
                flipped[chosen] = still
                break
    return images


def folded_parts(
    target: TriangleSurface, flipped: BoolArray, config: ProjectionConfig = ProjectionConfig()
) -> list[IndexArray]:
    """Vertices of flipped triangles (t,) by part, largest first; none if more than ``max_folded`` is folded."""
    triangles, areas = target.triangles, target.areas[flipped]
    if not config.min_part <= areas.sum() <= config.max_folded:
        return []
    n = target.n
    part = label_patches(
        triangles, flipped_rings(triangles, flipped, max(1, round(0.5 * config.part_distance * np.sqrt(n))), n)
    )
    share = np.bincount(part[triangles[flipped, 0]], areas)
    vertices = np.unique(triangles[flipped])
    large = np.flatnonzero(share >= config.min_part)
    return [vertices[part[vertices] == k] for k in large[np.argsort(-share[large])]]


def _flatten_part(
    images: SurfacePoints,
    part: IndexArray,
    growth: float,
    target: TriangleSurface,
    held: IndexArray,
    config: ProjectionConfig,
) -> tuple[IndexArray, SurfacePoints] | None:
    """Target triangles of the disc around a part, and new images; None without a disc."""
    centre = images.positions[part].mean(axis=0)
    away = row_lengths(images.positions - centre)
    radius = growth * away[part].max()
    ball = away < radius
    ball[part] = True
    disc = _disc_in(ball, target.triangles, part, config.max_disc)
    if disc is None:
        return None
    now, source = images.at(disc.vertices), images.surface
    needed = now.corners.ravel()
    distance = row_lengths(source.positions - centre)
    around_it = distance <= max(config.margin * radius, distance[needed].max())
    below = _disc_in(around_it, source.triangles, needed[:1], config.max_disc, whole=True)
    if below is None:
        return None
    at = places_of(below.chosen, len(source.triangles))[now.triangle]
    if np.any(at < 0):
        return None
    plane = flat_disc(below)
    before = np.einsum("nk,nkd->nd", now.barycentric, plane[below.triangles[at]])
    try:
        after = combine_points(convex_weights(before, disc), before, disc.inside)
    except SolverError:  # points of the map coincide to rounding
        return None
    fixed = disc.inside & np.isin(disc.vertices, held)
    chosen = np.flatnonzero(fixed)
    moved = move_points(after, disc.rim, chosen, before[fixed], config.disc_steps) if len(chosen) else after
    if moved is None:
        return None
    free = disc.inside & ~fixed
    flat, queries = (np.column_stack([places, np.zeros(len(places))]) for places in (plane, moved[free]))
    found = SurfacePoints.nearest(TriangleSurface(flat, below.triangles), queries)
    new = SurfacePoints(source, below.chosen[found.triangle], found.barycentric)
    return disc.chosen, images.replaced(disc.vertices[free], new)


def _disc_in(
    ball: BoolArray, triangles: IndexArray, seeds: IndexArray, max_share: float, *, whole: bool = False
) -> Disc | None:
    """Disc of the triangles with one corner (or all) in a ball, connected with the seeds."""
    patch = label_patches(triangles, ball)
    inside = ball & np.isin(patch, patch[seeds])

    def disc(inside: BoolArray) -> Disc | None:
        chosen = inside[triangles].all(axis=1) if whole else touched_triangles(triangles, inside)
        return _disc(triangles, np.flatnonzero(chosen), max_share * len(inside))

    return disc(inside) or disc(_fill_holes(triangles, inside))


def _disc(triangles: IndexArray, chosen: IndexArray, max_vertices: float) -> Disc | None:
    """Disc of the chosen triangles; None if they are no disc or have too many vertices."""
    vertices, corners = np.unique(triangles[chosen], return_inverse=True)
    corners = corners.reshape(-1, 3)
    n = len(vertices)
    edges = corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    directed = sparse.csr_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    border = sparse.coo_array((directed - directed.T).maximum(0.0))
    border.eliminate_zeros()
    euler = n - (len(edges) + border.nnz) // 2 + len(chosen)
    if euler != 1 or border.nnz == 0 or n > max_vertices:
        return None
    rim = csgraph.depth_first_order(border.tocsr(), int(border.row[0]), return_predecessors=False).astype(np.int64)
    return Disc(vertices, chosen, corners, rim) if len(rim) == border.nnz else None


def _fill_holes(triangles: IndexArray, inside: BoolArray) -> BoolArray:
    """Vertices inside, and the holes among them: all but the largest component outside."""
    if inside.all():
        return inside
    patch = label_patches(triangles, ~inside)
    return np.asarray(patch != np.bincount(patch[~inside]).argmax())


def flat_disc(disc: Disc) -> FloatArray:
    """(n, 2) positions of a disc in the unit circle: rim evenly spaced, others at their neighbours' mean."""
    angles = 2.0 * np.pi * np.arange(len(disc.rim)) / len(disc.rim)
    plane = np.zeros((len(disc.vertices), 2))
    plane[disc.rim] = np.column_stack([np.cos(angles), np.sin(angles)])
    return combine_points(neighbour_means(disc.triangles, disc.inside), plane, disc.inside)


def convex_weights(places: FloatArray, disc: Disc) -> sparse.csr_array:
    """(v, n) weights of the neighbours of the v inner vertices of a flat disc, perhaps folded.

    Mean value coordinates (Floater 2003) in the unfolded part that is connected with the rim, equal weights elsewhere.
    """
    triangles, inside = disc.triangles, disc.inside
    n = len(places)
    rows, columns, weights = [], [], []
    whole, upright = np.zeros(n), np.ones(n, dtype=bool)
    for corner in range(3):
        first, second, third = (triangles[:, (corner + k) % 3] for k in range(3))
        to_second, to_third = places[second] - places[first], places[third] - places[first]
        angle = np.arctan2(_cross(to_second, to_third), np.einsum("td,td->t", to_second, to_third))
        whole += np.bincount(first, angle, minlength=n)
        upright[first[angle <= 0]] = False
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            weights += [np.tan(angle / 2) / row_lengths(to_second), np.tan(angle / 2) / row_lengths(to_third)]
        rows += [first, first]
        columns += [second, third]
    # All angles can be positive although the triangles go around the vertex twice.
    upright &= np.abs(whole - 2.0 * np.pi) < 1e-3
    upright |= ~inside
    patch = label_patches(triangles, upright)
    kept = upright & np.isin(patch, patch[~inside])
    row, value = np.concatenate(rows), np.concatenate(weights)
    return convex_rows(row, np.concatenate(columns), np.where(kept[row] & np.isfinite(value), value, 1.0), inside)


def combine_points(weights: sparse.csr_array, places: FloatArray, inside: BoolArray) -> FloatArray:
    """(n, 2) positions with every inner vertex at its combination (v, n), the rim fixed; or SolverError."""
    if not inside.any():  # a disc so small that all its vertices are on the rim
        return places
    held = np.where(inside[:, None], 0.0, places)
    matrix = sparse.csc_array(sparse.eye_array(weights.shape[0]) - weights[:, np.flatnonzero(inside)])
    result = places.copy()
    result[inside] = factor_general(matrix).solve(weights @ held)
    return result


def move_points(
    places: FloatArray, rim: IndexArray, chosen: IndexArray, goals: FloatArray, steps: int
) -> FloatArray | None:
    """(n, 2) positions with chosen points moved to their goals, one-to-one; the rim is fixed.

    Each step moves a triangulation of rim and chosen points as far as no triangle flips, and interpolates the others.
    None if goals are not reached.
    """
    corners = np.concatenate([rim, chosen])
    wanted = np.concatenate([places[rim], goals])
    for _ in range(steps):
        mesh = Delaunay(places[corners])
        ends, share = wanted, 1.0
        while not _upright(mesh, ends):
            share /= 2.0
            if share <= 1e-3:
                return None
            ends = mesh.points + share * (wanted - mesh.points)
        triangle = mesh.find_simplex(places)
        known = triangle >= 0
        frame = mesh.transform[triangle[known]]
        first = np.einsum("nij,nj->ni", frame[:, :2], places[known] - frame[:, 2])
        barycentric = np.column_stack([first, 1.0 - first.sum(axis=1)])
        places = places.copy()
        places[known] = np.einsum("nk,nkd->nd", barycentric, ends[mesh.simplices[triangle[known]]])
        places[corners] = ends
        if share == 1.0:
            # A sliver of the triangulation has no barycentric coordinates.
            return places if np.isfinite(places).all() else None
    return None


def _upright(mesh: Delaunay, ends: FloatArray) -> bool:
    """Whether a triangulation keeps the orientation, and a tenth of the area, of all its triangles."""

    def areas(points: FloatArray) -> FloatArray:
        first, second, third = (points[mesh.simplices[:, k]] for k in range(3))
        return _cross(second - first, third - first)

    start = areas(mesh.points)
    return bool(np.all(areas(ends) * np.sign(start) >= 0.1 * np.abs(start)))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """(t,) cross products of vectors (t, 2)."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
