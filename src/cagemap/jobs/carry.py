"""Transfer of one model's landmarks to all other models of a collection.

Every other model gets a landmark file for the user to correct. Until the user edits it, it is rewritten whenever a map
changes, and no match reads it. Once edited, it is never written again, and matches use it.
"""

from __future__ import annotations

import itertools
import os
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import InvalidLandmarksError
from cagemap.files.landmarks.point_formats import write_points
from cagemap.files.landmarks.points import read_points
from cagemap.files.meshes.formats import read_whole
from cagemap.files.result.folder import read_result
from cagemap.jobs.detours import MAP_NORMAL_WEIGHT
from cagemap.jobs.job import Job
from cagemap.jobs.plan import PairNames, Plan, Task, content_hash, task_key
from cagemap.maps.pair import cage_points_of, locate
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import CagePoints, NamedCurve, NamedPoints, on_cage
from cagemap.mesh.curves import on_cage_curve
from cagemap.mesh.parts import numbers_on_part
from cagemap.numerics.arrays import FloatArray
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import normalize_rows

# Of sqrt(area): points that both directions of a map place farther apart are reported.
MAX_DIRECTION_DIFFERENCE = 0.01


def map_points(result: MatchResult, forward: bool, positions: FloatArray, normals: FloatArray) -> SurfacePoints:
    """Corresponding points of the other model, for positions (q, 3) at unit area and their normals.

    ``forward``: whether points go from the map's target to its source, as the map is stored.
    """
    point_map = result.point_map
    if forward:
        start = SurfacePoints.nearest(point_map.target, positions, normals, normal_weight=MAP_NORMAL_WEIGHT)
        images = start.interpolate(point_map.images.positions)
        normals = normalize_rows(start.interpolate(point_map.images.normals))
        return SurfacePoints.nearest(point_map.source, images, normals, normal_weight=MAP_NORMAL_WEIGHT)
    image_surface = TriangleSurface(point_map.images.positions, point_map.target.triangles, 1.0)
    points_on_image = SurfacePoints.nearest(image_surface, positions, normals, normal_weight=MAP_NORMAL_WEIGHT)
    return SurfacePoints(point_map.target, points_on_image.triangle, points_on_image.barycentric)


def add_carry_tasks(plan: Plan, job: Job, version: str) -> Plan:
    """The plan with a task, after its matches, for every model that gets landmarks.

    Models with landmarks of their own, or that no path of maps reaches, get no task.
    """
    if job.carry is None:
        return plan
    matches = {task.pair: task for task in plan.tasks if task.kind == "match" and task.pair is not None}
    landmarks = job.assets[job.carry.source].landmarks
    assert landmarks is not None
    landmark_hash, carry_tasks = content_hash(str(landmarks)), []
    for name, path in _shortest_paths(job.carry.source, matches).items():
        if job.assets[name].landmarks is not None:
            continue
        steps = [_match_between(start, end, matches) for start, end in itertools.pairwise(path)]
        has_both = len(path) == 2 and (path[1], path[0]) in matches
        opposite = matches.get((path[0], path[1])) if has_both else None
        landmark_file = job.carry.folder / f"{name}.json"
        request = {
            "asset": name,
            "steps": [[step.request["output"], forward] for step, forward in steps],
            "back": None if opposite is None else opposite.request["output"],
            "landmarks": str(landmarks),
            "file": str(job.assets[job.carry.source].file),
            "output": str(landmark_file),
        }
        needs = tuple(task.name for task in [*(step for step, _ in steps), opposite] if task is not None)
        keys = [(step.key, forward) for step, forward in steps], None if opposite is None else opposite.key
        key = task_key(version, "carry", landmark_hash, *keys, str(landmark_file))
        output = Path(os.path.relpath(landmark_file, plan.root)).as_posix()
        title, input_hashes = f"carry landmarks to {name}", {str(landmarks): landmark_hash}
        carry_tasks.append(Task("carry", title, key, needs, request, (output,), input_hashes=input_hashes))
    return replace(plan, tasks=(*plan.tasks, *carry_tasks))


def carry_landmarks(request: Mapping[str, Any]) -> dict[str, Any]:
    """Carry the landmarks and curves of one model to another, and write its file; returns figures for `carry_notes`.

    "look_at" are the points where both directions of a map disagree, worst first.
    """
    steps = [(read_result(folder), bool(forward)) for folder, forward in request["steps"]]
    (first_result, first_forward), (last_result, last_forward) = steps[0], steps[-1]
    first = first_result.target if first_forward else first_result.source
    source_points, point_sets = _read_on(request, first.control)
    sizes = [len(points.corners) for points in point_sets]
    joined = CagePoints.joined(point_sets)
    start = locate(first.finest_triangles, joined)
    end = start
    for result, forward in steps:
        end = map_points(result, forward, end.positions, end.normals)
    last = last_result.source if last_forward else last_result.target
    cage_points = cage_points_of(last, end)
    vertices, positions = cage_points.vertices, cage_points.of(last.control.positions)
    if last.control.file_vertices is not None:  # a part or welded: landmark files have the file's numbers
        vertices = np.where(vertices < 0, -1, last.control.file_vertices[vertices])
    last_rows = np.cumsum(sizes)
    curves = tuple(
        NamedCurve(curve.name, np.full(size, -1, dtype=np.int64), positions[stop - size : stop], curve.closed)
        for curve, size, stop in zip(source_points.curves, sizes[1:], last_rows[1:], strict=True)
    )
    points = NamedPoints(source_points.names, vertices[: sizes[0]], positions[: sizes[0]], last.control.name, curves)
    Path(request["output"]).parent.mkdir(parents=True, exist_ok=True)
    write_points(request["output"], points, last.control)
    look_at: list[str] = []
    if request["back"] is not None:
        opposite_end = map_points(read_result(request["back"]), not last_forward, start.positions, start.normals)
        differences = np.linalg.norm(opposite_end.positions - end.positions, axis=1)[: sizes[0]]
        look_at = [
            source_points.names[i] for i in np.argsort(-differences) if differences[i] > MAX_DIRECTION_DIFFERENCE
        ]
    return {"points": sizes[0], "curves": len(curves), "file": str(request["output"]), "look_at": look_at}


def _read_on(request: Mapping[str, Any], control: ControlMesh) -> tuple[NamedPoints, list[CagePoints]]:
    """Landmarks and curves of a file on a matched mesh, which may be a part: those of other parts are left out.

    The sets of points are the landmarks, then the points of each curve.
    """
    mesh = control if control.file_vertices is None else read_whole(Path(request["file"]))
    points = read_points(request["landmarks"], mesh)
    on_mesh = on_cage(points, mesh)
    curves = [(curve, on_cage_curve(curve, mesh).points) for curve in points.curves]
    if control.file_vertices is not None:
        number = numbers_on_part(control, mesh)
        on_mesh = replace(on_mesh, corners=number[on_mesh.corners])
        curves = [(curve, replace(on_curve, corners=number[on_curve.corners])) for curve, on_curve in curves]
    rows = np.flatnonzero((on_mesh.corners >= 0).all(axis=1))
    curves = [(curve, on_curve) for curve, on_curve in curves if (on_curve.corners >= 0).all()]
    if not len(rows) and not curves:
        raise InvalidLandmarksError(
            f"{request['landmarks']}: expected landmarks on {control.name}, as it was matched, found none there. "
            "Give landmarks of the part that is matched."
        )
    kept = replace(points, names=tuple(points.names[row] for row in rows), curves=tuple(curve for curve, _ in curves))
    return kept, [on_mesh.at(rows), *(on_curve for _, on_curve in curves)]


def carry_notes(figures: list[dict[str, Any]]) -> list[str]:
    """Notes for the user about the written landmark files."""
    notes = []
    for entry in figures:
        names = ", ".join(entry["look_at"][:5])
        hint = f"; look first at {names}" if names else ""
        notes.append(
            f"{entry['points']} landmarks carried to {entry['file']}{hint}. Correct them there and run again: an "
            "edited file counts as landmarks of its model"
        )
    return notes


def _shortest_paths(start: str, matches: Mapping[PairNames, Task]) -> dict[str, list[str]]:
    """Models along the shortest path of maps from one model to each other model."""
    paths, waiting = {start: [start]}, deque([start])
    while waiting:
        model = waiting.popleft()
        neighbors = [source if target == model else target for source, target in matches if model in (source, target)]
        for name in sorted(set(neighbors) - set(paths)):
            paths[name] = [*paths[model], name]
            waiting.append(name)
    del paths[start]
    return paths


def _match_between(start: str, end: str, matches: Mapping[PairNames, Task]) -> tuple[Task, bool]:
    """The match between two models, and whether its map starts at the first."""
    direct = matches.get((end, start))  # keys are (source, target); maps go from target to source
    return (direct, True) if direct is not None else (matches[start, end], False)
