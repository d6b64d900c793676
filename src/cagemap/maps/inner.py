"""Maps of plain meshes in their own numbers, and in those of the levels below them (`Surface.inner`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.deform.prepared import PreparedPair
from cagemap.maps.hypotheses.confidence import Confidence, Reading
from cagemap.maps.point_map import PointMap
from cagemap.spectral import Surface


def inner_map(point_map: PointMap, target: Surface, source: Surface) -> PointMap:
    """A map between finest surfaces as one between those that maps are found on; itself where nothing is plain.

    Triangles keep their order and their corners, so that only target vertices change places.

    Parameters
    ----------
    point_map : PointMap
    target, source : Surface
        Those that it was made for.
    """
    if target.inner is target and source.inner is source:
        return point_map
    rows = target.inner.refinement.inner_rows
    mine, theirs = (side.inner.triangles(side.inner.finest) for side in (target, source))
    return PointMap.from_arrays(mine, theirs, rows(point_map.triangle), rows(point_map.barycentric))


def outer_map(point_map: PointMap, target: Surface, source: Surface) -> PointMap:
    """Undo `inner_map`; the surfaces are the inner ones."""
    if target.outer is target and source.outer is source:
        return point_map
    rows = target.refinement.outer_rows
    mine, theirs = (side.outer.triangles(side.outer.finest) for side in (target, source))
    return PointMap.from_arrays(mine, theirs, rows(point_map.triangle), rows(point_map.barycentric))


def outer_confidence(confidence: Confidence, prepared: PreparedPair) -> Confidence:
    """Answers for the level that is deformed, as answers for all vertices of a plain target, in its own numbers.

    The vertex that decides gets its number in the target's file too, where the target is a part of it.
    """
    refinement, numbers = prepared.target.refinement, prepared.target.outer.control.file_vertices
    if numbers is not None and confidence.deciding is not None:
        confidence = replace(confidence, file_vertex=int(numbers[confidence.deciding]))
    if prepared.target.outer is prepared.target:
        return confidence

    def outer(reading: Reading) -> Reading:
        known = len(reading.positions)
        places = refinement.prolong(reading.positions, prepared.levels[0], refinement.n_levels)
        # Prolonged, those that are known would be smoothed.
        places = np.concatenate([reading.positions, places[known:]])
        return replace(reading, positions=refinement.outer_rows(places))

    return replace(confidence, readings=tuple(outer(reading) for reading in confidence.readings))


def inner_reading(reading: Reading, prepared: PreparedPair) -> Reading:
    """One answer for the level that is deformed: undoes `outer_confidence`.

    Of a plain target it is known wherever it was kept; of a cage only where the match itself still has it.
    """
    positions = prepared.target.refinement.inner_rows(reading.positions)
    return replace(reading, positions=positions[: prepared.mesh.n])
