"""Tasks of the command line, job files and the studio: a request each, and `run`, which runs any of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cagemap.errors import ParameterError
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.options import document_fields, validate_request

if TYPE_CHECKING:
    from cagemap.tasks.requests.demo import DemoRequest as DemoRequest
    from cagemap.tasks.requests.face import FaceRequest as FaceRequest
    from cagemap.tasks.requests.functions import FunctionsRequest as FunctionsRequest
    from cagemap.tasks.requests.import_map import MapRequest as MapRequest
    from cagemap.tasks.requests.match import MatchRequest as MatchRequest
    from cagemap.tasks.requests.mesh_commands import CheckRequest as CheckRequest
    from cagemap.tasks.requests.mesh_commands import RefineRequest as RefineRequest
    from cagemap.tasks.requests.report import ReportRequest as ReportRequest
    from cagemap.tasks.requests.rig import RigRequest as RigRequest
    from cagemap.tasks.requests.run import RunRequest as RunRequest
    from cagemap.tasks.requests.suggest import SuggestRequest as SuggestRequest
    from cagemap.tasks.requests.transfer import TransferRequest as TransferRequest
    from cagemap.tasks.requests.wrap import WrapRequest as WrapRequest

# By request: its module in `cagemap.tasks.requests`, and the function of `cagemap.tasks` that runs it.
_TASKS = {
    "DemoRequest": ("demo", "demo.run_demo"),
    "CheckRequest": ("mesh_commands", "mesh_commands.run_check"),
    "RefineRequest": ("mesh_commands", "mesh_commands.run_refine"),
    "MatchRequest": ("match", "match.run_match"),
    "TransferRequest": ("transfer", "transfer.run_transfer"),
    "RigRequest": ("rig", "rig_character.run_rig"),
    "FaceRequest": ("face", "face.run_face"),
    "ReportRequest": ("report", "report.run_report"),
    "SuggestRequest": ("suggest", "suggest.run_suggest"),
    "RunRequest": ("run", "run_job.run_job"),
    "FunctionsRequest": ("functions", "functions.run_functions"),
    "WrapRequest": ("wrap", "wrap.run_wrap"),
    "MapRequest": ("import_map", "import_map.run_map"),
}

__all__ = ["Outcome", "Stages", "run", *_TASKS]


@dataclass(frozen=True)
class Outcome:
    """What a task did.

    Attributes
    ----------
    summary : str
        What the command prints.
    warnings : tuple of str
    succeeded : bool
        False if `check` found problems, or a task of a job failed: the command's exit code is 1.
    files : tuple of Path
        Files that were written; not those of the workers of a job.
    figures : dict
        Numbers of the summary, for JSON: quality of a match, distances of a wrap, sizes of an image, counts of weights,
        names of shapes, the list of `check --json`.
    """

    summary: str
    warnings: tuple[str, ...]
    succeeded: bool
    files: tuple[Path, ...]
    figures: dict[str, Any]


def run(request: Any, progress: Callable[[str], None] | None = None) -> Outcome:
    """Run the task of a request, as the command of that name does.

    For example ``run(MatchRequest("deer.obj", "pony.obj", "RESULT"), print)``. What the task refuses is a
    `cagemap.CagemapError`.

    Parameters
    ----------
    request : MatchRequest, TransferRequest, ...
        A dataclass of this module; its fields are the command's options. Paths may be strings.
    progress : callable, optional
        Called with the name of each stage that begins; `Stages` hears of notes too.

    Raises
    ------
    ParameterError
        If the request is none of this module, or a field has a value of another kind.
    """
    from cagemap.files.atomic import files_written  # here, since `cagemap --help` needs no files

    task = runner_of(request)
    checked = validate_request(type(request), {field.name: getattr(request, field.name) for field in fields(request)})
    stages = progress if isinstance(progress, Stages) else Stages(progress)
    with files_written() as files, stages:
        summary, outcome = task(checked, stages)
    judged = isinstance(outcome, bool)
    warnings, succeeded = ((), outcome) if judged else (tuple(outcome), True)
    return Outcome(summary, warnings, succeeded, tuple(dict.fromkeys(files)), stages.figures)


def runner_of(request: object) -> Callable[[Any, Stages], tuple[str, Any]]:
    """The function that runs a request: it returns a summary and warnings, or of check and run whether all is well."""
    name = type(request).__name__
    if name not in _TASKS:
        raise ParameterError(f"request: expected one of {', '.join(_TASKS)}, got {name}. Make one of these.")
    module, _, function = _TASKS[name][1].rpartition(".")
    runner: Callable[[Any, Stages], tuple[str, Any]] = getattr(import_module(f"cagemap.tasks.{module}"), function)
    return runner


def request_class(name: str) -> type:
    """The request of a name, such as `DemoRequest`."""
    kind: type = getattr(import_module(f"cagemap.tasks.requests.{_TASKS[name][0]}"), name)
    return kind


def __getattr__(name: str) -> object:
    if name not in _TASKS:
        raise AttributeError(f"module 'cagemap.tasks' has no attribute {name!r}")
    request = request_class(name)
    document_fields(request)
    return request


def __dir__() -> list[str]:
    return __all__
