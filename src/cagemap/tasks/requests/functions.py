"""Request of `cagemap functions`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import (
    BoundaryOption,
    CreasingOption,
    Force,
    MeshFile,
    Option,
    SchemeOption,
    WeldOption,
)


@dataclass(frozen=True)
class FunctionsRequest:
    """Write eigenfunctions and descriptors of one mesh.

    Row i belongs to vertex i of the mesh that `cagemap refine` writes at the same level. The surface has unit area:
    eigenvalues and times do not depend on the file's unit.
    """

    mesh: MeshFile
    output: Annotated[
        Path, Option(("-o", "--output"), help="Arrays, .npz, .npy or .csv; or the mesh in colours, .ply.")
    ]
    kinds: Annotated[
        str,
        Option(
            help="eigenfunctions, heat-signatures, wave-signatures, heat-kernels, wave-kernels; several with commas."
        ),
    ] = "eigenfunctions"
    level: Annotated[
        int | None,
        Option(("--level", "-l"), min=1, help="Finest level of the surface.  [default: about 50000 vertices]"),
    ] = None
    at: Annotated[
        int | None, Option(min=0, help="Level at whose vertices the functions are given.  [default: the finest]")
    ] = None
    k: Annotated[int, Option(("-k",), min=1, help="Basis functions.")] = 100
    schedule: Annotated[str | None, Option(help="Basis functions per level, such as 100,50,50,50; replaces -k.")] = None
    laplacian: Annotated[str, Option(help="mean, alexa-wardetzky[:LAMBDA] or de-goes-butts-desbrun[:LAMBDA].")] = "mean"
    accuracy: Annotated[float, Option(help="Convergence of the eigensolver.")] = 1e-5
    literal: Annotated[
        bool, Option(("--literal",), help="With --schedule: the paper's Definition 2 exactly as printed.")
    ] = False
    heat: Annotated[int, Option(min=1, help="Heat signatures or kernels: diffusion times.")] = 10
    wave: Annotated[int, Option(min=1, help="Wave signatures or kernels: energies.")] = 20
    points: Annotated[str | None, Option(help="Kernels: control vertices that they start from, such as 0,12,40.")] = (
        None
    )
    column: Annotated[
        int | None,
        Option(min=0, help="Function that a .ply shows as colours.  [default: the first that is not constant]"),
    ] = None
    scheme: SchemeOption = None
    weld: WeldOption = None
    boundary: BoundaryOption = None
    creasing: CreasingOption = None
    force: Force = False
