"""Execution of a plan on Dask; finished tasks are kept, failures skip dependent tasks."""

from __future__ import annotations

import atexit
import importlib.util
import json
import logging
import os
import shutil
import signal
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cagemap.errors import CagemapError, FormatError, ParameterError, error_code, explain_error
from cagemap.files.atomic import files_written, leftovers, write_whole
from cagemap.files.ownership import is_own, mark
from cagemap.files.result.manifest import file_hash
from cagemap.files.schema import read_own_note
from cagemap.jobs.plan import DETOUR_FOLDER, RESULT_FOLDER, STATE_FOLDER, Plan, Task, content_hash
from cagemap.numerics.threads import core_count

if TYPE_CHECKING:
    from distributed import Client

MAX_RETRIES = 2  # of a task whose worker was lost
LOST_WORKER_SECONDS = 15  # until a worker that Dask does not start again is replaced
_REMEDY = "Run the same command again: what is done is kept."

Runner = Callable[[Task], dict[str, Any]]
Report = Callable[["TaskOutcome", int, int], None]
OpenClient = Callable[[], "Client"]


@dataclass(frozen=True)
class TaskOutcome:
    """The end of a task."""

    name: str
    state: str  # "done" now, "kept" from an earlier run, "failed", or "skipped" since a task that it needs failed
    message: str = ""  # why it failed or was skipped
    seconds: float = 0.0
    figures: dict[str, Any] = field(default_factory=dict)  # figures of the result
    files: tuple[str, ...] = ()  # written files, relative to the job's output folder
    code: str = ""  # kind of cause of a failure, see `cagemap.CagemapError`

    @property
    def usable(self) -> bool:
        """Whether its outputs exist."""
        return self.state in ("done", "kept")

    @property
    def failure(self) -> dict[str, str]:
        """Code, place and remedy of a failure; empty texts if there is none."""
        error = CagemapError(self.message if self.code else "")
        return {"code": self.code, "place": error.place, "remedy": error.remedy}

    def __str__(self) -> str:
        cause = f" ({self.code})" if self.code else ""
        return f"{self.name}: {self.state}{cause}{': ' * bool(self.message)}{self.message}"


def run_plan(
    plan: Plan, runner: Runner, connect: OpenClient, report: Report = lambda outcome, finished, total: None
) -> dict[str, TaskOutcome]:
    """Run the missing tasks of a plan; outcomes by name, without preparations that no missing task needs.

    ``runner``: does a task and returns its figures, or raises an error whose notes are the logged warnings; importable
    by name, since workers import it.
    ``connect``: as `open_client` gives it; called only if tasks are missing.
    ``report``: called with each outcome, the number of finished tasks and the number of all.
    """
    outcomes = {task.name: kept for task in plan.tasks if (kept := kept_outcome(plan.root, task)) is not None}
    missing = _select_missing(plan, set(outcomes))
    if missing:
        outcomes |= _run_tasks(connect(), plan, missing, runner, outcomes, report)
    return outcomes


def missing_tasks(plan: Plan) -> list[Task]:
    """Tasks that a run would do: not done, without preparations that no missing task needs."""
    return _select_missing(plan, {task.name for task in plan.tasks if kept_outcome(plan.root, task) is not None})


def _select_missing(plan: Plan, kept: set[str]) -> list[Task]:
    missing = [task for task in plan.tasks if task.name not in kept]
    needed = needed_tasks(plan, {task.name for task in missing if task.kind != "prepare"})
    return [task for task in missing if task.name in needed]


def needed_tasks(plan: Plan, names: set[str]) -> set[str]:
    """Names of tasks and of all tasks that they need."""
    needed = set(names)
    for task in reversed(plan.tasks):
        if task.name in needed:
            needed |= set(task.needs)
    return needed


def kept_outcome(root: Path, task: Task, *, exact_sizes: bool = False) -> TaskOutcome | None:
    """The outcome that an earlier run stored for a task, None if the task or one of its files has changed.

    A layer to which other tasks added since counts as unchanged, unless ``exact_sizes`` are asked for.
    """
    note = read_own_note(_note_path(root, task))
    if note is None or note["key"] != task.key:
        return None
    sizes = {path: (root / path).stat().st_size if (root / path).is_file() else -1 for path in note["outputs"]}
    changed = [path for path, size in note["outputs"].items() if sizes[path] != size]
    if any(exact_sizes or path != task.layer or not is_own(root / path) for path in changed):
        return None
    return TaskOutcome(task.name, "kept", "", note["seconds"], note["figures"], tuple(note["outputs"]))


def execute(task: Task, root: Path, runner: Runner, *earlier_outcomes: TaskOutcome) -> TaskOutcome:
    """Run one task unless another run has done it; errors become a failed outcome."""
    failed = [outcome for outcome in earlier_outcomes if outcome.name in task.needs and not outcome.usable]
    if failed:
        return TaskOutcome(task.name, "skipped", _skip_message(failed[0]))
    from filelock import FileLock  # here: plans and dry runs do not need it

    start = time.perf_counter()
    try:
        state = root / STATE_FOLDER
        folders = ((root / path).parent for path in task.outputs)
        folders = (one.parent if one.name in (RESULT_FOLDER, DETOUR_FOLDER) else one for one in folders)
        for folder in (state / "done", state / "locks", *folders):
            folder.mkdir(parents=True, exist_ok=True)
        with FileLock(state / "locks" / f"{task.slug}.lock"):
            # Exact sizes: a layer that an earlier task of this run wrote anew lacks this task's results.
            kept = kept_outcome(root, task, exact_sizes=True)
            if kept is not None:
                return kept
            _remove_leftovers(root, task)
            earlier = read_own_note(_note_path(root, task))
            if earlier is not None:  # its files are replaced below: no key fits, their hashes stay
                write_whole(_note_path(root, task), json.dumps({**earlier, "written_by": mark(), "key": ""}, indent=1))
            with files_written() as written:
                figures = runner(_allow_replacing(root, task, earlier or {}))
            for path, expected_hash in task.input_hashes.items():
                if content_hash(path) != expected_hash:
                    raise FormatError(
                        f"{path}: has changed since this run began, so what came of it is not kept. {_REMEDY}"
                    )
            seconds = time.perf_counter() - start
            outputs = _output_sizes(root, task, written)
            note = {
                "written_by": mark(),
                "name": task.name,
                "key": task.key,
                "seconds": seconds,
                "outputs": outputs,
                "hashes": {path: file_hash(root / path) for path in outputs if not is_own(root / path)},
                "figures": figures,
            }
            write_whole(_note_path(root, task), json.dumps(note, indent=1))
            return TaskOutcome(task.name, "done", "", seconds, figures, tuple(outputs))
    except Exception as error:
        seconds = time.perf_counter() - start
        figures = {"logged": [*getattr(error, "__notes__", [])]}
        return TaskOutcome(task.name, "failed", explain_in_job(error), seconds, figures, code=error_code(error))


def explain_in_job(error: Exception) -> str:
    """`explain_error` without ``--force``, which jobs do not have."""
    return explain_error(error).replace("allow it (--force)", "move it away")


def _run_tasks(
    client: Client,
    plan: Plan,
    missing: list[Task],
    runner: Runner,
    kept_outcomes: dict[str, TaskOutcome],
    report: Report,
) -> dict[str, TaskOutcome]:
    from distributed import as_completed, wait

    run = uuid.uuid4().hex[:8]

    def submit(task: Task, ended: Mapping[str, Any], trial: int) -> Any:
        key = f"{task.kind}-{task.slug}-{run}-{trial}"
        earlier_outcomes = [ended.get(name, kept_outcomes.get(name)) for name in (*task.needs, *task.predecessors)]
        return client.submit(execute, task, plan.root, runner, *earlier_outcomes, key=key, pure=False)

    futures: dict[str, Any] = {}
    for task in missing:
        futures[task.name] = submit(task, futures, 1)
    names = {future.key: name for name, future in futures.items()}
    outcomes: dict[str, TaskOutcome] = {}
    lost = set()
    for future in as_completed(futures.values()):
        name = names[future.key]
        # A lost worker may have finished the task: the second try finds the stored result.
        outcome = _outcome_of(future)
        if outcome is None:
            lost.add(name)
            continue
        outcomes[name] = outcome
        report(outcomes[name], len(outcomes), len(missing))
    # Dask blames every task of a dead worker: rerun them one by one.
    for task in missing:
        if task.name in lost:
            future = submit(task, outcomes, 2)
            wait(future)
            outcomes[task.name] = _outcome_of(future) or _lost_outcome(task, outcomes)
            report(outcomes[task.name], len(outcomes), len(missing))
    return outcomes


def _outcome_of(future: Any) -> TaskOutcome | None:
    """The outcome of a future that has ended; None if its worker was lost, also with an outcome not yet fetched."""
    from distributed import KilledWorker

    with suppress(KilledWorker):
        outcome: TaskOutcome | None = future.result() if future.status == "finished" else None
        # "kept" are tasks that a lost worker or another run finished meanwhile.
        return outcome if outcome is None or outcome.state != "kept" else replace(outcome, state="done")
    return None


def _skip_message(outcome: TaskOutcome) -> str:
    return f"needs '{outcome.name}', which {'was ' * (outcome.state == 'skipped')}{outcome.state}"


def _lost_outcome(task: Task, outcomes: dict[str, TaskOutcome]) -> TaskOutcome:
    """Outcome of a task whose workers were lost, or that needs such a task."""
    for name in task.needs:
        if name in outcomes and not outcomes[name].usable:
            return TaskOutcome(task.name, "skipped", _skip_message(outcomes[name]))
    cause = f"its worker died {MAX_RETRIES + 1} times, killed or out of memory. Use fewer workers"
    return TaskOutcome(task.name, "failed", f"{cause}. {_REMEDY}", code="lost-worker")


@contextmanager
def open_client(
    scheduler: str | None = None, workers: int | None = None, tell: Callable[[str], None] = lambda words: None
) -> Iterator[OpenClient]:
    """Connect to Dask for the first task; disconnect at the end of the block.

    ``scheduler``: of workers that reach the same files; default: ``workers`` processes of one thread each, one a core.
    ``tell``: called with the address of Dask's dashboard, where bokeh is installed.
    """
    with ExitStack() as stack:
        clients: list[Client] = []

        def connect() -> Client:
            if not clients:
                clients.append(_remote(stack, scheduler) if scheduler else _local(stack, workers or core_count()))
                if importlib.util.find_spec("bokeh") is not None and clients[0].dashboard_link:
                    tell(f"Dask's dashboard: {clients[0].dashboard_link}")
            return clients[0]

        yield connect


def _remote(stack: ExitStack, scheduler: str) -> Client:
    _require_dask()
    from distributed import Client

    try:
        return stack.enter_context(Client(scheduler, timeout="10s"))
    except (OSError, TimeoutError, ValueError) as error:
        raise ParameterError(
            f"--scheduler: expected the address of a Dask scheduler, {scheduler} does not answer ({error}). "
            "Start one with `dask scheduler`, and workers with `dask worker ADDRESS --nthreads 1`."
        ) from error


def _local(stack: ExitStack, workers: int) -> Client:
    _require_dask()
    import dask
    from distributed import Client, LocalCluster
    from distributed.deploy.spec import close_clusters
    from distributed.system import MEMORY_LIMIT
    from distributed.utils import LoopRunner
    from tornado.ioloop import PeriodicCallback

    environment = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "CAGEMAP_THREADS")}
    settings = {
        "distributed.scheduler.allowed-failures": MAX_RETRIES,
        "distributed.deploy.lost-worker-timeout": LOST_WORKER_SECONDS,
        "distributed.nanny.pre-spawn-environ": environment,
    }
    stack.enter_context(dask.config.set(settings))
    runner = LoopRunner()
    runner.start()
    runner.loop.add_callback(_block_interrupts)
    try:
        cluster = LocalCluster(
            loop=runner.loop,
            silence_logs=logging.CRITICAL,  # lost workers are reported as outcomes
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=MEMORY_LIMIT // workers,
            # Any free port, so that a second cluster on this machine causes no warning.
            dashboard_address="127.0.0.1:0",
        )
    except KeyboardInterrupt:
        atexit.unregister(close_clusters)  # Dask cannot close workers that have not started; they end with us
        raise
    stack.callback(runner.stop)
    cluster = stack.enter_context(cluster)
    client = stack.enter_context(Client(cluster))
    # Dask does not start a worker again that died while it was being started.
    replace_lost = PeriodicCallback(lambda: cluster.scale(workers), 1000 * LOST_WORKER_SECONDS)
    cluster.periodic_callbacks["replace lost workers"] = replace_lost  # Dask stops it with the cluster
    client.loop.add_callback(replace_lost.start)
    return client


def _block_interrupts() -> None:
    """Block Ctrl-C in this thread and in workers that it starts: a terminal sends it to all processes."""
    from multiprocessing.resource_tracker import ensure_running

    if hasattr(signal, "pthread_sigmask"):  # not on Windows
        ensure_running()  # before, since its start unblocks Ctrl-C
        signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))


def _require_dask() -> None:
    if importlib.util.find_spec("distributed") is None:
        raise ParameterError('expected Dask to run jobs on, found none. Install it: pip install "cagemap[dask]".')


def _note_path(root: Path, task: Task) -> Path:
    return root / STATE_FOLDER / "done" / f"{task.slug}.json"


def _output_sizes(root: Path, task: Task, written: list[Path]) -> dict[str, int]:
    """Written files of a task and their sizes, without RESULT folders and the job's state."""
    expected = [path for path in task.outputs if (root / path).is_file()]
    relative = [Path(os.path.relpath(path, root)) for path in written]
    internal = {RESULT_FOLDER, DETOUR_FOLDER, STATE_FOLDER}
    additional = [path.as_posix() for path in relative if not internal & set(path.parts)]
    sizes = {path: (root / path).stat().st_size for path in dict.fromkeys([*expected, *additional])}
    if task.outputs and not sizes:
        raise FormatError(f"{task.outputs[0]}: expected a file, none was written. {_REMEDY}")
    return sizes


def _allow_replacing(root: Path, task: Task, note: dict[str, Any]) -> Task:
    """The task with permission to replace its tables, which have no mark, if no file changed since the noted run."""
    hashes = note.get("hashes", {})
    known = {root / path: value for path, value in hashes.items() if (root / path).is_file()}
    others = {root / path for path in (*task.outputs, *note.get("outputs", ()))} - known.keys()
    if not known or any(file.is_file() and not is_own(file) for file in others):
        return task
    unchanged = all(file_hash(file) == value for file, value in known.items())
    return replace(task, request={**task.request, "force": True}) if unchanged else task


def _remove_leftovers(root: Path, task: Task) -> None:
    """Remove temporary files of a killed run of this task; the task's lock is held.

    `cagemap.files.atomic` removes them only after some seconds, and never on systems or disks without file locks.
    """
    for output in task.outputs:
        for folder in (root / output, (root / output).parent):
            for leftover in leftovers(folder):
                if leftover.is_dir():
                    shutil.rmtree(leftover)
                else:
                    leftover.unlink(missing_ok=True)
