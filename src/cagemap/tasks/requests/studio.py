"""Request of `cagemap studio`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import (
    INPUT,
    LANDMARKS,
    PAGE,
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

    target: Annotated[Path | None, Option("Control mesh that receives.", INPUT, ("-t",))] = None
    source: Annotated[Path | None, Option("Control mesh that gives.", INPUT, ("-s",))] = None
    landmarks: Annotated[Path | None, Option("Landmark file to open and save.", LANDMARKS)] = None
    texture: Annotated[Path | None, Option("Image over the source's UVs.", INPUT)] = None
    result: Annotated[
        Path | None,
        Option("RESULT folder to write; without models, the one to open.", INPUT, metavar="FOLDER"),
    ] = None
    folder: Annotated[
        tuple[Path, ...],
        Option("Folder that the page may open and write; may be repeated.", PAGE, metavar="FOLDER"),
    ] = ()
    host: Annotated[str, Option("Address to serve; other machines need the printed token.", PAGE)] = "127.0.0.1"
    port: Annotated[int, Option("Port; if it is in use, the next free one.", PAGE, min=0, max=65535)] = 8765
    vertices: Annotated[int, Option("About this many displayed vertices per model.", PAGE, min=1)] = 25_000
    no_browser: Annotated[bool, Option("Do not open the page.", PAGE)] = False
    scheme: SchemeOption = None
    target_scheme: TargetSchemeOption = None
    source_scheme: SourceSchemeOption = None
    part: Annotated[
        str | None,
        Option(
            "Open this object, group, material or component of both files.  [default: all, or the largest piece]", INPUT
        ),
    ] = None
    target_part: TargetPartOption = None
    source_part: SourcePartOption = None
