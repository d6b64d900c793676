"""Contact of a carried passenger with the body: vertices outside the body stay outside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.character.body_frames import (
    BodyFrames,
    SignedDistances,
    longer_rows,
    neighbor_means,
    spread_push,
    weighted_means,
)
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.kinds import Config
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import normalize_rows


@dataclass(frozen=True)
class ContactConfig(Config):
    """Numbers of `push_out`; lengths in units of sqrt(area). What was tried: docs/lab/passengers.md."""

    height_share: float = 0.5  # smallest height over the target, as a share of the height over the source
    reach: float = 0.03  # largest distance of passenger and body in contact
    min_above_cosine: float = 0.5  # of the body's normal with the direction to the passenger above it
    min_facing_cosine: float = 0.3  # of the body's normal with that of the anchor
    tolerance: float = 1e-5  # of heights; also the height of a vertex that was moved outside
    max_rounds: int = 12
    leaving_rounds: int = 4  # most rounds that move vertices still inside to the nearest point outside
    spreading_rounds: int = 4  # in which a push spreads to neighbouring vertices


_CONFIG = ContactConfig()


@dataclass(frozen=True, eq=False)
class Contact:
    """Passenger vertices over the body, and body vertices below the passenger."""

    vertices: IndexArray  # (k,) passenger vertices above the source's body
    directions: FloatArray  # (k, 3) unit directions away from the target at them
    min_heights: FloatArray  # (k,) smallest allowed heights over the target
    body_vertices: IndexArray  # (c,) vertices of the target's body that the passenger covers
    corners: IndexArray  # (c, 3) point of the passenger over each
    barycentric: FloatArray  # (c, 3)
    min_gaps: FloatArray  # (c,) smallest allowed heights of these points

    @classmethod
    def find(
        cls,
        frames: BodyFrames,
        points: FloatArray,
        meshes: Sequence[IndexArray],
        normals: FloatArray,
        frames_at_points: FloatArray,
    ) -> Contact:
        """Find the contact on the source, for every mesh on its own.

        ``points``: (n, 3), vertices of all passengers in the source's unit.
        ``meshes``: (t, 3) triangles of each.
        ``normals``: (n, 3), of the source at the closest points.
        ``frames_at_points``: (n, 3, 3), affine maps from source to target around the points.
        """
        heights = _signed_distances(frames.point_map.source, points, normals).heights
        vertices = np.flatnonzero((heights > 0) & (heights < _CONFIG.reach))
        directions = normalize_rows(np.einsum("nd,nde->ne", normals, frames_at_points))[vertices]
        found_per_mesh = [_find_covered(frames, points, triangles) for triangles in meshes]
        body_vertices, corners, barycentric, gaps = (
            np.concatenate(arrays) for arrays in zip(*found_per_mesh, strict=True)
        )
        return cls(
            vertices,
            directions,
            _CONFIG.height_share * heights[vertices],
            body_vertices,
            corners,
            barycentric,
            _CONFIG.height_share * gaps,
        )


def _find_covered(
    frames: BodyFrames, points: FloatArray, triangles: IndexArray
) -> tuple[IndexArray, IndexArray, FloatArray, FloatArray]:
    """Body vertices below a mesh; corners, barycentric coordinates and heights of the points above."""
    images, upward = frames.point_map.images.positions, frames.source_normals
    used, inverse = np.unique(triangles, return_inverse=True)
    mesh = TriangleSurface(points[used], inverse.reshape(-1, 3))
    low, high = mesh.positions.min(axis=0) - _CONFIG.reach, mesh.positions.max(axis=0) + _CONFIG.reach
    body = np.flatnonzero(((images > low) & (images < high)).all(axis=1))
    triangle, barycentric, distance = closest_points(mesh.tree, images[body], within=_CONFIG.reach)
    offsets = np.einsum("nc,ncd->nd", barycentric, mesh.positions[mesh.triangles[triangle]]) - images[body]
    gaps = np.einsum("nd,nd->n", offsets, upward[body])
    # Vertices beside an open edge are not below the mesh: in the eye's socket, beside a brow.
    is_below = (triangle >= 0) & ~mesh.at_boundary(triangle, barycentric)
    rows = np.flatnonzero(is_below & (gaps > 0) & (gaps >= _CONFIG.min_above_cosine * distance))
    return body[rows], triangles[triangle[rows]], barycentric[rows], gaps[rows]


def push_out(target: TriangleSurface, contact: Contact, places: FloatArray, triangles: IndexArray) -> FloatArray:
    """Positions (n, 3) at unit area, moved out of the target's body to the contact's smallest heights.

    A push spreads to neighbouring vertices of the passenger and fades with each step.
    """
    body_positions, upward = target.positions[contact.body_vertices], target.vertex_normals[contact.body_vertices]
    squared = np.einsum("nc,nc->n", contact.barycentric, contact.barycentric)
    means = neighbor_means(triangles, len(places))
    is_moved: NDArray[np.bool_] = np.ones(len(places), dtype=bool)
    heights, upright = np.full(len(contact.vertices), np.inf), np.zeros_like(contact.directions)
    for _ in range(_CONFIG.max_rounds):
        changed = np.flatnonzero(is_moved[contact.vertices])
        distances = _signed_distances(target, places[contact.vertices[changed]], contact.directions[changed])
        heights[changed], upright[changed] = distances.heights, distances.normals
        rise = np.maximum(contact.min_heights - heights, 0.0)  # 0 where no body is near: heights are infinite
        rise[rise < _CONFIG.tolerance] = 0.0
        offsets = np.einsum("nc,ncd->nd", contact.barycentric, places[contact.corners]) - body_positions
        missing = np.maximum(contact.min_gaps - np.einsum("nd,nd->n", offsets, upward), 0.0)
        rows = np.flatnonzero(missing > _CONFIG.tolerance)
        if not len(rows) and not rise.any():
            break
        shares = contact.barycentric[rows] / squared[rows, None]
        moves = (missing[rows, None] * shares)[:, :, None] * upward[rows, None]
        corners, weights = contact.corners[rows].ravel(), contact.barycentric[rows].ravel()
        push = weighted_means(corners, weights, moves.reshape(-1, 3), len(places))
        push[contact.vertices] = longer_rows(rise[:, None] * upright, push[contact.vertices])
        push = spread_push(means, push, _CONFIG.spreading_rounds)
        places, is_moved = places + push, np.asarray(push.any(axis=1))
    return _leave_body(target, contact.vertices, places)


def _leave_body(target: TriangleSurface, rows: IndexArray, places: FloatArray) -> FloatArray:
    """Places (n, 3) with ``rows`` outside the body: pushes add up, and may end in the other of touching thighs."""
    places = places.copy()
    for _ in range(_CONFIG.leaving_rounds):
        distances = _signed_distances(target, places[rows], None)
        is_inside = distances.heights < 0.0
        rows, depths = rows[is_inside], -distances.heights[is_inside]
        if not len(rows):
            break
        outward = distances.closest[is_inside] - places[rows]
        places[rows] += (1.0 + _CONFIG.tolerance / depths)[:, None] * outward
    return places


def _signed_distances(surface: TriangleSurface, points: FloatArray, normals: FloatArray | None) -> SignedDistances:
    """Signed distances from points of the surface with similar normals, infinite out of reach."""
    minimum_cosine = -2.0 if normals is None else _CONFIG.min_facing_cosine
    return SignedDistances.of(surface, points, normals, minimum_cosine, 2.0 * _CONFIG.reach)
