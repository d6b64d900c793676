"""Request of `cagemap wrap`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import (
    FIT,
    IMAGES,
    INPUT,
    LANDMARKS,
    OUTPUT,
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
        Argument("Folders of `cagemap match`; with --target, meshes: frames of a motion.", metavar="[RESULT]"),
    ]
    output: Annotated[
        Path, Option("Mesh to write: .obj, .ply, .off, .glb, USD; folder with --blend-shapes.", OUTPUT, ("-o",))
    ]
    target: Annotated[Path | None, Option("Instead of RESULT: cage to match first, then to wrap.", INPUT, ("-t",))] = (
        None
    )
    source: Annotated[Path | None, Option("With --target: mesh to wrap it onto.", INPUT, ("-s",))] = None
    landmarks: Annotated[Path | None, Option("JSON file of pairs of corresponding points.", LANDMARKS)] = None
    map: Annotated[Path | None, Option("Point map of any method, instead of a match.", INPUT)] = None
    scheme: SchemeOption = None
    target_scheme: TargetSchemeOption = None
    source_scheme: SourceSchemeOption = None
    weld: WeldOption = None
    target_weld: TargetWeldOption = None
    source_weld: SourceWeldOption = None
    fit_level: Annotated[int, Option("Level whose vertices are fitted; 0 moves the control points.", FIT, min=0)] = 0
    amount: Annotated[float, Option("From 0, the target, to 1, the source's shape.", FIT)] = 1.0
    fairness: Annotated[float, Option("Larger: smoother edge flow; smaller: closer to the source.", FIT)] = 1e-4
    weights: Annotated[
        Path | None, Option("Weight of each control vertex: 1 follows the source, 0 its surroundings.", FIT)
    ] = None
    target_mask: TargetMaskOption = None
    source_mask: SourceMaskOption = None
    mask_edge: MaskEdgeOption = None
    symmetric: Annotated[bool, Option("Keep a mirror symmetric cage symmetric.", FIT)] = False
    blend_shapes: Annotated[bool, Option("Write a folder: the cage at rest, then every RESULT or frame.", OUTPUT)] = (
        False
    )
    displacement: Annotated[
        Path | None, Option("Image to write: missing detail, as heights along the normal.", IMAGES)
    ] = None
    vector_displacement: Annotated[Path | None, Option("Image to write: missing detail, as vectors.", IMAGES)] = None
    normal_map: Annotated[Path | None, Option("Image to write: the source's normals on the wrapped cage.", IMAGES)] = (
        None
    )
    occlusion: Annotated[Path | None, Option("Image to write: the source's ambient occlusion.", IMAGES)] = None
    colors: Annotated[Path | None, Option("Image to write: the source's vertex colours.", IMAGES)] = None
    texture: Annotated[Path | None, Option("Source image, or model file with one, to bake into --baked.", IMAGES)] = (
        None
    )
    baked: Annotated[Path | None, Option("Image to write: the baked texture.", IMAGES)] = None
    detail: Annotated[Path | None, Option("More detailed mesh to bake from, instead of the source.", IMAGES)] = None
    detail_texture: Annotated[Path | None, Option("Image of the detailed mesh, baked into --baked.", IMAGES)] = None
    space: Space = "tangent"
    green: Green = "up"
    rays: Annotated[int, Option("Occlusion: rays per vertex.", IMAGES, min=1)] = 128
    size: Annotated[
        int | None,
        Option("Width and height.  [default: 2048; of --baked the image's]", IMAGES, min=1, max=32767),
    ] = None
    mhclo: Annotated[Path | None, Option("Clothes file to write for MakeHuman and MPFB: .mhclo, .proxy.", OUTPUT)] = (
        None
    )
    force: Force = False
