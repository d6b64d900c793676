"""`cagemap studio`: its options, each said once; the work is in `cagemap.cli.studio`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option

from cagemap.cli.command import asks
from cagemap.cli.options import SchemeOption, SourcePartOption, SourceSchemeOption, TargetPartOption, TargetSchemeOption
from cagemap.cli.words import say


@dataclass(frozen=True)
class StudioRequest:
    """What the user asked for, as said on the command line."""

    target: Annotated[Path | None, Option("--target", "-t", help="Control mesh that receives.")] = None
    source: Annotated[Path | None, Option("--source", "-s", help="Control mesh that gives.")] = None
    landmarks: Annotated[Path | None, Option(help="Landmark file to open and save.")] = None
    texture: Annotated[Path | None, Option(help="Image over the source's UVs.")] = None
    result: Annotated[Path | None, Option(help="RESULT folder of the finish; alone, the one to open.")] = None
    folder: Annotated[
        tuple[Path, ...], Option(help="Folder whose files the page may open and write; repeat it for more.")
    ] = ()
    host: Annotated[str, Option(help="Address to serve; others than loopback need the token.")] = "127.0.0.1"
    port: Annotated[int, Option(min=0, max=65535, help="The next free one is taken.")] = 8765
    vertices: Annotated[int, Option(min=1, help="About this many a model, in the page.")] = 25_000
    no_browser: Annotated[bool, Option("--no-browser", help="Do not open the page.")] = False
    scheme: SchemeOption = None
    target_scheme: TargetSchemeOption = None
    source_scheme: SourceSchemeOption = None
    part: Annotated[
        str | None,
        Option(
            help="Open this object, group, material or component of both files; `cagemap check` lists them.  "
            "[default: all of a file in one piece, else its largest]"
        ),
    ] = None
    target_part: TargetPartOption = None
    source_part: SourcePartOption = None


@asks(StudioRequest)
def studio(request: StudioRequest) -> None:
    """See the map in the browser, click where it is wrong, bake.

    Without models the built-in pair opens. The page reads and writes only in the folders of the files given here.
    """
    from cagemap.cli.studio import run_studio

    run_studio(request, say)
