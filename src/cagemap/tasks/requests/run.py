"""Request of `cagemap run`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cagemap.tasks.requests.options import Argument, Option


@dataclass(frozen=True)
class RunRequest:
    """Match and transfer all pairs of a job file.

    Writes a folder with a RESULT for every pair, the outputs of the job, index.html and figures.csv. Finished tasks are
    kept: after a failure or a change, run it again and only missing tasks are done. Exit code 1 if anything failed.
    """

    job: Annotated[Path, Argument("Job file, .toml.", metavar="JOB")]
    scheduler: Annotated[
        str | None,
        Option("Address of a running Dask scheduler, such as tcp://host:8786.  [default: processes on this machine]"),
    ] = None
    workers: Annotated[int | None, Option("Processes on this machine.  [default: one for each core]", min=1)] = None
    dry_run: Annotated[bool, Option("Only list tasks; estimate time and disk space.")] = False
    task: Annotated[
        str | None, Option("Only tasks of these numbers, without Dask; --dry-run lists them.", metavar="N|A-B")
    ] = None
    export: Annotated[
        Literal["openjd", "slurm"] | None, Option("Print a template or script that runs each task by its number.")
    ] = None

    @property
    def for_scripts(self) -> bool:
        """Whether the text is what was asked for, and no report of what was done."""
        return self.dry_run or self.export is not None
