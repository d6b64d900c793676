"""`cagemap map`: its options, each said once; the work is in `cagemap.cli.own_map`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from cagemap.cli.command import Outcome, asks, in_stages
from cagemap.cli.options import Force, MaskEdgeOption, SourceMaskOption, TargetMaskOption
from cagemap.cli.progress import Stages


@dataclass(frozen=True)
class MapRequest:
    """What the user asked for, as said on the command line."""

    map: Annotated[Path, Argument(metavar="MAP", help="Point map: .npy, .npz, .mtx or .vts.")]
    target: Annotated[Path, Option("--target", "-t", help="Mesh that the map starts from; it receives.")]
    source: Annotated[Path, Option("--source", "-s", help="Mesh that the map goes to; it gives.")]
    output: Annotated[Path, Option("-o", "--output", help="RESULT folder to write.")]
    level: Annotated[int | None, Option(min=1, help="Level of both surfaces.  [default: about 50000 vertices]")] = None
    target_mask: TargetMaskOption = None
    source_mask: SourceMaskOption = None
    mask_edge: MaskEdgeOption = None
    force: Force = False


@asks(MapRequest)
@in_stages
def map_file(request: MapRequest, stages: Stages) -> Outcome:
    """Take a point map of any method as a RESULT.

    Bake with it, wrap, see it in a report. A list of source vertices, one for each vertex of the target at any level;
    or triangles of the source's level and barycentric coordinates; or a sparse matrix. `cagemap transfer RESULT
    --write-map` writes them.
    """
    from cagemap.cli.own_map import run_map

    return run_map(request, stages)
