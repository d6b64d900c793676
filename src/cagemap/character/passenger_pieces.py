"""Connected pieces of a passenger, and similarities that move the rigid ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cagemap.numerics.arrays import (
    FloatArray,
    IndexArray,
    grouped_sums,
    joined_runs,
    label_components,
    members_of,
    nearest_rotations,
    offsets_of,
)
from cagemap.numerics.kinds import Config

PassengerKind = Literal["cloth", "rigid", "similarity"]
PASSENGER_KINDS: tuple[PassengerKind, ...] = ("cloth", "rigid", "similarity")


@dataclass(frozen=True)
class PieceConfig(Config):
    """Bounds that separate rigid pieces from cloth; lengths in units of sqrt(area)."""

    max_radius: float = 0.04  # of a button, a tooth or an eyeball
    min_compactness: float = 0.75  # middle over largest extent; strips have less
    prop_distance: float = 0.15  # mean distance from the body beyond which a piece is a prop
    # A smaller rigid piece, such as an iris, moves with a larger one, such as an eyeball, if no vertex of it is farther
    # from the larger one's centre than this multiple of that one's radius.
    joined_distance: float = 1.2


PIECES = PieceConfig()
# Pairs of pieces whose vertices are tested at once.
_PAIRS_AT_ONCE = 10_000


@dataclass(frozen=True, eq=False)
class Pieces:
    """Groups of pieces that move together."""

    group: IndexArray  # (n,) of every vertex
    is_rigid: NDArray[np.bool_]  # (g,) whether a group keeps its shape, up to its size
    has_local_scale: bool  # whether rigid groups scale with their surroundings, not with the whole body

    def rigid_groups(self) -> list[IndexArray]:
        """Vertices of each rigid group."""
        return [vertices for vertices, rigid in zip(members_of(self.group), self.is_rigid, strict=True) if rigid]


def find_pieces(
    triangles: IndexArray,
    points: FloatArray,
    heights: FloatArray,
    kind: PassengerKind | None,
    config: PieceConfig = PIECES,
) -> Pieces:
    """Group the connected pieces of triangles (m, 3); decide which are rigid.

    ``points``: (n, 3), vertices in the source's unit, and ``heights`` (n,), their signed distances from the body.
    ``kind``: of all pieces.
    """
    piece = label_components(triangles.ravel(), triangles[:, [1, 2, 0]].ravel(), len(points))
    count = int(piece.max()) + 1
    sizes = np.bincount(piece, minlength=count)
    centres = grouped_sums(piece, points, count) / sizes[:, None]
    offsets = points - centres[piece]
    moments = grouped_sums(piece, (offsets[:, :, None] * offsets[:, None]).reshape(-1, 9), count).reshape(-1, 3, 3)
    extents = np.sqrt(np.maximum(np.linalg.eigvalsh(moments / sizes[:, None, None]), 0.0))
    radius = np.zeros(count)
    np.maximum.at(radius, piece, np.linalg.norm(offsets, axis=1))
    mean_height = np.bincount(piece, np.abs(heights), minlength=count) / sizes
    is_rigid = (radius < config.max_radius) & (extents[:, 1] > config.min_compactness * extents[:, 2]) | (
        mean_height > config.prop_distance
    )
    if kind is not None:
        is_rigid = np.full(count, kind != "cloth")
    group = _join_pieces(piece, points, centres, radius, np.flatnonzero(is_rigid), config)
    group_rigid = np.zeros(int(group.max()) + 1, dtype=bool)
    group_rigid[group[is_rigid]] = True
    return Pieces(group[piece], group_rigid, kind != "rigid")


def _join_pieces(
    piece: IndexArray,
    points: FloatArray,
    centres: FloatArray,
    radius: FloatArray,
    rigid: IndexArray,
    config: PieceConfig,
) -> IndexArray:
    """(k,) group of each piece: a rigid piece within reach of the centre of a larger one is in its group."""
    near = cKDTree(centres[rigid]).query_pairs(config.joined_distance * config.max_radius, output_type="ndarray")
    smaller, larger = np.take_along_axis(rigid[near], np.argsort(radius[rigid[near]], axis=1), axis=1).T
    reach = config.joined_distance * radius[larger]
    distances = np.linalg.norm(centres[smaller] - centres[larger], axis=1)
    is_joined = distances + radius[smaller] < reach
    group = label_components(smaller[is_joined], larger[is_joined], len(centres))
    # Of the others, those whose centres are too far are out; the vertices decide the rest.
    asked = np.flatnonzero(~is_joined & (distances < reach) & (group[smaller] != group[larger]))
    order, sizes = np.argsort(piece, kind="stable"), np.bincount(piece)
    starts = offsets_of(sizes)[:-1]
    for start in range(0, len(asked), _PAIRS_AT_ONCE):
        block = asked[start : start + _PAIRS_AT_ONCE]
        runs, rows = joined_runs(starts[smaller[block]], sizes[smaller[block]])
        offsets = points[order[rows]] - np.repeat(centres[larger[block]], np.diff(runs), axis=0)
        farthest = np.maximum.reduceat(np.linalg.norm(offsets, axis=1), runs[:-1])
        is_joined[block] = farthest < reach[block]
    return label_components(smaller[is_joined], larger[is_joined], len(centres))


def fit_similarities(
    pieces: Pieces, points: FloatArray, places: FloatArray, frames: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Move every rigid group by the least-squares similarity from its points to their places.

    The frames (n, 3, 3) decide the rotation of a group that is a point, a line or flat.

    Returns
    -------
    places : (n, 3) float64
    turns : (n, 3, 3) float64
        Rotations, for rows, of the surroundings of each vertex.
    scales : (n,) float64
        Their scales.
    """
    group, count = pieces.group, len(pieces.is_rigid)
    sizes = np.bincount(group, minlength=count)[:, None]
    centres, place_centres = (grouped_sums(group, array, count) / sizes for array in (points, places))
    offsets, place_offsets = points - centres[group], places - place_centres[group]
    covariance = grouped_sums(group, (offsets[:, :, None] * place_offsets[:, None]).reshape(-1, 9), count).reshape(
        -1, 3, 3
    )
    spread = np.bincount(group, np.einsum("nd,nd->n", offsets, offsets), minlength=count)
    mean_frames = grouped_sums(group, frames.reshape(-1, 9), count).reshape(-1, 3, 3) / sizes[:, :, None]
    turns = nearest_rotations(covariance + (1e-3 * spread + 1e-12)[:, None, None] * mean_frames)
    scales = np.ones(count)
    if pieces.has_local_scale:
        fitted_scales = np.einsum("gab,gab->g", turns, covariance) / np.where(spread > 0, spread, 1.0)
        scales = np.where(spread > 0, fitted_scales, _length_factors(mean_frames))
    is_rigid = pieces.is_rigid[group]
    rigid_places = place_centres[group] + scales[group, None] * np.einsum("nd,nde->ne", offsets, turns[group])
    return (
        np.where(is_rigid[:, None], rigid_places, places),
        np.where(is_rigid[:, None, None], turns[group], nearest_rotations(frames)),
        np.where(is_rigid, scales[group], _length_factors(frames)),
    )


def _length_factors(frames: FloatArray) -> FloatArray:
    """(n,) mean length factors of linear maps (n, 3, 3)."""
    return np.asarray(np.cbrt(np.abs(np.linalg.det(frames))))
