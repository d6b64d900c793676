"""The curve term of the elastic fit: every curve of the target lies on its counterpart, and slides along it freely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cagemap.geometry.polylines import Polyline
from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.curves import CurvePair
from cagemap.maps.elastic.anchors import Anchors
from cagemap.maps.elastic.constants import FEWEST_OF_CURVE
from cagemap.numerics.arrays import FloatArray, IndexArray


@dataclass(frozen=True, eq=False)
class PulledCurve:
    """A curve of a graph and where it belongs.

    Attributes
    ----------
    anchors : Anchors
        (m,) points along it.
    rest : Polyline
        Their places in the rest shape.
    source : Polyline
    """

    anchors: Anchors
    rest: Polyline
    source: Polyline

    def terms(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What the curve asks of its points: B (m, 3, 3) of ``sum_i (x_i - y_i)^T B_i (x_i - y_i)``, and B (y - x).

        Closest points of the two polylines, both ways, as planes across the curve: x_i should lie on the source's
        tangent line at its foot, and the target's on every source point q. The residual of q is asked of the two points
        beside its foot with their weights, an upper bound as in `cagemap.maps.elastic.data.pull_by_source`. What is
        nearest to an end goes to that end: so the ends of open curves meet.

        Parameters
        ----------
        positions : (n, 3) float64
            Of the deformed graph.
        """
        own = Polyline(self.anchors.of(positions), self.source.closed)
        feet = self.source.nearest(own.positions)
        blocks = self.rest.shares[:, None, None] * feet.across()
        moved = np.einsum("mab,mb->ma", blocks, feet.places - own.positions)
        back = own.nearest(self.source.positions)
        lengths = self.source.shares * (self.rest.length / self.source.length)
        pulls = lengths[:, None, None] * back.across()
        residual = np.einsum("mab,mb->ma", pulls, self.source.positions - back.places)
        for side, weight in enumerate((1.0 - back.share, back.share)):
            np.add.at(blocks, back.ends[:, side], weight[:, None, None] * pulls)
            np.add.at(moved, back.ends[:, side], weight[:, None] * residual)
        return blocks, moved

    def thinned(self, count: int) -> PulledCurve:
        """At most ``count`` of its points, each moved to the vertex next to it."""
        chosen = self.rest.spread(count)
        vertices = self.anchors.at(chosen).nearest_vertices
        rows = np.sort(np.unique(vertices, return_index=True)[1])
        rest = Polyline(self.rest.positions[chosen][rows], self.rest.closed)
        return PulledCurve(Anchors.of_vertices(vertices[rows]), rest, self.source)


def curves_on_mesh(mesh: TriangleSurface, pairs: Sequence[CurvePair]) -> tuple[PulledCurve, ...]:
    """Curves of the finest surface on the mesh of a coarser level."""
    anchors = [Anchors.on_mesh(mesh, pair.target.points) for pair in pairs]
    return tuple(
        PulledCurve(at, Polyline(at.of(mesh.positions), pair.target.closed), pair.source.line)
        for at, pair in zip(anchors, pairs, strict=True)
    )


def pull_curves(
    curves: Sequence[PulledCurve], blocks: FloatArray, right: FloatArray, positions: FloatArray, weight: float
) -> None:
    """Add the term of every curve, times a weight, to a data term (n, 3, 3), (n, 3) at positions (n, 3)."""
    for curve in curves:
        pulls, forces = curve.terms(positions)
        curve.anchors.pull(blocks, right, positions, weight * pulls, weight * forces)


def with_clusters(
    curves: Sequence[PulledCurve], kept: IndexArray, count: int
) -> tuple[IndexArray, tuple[PulledCurve, ...]]:
    """Vertices that a coarse graph should keep, and the curves on that graph.

    Parameters
    ----------
    curves : sequence of PulledCurve
        Of the finer graph.
    kept : (p,) int64
        Vertices that come first.
    count : int
        About how many vertices all curves may have together.

    Returns
    -------
    vertices : (p + c,) int64
        All different; a coarse graph numbers them in this order.
    curves : tuple of PulledCurve
    """
    each = max(count // max(len(curves), 1), FEWEST_OF_CURVE)
    thinned = [curve.thinned(each) for curve in curves]
    listed = np.concatenate([kept, *(curve.anchors.corners[:, 0] for curve in thinned)])
    values, first = np.unique(listed, return_index=True)
    place = np.argsort(np.argsort(first))  # of every value among the vertices
    numbered = (
        replace(curve, anchors=Anchors.of_vertices(place[np.searchsorted(values, curve.anchors.corners[:, 0])]))
        for curve in thinned
    )
    return listed[np.sort(first)], tuple(numbered)
