"""Request of `cagemap map`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import (
    INPUT,
    OUTPUT,
    Argument,
    Force,
    MaskEdgeOption,
    Option,
    SourceMaskOption,
    SourceWeldOption,
    TargetMaskOption,
    TargetWeldOption,
    WeldOption,
)


@dataclass(frozen=True)
class MapRequest:
    """Import a point map of any method as a RESULT.

    The RESULT can be used for baking, wrapping and reports. A map is a list of source vertices, one for each vertex of
    the target at any level; or triangles of the source's level and barycentric coordinates; or a sparse matrix.
    `cagemap transfer RESULT --write-map` writes them. With --weld the numbers are those of what `cagemap refine --weld`
    writes.
    """

    map: Annotated[Path, Argument("Point map: .npy, .npz, .mtx or .vts.", metavar="MAP")]
    target: Annotated[Path, Option("Mesh that receives; the map starts from it.", INPUT, ("-t",))]
    source: Annotated[Path, Option("Mesh that gives; the map goes to it.", INPUT, ("-s",))]
    output: Annotated[Path, Option("RESULT folder to write.", OUTPUT, ("-o",), metavar="FOLDER")]
    level: Annotated[int | None, Option("Level of both surfaces.  [default: about 50000 vertices]", INPUT, min=1)] = (
        None
    )
    weld: WeldOption = None
    target_weld: TargetWeldOption = None
    source_weld: SourceWeldOption = None
    target_mask: TargetMaskOption = None
    source_mask: SourceMaskOption = None
    mask_edge: MaskEdgeOption = None
    force: Force = False
