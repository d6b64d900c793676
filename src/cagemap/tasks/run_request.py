"""Run a request by its type."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cagemap.tasks.match import run_match
from cagemap.tasks.progress import Outcome, Stages
from cagemap.tasks.report import run_report
from cagemap.tasks.requests.catalogue import COMMANDS, Request
from cagemap.tasks.transfer import run_transfer
from cagemap.tasks.wrap import run_wrap

_RUNS: dict[str, Callable[[Any, Stages], Outcome]] = {
    "match": run_match,
    "transfer": run_transfer,
    "wrap": run_wrap,
    "report": run_report,
}


def run_request(request: Request, stages: Stages) -> Outcome:
    """Do a request of `COMMANDS`; returns a summary and warnings."""
    command = next(name for name, kind in COMMANDS.items() if isinstance(request, kind))
    return _RUNS[command](request, stages)
