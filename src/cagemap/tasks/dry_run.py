"""`cagemap run --dry-run`: the tasks of a job, their sizes and estimated costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

from cagemap.errors import CagemapError
from cagemap.files.meshes.formats import read_whole
from cagemap.jobs.costs import (
    ERROR_FACTOR,
    PREPARED_VERTICES,
    STARTUP_SECONDS,
    Size,
    result_bytes,
    surface_bytes,
    task_seconds,
    worker_memory,
)
from cagemap.jobs.farm import farm_steps, numbered_tasks
from cagemap.jobs.job import Job
from cagemap.jobs.plan import Plan, Task
from cagemap.jobs.run import missing_tasks
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import count_noun
from cagemap.subdivision.refinement import default_scheme, vertex_counts
from cagemap.tasks.import_map import MAP_VERTICES
from cagemap.tasks.method import SIDES, side_levels
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.subdivision import SubdivisionRequest

# Default side of a baked image.
IMAGE = 2048

# Options of `transfer` that bake: from images over the source's UVs, and those that need only the target's UVs.
_OVER_SOURCE = ("texture", "maps", "displacement", "normal_map", "vector_displacement")
_BAKED = ("material_colors", "bake")
# Options of `match` that decide the size of a surface.
_SIZE_OPTIONS = [f"{side}{name}" for side in ("", "target_", "source_") for name in ("vertices", "level", "scheme")]


@dataclass(frozen=True)
class AssetSize:
    """Vertex counts of a model; zeros if its mesh cannot be read."""

    # `control`, `finest`, `prepared`: vertices of the control mesh, of the finest level, and of the last level of its
    # basis
    control: int = 0
    finest: int = 0
    prepared: int = 0
    laid_out: bool = True  # whether it has texture coordinates
    problem: str = ""  # why it cannot be read

    @property
    def both(self) -> Size:
        """Control and finest vertices."""
        return self.control, self.finest


def dry_run(job: Job, plan: Plan, workers: int) -> str:
    """Text with a job's tasks, their states and sizes, and estimated time, memory and disk space."""
    read = cache(lambda name: read_whole(job.assets[name].file))
    models = dict.fromkeys(model for task in plan.tasks for model in _models(task))
    named = {name for name, _ in models}
    models |= dict.fromkeys((name, "target") for name in job.assets if name not in named)
    sizes = {(name, side): _size(job, name, side, plan, read) for name, side in models}
    problems = {name: size.problem for (name, _), size in sizes.items() if size.problem}
    lines, total, memory, disk = [], 0.0, 0.0, 0.0
    missing = missing_tasks(plan)
    waiting, steps = {task.name for task in missing}, farm_steps(plan)
    for number, task in numbered_tasks(steps):
        if task.name not in waiting:
            lines.append(f"  {number} {task.name}: done")
            continue
        asset_sizes = [sizes[model] for model in _models(task)]
        vertex_sizes = [size.both for size in asset_sizes]
        seconds = _seconds(task, vertex_sizes)
        total += seconds
        memory = max(memory, worker_memory(vertex_sizes))
        disk += _bytes(task, asset_sizes)
        shown = " + ".join(f"{size.finest:,}" for size in asset_sizes)
        lines.append(
            f"  {number} {task.name}: {shown} vertices, about {seconds:.0f} s{_expected_refusal(task, asset_sizes)}"
        )
    used = max(min(workers, len(missing)), 1)
    minutes = (total / used + STARTUP_SECONDS * bool(missing)) / 60
    return "\n".join(
        [
            f"{count_noun(len(plan.tasks), 'task')} for {count_noun(len(plan.pairs), 'pair')}, {len(missing)} to do; "
            f"--task takes numbers from 1 to {steps[-1].last}, one for all outputs of a pair",
            *lines,
            f"  {steps[-1].last} page",
            *(f"  {text}" for text in plan.omitted_outputs),
            *(f"  {name} cannot be used: {problems[name]}" for name in job.assets if name in problems),
            f"about {total / 60:.1f} core minutes, {minutes:.1f} minutes with {workers} workers (within a factor of "
            f"{ERROR_FACTOR:g} on the machine that was measured)",
            f"about {memory / 1e9:.1f} GB of memory for each worker, {disk / 1e9:.2f} GB on the disk",
        ]
    )


def _expected_refusal(task: Task, sizes: list[AssetSize]) -> str:
    """Why a bake will be refused (a mesh without texture coordinates), or an empty text."""
    if task.kind != "transfer" or task.pair is None:
        return ""
    source, target = (size.laid_out for size in sizes)
    painted = [name for name in _OVER_SOURCE if task.request.get(name)]
    baked = bool(painted) or any(task.request.get(name) for name in _BAKED)
    if painted and not source:
        return f"; will be refused, for {task.pair[0]} has no texture coordinates, which {painted[0]} lies over"
    if baked and not target and not task.request.get("unwrap"):
        return f"; will be refused, for {task.pair[1]} has no texture coordinates: add `unwrap = true`"
    return ""


def _seconds(task: Task, sizes: list[Size]) -> float:
    """Processor seconds of a task."""
    named = {"landmarks", "target_points", "curves", "map"} & {name for name, given in task.request.items() if given}
    side = int(task.request.get("size") or IMAGE)
    texels = side * side if task.kind == "transfer" else 0
    return task_seconds(task.kind, sizes, landmarks=bool(named), texels=texels)


def _bytes(task: Task, sizes: list[AssetSize]) -> float:
    """Bytes that a task writes to the disk, without output images."""
    if task.kind == "prepare":
        return surface_bytes(sizes[0].both, sizes[0].prepared)
    return result_bytes([size.both for size in sizes]) if task.kind in ("match", "compose") else 0.0


def _size(job: Job, name: str, side: str, plan: Plan, read: Callable[[str], ControlMesh]) -> AssetSize:
    """Size of an asset as target or source, with the options of its first task."""
    tasks = (task for task in plan.tasks if task.kind in ("prepare", "match") and (name, side) in _models(task))
    options: dict[str, Any] = next((task.request.get("options", task.request) for task in tasks), {})
    request = MatchRequest(Path(), Path(), Path(), vertices=MAP_VERTICES if "map" in options else None)
    request = replace(request, **{key: value for key, value in options.items() if key in _SIZE_OPTIONS})
    try:
        scheme = getattr(request, f"{side}_scheme") or job.assets[name].scheme or request.scheme
        control = SubdivisionRequest(scheme).apply(read(name))
        level = side_levels(request, (control, control))[SIDES.index(side)]
        counts = list(islice(vertex_counts(control, default_scheme(control)), level + 1))
    except CagemapError as error:
        return AssetSize(problem=str(error))
    prepared = next((n for n in counts if n >= PREPARED_VERTICES), counts[-1])
    return AssetSize(control.n_vertices, counts[-1], prepared, control.uvs is not None)


def _models(task: Task) -> list[tuple[str, str]]:
    """Names and sides of the assets that a task reads: source and target of its pair, or one of them."""
    if task.pair is None:
        return [(task.request["asset"], task.request.get("side", "target"))]
    return list(zip(task.pair, ("source", "target"), strict=True))
