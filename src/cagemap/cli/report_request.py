"""What `cagemap report` is asked for, as said on the command line or in a job file; each option said once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from cagemap.cli.options import Force, ResultFolder


@dataclass(frozen=True)
class ReportRequest:
    """What the user asked for; without a texture the last one that was baked is shown, if its files are there."""

    result: ResultFolder
    output: Annotated[Path, typer.Option("-o", "--output", help="HTML file to write.")] = Path("report.html")
    texture: Annotated[
        Path | None,
        typer.Option(
            "--texture", help="Source texture to show.  [default: that of the last transfer]", show_default=False
        ),
    ] = None
    force: Force = False
    level: Annotated[
        int | None,
        typer.Option(
            "--level",
            min=0,
            help="Show the map of this level of the target, of --method hfm or paper.  [default: the finest]",
            show_default=False,
        ),
    ] = None
