"""From a result that was read back to a match that goes on: its surfaces are prepared again, its map is kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from cagemap.basis import BasisConfig
from cagemap.files.result import Result, Side, result_record
from cagemap.files.schema import BasisRecord, ResultRecord
from cagemap.files.surface_store import prepared
from cagemap.maps.elastic.method import functional_map_of
from cagemap.maps.landmarks.check import LandmarkCheck, LandmarkSuspect
from cagemap.maps.pair import point_pairs
from cagemap.maps.point_map import PointMap
from cagemap.mesh.landmarks import CagePoints, Landmarks
from cagemap.pipeline import MAP_BASIS, MatchResult, judge, prepare_surface, prepare_surfaces


def resume(
    result: Result, *, cache: str | Path | None = None, progress: Callable[[str], None] = lambda stage: None
) -> MatchResult:
    """The match that a result was stored from, so that `cagemap.update_match` can go on from it.

    The map, the landmarks and what was found about them are those stored. Both surfaces are prepared again, as they
    were; quality and functional map are read off the map again.

    Parameters
    ----------
    result : Result
        Of `cagemap.read_result`.
    cache : path, optional
        Folder of prepared surfaces (``--cache`` of the match), which saves preparing them.
    progress : callable
        Called with the name of each stage.

    Raises
    ------
    FormatError
        If the manifest holds something else where it should say what was found about the landmarks.
    """
    sides = {"target": result.target, "source": result.source}
    places = [side.landmark_points or CagePoints.of_vertices(side.landmarks) for side in sides.values()]
    landmarks = Landmarks(
        result.landmark_names or tuple(f"pair {i}" for i in range(len(result.target.landmarks))),
        places[0].vertices,
        places[1].vertices,
        result.target.control.name,
        result.source.control.name,
        places[0],
        places[1],
        result.curves,
    )
    record = result_record(result)
    check = _stored_check(record)
    prepare = prepare_surface if cache is None else partial(prepared, cache)
    levels = result.target.level, result.source.level
    controls = [replace(side.control, scheme=side.scheme) for side in sides.values()]
    bases = [_basis(record.bases.get(name), side) for name, side in sides.items()]
    target, source = prepare_surfaces(
        controls[0], controls[1], levels, (bases[0], bases[1]), prepare=prepare, progress=progress
    )
    point_map = PointMap.from_arrays(
        target.triangles(target.finest), source.triangles(source.finest), result.triangle, result.barycentric
    )
    trusted = check.trusted(landmarks)
    points = point_pairs(target, source, trusted)
    progress("functional map, quality")
    return MatchResult(
        target,
        source,
        landmarks,
        functional_map_of(target, source, point_map),
        point_map,
        judge(target, point_map, points, trusted.names, result.masks),
        {stage: seconds or 0.0 for stage, seconds in record.timings.items()},
        check,
        masks=result.masks,
    )


def _basis(record: BasisRecord | None, side: Side) -> BasisConfig:
    """How a surface was prepared; of a result that does not say, as many functions as it has."""
    if record is None:
        return replace(MAP_BASIS, count=len(side.eigenvalues))
    schedule = None if record.schedule is None else tuple(record.schedule)
    return BasisConfig(record.count, record.tolerance, schedule, record.accuracy)


def _stored_check(record: ResultRecord) -> LandmarkCheck:
    """What was found about the landmarks."""
    if record.landmark_check is None:
        return LandmarkCheck()
    suspects = [
        LandmarkSuspect(s.name, s.pair, s.distance, s.nearest_vertex, s.source_vertex, s.evidence)
        for s in record.landmark_check.suspects
    ]
    return LandmarkCheck(tuple(suspects), tuple(record.landmark_check.notes))
