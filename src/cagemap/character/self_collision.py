"""Self-collisions of a deformed surface: lips or eyelids that went through each other are moved apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cagemap.character.body_frames import neighbor_means, spread_push, weighted_means
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.kinds import Config
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.triangles import row_lengths, surface_area, vertex_normals
from cagemap.transfer.textured_surface import plane_basis

# Slopes of the rays against `outward`: without, they run through edges on the midline of a symmetric face.
_TILT = np.array([0.0123, 0.0071])


@dataclass(frozen=True)
class CollisionConfig(Config):
    """Numbers of `move_apart`; lengths in units of sqrt(area). What was measured: docs/lab/characters.md."""

    reach: float = 0.02  # largest depth of a collision
    lift: float = 1e-4  # of points over the vertices that are tested
    max_depth: float = 2e-4  # depth that is left
    min_move: float = 2e-4  # vertices that a shape moves by less are not tested
    max_rounds: int = 30
    spreading_rounds: int = 4  # in which a push spreads to neighbouring vertices


_CONFIG = CollisionConfig()


@dataclass(frozen=True, eq=False)
class Collisions:
    """Vertices that lie inside another part of the same surface."""

    vertices: IndexArray  # (k,)
    exits: FloatArray  # (k, 3) vectors to the nearest point of the surface whose normal opposes the vertex's own
    corners: IndexArray  # (k, 3) that point
    barycentric: FloatArray  # (k, 3)

    @classmethod
    def find(
        cls, positions: FloatArray, triangles: IndexArray, vertices: IndexArray, outward: FloatArray
    ) -> Collisions:
        """Find which of some vertices collide; no ray along ``outward`` (3,) may pass through a hole."""
        size = np.sqrt(surface_area(positions, triangles))
        normals = vertex_normals(positions, triangles)[vertices]
        points = positions[vertices] + _CONFIG.lift * size * normals
        triangle, barycentric, _ = closest_points(
            build_tree(positions, triangles), points, -normals, minimum_cosine=0.0, within=_CONFIG.reach * size
        )
        near = np.flatnonzero(triangle >= 0)
        inside = near[winding_numbers(positions, triangles, points[near], outward) > 0]
        corners, barycentric = triangles[triangle[inside]], barycentric[inside]
        facing = np.einsum("kc,kcd->kd", barycentric, positions[corners])
        return cls(vertices[inside], facing - points[inside], corners, barycentric)


def move_apart(rest: FloatArray, moved: FloatArray, triangles: IndexArray, outward: FloatArray) -> FloatArray:
    """Positions (n, 3) of ``moved``, with collisions that ``rest`` (n, 3) does not have moved apart.

    Deeper ones than ``reach`` stay. Both sides give way by half. A push spreads to neighbouring vertices and fades with
    each step.
    """
    size = np.sqrt(surface_area(rest, triangles))
    means = neighbor_means(triangles, len(rest))
    vertices = np.flatnonzero(row_lengths(moved - rest) > _CONFIG.min_move * size)
    tested = Collisions.find(moved, triangles, vertices, outward).vertices
    if not len(tested):
        return moved
    at_rest = Collisions.find(rest, triangles, np.arange(len(rest)), outward).vertices
    for _ in range(_CONFIG.max_rounds):
        tested = np.setdiff1d(tested, at_rest)
        found = Collisions.find(moved, triangles, tested, outward)
        if row_lengths(found.exits).max(initial=0.0) < _CONFIG.max_depth * size:
            break
        half, weights = 0.5 * found.exits, found.barycentric
        shares = weights / np.einsum("kc,kc->k", weights, weights)[:, None]
        moves = np.concatenate([half, (-shares[:, :, None] * half[:, None]).reshape(-1, 3)])
        rows = np.concatenate([found.vertices, found.corners.ravel()])
        row_weights = np.concatenate([np.ones(len(half)), weights.ravel()])
        push = spread_push(means, weighted_means(rows, row_weights, moves, len(rest)), _CONFIG.spreading_rounds)
        moved = moved + push
        tested = np.union1d(tested, np.flatnonzero(push.any(axis=1)))
    return moved


def _pairs_within(points: FloatArray, centres: FloatArray, radii: FloatArray) -> tuple[IndexArray, IndexArray]:
    """Pairs of points (k, 2) and discs that may hold them; discs are searched by classes of their radius."""
    tree, classes = cKDTree(points), np.frexp(np.maximum(radii, np.finfo(float).tiny))[1]
    points_found, discs_found = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for one in np.unique(classes):
        discs = np.flatnonzero(classes == one)
        pairs = tree.sparse_distance_matrix(cKDTree(centres[discs]), 2.0**one, output_type="ndarray")
        points_found.append(pairs["i"])
        discs_found.append(discs[pairs["j"]])
    return np.concatenate(points_found), np.concatenate(discs_found)


def winding_numbers(
    positions: FloatArray, triangles: IndexArray, points: FloatArray, direction: FloatArray
) -> IndexArray:
    """(m,) winding numbers of a surface around points, by crossings of rays: 0 outside."""
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    unit = direction / np.linalg.norm(direction)
    across = plane_basis(unit[None], np.eye(3)[:1])[0]
    frame = np.column_stack([across - unit[:, None] * _TILT, unit])  # rays keep their first two coordinates
    origins, corners = points @ frame, (positions @ frame)[triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    is_ahead = (high >= origins.min(axis=0)).all(axis=1) & (low[:, :2] <= origins[:, :2].max(axis=0)).all(axis=1)
    corners, low, high = corners[is_ahead], low[is_ahead], high[is_ahead]
    row, triangle = _pairs_within(origins[:, :2], 0.5 * (low + high)[:, :2], 0.5 * row_lengths((high - low)[:, :2]))
    near = (high[triangle] >= origins[row]).all(axis=1) & (low[triangle, :2] <= origins[row, :2]).all(axis=1)
    row, corners = row[near], corners[triangle[near]]
    arms, following = corners[:, :, :2] - origins[row, None, :2], np.roll(corners, -1, axis=1)[:, :, :2]
    following = following - origins[row, None, :2]
    # Twice the signed area of the origin and an edge, in the order of the corners where the edges start.
    areas = arms[:, :, 0] * following[:, :, 1] - arms[:, :, 1] * following[:, :, 0]
    depths = np.einsum("pk,pk->p", np.roll(areas, -1, axis=1), corners[:, :, 2])
    doubled = areas.sum(axis=1)
    sign = np.sign(doubled)
    is_hit = (areas * sign[:, None] >= 0).all(axis=1) & (depths * sign > origins[row, 2] * np.abs(doubled))
    return np.bincount(row, sign * is_hit, minlength=len(points)).astype(np.int64)
