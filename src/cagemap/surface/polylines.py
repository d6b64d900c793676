"""Polylines in space, open or closed, and their closest points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import kept
from cagemap.surface.closest_points import TriangleTree, build_tree, closest_points


@dataclass(frozen=True, eq=False)
class Polyline:
    """Polyline of points (m, 3); if ``closed``, the last is joined to the first."""

    positions: FloatArray
    closed: bool

    def __len__(self) -> int:
        return len(self.positions)

    @kept
    def pieces(self) -> IndexArray:
        """(p, 2) ends of the segments of positive length; one segment if there is none."""
        first = np.arange(len(self) if self.closed else len(self) - 1)
        ends = np.column_stack([first, (first + 1) % len(self)])
        long = np.any(self.positions[ends[:, 0]] != self.positions[ends[:, 1]], axis=1)
        return ends[long] if long.any() else np.zeros((1, 2), dtype=np.int64)

    @kept
    def tree(self) -> TriangleTree:
        """Search tree of the segments, as triangles with two equal corners."""
        return build_tree(self.positions, self.pieces[:, [0, 1, 1]])

    @kept
    def point_lengths(self) -> FloatArray:
        """(m,) length that every point stands for: half of its two segments."""
        after = np.linalg.norm(np.roll(self.positions, -1, axis=0) - self.positions, axis=1)
        if not self.closed:
            after[-1] = 0.0
        return np.asarray(0.5 * (after + np.roll(after, 1)))

    @property
    def point_shares(self) -> FloatArray:
        """(m,) share of the length that every point stands for, sum 1."""
        return self.point_lengths / self.length

    @property
    def length(self) -> float:
        """Sum of the lengths of all segments."""
        return float(self.point_lengths.sum())

    def finer(self, pieces: int) -> FloatArray:
        """(q, 3) points along the polyline, ``pieces`` in every segment."""
        starts = self.positions if self.closed else self.positions[:-1]
        stops = np.roll(self.positions, -1, axis=0)[: len(starts)]
        share = (np.arange(pieces) / pieces)[None, :, None]
        return np.asarray(((1.0 - share) * starts[:, None] + share * stops[:, None]).reshape(-1, 3))

    def spread(self, count: int) -> IndexArray:
        """Indices of at most ``count`` evenly spaced points, with the ends of an open polyline."""
        if count >= len(self):
            return np.arange(len(self))
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.positions, axis=0), axis=1))])
        wanted = np.linspace(0.0, self.length, count, endpoint=not self.closed)
        return np.unique(np.clip(np.searchsorted(along, wanted - 1e-12), 0, len(self) - 1))

    def nearest(self, points: FloatArray) -> tuple[FloatArray, IndexArray, FloatArray, FloatArray]:
        """Closest points (q, 3) of the polyline to points (q, 3), with their segments and tangents.

        A segment is given by its ends (q, 2) and the weight (q,) of the second one, from 0 to 1. Tangents (q, 3) are
        unit vectors along the segment; zero at the ends of an open polyline.
        """
        segment, _, _ = closest_points(self.tree, points)
        ends = self.pieces[segment]
        starts = self.positions[ends[:, 0]]
        along = self.positions[ends[:, 1]] - starts
        squared = np.einsum("qd,qd->q", along, along)
        share = np.einsum("qd,qd->q", points - starts, along) / np.where(squared > 0.0, squared, 1.0)
        past = (share < 0.0) | (share > 1.0)
        share = np.clip(share, 0.0, 1.0)
        tangents = along / np.maximum(np.sqrt(squared), 1e-300)[:, None]
        if not self.closed:
            foot = np.where(share < 0.5, ends[:, 0], ends[:, 1])
            tangents[past & ((foot == 0) | (foot == len(self) - 1))] = 0.0
        return starts + share[:, None] * along, ends, share, tangents


def normal_projections(tangents: FloatArray) -> FloatArray:
    """(q, 3, 3) projections I - t t^T to the planes normal to unit vectors t (q, 3)."""
    return np.asarray(np.eye(3) - tangents[:, :, None] * tangents[:, None, :])
