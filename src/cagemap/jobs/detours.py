"""Replacement of doubtful maps by detours: compositions of better maps."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from cagemap.files.result.folder import ARRAYS
from cagemap.jobs.consistency import MapKey
from cagemap.jobs.plan import DETOUR_FOLDER, PairNames, Plan, Task, pair_folder, task_key
from cagemap.maps.masks import Masks
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import measure_quality
from cagemap.maps.result import MatchResult, SpectralMap
from cagemap.mesh.landmarks import Landmarks
from cagemap.surface.triangle_surface import SurfacePoints
from cagemap.surface.triangles import normalize_rows

# Weight of normals, beside positions at unit area, in closest point searches: as in the elastic fit, it separates the
# sides of thin parts.
MAP_NORMAL_WEIGHT = 0.03


def compose_maps(maps: Sequence[PointMap]) -> PointMap:
    """Compose maps, each of whose sources is the next one's target.

    Images between vertices are interpolated linearly and projected onto the last surface.
    """
    positions, normals = maps[-1].images.positions, maps[-1].images.normals
    for point_map in reversed(maps[:-1]):
        positions, normals = point_map.pull_back(positions), point_map.pull_back(normals)
    images = SurfacePoints.nearest(maps[-1].source, positions, normalize_rows(normals), normal_weight=MAP_NORMAL_WEIGHT)
    return PointMap(maps[0].target, images)


def compose_results(results: Sequence[MatchResult], names: Sequence[str]) -> MatchResult:
    """Compose results from target to source, which ``names`` names; quality is measured without landmarks.

    Masks and input files are those of the first target and the last source. Functional maps are multiplied if the maps
    in a row share bases.
    """
    first, last = results[0], results[-1]
    point_map = compose_maps([result.point_map for result in results])
    masks = Masks(first.masks.target, last.masks.source)
    quality = measure_quality(point_map, masks=masks)
    spectral = None
    if all(result.has_spectral for result in results) and all(map(_share_basis, results, results[1:])):
        product = reduce(np.matmul, [result.functional_map for result in results])
        spectral = SpectralMap(product, first.spectral.target_eigenvalues, last.spectral.source_eigenvalues)
    note = f"composed of the maps {' -> '.join(reversed(names))}, since the direct one disagrees with its detours"
    # All RESULT folders of a job are equally deep, so that relative paths hold.
    inputs = {
        side: (result.manifest.get("inputs") or {}).get(side) for side, result in (("target", first), ("source", last))
    }
    provenance = {"notes": [note], "way": list(names), "inputs": {side: one for side, one in inputs.items() if one}}
    return MatchResult(
        first.target,
        last.source,
        Landmarks.none(),
        point_map,
        quality,
        masks=masks,
        known_spectral=spectral,
        provenance=provenance,
    )


def _share_basis(result: MatchResult, following: MatchResult) -> bool:
    """Whether one basis serves a result's source and the target of the following result."""
    eigenvalues = result.spectral.source_eigenvalues, following.spectral.target_eigenvalues
    return result.source.config == following.target.config and np.array_equal(*eigenvalues)


def add_detours(plan: Plan, detours: Mapping[MapKey, Sequence[str]], version: str) -> Plan:
    """The plan with a task for every detour; outputs of those pairs use the detour."""
    matches = {task.pair: task for task in plan.tasks if task.kind == "match"}
    tasks: list[Task] = []
    composed: dict[PairNames, Task] = {}
    for (target, source), names in detours.items():
        steps = [matches[end, start] for start, end in itertools.pairwise(names)]
        folder = f"{pair_folder((source, target))}/{DETOUR_FOLDER}"
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
        detour = None if task.pair is None or task.kind == "match" else composed.get(task.pair)
        if detour is not None:
            request = {**task.request, "result": detour.request["output"]}
            key = task_key(version, task.kind, task.key, detour.key)
            task = replace(task, key=key, needs=(detour.name,), request=request)
        tasks.append(_reroute_carry(task, matches, composed, version) if task.kind == "carry" else task)
    matches_first = [task for task in tasks if task.kind in ("prepare", "match")]
    outputs = [task for task in tasks if task.kind not in ("prepare", "match")]
    return replace(plan, tasks=(*matches_first, *composed.values(), *outputs))


def _reroute_carry(
    task: Task, matches: Mapping[PairNames | None, Task], composed: Mapping[PairNames, Task], version: str
) -> Task:
    """A carry task with detours instead of doubtful maps."""
    detour_of_folder = {matches[pair].request["output"]: detour for pair, detour in composed.items()}
    detour_names = {matches[pair].name: detour.name for pair, detour in composed.items()}
    detours = [detour_of_folder[folder] for folder, _ in task.request["steps"] if folder in detour_of_folder]
    if not detours:
        return task
    steps = [
        [detour_of_folder[folder].request["output"] if folder in detour_of_folder else folder, forward]
        for folder, forward in task.request["steps"]
    ]
    return replace(
        task,
        key=task_key(version, "carry", task.key, [detour.key for detour in detours]),
        needs=tuple(detour_names.get(name, name) for name in task.needs),
        request={**task.request, "steps": steps},
    )


def keep_matches(plan: Plan) -> Plan:
    """The plan with its preparations and matches only."""
    return replace(plan, tasks=tuple(task for task in plan.tasks if task.kind in ("prepare", "match")))


def has_detours(plan: Plan) -> bool:
    """Whether any map of a plan has a detour to compare with."""
    pairs = set(plan.pairs)
    return any((a, b) in pairs and (b, c) in pairs for a, c in pairs for b in {b for _, b in pairs} - {a, c})
