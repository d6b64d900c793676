"""Request of `cagemap wrap`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import (
    Argument,
    Force,
    Green,
    MaskEdgeOption,
    Option,
    SchemeOption,
    SourceMaskOption,
    SourceSchemeOption,
    SourceWeldOption,
    Space,
    TargetMaskOption,
    TargetSchemeOption,
    TargetWeldOption,
    WeldOption,
)


@dataclass(frozen=True)
class WrapRequest:
    """Give the target's cage the source's shape.

    The refined surface is fitted to the source. Vertices, faces, UVs, groups and materials stay those of the target.
    """

    results: Annotated[
        tuple[Path, ...],
        Argument(
            metavar="[RESULT]...",
            help="Folder that `cagemap match` wrote; with --target, meshes: the frames of a motion, in order.",
        ),
    ]
    output: Annotated[
        Path, Option(("-o", "--output"), help="Mesh to write: .obj, .ply, .off, .glb, USD; folder with --blend-shapes.")
    ]
    target: Annotated[
        Path | None, Option(("--target", "-t"), help="Instead of RESULT: cage to match first, then to wrap.")
    ] = None
    source: Annotated[Path | None, Option(("--source", "-s"), help="With --target: mesh to wrap it onto.")] = None
    landmarks: Annotated[Path | None, Option(help="JSON file of pairs of corresponding points.")] = None
    map: Annotated[
        Path | None,
        Option(help="Point map of any method, instead of a match."),
    ] = None
    scheme: SchemeOption = None
    target_scheme: TargetSchemeOption = None
    source_scheme: SourceSchemeOption = None
    weld: WeldOption = None
    target_weld: TargetWeldOption = None
    source_weld: SourceWeldOption = None
    fit_level: Annotated[int, Option(min=0, help="Level whose vertices are fitted; 0 moves the control points.")] = 0
    amount: Annotated[float, Option(help="From 0, the target, to 1, the source's shape.")] = 1.0
    fairness: Annotated[float, Option(help="Larger: smoother edge flow; smaller: closer to the source.")] = 1e-4
    weights: Annotated[
        Path | None, Option(help="Weight of each control vertex: 1 follows the source, 0 its surroundings.")
    ] = None
    target_mask: TargetMaskOption = None
    source_mask: SourceMaskOption = None
    mask_edge: MaskEdgeOption = None
    symmetric: Annotated[bool, Option(("--symmetric",), help="Keep a mirror symmetric cage symmetric.")] = False
    blend_shapes: Annotated[
        bool, Option(("--blend-shapes",), help="Write a folder: the cage at rest, then every RESULT or frame.")
    ] = False
    displacement: Annotated[
        Path | None, Option(help="Image to write: missing detail, as heights along the normal.")
    ] = None
    vector_displacement: Annotated[Path | None, Option(help="Image to write: missing detail, as vectors.")] = None
    normal_map: Annotated[Path | None, Option(help="Image to write: the source's normals on the wrapped cage.")] = None
    occlusion: Annotated[Path | None, Option(help="Image to write: the source's ambient occlusion.")] = None
    colors: Annotated[Path | None, Option(help="Image to write: the source's vertex colours.")] = None
    texture: Annotated[Path | None, Option(help="The source's texture, to bake into the target's layout.")] = None
    baked: Annotated[Path | None, Option(help="Image to write: the baked texture.")] = None
    detail: Annotated[Path | None, Option(help="More detailed mesh to bake from, instead of the source.")] = None
    detail_texture: Annotated[Path | None, Option(help="Image of the detailed mesh, baked into --baked.")] = None
    space: Space = "tangent"
    green: Green = "up"
    rays: Annotated[int, Option(min=1, help="Occlusion: rays per vertex.")] = 128
    size: Annotated[int | None, Option(min=1, help="Width and height of the images.  [default: 2048]")] = None
    mhclo: Annotated[
        Path | None,
        Option(help="Clothes file to write for MakeHuman and MPFB: .mhclo, .proxy."),
    ] = None
    force: Force = False
