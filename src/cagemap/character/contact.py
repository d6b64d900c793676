"""Contact of a carried passenger with the body: what was outside stays outside, and the body stays below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.character.body_frames import BodyFrames, neighbor_means
from cagemap.numerics.arrays import FloatArray, IndexArray, grouped_sums
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import normalized, row_lengths


@dataclass(frozen=True)
class ContactConfig:
    """Numbers of `push_out`; lengths in units of sqrt(area). What was tried: docs/lab/passengers.md."""

    share: float = 0.5  # least share of its height over the source that a point keeps over the target
    reach: float = 0.03  # passenger and body further apart than this do not touch
    above: float = 0.5  # least cosine of the body's normal with the way to the passenger above it
    facing: float = 0.3  # least cosine of the body's normal with that of the anchor
    tolerance: float = 1e-5
    rounds: int = 12
    halvings: int = 4  # of a push that ends in another part of the body
    spreading: int = 4  # rounds in which a push spreads to neighbouring vertices


@dataclass(frozen=True, eq=False)
class Contact:
    """What touches what: vertices over the body, and vertices of the body below the passenger.

    Attributes
    ----------
    outside : (k,) int64
        Passenger vertices over the source.
    ways : (k, 3) float64
        Unit directions away from the target at them.
    floors : (k,) float64
        Least heights over the target.
    covered : (c,) int64
        Vertices of the target's body that the passenger covers.
    corners, barycentric : (c, 3)
        Point of the passenger over each.
    gaps : (c,) float64
        Least heights of these points over them.
    """

    outside: IndexArray
    ways: FloatArray
    floors: FloatArray
    covered: IndexArray
    corners: IndexArray
    barycentric: FloatArray
    gaps: FloatArray

    @classmethod
    def find(
        cls,
        frames: BodyFrames,
        points: FloatArray,
        meshes: Sequence[IndexArray],
        normals: FloatArray,
        linear: FloatArray,
        config: ContactConfig = ContactConfig(),
    ) -> Contact:
        """Contact on the source. Every mesh is over the body on its own, whatever lies between.

        Parameters
        ----------
        frames : BodyFrames
        points : (n, 3) float64
            Vertices of all passengers in the source's unit.
        meshes : sequence of (t, 3) int64
            Triangles of each.
        normals : (n, 3) float64
            Of the source at their closest points.
        linear : (n, 3, 3) float64
            Affine maps from source to target around them.
        config : ContactConfig
        """
        heights, _ = _heights(frames.point_map.source, points, normals, config)
        outside = np.flatnonzero((heights > 0) & (heights < config.reach))
        ways = normalized(np.einsum("nd,nde->ne", normals, linear))[outside]
        covered = [_covered(frames, points, triangles, config) for triangles in meshes]
        body, corners, barycentric, gaps = (np.concatenate(arrays) for arrays in zip(*covered, strict=True))
        return cls(outside, ways, config.share * heights[outside], body, corners, barycentric, config.share * gaps)


def _covered(
    frames: BodyFrames, points: FloatArray, triangles: IndexArray, config: ContactConfig
) -> tuple[IndexArray, IndexArray, FloatArray, FloatArray]:
    """Vertices of the body below a mesh, corners and barycentric coordinates of the point over each, and heights."""
    images, upward = frames.point_map.images.positions, frames.source_normals
    used, own = np.unique(triangles, return_inverse=True)
    own_points, own_triangles = points[used], own.reshape(-1, 3)
    low, high = own_points.min(axis=0) - config.reach, own_points.max(axis=0) + config.reach
    body = np.flatnonzero(((images > low) & (images < high)).all(axis=1))
    triangle, barycentric, distance = closest_points(
        build_tree(own_points, own_triangles), images[body], within=config.reach
    )
    over = np.einsum("nc,ncd->nd", barycentric, own_points[own_triangles[triangle]]) - images[body]
    gaps = np.einsum("nd,nd->n", over, upward[body])
    kept = np.flatnonzero((triangle >= 0) & (gaps > 0) & (gaps >= config.above * distance))
    return body[kept], triangles[triangle[kept]], barycentric[kept], gaps[kept]


def push_out(
    target: TriangleSurface,
    contact: Contact,
    places: FloatArray,
    triangles: IndexArray,
    config: ContactConfig = ContactConfig(),
) -> FloatArray:
    """Places (n, 3) in the target's unit, moved away from its body until all are as high as the contact asks for.

    A push spreads to the passenger's vertices around, and fades with each step.
    """
    below, upward = target.positions[contact.covered], target.vertex_normals[contact.covered]
    squared = np.einsum("nc,nc->n", contact.barycentric, contact.barycentric)
    means = neighbor_means(triangles, len(places))
    start = places
    moved: NDArray[np.bool_] = np.ones(len(places), dtype=bool)
    heights, upright = np.full(len(contact.outside), np.inf), np.zeros_like(contact.ways)
    for _ in range(config.rounds):
        again = np.flatnonzero(moved[contact.outside])
        heights[again], upright[again] = _heights(target, places[contact.outside[again]], contact.ways[again], config)
        own = np.maximum(contact.floors - heights, 0.0)  # not where nothing is near: heights are infinite
        own[own < config.tolerance] = 0.0
        over = np.einsum("nc,ncd->nd", contact.barycentric, places[contact.corners]) - below
        lacking = np.maximum(contact.gaps - np.einsum("nd,nd->n", over, upward), 0.0)
        rows = np.flatnonzero(lacking > config.tolerance)
        if not len(rows) and not own.any():
            break
        shares = contact.barycentric[rows] / squared[rows, None]
        moves = (lacking[rows, None] * shares)[:, :, None] * upward[rows, None]
        corners, weights = contact.corners[rows].ravel(), contact.barycentric[rows].ravel()
        total = np.bincount(corners, weights, minlength=len(places))[:, None]
        push = grouped_sums(corners, weights[:, None] * moves.reshape(-1, 3), len(places)) / np.where(total, total, 1.0)
        push[contact.outside] = _longer(own[:, None] * upright, push[contact.outside])
        for _ in range(config.spreading):
            push = _longer(push, means @ push)
        places, moved = places + push, np.asarray(push.any(axis=1))
    return _not_deeper(target, start, places, config)


def _not_deeper(target: TriangleSurface, before: FloatArray, after: FloatArray, config: ContactConfig) -> FloatArray:
    """(n, 3) places after a push, with pushes into another part of the body cut to a half until they are none."""
    moved = np.flatnonzero((before != after).any(axis=1))
    depths = np.minimum(_heights(target, before[moved], None, config)[0], 0.0)
    for _ in range(config.halvings):
        worse = _heights(target, after[moved], None, config)[0] < depths - config.tolerance
        moved, depths = moved[worse], depths[worse]
        after[moved] = 0.5 * (before[moved] + after[moved])
    return after


def _heights(
    surface: TriangleSurface,
    points: FloatArray,
    normals: FloatArray | None,
    config: ContactConfig,
) -> tuple[FloatArray, FloatArray]:
    """Signed distances (m,) from closest points that face as normals given do, and the normals (m, 3) there.

    Infinite where there is none in reach.
    """
    triangle, barycentric, distance = closest_points(
        surface.tree,
        points,
        normals,
        minimum_cosine=-2.0 if normals is None else config.facing,
        within=2.0 * config.reach,
    )
    corners = surface.triangles[triangle]
    feet = np.einsum("nc,ncd->nd", barycentric, surface.positions[corners])
    upward = normalized(np.einsum("nc,ncd->nd", barycentric, surface.vertex_normals[corners]))
    return np.copysign(distance, np.einsum("nd,nd->n", points - feet, upward)), upward


def _longer(first: FloatArray, second: FloatArray) -> FloatArray:
    """(n, 3) the longer of two vectors, row by row."""
    return np.where((row_lengths(first) >= row_lengths(second))[:, None], first, second)
