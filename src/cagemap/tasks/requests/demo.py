"""Request of `cagemap demo`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import OUTPUT, Force, Option


@dataclass(frozen=True)
class DemoRequest:
    """Run the built-in pair end to end and write DIR/report.html.

    Two small creatures made for this purpose: the striped pony gives its texture to the deer. The folder also gets
    the meshes, landmarks and texture, so that you can repeat every step by hand.
    """

    output: Annotated[
        Path,
        Option("Folder to write everything to.", OUTPUT, ("-o",), metavar="FOLDER"),
    ] = Path("cagemap-demo")
    force: Force = False
