"""The words of `cagemap map`; the work is in `cagemap.cli.own_map`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def map_file(
    file: Annotated[
        Path, typer.Argument(metavar="MAP", help="Point map: .npy, .npz, .mtx or .vts.", show_default=False)
    ],
    target: Annotated[Path, typer.Option("--target", "-t", help="Mesh that the map starts from; it receives.")],
    source: Annotated[Path, typer.Option("--source", "-s", help="Mesh that the map goes to; it gives.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="RESULT folder to write.")],
    level: Annotated[
        int | None,
        typer.Option("--level", min=1, help="Level of both surfaces.  [default: about 50000 vertices]"),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Overwrite files that cagemap did not write, or that were changed since.")
    ] = False,
) -> None:
    """Take a point map of any method, as if `cagemap match` had found it: bake with it, wrap, see it in a report.

    A list of source vertices, one for each vertex of the target at any level; or triangles of the source's level and
    barycentric coordinates; or a sparse matrix. `cagemap transfer RESULT --write-map` writes them.
    """
    from cagemap.cli.own_map import MapRequest, run_map
    from cagemap.cli.progress import Stages

    with Stages() as stages:
        summary, warnings = run_map(MapRequest(file, target, source, output, level, force), stages)
    for message in warnings:
        typer.echo(f"cagemap: warning: {message}", err=True)
    typer.echo(summary)
