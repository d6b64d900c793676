"""`cagemap run`: run a job file; write its results, a page and a table."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from cagemap.errors import CagemapError, FormatError, ParameterError, use_option_names
from cagemap.files.images.image import write_image
from cagemap.files.result.folder import read_result, write_result
from cagemap.files.result.manifest import code_version, landmark_messages, read_manifest
from cagemap.files.result.surface_store import load_or_prepare
from cagemap.jobs.carry import add_carry_tasks, carry_landmarks, carry_notes
from cagemap.jobs.consistency import Consistency, measure_consistency, read_consistency, write_consistency
from cagemap.jobs.detours import add_detours, compose_results, has_detours, keep_matches
from cagemap.jobs.farm import PAGE_STEP, farm_steps, openjd_template, parse_task_range, slurm_script
from cagemap.jobs.job import Job, read_job
from cagemap.jobs.page import PairRow, pair_rows, remarks_of, write_library
from cagemap.jobs.plan import STATE_FOLDER, Plan, Task, plan_job
from cagemap.jobs.run import TaskOutcome, execute, explain_in_job, kept_outcome, missing_tasks, open_client, run_plan
from cagemap.jobs.tree import spanning_tree
from cagemap.mesh.mesh_report import count_noun
from cagemap.numerics.threads import core_count
from cagemap.report import draw_thumbnail
from cagemap.tasks import runner_of
from cagemap.tasks.dry_run import dry_run
from cagemap.tasks.match import check_match, read_control
from cagemap.tasks.match_parts import ready_mesh
from cagemap.tasks.method import SIDES, require_levels, side_bases, side_levels
from cagemap.tasks.progress import Stages, logged_warnings
from cagemap.tasks.requests.catalogue import COMMANDS, WRITTEN
from cagemap.tasks.requests.import_map import MapRequest
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.options import validate_request
from cagemap.tasks.requests.run import RunRequest
from cagemap.tasks.subdivision import weld_side
from cagemap.tasks.transfer import check_transfer
from cagemap.tasks.wrap_checks import check_wrap


def run_job(request: RunRequest, stages: Stages) -> tuple[str, bool]:
    """Run a job file; returns a summary, and whether all results exist."""
    stages("read job")
    job = read_job(request.job, COMMANDS, WRITTEN)
    version = code_version()
    plan = add_carry_tasks(plan_job(job, version, spanning_tree), job, version)
    _require_one_way(request)
    _require_sound(job, plan)
    if request.dry_run:
        return dry_run(job, plan, request.workers or core_count()), True
    if request.export == "slurm":
        return slurm_script(job.path, farm_steps(plan)), True
    if request.export == "openjd":
        return json.dumps(openjd_template(job.path, farm_steps(plan)), indent=2), True
    if request.task is not None:
        return run_numbered(request.task, job.path.stem, plan, version, stages)
    started, slowest = time.perf_counter(), TaskOutcome("", "done")

    def show(outcome: TaskOutcome, finished: int, total: int) -> None:
        nonlocal slowest
        slowest = max(outcome, slowest, key=lambda one: one.seconds)
        stages.show(f"{finished} of {total} tasks; slowest: {slowest.name}, {slowest.seconds:.1f} s")

    stages("run tasks")
    with open_client(request.scheduler, request.workers, stages.note) as connect:
        verdict, matched = Consistency(), dict[str, TaskOutcome]()
        if has_detours(plan):
            matched = run_plan(keep_matches(plan), run_task, connect, show)
            stages("compare maps with each other")
            verdict = collection_verdict(plan, matched)
            plan = add_detours(plan, verdict.detours, version)
            stages("run tasks")
        outcomes = run_plan(plan, run_task, connect, show)
    # Matches of the first pass were done in this run: they are not "kept".
    outcomes |= {name: matched[name] for name, now in outcomes.items() if now.state == "kept" and name in matched}
    stages("page")
    return _write_page(job.path.stem, plan, outcomes, verdict, started)


def run_numbered(words: str, title: str, plan: Plan, version: str, stages: Stages) -> tuple[str, bool]:
    """Run tasks by their numbers, one after the other in this process; finished tasks are kept.

    A task whose needs are not done fails. Detours around doubtful maps have no number and are composed first.
    """
    steps = farm_steps(plan)
    numbers = parse_task_range(words, steps[-1].last)
    lines, whole, started = [], True, time.perf_counter()
    ended: dict[str, TaskOutcome] = {}
    for step, number in ((step, number) for step in steps for number in numbers if step.first <= number <= step.last):
        verdict = Consistency()
        current = plan
        if step.name not in ("prepare", "match"):
            verdict, current = _verdict_and_plan(plan, version)
        if step.name == PAGE_STEP:
            text, complete = _write_page(title, current, _kept_outcomes(current) | ended, verdict, started)
            lines.append(f"{number} page:\n{text}")
            whole &= complete
        for task in step.tasks[number - step.first]:
            stages(task.name)
            outcome = _run_alone(task.name, current, ended)
            lines += [f"{number} {outcome}", *(f"  {text}" for text in remarks_of(outcome))]
            whole &= outcome.usable
    return use_option_names("\n".join(lines)), whole


def _require_one_way(request: RunRequest) -> None:
    """Refuse combinations of options in which one would be ignored."""
    options = {
        "--task": request.task is not None,
        "--export": request.export is not None,
        "--dry-run": request.dry_run,
        "--scheduler": request.scheduler is not None,
    }
    used = [name for name, is_given in options.items() if is_given]
    if request.workers is not None and not request.dry_run:
        used.append("--workers")
    if len(used) > 1:
        raise ParameterError(f"{used[0]}: expected none of {', '.join(used[1:])} beside it. Give one of them.")


def _require_sound(job: Job, plan: Plan) -> None:
    """Refuse a job with tasks whose options contradict each other, before any of them runs."""
    checks: dict[str, Callable[[Any], object]] = {"match": check_match, "transfer": check_transfer, "wrap": check_wrap}
    problems: dict[str, str] = {}
    for task in plan.tasks:
        if task.kind in checks and "map" not in task.request:
            try:
                checks[task.kind](_request_of(task))
            except CagemapError as error:
                problems.setdefault(str(error), task.name)
    if problems:
        listing = "\n".join(f"  {name}: {message}" for message, name in problems.items())
        raise FormatError(f"{job.path}: {count_noun(len(problems), 'problem')}; nothing was started.\n{listing}")


def _request_of(task: Task) -> Any:
    """The request of a task that a command does."""
    arguments = dict(task.request)
    if task.kind == "wrap":
        arguments["results"] = [arguments.pop("result")]
    return validate_request(
        MapRequest if task.kind == "match" and "map" in arguments else COMMANDS[task.kind], arguments
    )


def _run_alone(name: str, plan: Plan, ended: dict[str, TaskOutcome]) -> TaskOutcome:
    """Run one task of a plan, after the composed maps that it needs; their outcomes are added to ``ended``."""
    tasks = {task.name: task for task in plan.tasks}
    task, before = tasks[name], []
    for need in task.needs:
        kept = kept_outcome(plan.root, tasks[need])
        if kept is None and tasks[need].kind == "compose":
            kept = _run_alone(need, plan, ended)
        before.append(kept or TaskOutcome(need, "failed", "not done"))
    unusable = [outcome for outcome in before if not outcome.usable]
    if unusable and kept_outcome(plan.root, task) is None and unusable[0].message == "not done":
        return TaskOutcome(name, "skipped", f"needs '{unusable[0].name}', which is not done. Run its number first.")
    ended[name] = execute(task, plan.root, run_task, *before)
    return ended[name]


def _kept_outcomes(plan: Plan) -> dict[str, TaskOutcome]:
    """Outcomes of finished tasks; missing tasks are failed."""
    kept = {task.name: kept_outcome(plan.root, task) for task in plan.tasks}
    missing = {task.name: TaskOutcome(task.name, "failed", "not done") for task in missing_tasks(plan)}
    return {name: outcome for name, outcome in kept.items() if outcome is not None} | missing


def _verdict_and_plan(plan: Plan, version: str) -> tuple[Consistency, Plan]:
    """Consistency of finished maps, and the plan with detours around doubtful ones; under a file lock."""
    if not has_detours(plan):
        return Consistency(), plan
    from filelock import FileLock

    (plan.root / STATE_FOLDER).mkdir(parents=True, exist_ok=True)
    with FileLock(plan.root / STATE_FOLDER / "consistency.lock"):
        verdict = collection_verdict(plan, _kept_outcomes(plan))
    return verdict, add_detours(plan, verdict.detours, version)


def _write_page(
    title: str, plan: Plan, outcomes: dict[str, TaskOutcome], verdict: Consistency, started: float
) -> tuple[str, bool]:
    """Write the page of a job; returns a summary, and whether all results exist."""
    carried = [outcomes[task.name] for task in plan.tasks if task.kind == "carry" and outcomes[task.name].usable]
    notes = [*plan.omitted_outputs, *cycle_notes(verdict), *carry_notes([outcome.figures for outcome in carried])]
    page = None
    try:  # with a full disk the outcomes are still reported
        page = write_library(plan.root, title, rows_in_user_words(pair_rows(plan, outcomes, verdict.errors)), notes)[0]
    except (CagemapError, OSError) as error:
        notes.append(f"the page could not be written: {explain_in_job(error)}")
    whole = page is not None and all(outcome.usable for outcome in outcomes.values())
    return summary(plan, outcomes, notes, page, time.perf_counter() - started), whole


def rows_in_user_words(rows: Iterable[PairRow]) -> list[PairRow]:
    """Rows of the page, with option names in their messages as users type them."""
    return [replace(row, messages=tuple(map(use_option_names, row.messages))) for row in rows]


def collection_verdict(plan: Plan, outcomes: dict[str, TaskOutcome]) -> Consistency:
    """Consistency of a job's maps; stored with them, and measured again if a map changes."""
    matches = [task for task in plan.tasks if task.kind == "match" and outcomes[task.name].usable]
    keys = {task.name: task.key for task in matches}
    place = plan.root / STATE_FOLDER / "consistency.json"
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
    """Sentences about pairs that are inconsistent with their detours."""
    notes = []
    for pair in verdict.doubtful:
        target, source = pair
        text = f"{source} -> {target} disagrees with its detours by {100 * verdict.errors[pair]:.1f} % of the size"
        detour = verdict.detours.get(pair)
        notes.append(f"{text}; replaced by the way through {', '.join(detour[1:-1])}" if detour else text)
    return notes


def summary(plan: Plan, outcomes: dict[str, TaskOutcome], notes: list[str], page: Path | None, seconds: float) -> str:
    """Summary for the terminal: numbers of outcomes, failures and notes."""
    states = {
        state: sum(o.state == state for o in outcomes.values()) for state in ("done", "kept", "failed", "skipped")
    }
    ended = ", ".join(f"{count} {state}" for state, count in states.items() if count)
    failures = [f"  {outcome}" for outcome in outcomes.values() if not outcome.usable]
    return "\n".join(
        [
            f"{count_noun(len(plan.pairs), 'pair')}, tasks: {ended}, in {seconds:.1f} s",
            *failures,
            *dict.fromkeys(f"  {text}" for name, one in outcomes.items() for text in remarks_of(one, name)),
            *(f"  {note}" for note in notes),
            *([] if page is None else [f"Open {page} in a browser."]),
        ]
    )


def run_task(task: Task) -> dict[str, Any]:
    """Run one task of a plan, here or on a worker; returns its figures, notes and logged warnings.

    An error has the warnings as its notes.
    """
    with logged_warnings() as texts:
        try:
            figures = _figures_of(task)
        except Exception as error:
            for text in texts:
                error.add_note(_with_plain_path(text))
            raise
    return {**figures, "logged": list(map(_with_plain_path, texts))}


def _with_plain_path(text: str) -> str:
    """A message; the file that it begins with, if any, has one name in all tasks."""
    file, colon, rest = text.partition(": ")
    return f"{os.path.normpath(file)}{colon}{rest}" if colon and os.path.exists(file) else text


def _figures_of(task: Task) -> dict[str, Any]:
    """Run one task of a plan; returns its figures and notes."""
    stages = Stages()
    if task.kind == "prepare":
        return _prepare(task)
    if task.kind == "picture":
        write_image(task.request["output"], draw_thumbnail(read_result(task.request["result"])))
        return {}
    if task.kind == "carry":
        return carry_landmarks(task.request)
    if task.kind == "compose":
        results = [read_result(folder) for folder in task.request["way"]]
        result = compose_results(results, task.request["names"])
        write_result(task.request["output"], result)
        return _map_figures(result.manifest)
    request = _request_of(task)
    _, warnings = runner_of(request)(request, stages)
    if task.kind != "match":
        return {**stages.figures, "warnings": warnings}
    return _map_figures(read_manifest(Path(task.request["output"])))


def _map_figures(manifest: dict[str, Any]) -> dict[str, Any]:
    """Figures, notes and warnings of a map, from its manifest."""
    warnings = [*landmark_messages(manifest), *manifest["quality"]["warnings"]]
    known: dict[str, Any] = {name: manifest[name] for name in ("quality", "timings", "notes") if name in manifest}
    return {**known, "warnings": warnings}


def _prepare(task: Task) -> dict[str, Any]:
    """Prepare one surface as a match would do for that side, and keep it in the store."""
    file, side = Path(task.request["file"]), SIDES.index(task.request["side"])
    arguments = {"target": file, "source": file, "output": file, **task.request["options"]}
    request: MatchRequest = validate_request(MatchRequest, arguments)
    welded = weld_side(read_control(file, request, task.request["side"]), request, task.request["side"])
    control = ready_mesh(welded.mesh).mesh
    level = side_levels(request, (control, control))[side]
    require_levels(request, (control, control), (level, level))
    surface = load_or_prepare(task.request["cache"], control, level, side_bases(request, (level, level))[side])
    return {"vertices": surface.refinement.finest.n_vertices, "level": level}
