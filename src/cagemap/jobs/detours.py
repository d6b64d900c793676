"""Doubtful maps replaced by detours: compositions of better ones."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np

from cagemap.files.result.folder import ARRAYS
from cagemap.jobs.consistency import Pair
from cagemap.jobs.plan import DETOUR, Plan, Task, task_key
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import measure_quality
from cagemap.maps.result import MatchResult, SpectralMap
from cagemap.mesh.landmarks import Landmarks
from cagemap.surface.surface_points import SurfacePoints
from cagemap.surface.triangles import normalized

# Weight of normals beside positions at unit area in the search for the composed map's points: as in the elastic fit,
# enough to tell the sides of thin parts apart.
NORMAL_WEIGHT = 0.03


def composed_map(way: Sequence[PointMap]) -> PointMap:
    """The map from the first target to the last source, one map after the other.

    Images between two vertices are mixed linearly and put back onto the last surface.

    Parameters
    ----------
    way : sequence of PointMap
        The source of each is the target of the next.

    Raises
    ------
    ParameterError
        If they do not follow each other.
    """
    positions, normals = way[-1].images.positions, way[-1].images.normals
    for earlier in reversed(way[:-1]):
        positions, normals = earlier.pull_back(positions), earlier.pull_back(normals)
    images = SurfacePoints.nearest(way[-1].source, positions, normalized(normals), normal_weight=NORMAL_WEIGHT)
    return PointMap(way[0].target, images)


def composed_result(way: Sequence[MatchResult], names: Sequence[str]) -> MatchResult:
    """Results along a way as one: point maps composed, functional maps multiplied, judged without landmarks.

    Parameters
    ----------
    way : sequence of MatchResult
        The source of each is the target of the next.
    names : sequence of str
        What is passed, from target to source, for the manifest's note.
    """
    first, last = way[0], way[-1]
    found = composed_map([result.point_map for result in way])
    quality = measure_quality(found)
    spectral = None
    if all(result.has_spectral for result in way):
        product = reduce(np.matmul, [result.functional_map for result in way])
        spectral = SpectralMap(product, first.spectral.target_eigenvalues, last.spectral.source_eigenvalues)
    note = f"composed of the maps {' -> '.join(reversed(names))}, since the direct one disagrees with its detours"
    provenance = {"notes": [note], "way": list(names)}
    return MatchResult(
        first.target, last.source, Landmarks.none(), found, quality, known_spectral=spectral, provenance=provenance
    )


def with_detours(plan: Plan, detours: Mapping[Pair, Sequence[str]], version: str) -> Plan:
    """The plan with a task for every detour, and outputs of those pairs taken from it.

    Parameters
    ----------
    plan : Plan
    detours : mapping of (target, source) to names
        Assets along the way, from target to source.
    version : str
        Of the code.
    """
    matches = {task.pair: task for task in plan.tasks if task.kind == "match"}
    tasks: list[Task] = []
    composed: dict[tuple[str, str], Task] = {}
    for (target, source), names in detours.items():
        steps = [matches[there, here] for here, there in itertools.pairwise(names)]
        folder = f"{source}__{target}/{DETOUR}"
        request = {
            "way": [step.request["output"] for step in steps],
            "names": list(names),
            "output": str(plan.root / folder),
        }
        composed[source, target] = Task(
            "compose",
            f"compose {source} -> {target} by way of {', '.join(names[1:-1])}",
            task_key(version, "compose", [step.key for step in steps]),
            tuple(step.name for step in steps),
            request,
            (f"{folder}/{ARRAYS}",),
            (source, target),
        )
    for task in plan.tasks:
        around = None if task.pair is None or task.kind == "match" else composed.get(task.pair)
        if around is not None:
            request = {**task.request, "result": around.request["output"]}
            key = task_key(version, task.kind, task.key, around.key)
            task = replace(task, key=key, needs=(around.name,), request=request)
        tasks.append(_with_detours(task, matches, composed, version) if task.kind == "carry" else task)
    ordered = [task for task in tasks if task.kind in ("prepare", "match")]
    others = [task for task in tasks if task.kind not in ("prepare", "match")]
    return replace(plan, tasks=(*ordered, *composed.values(), *others))


def _with_detours(task: Task, matches: Mapping[Any, Task], composed: Mapping[Pair, Task], version: str) -> Task:
    """A task that carries landmarks, with the detour in place of every map that has one."""
    other = {matches[pair].request["output"]: around for pair, around in composed.items()}
    others_names = {matches[pair].name: around.name for pair, around in composed.items()}
    used = [other[folder] for folder, _ in task.request["steps"] if folder in other]
    if not used:
        return task
    steps = [
        [other[folder].request["output"] if folder in other else folder, forward]
        for folder, forward in task.request["steps"]
    ]
    return replace(
        task,
        key=task_key(version, "carry", task.key, [around.key for around in used]),
        needs=tuple(others_names.get(name, name) for name in task.needs),
        request={**task.request, "steps": steps},
    )


def matches_only(plan: Plan) -> Plan:
    """The part of a plan that consistency needs."""
    return replace(plan, tasks=tuple(task for task in plan.tasks if task.kind in ("prepare", "match")))


def has_detours(plan: Plan) -> bool:
    """Whether any map of a plan could be compared with a detour."""
    pairs = set(plan.pairs)
    return any((a, b) in pairs and (b, c) in pairs for a, c in pairs for b in {b for _, b in pairs} - {a, c})
