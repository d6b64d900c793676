"""`cagemap report`: its options, each said once, for the command line, job files and the studio's page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option

from cagemap.cli.command import Outcome, asks, in_stages
from cagemap.cli.options import Force, ResultFolder
from cagemap.cli.progress import Stages


@dataclass(frozen=True)
class ReportRequest:
    """What the user asked for; without a texture the last one that was baked is shown, if its files are there."""

    result: ResultFolder
    output: Annotated[Path, Option("-o", "--output", help="HTML file to write.")] = Path("report.html")
    texture: Annotated[Path | None, Option(help="Source texture to show.  [default: that of the last transfer]")] = None
    force: Force = False
    level: Annotated[
        int | None,
        Option(
            min=0, help="Show the map of this level of the target, of --method hfm or paper.  [default: the finest]"
        ),
    ] = None


@asks(ReportRequest)
@in_stages
def report(request: ReportRequest, stages: Stages) -> Outcome:
    """Write one HTML page: pictures, and quality in plain words.

    Both surfaces in the same views, the map as colours, what was made with it. The page needs nothing beside it: mail
    it, print it.
    """
    from cagemap.cli.report import run_report

    run_report(request, stages)
    return f"Open {request.output} in a browser.", []
