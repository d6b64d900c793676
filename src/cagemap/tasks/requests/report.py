"""Request of `cagemap report`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cagemap.tasks.requests.options import INPUT, OUTPUT, Force, Option, ResultFolder


@dataclass(frozen=True)
class ReportRequest:
    """Write one HTML page: a verdict, and both models in 3D.

    Shows both models coloured by the map, marks of doubtful places, and what was transferred. The page is one file and
    needs no network.
    """

    result: ResultFolder
    output: Annotated[Path, Option("HTML file to write.", OUTPUT, ("-o",))] = Path("report.html")
    texture: Annotated[Path | None, Option("Source texture to show.  [default: that of the last transfer]", INPUT)] = (
        None
    )
    force: Force = False
    level: Annotated[
        int | None, Option("Map of this level of the target (methods hfm, paper).  [default: the finest]", INPUT, min=0)
    ] = None
    up: Annotated[
        Literal["y", "z"] | None,
        Option(
            "Axis of the target that is up in the pictures.  [default: the USD file's, or guessed from the shape]",
            OUTPUT,
        ),
    ] = None
