"""`cagemap functions` as a command; the work is in `cagemap.cli.functions`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from cagemap.cli.command import asks
from cagemap.cli.options import BoundaryOption, CreasingOption, Force, MeshFile, SchemeOption
from cagemap.cli.words import say


@dataclass(frozen=True)
class FunctionsRequest:
    """What the user asked for, as said on the command line."""

    mesh: MeshFile
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Arrays, .npz, .npy or .csv; or the mesh in colours, .ply.")
    ]
    kinds: Annotated[
        str,
        typer.Option(
            "--kinds",
            help="eigenfunctions, heat-signatures, wave-signatures, heat-kernels, wave-kernels; several with commas.",
        ),
    ] = "eigenfunctions"
    level: Annotated[
        int | None,
        typer.Option(
            "--level",
            "-l",
            min=1,
            help="Finest level of the surface.  [default: about 50000 vertices]",
            show_default=False,
        ),
    ] = None
    at: Annotated[
        int | None,
        typer.Option(
            "--at",
            min=0,
            help="Level at whose vertices the functions are given.  [default: the finest]",
            show_default=False,
        ),
    ] = None
    k: Annotated[int, typer.Option("-k", min=1, help="Basis functions.")] = 150
    tolerance: Annotated[float, typer.Option("--tolerance", help="Relative error allowed in eigenvalues.")] = 0.05
    schedule: Annotated[
        str | None,
        typer.Option(
            "--schedule",
            help="Basis functions per level, such as 100,50,50,50; replaces -k and --tolerance.",
            show_default=False,
        ),
    ] = None
    laplacian: Annotated[
        str,
        typer.Option("--laplacian", help="mean, alexa-wardetzky or de-goes-butts-desbrun, these with :LAMBDA or not."),
    ] = "mean"
    accuracy: Annotated[
        float | None,
        typer.Option("--accuracy", help="Convergence of the eigensolver.  [default: as match]", show_default=False),
    ] = None
    literal: Annotated[
        bool, typer.Option("--literal", help="With --schedule: the paper's Definition 2 to the letter.")
    ] = False
    heat: Annotated[int, typer.Option("--heat", min=1, help="Heat signatures or kernels: diffusion times.")] = 10
    wave: Annotated[int, typer.Option("--wave", min=1, help="Wave signatures or kernels: energies.")] = 20
    points: Annotated[
        str | None,
        typer.Option(
            "--points", help="Kernels: control vertices that they start from, such as 0,12,40.", show_default=False
        ),
    ] = None
    column: Annotated[
        int | None,
        typer.Option(
            "--column",
            min=0,
            help="In colours: which one of the functions.  [default: the first that is not constant]",
            show_default=False,
        ),
    ] = None
    scheme: SchemeOption = None
    boundary: BoundaryOption = None
    creasing: CreasingOption = None
    force: Force = False


@asks(FunctionsRequest)
def functions(request: FunctionsRequest) -> None:
    """Write eigenfunctions and descriptors of one mesh at its vertices: for research, and to look at.

    Row i belongs to vertex i of the mesh that `cagemap refine` writes at the same level. The surface has unit area:
    eigenfunctions are those of the hierarchical basis, eigenvalues and times are free of the file's unit.
    """
    from cagemap.cli.functions import run_functions
    from cagemap.cli.progress import Stages

    with Stages() as stages:
        summary = run_functions(request, stages)
    say(summary)
