"""The map of a pair that few landmarks or none decide, and how sure it is."""

from __future__ import annotations

from cagemap.geometry.closest import build_tree
from cagemap.maps.elastic.method import RefinedConfig
from cagemap.maps.hypotheses.confidence import Confidence
from cagemap.maps.hypotheses.search import HypothesesConfig, found_readings
from cagemap.maps.pair import Pair, Progress
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import finest_surface, project, refined_positions
from cagemap.maps.spectral.hierarchical import search_levels

# With fewer landmarks, they only help to choose among hypotheses; from here on they start a map of their own.
FEWEST_LANDMARKS = 3


def hypothesis_map(
    pair: Pair,
    refined: RefinedConfig = RefinedConfig(),
    config: HypothesesConfig = HypothesesConfig(),
    progress: Progress = lambda stage: None,
) -> tuple[PointMap, Confidence]:
    """Point map T12 of the finest levels by the cheapest hypothesis, which meets the landmarks there are.

    Parameters
    ----------
    pair : Pair
        With any number of landmarks; meant for fewer than `FEWEST_LANDMARKS`.
    refined : RefinedConfig
    config : HypothesesConfig
    progress : callable
        Called with the name of each stage.
    """
    levels = search_levels(pair, refined.hierarchy)
    readings = found_readings(pair, levels, refined.elastic, config, progress)
    progress("projection")
    tree = build_tree(*finest_surface(pair.source))
    positions = refined_positions(pair.target.refinement, levels[0], readings[0].positions)
    return project(positions, pair, tree, refined.elastic), Confidence.of(readings, pair.target.control.n_vertices)
