"""What `cagemap wrap` is asked for, as said on the command line or in a job file; each option said once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from cagemap.cli.options import (
    Force,
    Green,
    MaskEdgeOption,
    SchemeOption,
    SourceMaskOption,
    SourceSchemeOption,
    Space,
    TargetMaskOption,
    TargetSchemeOption,
)


@dataclass(frozen=True)
class WrapRequest:
    """What the user asked for."""

    results: Annotated[
        tuple[Path, ...],
        typer.Argument(metavar="[RESULT]...", help="Folder that `cagemap match` wrote.", show_default=False),
    ]
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="Mesh to write: .obj, .ply, .off, .usd; a folder with --blend-shapes."),
    ]
    target: Annotated[
        Path | None,
        typer.Option("--target", "-t", help="Instead of RESULT, match first: the cage to wrap.", show_default=False),
    ] = None
    source: Annotated[
        Path | None, typer.Option("--source", "-s", help="The shape to wrap it onto.", show_default=False)
    ] = None
    landmarks: Annotated[
        Path | None, typer.Option("--landmarks", help="JSON file of corresponding vertices.", show_default=False)
    ] = None
    map: Annotated[
        Path | None,
        typer.Option(
            "--map",
            help="With --target and --source, a point map of any method instead of a match: .npy, .npz, .mtx or .vts.",
            show_default=False,
        ),
    ] = None
    scheme: SchemeOption = None
    target_scheme: TargetSchemeOption = None
    source_scheme: SourceSchemeOption = None
    fit_level: Annotated[
        int, typer.Option("--fit-level", min=0, help="0 moves the control points, l the refined net of level l.")
    ] = 0
    amount: Annotated[float, typer.Option("--amount", help="From 0, the target, to 1, the source's shape.")] = 1.0
    fairness: Annotated[
        float, typer.Option("--fairness", help="Larger keeps the net smoother, smaller lies closer.")
    ] = 1e-4
    weights: Annotated[
        Path | None,
        typer.Option(
            "--weights",
            help="How far each control vertex may follow, 0 to 1: .npy, .npz or .csv.",
            show_default=False,
        ),
    ] = None
    target_mask: TargetMaskOption = None
    source_mask: SourceMaskOption = None
    mask_edge: MaskEdgeOption = None
    symmetric: Annotated[bool, typer.Option("--symmetric", help="Keep a mirror symmetric cage symmetric.")] = False
    blend_shapes: Annotated[
        bool, typer.Option("--blend-shapes", help="Write a folder: the cage at rest, and one mesh for every RESULT.")
    ] = False
    displacement: Annotated[
        Path | None,
        typer.Option(
            "--displacement", help="Image to write: what is still missing, along the normal.", show_default=False
        ),
    ] = None
    vector_displacement: Annotated[
        Path | None,
        typer.Option(
            "--vector-displacement",
            help="Image to write: what is still missing, as vectors.",
            show_default=False,
        ),
    ] = None
    normal_map: Annotated[
        Path | None,
        typer.Option(
            "--normal-map", help="Image to write: the source's normals on the wrapped cage.", show_default=False
        ),
    ] = None
    occlusion: Annotated[
        Path | None,
        typer.Option("--occlusion", help="Image to write: the source's ambient occlusion.", show_default=False),
    ] = None
    colors: Annotated[
        Path | None, typer.Option("--colors", help="Image to write: the source's vertex colours.", show_default=False)
    ] = None
    texture: Annotated[
        Path | None,
        typer.Option("--texture", help="The source's image, to carry into the target's layout.", show_default=False),
    ] = None
    baked: Annotated[
        Path | None, typer.Option("--baked", help="Image to write: the texture carried.", show_default=False)
    ] = None
    detail: Annotated[
        Path | None,
        typer.Option("--detail", help="Bake a more detailed mesh in the source's place instead.", show_default=False),
    ] = None
    detail_texture: Annotated[
        Path | None,
        typer.Option("--detail-texture", help="The detailed mesh's own image, to bake as --baked.", show_default=False),
    ] = None
    space: Space = "tangent"
    green: Green = "up"
    rays: Annotated[int, typer.Option("--rays", min=1, help="Occlusion: rays for every vertex of the mesh.")] = 128
    size: Annotated[
        int | None,
        typer.Option("--size", min=1, help="Width and height of the images.  [default: 2048]", show_default=False),
    ] = None
    mhclo: Annotated[
        Path | None,
        typer.Option(
            "--mhclo",
            help="File to write (.mhclo, .proxy) that makes the mesh follow the source in MakeHuman and MPFB.",
            show_default=False,
        ),
    ] = None
    force: Force = False
