"""Landmarks of one model of a collection, carried to the others along its maps, to be corrected there.

Every other model gets a file. While nobody has edited it, it is rewritten whenever a map changes, and no match reads
it. Once edited, it holds the landmarks of that model: it is never written again, and matches of two models with
landmarks use it.
"""

from __future__ import annotations

import itertools
import os
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.files.landmarks.point_formats import write_points
from cagemap.files.landmarks.points import read_points
from cagemap.files.result.folder import read_result
from cagemap.files.result.manifest import file_hash
from cagemap.jobs.detours import NORMAL_WEIGHT
from cagemap.jobs.job import Job
from cagemap.jobs.plan import Pair, Plan, Task, task_key
from cagemap.maps.places import cage_points_of, located
from cagemap.maps.result import MatchResult
from cagemap.mesh.cage_points import CagePoints, NamedCurve, NamedPoints, on_cage
from cagemap.mesh.curves import on_cage_curve
from cagemap.numerics.arrays import FloatArray
from cagemap.surface.surface_points import SurfacePoints
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import normalized

# Points where both directions of a map differ by more than this, of sqrt(area), are reported.
DOUBTFUL = 0.01


@dataclass(frozen=True, eq=False)
class Step:
    """One map on the way from model to model.

    Attributes
    ----------
    result : MatchResult
    forward : bool
        Whether it leads from the map's target to its source, the way that the map is stored.
    """

    result: MatchResult
    forward: bool

    def carried(self, positions: FloatArray, normals: FloatArray) -> SurfacePoints:
        """Points of the next model that correspond to places (q, 3) on this one, at unit area, with their normals."""
        found = self.result.point_map
        if self.forward:
            here = SurfacePoints.nearest(found.target, positions, normals, normal_weight=NORMAL_WEIGHT)
            there = here.interpolate(found.images.positions)
            facing = normalized(here.interpolate(found.images.normals))
            return SurfacePoints.nearest(found.source, there, facing, normal_weight=NORMAL_WEIGHT)
        laid = TriangleSurface(found.images.positions, found.target.triangles, 1.0)
        near = SurfacePoints.nearest(laid, positions, normals, normal_weight=NORMAL_WEIGHT)
        return SurfacePoints(found.target, near.triangle, near.barycentric)


def with_carried(plan: Plan, job: Job, version: str) -> Plan:
    """The plan with a task for every model that landmarks are carried to, after its matches.

    Models that have landmarks of their own, or that no way of maps leads to, get none.

    Parameters
    ----------
    plan : Plan
    job : Job
    version : str
        Of the code.
    """
    if job.carry is None:
        return plan
    matches = {task.pair: task for task in plan.tasks if task.kind == "match" and task.pair is not None}
    given = job.assets[job.carry.source].landmarks
    assert given is not None
    content, made = file_hash(given), []
    for name, way in _paths(job.carry.source, matches).items():
        if job.assets[name].landmarks is not None:
            continue
        steps = [_between(here, there, matches) for here, there in itertools.pairwise(way)]
        back = _other_direction(way, matches)
        file = job.carry.folder / f"{name}.json"
        request = {
            "asset": name,
            "steps": [[step.request["output"], forward] for step, forward in steps],
            "back": None if back is None else back.request["output"],
            "landmarks": str(given),
            "output": str(file),
        }
        needs = tuple(task.name for task in [*(step for step, _ in steps), back] if task is not None)
        keys = [(step.key, forward) for step, forward in steps], None if back is None else back.key
        key = task_key(version, "carry", content, *keys, str(file))
        written = Path(os.path.relpath(file, plan.root)).as_posix()
        title, reads = f"carry landmarks to {name}", {str(given): content}
        made.append(Task("carry", title, key, needs, request, (written,), reads=reads))
    return replace(plan, tasks=(*plan.tasks, *made))


def carry_landmarks(request: Mapping[str, Any]) -> dict[str, Any]:
    """Carry the landmarks and curves of one model to another, and write its file; what a task of `with_carried` does.

    Returns
    -------
    dict
        "points": how many; "look_at": names of points where both directions of a map disagree, worst first.
    """
    steps = [Step(read_result(folder), bool(forward)) for folder, forward in request["steps"]]
    first = steps[0].result.target if steps[0].forward else steps[0].result.source
    given = read_points(request["landmarks"], first.control)
    own = on_cage(given, first.control)
    lines = [on_cage_curve(curve, first.control) for curve in given.curves]
    every = [own, *(line.points for line in lines)]
    sizes = [len(points.corners) for points in every]
    joined = CagePoints(np.vstack([p.corners for p in every]), np.vstack([p.weights for p in every]))
    start = located(first, joined)
    found = start
    for step in steps:
        found = step.carried(found.positions, found.normals)
    last = steps[-1].result.source if steps[-1].forward else steps[-1].result.target
    on_control = cage_points_of(last, found)  # control vertices, or places on the control mesh in file units
    vertices, positions = on_control.vertices, on_control.of(last.control.positions)
    ends = np.cumsum(sizes)
    curves = tuple(
        NamedCurve(curve.name, np.full(size, -1, dtype=np.int64), positions[end - size : end], curve.closed)
        for curve, size, end in zip(given.curves, sizes[1:], ends[1:], strict=True)
    )
    points = NamedPoints(given.names, vertices[: sizes[0]], positions[: sizes[0]], last.control.name, curves)
    Path(request["output"]).parent.mkdir(parents=True, exist_ok=True)
    write_points(request["output"], points, last.control)
    look_at: list[str] = []
    if request["back"] is not None:
        again = Step(read_result(request["back"]), not steps[-1].forward).carried(start.positions, start.normals)
        apart = np.linalg.norm(again.positions - found.positions, axis=1)[: sizes[0]]
        look_at = [given.names[i] for i in np.argsort(-apart) if apart[i] > DOUBTFUL]
    return {"points": sizes[0], "curves": len(curves), "file": str(request["output"]), "look_at": look_at}


def carried_notes(figures: list[dict[str, Any]]) -> list[str]:
    """Sentences about the files that landmarks were carried to."""
    notes = []
    for one in figures:
        first = ", ".join(one["look_at"][:5])
        hint = f"; look first at {first}" if first else ""
        notes.append(
            f"{one['points']} landmarks carried to {one['file']}{hint}. Correct them there and run again: an edited "
            "file counts as landmarks of its model"
        )
    return notes


def _paths(start: str, matches: Mapping[Pair, Task]) -> dict[str, list[str]]:
    """Models along the shortest path of maps from one model to every other."""
    paths, waiting = {start: [start]}, deque([start])
    while waiting:
        here = waiting.popleft()
        near = [source if target == here else target for source, target in matches if here in (source, target)]
        for name in sorted(set(near) - set(paths)):
            paths[name] = [*paths[here], name]
            waiting.append(name)
    del paths[start]
    return paths


def _between(here: str, there: str, matches: Mapping[Pair, Task]) -> tuple[Task, bool]:
    """The match that leads from one model to the next, and whether it does so in its own direction."""
    direct = matches.get((there, here))  # source, target: maps go from target to source
    return (direct, True) if direct is not None else (matches[here, there], False)


def _other_direction(way: list[str], matches: Mapping[Pair, Task]) -> Task | None:
    """The match of the opposite direction of a way of one map, if there are both."""
    both = len(way) == 2 and (way[1], way[0]) in matches
    return matches.get((way[0], way[1])) if both else None
