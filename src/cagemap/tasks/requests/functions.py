"""Request of `cagemap functions`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import (
    FUNCTIONS,
    INPUT,
    OUTPUT,
    RESEARCH,
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
    output: Annotated[Path, Option("Arrays, .npz, .npy or .csv; or the mesh in colours, .ply.", OUTPUT, ("-o",))]
    kinds: Annotated[
        str,
        Option(
            "eigenfunctions, heat-signatures, wave-signatures, heat-kernels, wave-kernels; several with commas.",
            FUNCTIONS,
        ),
    ] = "eigenfunctions"
    level: Annotated[
        int | None, Option("Finest level of the surface.  [default: about 50000 vertices]", INPUT, ("-l",), min=0)
    ] = None
    at: Annotated[
        int | None, Option("Level at whose vertices the functions are given.  [default: the finest]", FUNCTIONS, min=0)
    ] = None
    k: Annotated[int, Option("Basis functions.", RESEARCH, min=1)] = 100
    schedule: Annotated[
        str | None, Option("Basis functions per level, such as 100,50,50,50; replaces -k.", RESEARCH)
    ] = None
    laplacian: Annotated[str, Option("mean, alexa-wardetzky[:LAMBDA] or de-goes-butts-desbrun[:LAMBDA].", RESEARCH)] = (
        "mean"
    )
    accuracy: Annotated[float, Option("Convergence of the eigensolver.", RESEARCH)] = 1e-5
    literal: Annotated[bool, Option("With --schedule: the paper's Definition 2 exactly as printed.", RESEARCH)] = False
    heat: Annotated[int, Option("Heat signatures or kernels: diffusion times.", FUNCTIONS, min=1)] = 10
    wave: Annotated[int, Option("Wave signatures or kernels: energies.", FUNCTIONS, min=1)] = 20
    points: Annotated[
        str | None, Option("Kernels: control vertices that they start from, such as 0,12,40.", FUNCTIONS)
    ] = None
    column: Annotated[
        int | None,
        Option("Function that a .ply shows as colours.  [default: the first that is not constant]", OUTPUT, min=0),
    ] = None
    scheme: SchemeOption = None
    weld: WeldOption = None
    boundary: BoundaryOption = None
    creasing: CreasingOption = None
    force: Force = False
