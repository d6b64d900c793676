"""`cagemap run`: a job file in, all its results, a page and a table out."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from cagemap.cli.bases import SIDES, side_bases, side_levels
from cagemap.cli.dry_run import dry_run
from cagemap.cli.job_file import COMMANDS, WRITTEN
from cagemap.cli.map_request import MapRequest
from cagemap.cli.match import MatchRequest, read_control, run_match
from cagemap.cli.mesh_commands import require_size
from cagemap.cli.own_map import run_map
from cagemap.cli.progress import Stages
from cagemap.cli.report import run_report
from cagemap.cli.run_request import RunRequest
from cagemap.cli.transfer import run_transfer
from cagemap.cli.wrap import run_wrap
from cagemap.errors import CagemapError, in_options
from cagemap.files.code_version import code_version
from cagemap.files.images import write_image
from cagemap.files.result import landmark_messages, read_manifest, read_result, write_result
from cagemap.files.surface_store import prepared
from cagemap.library import (
    Consistency,
    Outcome,
    Plan,
    Task,
    measure_consistency,
    open_crew,
    pair_rows,
    plan_job,
    read_job,
    run_plan,
    spanning_tree,
    write_library,
)
from cagemap.library.carry import carried_notes, carry_landmarks, with_carried
from cagemap.library.consistency import read_consistency, write_consistency
from cagemap.library.page import PairRow
from cagemap.library.plan import STATE
from cagemap.library.ways import composed_result, has_ways_round, matches_only, with_ways
from cagemap.mesh.checks import require_valid
from cagemap.mesh.plain import plain_mesh
from cagemap.mesh.schemes import Plain
from cagemap.numerics.threads import core_count
from cagemap.report import draw_thumbnail


class Ticker:
    """Tells the progress of the whole, and which kind of task is slowest so far."""

    def __init__(self, stages: Stages) -> None:
        self._stages = stages
        self._slowest: Outcome | None = None

    def __call__(self, outcome: Outcome, finished: int, total: int) -> None:
        """Note an outcome and show where things stand."""
        if outcome.state == "done" and (self._slowest is None or outcome.seconds > self._slowest.seconds):
            self._slowest = outcome
        slowest = "" if self._slowest is None else f"; slowest: {self._slowest.name}, {self._slowest.seconds:.1f} s"
        self._stages.show(f"{finished} of {total} tasks{slowest}")


def run_job(request: RunRequest, stages: Stages) -> tuple[str, bool]:
    """Do what a job file says; returns a summary, and whether everything is there."""
    stages("read job")
    job = read_job(request.job, COMMANDS, WRITTEN)
    version = code_version()
    plan = with_carried(plan_job(job, version, spanning_tree), job, version)
    if request.dry_run:
        return dry_run(job, plan, request.workers or core_count()), True
    started = time.perf_counter()
    stages("run tasks")
    with open_crew(request.scheduler, request.workers, stages.note) as crew:
        verdict, matched = Consistency({}, 0, (), {}), dict[str, Outcome]()
        if has_ways_round(plan):
            matched = run_plan(matches_only(plan), run_task, crew, Ticker(stages))
            stages("compare maps with each other")
            verdict = collection_verdict(plan, matched)
            plan = with_ways(plan, verdict.ways, version)
            stages("run tasks")
        outcomes = run_plan(plan, run_task, crew, Ticker(stages))
    # What the first half did is no leftover of an earlier run.
    outcomes |= {name: matched[name] for name, now in outcomes.items() if now.state == "kept" and name in matched}
    stages("page")
    carried = [outcomes[task.name] for task in plan.tasks if task.kind == "carry" and outcomes[task.name].usable]
    notes = [*plan.left_out, *cycle_notes(verdict), *carried_notes([outcome.figures for outcome in carried])]
    page = None
    try:  # where the disk is full the outcomes are still told
        page = write_library(plan.root, job.path.stem, in_words(pair_rows(plan, outcomes, verdict.errors)), notes)[0]
    except (CagemapError, OSError) as error:
        notes.append(f"the page could not be written: {error}")
    seconds = time.perf_counter() - started
    whole = page is not None and all(outcome.usable for outcome in outcomes.values())
    return summary(plan, outcomes, notes, page, seconds), whole


def in_words(rows: Iterable[PairRow]) -> list[PairRow]:
    """Rows of the page with messages in the words of the command line and of job files."""
    return [replace(row, messages=tuple(map(in_options, row.messages))) for row in rows]


def collection_verdict(plan: Plan, outcomes: dict[str, Outcome]) -> Consistency:
    """How the maps of a job agree with each other; kept beside them, and measured again when one of them changes."""
    matches = [task for task in plan.tasks if task.kind == "match" and outcomes[task.name].usable]
    keys = {task.name: task.key for task in matches}
    place = plan.root / STATE / "consistency.json"
    known = read_consistency(place, keys)
    if known is not None:
        return known
    maps = {}
    for task in matches:
        assert task.pair is not None
        maps[task.pair[1], task.pair[0]] = read_result((plan.root / task.outputs[0]).parent).point_map
    verdict = measure_consistency(maps)
    write_consistency(place, keys, verdict)
    return verdict


def cycle_notes(verdict: Consistency) -> list[str]:
    """Sentences about pairs that break cycles."""
    notes = []
    for pair in verdict.doubtful:
        target, source = pair
        text = (
            f"{source} -> {target} disagrees with the ways round it by {100 * verdict.errors[pair]:.1f} % of the size"
        )
        way = verdict.ways.get(pair)
        notes.append(f"{text}; replaced by the way through {', '.join(way[1:-1])}" if way else text)
    return notes


def summary(plan: Plan, outcomes: dict[str, Outcome], notes: list[str], page: Path | None, seconds: float) -> str:
    """A few lines for the terminal: what was done, what failed and why."""
    states = {
        state: sum(o.state == state for o in outcomes.values()) for state in ("done", "kept", "failed", "skipped")
    }
    counted = ", ".join(f"{count} {state}" for state, count in states.items() if count)
    failures = [f"  {o.name}: {o.state}: {o.message}" for o in outcomes.values() if not o.usable]
    return "\n".join(
        [
            f"{len(plan.pairs)} pair{'s' * (len(plan.pairs) != 1)}, tasks: {counted}, in {seconds:.1f} s",
            *failures,
            *(f"  {note}" for note in notes),
            *([] if page is None else [f"Open {page} in a browser."]),
        ]
    )


def run_task(task: Task) -> dict[str, Any]:
    """Do one task of a plan, here or on a worker; returns what it has to say about its result."""
    stages = Stages(shown=False)
    if task.kind == "prepare":
        return _prepare(task)
    if task.kind == "picture":
        write_image(task.request["output"], draw_thumbnail(read_result(task.request["result"])))
        return {}
    if task.kind == "carry":
        return carry_landmarks(task.request)
    if task.kind == "compose":
        way = [read_result(folder) for folder in task.request["way"]]
        result = composed_result(way, task.request["names"])
        write_result(task.request["output"], result)
        return {"quality": result.manifest["quality"], "notes": result.manifest["notes"]}
    if task.kind == "match":
        return _match(task, stages)
    given = dict(task.request)
    if task.kind == "wrap":
        given["results"] = [given.pop("result")]
    request: Any = TypeAdapter(COMMANDS[task.kind]).validate_python(given)
    if task.kind == "report":
        run_report(request, stages)
        return {}
    _, warnings = (run_transfer if task.kind == "transfer" else run_wrap)(request, stages)
    return {"warnings": warnings}


def _match(task: Task, stages: Stages) -> dict[str, Any]:
    """Find the map of a pair, or take the one that is given."""
    if "map" in task.request:
        run_map(TypeAdapter(MapRequest).validate_python(task.request), stages)
    else:
        run_match(TypeAdapter(MatchRequest).validate_python({"landmarks": None, **task.request}), stages)
    manifest = read_manifest(Path(task.request["output"]))
    warnings = [*landmark_messages(manifest), *manifest["quality"]["warnings"]]
    return {name: manifest[name] for name in ("quality", "timings", "notes") if name in manifest} | {
        "warnings": warnings
    }


def _prepare(task: Task) -> dict[str, Any]:
    """Prepare one surface and keep it in the store; the same as a match would do for that side."""
    file, side = Path(task.request["file"]), SIDES.index(task.request["side"])
    given = {"target": file, "source": file, "landmarks": None, "output": file, **task.request["options"]}
    request: MatchRequest = TypeAdapter(MatchRequest).validate_python(given)
    control = read_control(file, request, task.request["side"])
    if isinstance(control.scheme, Plain):
        control = plain_mesh(control).mesh
    else:
        require_valid(control)
    level = side_levels(request, (control, control))[side]
    require_size(control, level)
    surface = prepared(task.request["cache"], control, level, side_bases(request)[side])
    return {"vertices": surface.refinement.finest.n_vertices, "level": level}
