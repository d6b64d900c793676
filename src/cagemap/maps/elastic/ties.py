"""What a fit has to meet: points that are held at places, and curves that lie on curves."""

from __future__ import annotations

from dataclasses import dataclass

from cagemap.maps.elastic.anchors import Anchors
from cagemap.maps.elastic.config import ElasticConfig
from cagemap.maps.elastic.curves import PulledCurve, pull_curves
from cagemap.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Ties:
    """Points and curves of a graph with where they belong on the source.

    Attributes
    ----------
    anchors : Anchors
        (p,) points that are held.
    places : (p, 3) float64
        Where.
    curves : tuple of PulledCurve
    """

    anchors: Anchors
    places: FloatArray
    curves: tuple[PulledCurve, ...] = ()

    def add(self, blocks: FloatArray, right: FloatArray, positions: FloatArray, config: ElasticConfig) -> None:
        """Put their terms into a data term (n, 3, 3), (n, 3) at positions (n, 3)."""
        pull_curves(self.curves, blocks, right, positions, config.curve_weight)
        self.anchors.hold(blocks, right, positions, self.places, config.landmark_weight)
