"""Polylines in space, open or closed, and the points of one that are nearest to points in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import kept


@dataclass(frozen=True, eq=False)
class PolylineFeet:
    """The points of a polyline nearest to q points in space.

    Attributes
    ----------
    ends : (q, 2) int64
        The polyline's points that the straight piece joins.
    share : (q,) float64
        Weight of the second of them, from 0 to 1.
    places : (q, 3) float64
    tangents : (q, 3) float64
        Unit vectors along the piece; zero where the nearest point is an end of the whole polyline, past which nothing
        can slide.
    """

    ends: IndexArray
    share: FloatArray
    places: FloatArray
    tangents: FloatArray

    def across(self) -> FloatArray:
        """(q, 3, 3) projections I - t t^T: what of a distance counts where sliding along the polyline is free."""
        return np.asarray(np.eye(3) - self.tangents[:, :, None] * self.tangents[:, None, :])


@dataclass(frozen=True, eq=False)
class Polyline:
    """Points joined by straight pieces.

    Attributes
    ----------
    positions : (m, 3) float64
    closed : bool
        Whether the last point is joined to the first.
    """

    positions: FloatArray
    closed: bool

    def __len__(self) -> int:
        return len(self.positions)

    @kept
    def tree(self) -> cKDTree:
        """Of the points."""
        return cKDTree(self.positions)

    @kept
    def shares(self) -> FloatArray:
        """(m,) length that every point stands for: half of the pieces beside it."""
        after = np.linalg.norm(np.roll(self.positions, -1, axis=0) - self.positions, axis=1)
        if not self.closed:
            after[-1] = 0.0
        return np.asarray(0.5 * (after + np.roll(after, 1)))

    @property
    def length(self) -> float:
        """Sum of the lengths of all pieces."""
        return float(self.shares.sum())

    def finer(self, pieces: int) -> FloatArray:
        """(q, 3) points along it, ``pieces`` to every straight piece."""
        starts = self.positions if self.closed else self.positions[:-1]
        stops = np.roll(self.positions, -1, axis=0)[: len(starts)]
        share = (np.arange(pieces) / pieces)[None, :, None]
        return np.asarray(((1.0 - share) * starts[:, None] + share * stops[:, None]).reshape(-1, 3))

    def spread(self, count: int) -> IndexArray:
        """At most ``count`` of its points, about equally far along it; the ends of an open one among them."""
        if count >= len(self):
            return np.arange(len(self))
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.positions, axis=0), axis=1))])
        wanted = np.linspace(0.0, self.length, count, endpoint=not self.closed)
        return np.unique(np.clip(np.searchsorted(along, wanted - 1e-12), 0, len(self) - 1))

    def nearest(self, points: FloatArray) -> PolylineFeet:
        """The nearest points to points (q, 3), searched on the pieces beside the nearest of the polyline's points."""
        m = len(self)
        vertex = np.asarray(self.tree.query(points)[1], dtype=np.int64)
        around = vertex[:, None] + np.array([-1, 0, 1])
        around = around % m if self.closed else np.clip(around, 0, m - 1)
        starts, stops = around[:, :2], around[:, 1:]
        pieces = self.positions[stops] - self.positions[starts]
        squared = np.einsum("qkd,qkd->qk", pieces, pieces)
        offsets = points[:, None] - self.positions[starts]
        share = np.einsum("qkd,qkd->qk", offsets, pieces) / np.where(squared > 0.0, squared, 1.0)
        past = (share < 0.0) | (share > 1.0)
        share = np.clip(share, 0.0, 1.0)
        places = self.positions[starts] + share[:, :, None] * pieces
        distances = np.where(squared > 0.0, ((points[:, None] - places) ** 2).sum(axis=2), np.inf)
        best = np.argmin(distances, axis=1)
        rows = np.arange(len(points))
        chosen = pieces[rows, best]
        tangents = chosen / np.maximum(np.linalg.norm(chosen, axis=1), 1e-300)[:, None]
        if not self.closed:
            foot = np.where(share[rows, best] < 0.5, starts[rows, best], stops[rows, best])
            tangents[past[rows, best] & ((foot == 0) | (foot == m - 1))] = 0.0
        return PolylineFeet(
            np.column_stack([starts[rows, best], stops[rows, best]]), share[rows, best], places[rows, best], tangents
        )
