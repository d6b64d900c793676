"""Request of `cagemap studio`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import (
    Option,
    SchemeOption,
    SourcePartOption,
    SourceSchemeOption,
    TargetPartOption,
    TargetSchemeOption,
)


@dataclass(frozen=True)
class StudioRequest:
    """View and correct the map in the browser, and bake textures.

    Without models the built-in pair opens. The page reads and writes only in the folders of the files given here.
    """

    target: Annotated[Path | None, Option(("--target", "-t"), help="Control mesh that receives.")] = None
    source: Annotated[Path | None, Option(("--source", "-s"), help="Control mesh that gives.")] = None
    landmarks: Annotated[Path | None, Option(help="Landmark file to open and save.")] = None
    texture: Annotated[Path | None, Option(help="Image over the source's UVs.")] = None
    result: Annotated[Path | None, Option(help="RESULT folder to write; without models, the one to open.")] = None
    folder: Annotated[tuple[Path, ...], Option(help="Folder that the page may open and write; may be repeated.")] = ()
    host: Annotated[str, Option(help="Address to serve; other machines need the printed token.")] = "127.0.0.1"
    port: Annotated[int, Option(min=0, max=65535, help="Port; if it is in use, the next free one.")] = 8765
    vertices: Annotated[int, Option(min=1, help="About this many displayed vertices per model.")] = 25_000
    no_browser: Annotated[bool, Option(("--no-browser",), help="Do not open the page.")] = False
    scheme: SchemeOption = None
    target_scheme: TargetSchemeOption = None
    source_scheme: SourceSchemeOption = None
    part: Annotated[
        str | None,
        Option(
            help="Open this object, group, material or component of both files.  "
            "[default: all of a file in one piece, else its largest]"
        ),
    ] = None
    target_part: TargetPartOption = None
    source_part: SourcePartOption = None
