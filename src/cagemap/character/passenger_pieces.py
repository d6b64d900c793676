"""Connected pieces of a passenger: which keep their shape, and the similarity that moves each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray, components, grouped_sums, nearest_rotations

Kind = Literal["cloth", "rigid", "similarity"]
KINDS: tuple[Kind, ...] = ("cloth", "rigid", "similarity")


@dataclass(frozen=True)
class PieceConfig:
    """What tells pieces that keep their shape from cloth; lengths in units of sqrt(area)."""

    small: float = 0.04  # radius of a button, a tooth or an eyeball at most
    compact: float = 0.75  # least ratio of the middle to the largest of the three extents: a strip has less
    apart: float = 0.15  # a piece further from the body than this on average is a prop
    concentric: float = 0.5  # pieces with centres closer than this, of the larger's radius, move together


@dataclass(frozen=True, eq=False)
class Pieces:
    """Groups of pieces that move together.

    Attributes
    ----------
    group : (n,) int64
        Of every vertex.
    firm : (g,) bool
        Whether a group keeps its shape.
    scaled : bool
        Whether firm groups take the size of their surroundings, or that of the whole body.
    """

    group: IndexArray
    firm: NDArray[np.bool_]
    scaled: bool


def find_pieces(
    mesh: ControlMesh, points: FloatArray, heights: FloatArray, kind: Kind | None, config: PieceConfig = PieceConfig()
) -> Pieces:
    """Pieces of a mesh and what becomes of them; a kind, if given, holds for all.

    Parameters
    ----------
    mesh : ControlMesh
    points : (n, 3) float64
        Its vertices in the source's unit.
    heights : (n,) float64
        Their signed distances from the body.
    kind : str, optional
    config : PieceConfig
    """
    piece = components(mesh.face_indices, mesh.face_indices[mesh.next_corners], mesh.n_vertices)
    count = int(piece.max()) + 1
    sizes = np.bincount(piece, minlength=count)
    centres = grouped_sums(piece, points, count) / sizes[:, None]
    offsets = points - centres[piece]
    moments = grouped_sums(piece, (offsets[:, :, None] * offsets[:, None]).reshape(-1, 9), count).reshape(-1, 3, 3)
    extents = np.sqrt(np.maximum(np.linalg.eigvalsh(moments / sizes[:, None, None]), 0.0))
    radius = np.zeros(count)
    np.maximum.at(radius, piece, np.linalg.norm(offsets, axis=1))
    away = np.bincount(piece, np.abs(heights), minlength=count) / sizes
    firm = (radius < config.small) & (extents[:, 1] > config.compact * extents[:, 2]) | (away > config.apart)
    if kind is not None:
        firm = np.full(count, kind != "cloth")
    heads, tails = _near_pairs(centres, config.concentric * config.small)
    together = np.linalg.norm(centres[heads] - centres[tails], axis=1) < config.concentric * np.maximum(
        radius[heads], radius[tails]
    )
    together &= firm[heads] & firm[tails]
    group = components(heads[together], tails[together], count)
    joined = np.zeros(int(group.max()) + 1, dtype=bool)
    joined[group[firm]] = True
    return Pieces(group[piece], joined, kind != "rigid")


def _near_pairs(centres: FloatArray, within: float) -> tuple[IndexArray, IndexArray]:
    pairs = cKDTree(centres).query_pairs(within, output_type="ndarray")
    return pairs[:, 0].astype(np.int64), pairs[:, 1].astype(np.int64)


def keep_shape(
    pieces: Pieces, points: FloatArray, places: FloatArray, frames: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Move every firm group by the similarity of its points that comes nearest to their places.

    The frames (n, 3, 3) decide the rotation where a group is a point, a line or flat.

    Returns
    -------
    places : (n, 3) float64
    turns : (n, 3, 3) float64
        How each vertex's surroundings turn: rotations for rows.
    scales : (n,) float64
        And how they change in size.
    """
    group, count = pieces.group, len(pieces.firm)
    sizes = np.bincount(group, minlength=count)[:, None]
    centres, goals = (grouped_sums(group, array, count) / sizes for array in (points, places))
    offsets, moved = points - centres[group], places - goals[group]
    mixed = grouped_sums(group, (offsets[:, :, None] * moved[:, None]).reshape(-1, 9), count).reshape(-1, 3, 3)
    spread = np.bincount(group, np.einsum("nd,nd->n", offsets, offsets), minlength=count)
    mean = grouped_sums(group, frames.reshape(-1, 9), count).reshape(-1, 3, 3) / sizes[:, :, None]
    turns = nearest_rotations(mixed + (1e-3 * spread + 1e-12)[:, None, None] * mean)
    scales = np.ones(count)
    if pieces.scaled:
        fitted = np.einsum("gab,gab->g", turns, mixed) / np.where(spread > 0, spread, 1.0)
        scales = np.where(spread > 0, fitted, _sizes(mean))
    firm = pieces.firm[group]
    kept = goals[group] + scales[group, None] * np.einsum("nd,nde->ne", offsets, turns[group])
    return (
        np.where(firm[:, None], kept, places),
        np.where(firm[:, None, None], turns[group], nearest_rotations(frames)),
        np.where(firm, scales[group], _sizes(frames)),
    )


def _sizes(frames: FloatArray) -> FloatArray:
    """(n,) mean factor of lengths of linear maps (n, 3, 3)."""
    return np.asarray(np.cbrt(np.abs(np.linalg.det(frames))))
