"""What `cagemap transfer` is asked for, as said on the command line or in a job file; each option said once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from cagemap.cli.options import (
    Force,
    Green,
    MaskEdgeOption,
    OneOf,
    ResultFolder,
    SomeOf,
    SourceMaskOption,
    Space,
    TargetMaskOption,
)

# A summary, and warnings.
Outcome = tuple[str, list[str]]


@dataclass(frozen=True)
class TransferRequest:
    """What the user asked for; several images have names, and a base without one lies under all of them."""

    result: ResultFolder
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help="Image to write; with --attribute a .npy, .npz or .csv, with --source-uvs a mesh."
        ),
    ]
    texture: Annotated[
        Path | None,
        typer.Option(
            "--texture",
            help="Source texture: colour, roughness, any image. Several as NAME=IMAGE, once each; -o gets their names.",
            show_default=False,
        ),
    ] = None
    maps: tuple[tuple[str, Path], ...] = ()  # of --texture, where they have names
    usd: Annotated[
        Path | None,
        typer.Option(
            "--usd",
            help="Also write a USD layer over the target that has the textures or attributes.",
            show_default=False,
        ),
    ] = None
    displacement: Annotated[
        Path | None, typer.Option("--displacement", help="Source displacement along the normal.", show_default=False)
    ] = None
    normal_map: Annotated[
        Path | None, typer.Option("--normal-map", help="Source normal map, turned with the map.", show_default=False)
    ] = None
    vector_displacement: Annotated[
        Path | None, typer.Option("--vector-displacement", help="Source vector displacement.", show_default=False)
    ] = None
    space: Space = "tangent"
    green: Green = "up"
    as_color: Annotated[
        bool, typer.Option("--as-color", help="Texture: carry what looks like a normal map as a picture.")
    ] = False
    filter: Annotated[
        str,
        typer.Option(
            "--filter",
            help="How a source image is read where it does not shrink: smooth or linear; nearest, everywhere, for "
            "labels and ID maps, whose colours must not mix.",
        ),
        OneOf(("smooth", "linear", "nearest")),
    ] = "smooth"
    attribute: Annotated[
        Path | None,
        typer.Option(
            "--attribute",
            help="Values at the source's control vertices, faces or corners: .npy, .npz, .csv; groups in .json.",
            show_default=False,
        ),
    ] = None
    material_colors: Annotated[bool, typer.Option("--material-colors", help="Bake the source's material colours.")] = (
        False
    )
    bake: Annotated[
        tuple[str, ...],
        typer.Option(
            "--bake",
            help="From a detailed mesh: normal, displacement, vector-displacement, ao, colors, texture; several with "
            "commas.",
            show_default=False,
        ),
        SomeOf(("normal", "displacement", "vector-displacement", "ao", "colors", "texture")),
    ] = ()
    detail: Annotated[
        Path | None,
        typer.Option(
            "--detail",
            help="Bake: mesh that lies on the source.  [default: the source, for ao and colors]",
            show_default=False,
        ),
    ] = None
    detail_texture: Annotated[
        Path | None,
        typer.Option("--detail-texture", help="Bake texture: the detailed mesh's own image.", show_default=False),
    ] = None
    rays: Annotated[int, typer.Option("--rays", min=1, help="Bake ao: rays for every vertex of the mesh.")] = 128
    source_uvs: Annotated[
        bool,
        typer.Option("--source-uvs", help="Give the target the source's UVs; -o names the mesh, and seams are listed."),
    ] = False
    weights: Annotated[
        Path | None,
        typer.Option(
            "--weights", help="Skinning weights of the source's cage, a column a joint: .csv, .npz.", show_default=False
        ),
    ] = None
    influences: Annotated[
        int, typer.Option("--influences", min=0, help="Weights: at most so many joints a vertex; 0 for all.")
    ] = 4
    joints: Annotated[
        Path | None,
        typer.Option("--joints", help="Skeleton of the source, .json; with --weights its names.", show_default=False),
    ] = None
    blend_shapes: Annotated[
        tuple[Path, ...],
        typer.Option(
            "--blend-shapes",
            help="Shapes of the source's cage: .obj, .npz or a folder; repeat it for more.",
            show_default=False,
        ),
    ] = ()
    write_map: Annotated[
        bool, typer.Option("--write-map", help="The map itself, for other programs: .npy, .npz, .mtx or .vts.")
    ] = False
    level: Annotated[
        int | None,
        typer.Option(
            "--level",
            min=0,
            help="Take the map of this level of the target, of --method hfm or paper.  [default: the finest]",
            show_default=False,
        ),
    ] = None
    size: Annotated[
        int | None,
        typer.Option(
            "--size",
            min=1,
            max=65_536,
            help="Width and height in texels.  [default: the source image's, or 2048]",
            show_default=False,
        ),
    ] = None
    bits: Annotated[
        int | None,
        typer.Option(
            "--bits", help="8, 16 or 32 (float) a channel.  [default: as the source image]", show_default=False
        ),
        OneOf((8, 16, 32)),
    ] = None
    scale: Annotated[float, typer.Option("--scale", help="Displacement: source height between the values 0 and 1.")] = (
        1.0
    )
    midlevel: Annotated[
        float | None,
        typer.Option(
            "--midlevel",
            help="Displacement: value that means none.  [default: 0.5 for integers, 0 for floats]",
            show_default=False,
        ),
    ] = None
    bases: Annotated[
        tuple[tuple[str, Path], ...],
        typer.Option(
            "--base",
            help="The target's own image (or values), which stays outside the masks; for several maps as "
            "NAME=IMAGE.  [default: alpha]",
            show_default=False,
        ),
    ] = ()
    target_mask: TargetMaskOption = None
    source_mask: SourceMaskOption = None
    mask_edge: MaskEdgeOption = None
    unwrap: Annotated[
        bool,
        typer.Option(
            "--unwrap", help="Give a target without UVs a layout, and write a mesh that has it beside the image."
        ),
    ] = False
    force: Force = False


def base_of(request: TransferRequest, name: str = "") -> Path | None:
    """What lies outside the masks of a map, or of all of them."""
    given = dict(request.bases)
    return given.get(name, given.get(""))
