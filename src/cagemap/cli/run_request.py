"""`cagemap run`: its options, each said once; the work is in `cagemap.cli.library`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from cagemap.cli.command import asks
from cagemap.cli.progress import Stages
from cagemap.cli.words import say


@dataclass(frozen=True)
class RunRequest:
    """What the user asked for, as said on the command line."""

    job: Annotated[Path, Argument(help="Job file, .toml.")]
    scheduler: Annotated[
        str | None,
        Option(help="Address of a running Dask scheduler, such as tcp://host:8786.  [default: processes here]"),
    ] = None
    workers: Annotated[int | None, Option(min=1, help="Processes here.  [default: one for each core]")] = None
    dry_run: Annotated[bool, Option("--dry-run", help="Only say what would be done, and about how long it takes.")] = (
        False
    )


@asks(RunRequest)
def run(request: RunRequest) -> None:
    """Match and transfer many pairs, as a job file says.

    Each surface is prepared once, what is done is kept. Writes a folder with a RESULT for every pair, what the job asks
    for beside it, index.html and figures.csv. Run it again after a failure or a change: only what is missing is done.
    Exit code 1 if anything failed.
    """
    from cagemap.cli.library import run_job

    with Stages() as stages:
        text, complete = run_job(request, stages)
    say(text, always=not complete)
    if not complete:
        raise Exit(1)
