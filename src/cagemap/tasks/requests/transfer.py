"""Request of `cagemap transfer`, annotated with its options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import (
    Force,
    Green,
    MaskEdgeOption,
    OneOf,
    Option,
    ResultFolder,
    SomeOf,
    SourceMaskOption,
    Space,
    TargetMaskOption,
)


@dataclass(frozen=True)
class TransferRequest:
    """What the user asked for; several images have names, and a base without one lies under all of them."""

    result: ResultFolder
    output: Annotated[
        Path,
        Option("-o", "--output", help="Image, values or mesh to write."),
    ]
    texture: Annotated[
        Path | None,
        Option(help="Source texture: any image; several as NAME=IMAGE, once each."),
    ] = None
    maps: tuple[tuple[str, Path], ...] = ()  # of --texture, where they have names
    usd: Annotated[Path | None, Option(help="Also write a USD layer over the target.")] = None
    displacement: Annotated[Path | None, Option(help="Source displacement along the normal.")] = None
    normal_map: Annotated[Path | None, Option(help="Source normal map, turned with the map.")] = None
    vector_displacement: Annotated[Path | None, Option(help="Source vector displacement.")] = None
    space: Space = "tangent"
    green: Green = "up"
    as_color: Annotated[
        bool, Option("--as-color", help="Texture: carry what looks like a normal map as a picture.")
    ] = False
    filter: Annotated[
        str,
        Option(help="Sampling of enlarged images: smooth, linear, or nearest for labels."),
        OneOf(("smooth", "linear", "nearest")),
    ] = "smooth"
    attribute: Annotated[
        Path | None,
        Option(help="Values at the source's control vertices, faces or corners."),
    ] = None
    material_colors: Annotated[bool, Option("--material-colors", help="Bake the source's material colours.")] = False
    bake: Annotated[
        tuple[str, ...],
        Option(
            help="From a detailed mesh, with commas: normal, displacement, vector-displacement, ao, colors, texture."
        ),
        SomeOf(("normal", "displacement", "vector-displacement", "ao", "colors", "texture")),
    ] = ()
    detail: Annotated[
        Path | None, Option(help="Bake: mesh that lies on the source.  [default: the source, for ao and colors]")
    ] = None
    detail_texture: Annotated[Path | None, Option(help="Bake texture: the detailed mesh's own image.")] = None
    rays: Annotated[int, Option(min=1, help="Bake ao: rays for every vertex of the mesh.")] = 128
    source_uvs: Annotated[bool, Option("--source-uvs", help="Give the target the source's UVs; -o names the mesh.")] = (
        False
    )
    weights: Annotated[
        Path | None, Option(help="Skinning weights of the source, a column a joint: .csv, .npz, glTF.")
    ] = None
    influences: Annotated[int, Option(min=0, help="Weights: at most so many joints a vertex; 0 for all.")] = 4
    only: Annotated[
        str | None, Option(help="Weights: of these joints, with commas; --base has the target's own of all others.")
    ] = None
    mirror: Annotated[bool, Option("--mirror", help="Weights: make both sides alike, by the joints' names.")] = False
    joints: Annotated[Path | None, Option(help="Skeleton of the source, .json, glTF; with --weights its names.")] = None
    blend_shapes: Annotated[
        tuple[Path, ...], Option(help="Shapes of the source's cage: .obj, .npz, folder; may be repeated.")
    ] = ()
    passenger: Annotated[Path | None, Option(help="Mesh on the source to carry: clothes, eyes, hair, a prop.")] = None
    kind: Annotated[
        str | None,
        Option("--as", help="Passenger: cloth, rigid or similarity.  [default: as its pieces look]"),
        OneOf(("cloth", "rigid", "similarity")),
    ] = None
    write_map: Annotated[
        bool,
        Option("--write-map", help="Write the map itself, for other programs."),
    ] = False
    level: Annotated[
        int | None,
        Option(min=0, help="Map of this level of the target (methods hfm, paper).  [default: the finest]"),
    ] = None
    size: Annotated[
        int | None,
        Option(min=1, max=65_536, help="Width and height in texels.  [default: the source image's, or 2048]"),
    ] = None
    bits: Annotated[
        int | None, Option(help="8, 16 or 32 (float) a channel.  [default: as the source image]"), OneOf((8, 16, 32))
    ] = None
    scale: Annotated[float, Option(help="Displacement: source height between the values 0 and 1.")] = 1.0
    midlevel: Annotated[
        float | None, Option(help="Displacement: value that means none.  [default: 0.5 for integers, 0 for floats]")
    ] = None
    bases: Annotated[
        tuple[tuple[str, Path], ...],
        Option(
            "--base",
            help="The target's own image or values outside the masks; [NAME=]IMAGE.  [default: alpha]",
        ),
    ] = ()
    target_mask: TargetMaskOption = None
    source_mask: SourceMaskOption = None
    mask_edge: MaskEdgeOption = None
    unwrap: Annotated[
        bool,
        Option("--unwrap", help="Make UVs where the target has none; writes that mesh too."),
    ] = False
    force: Force = False


def base_of(request: TransferRequest, name: str = "") -> Path | None:
    """What lies outside the masks of a map, or of all of them."""
    given = dict(request.bases)
    return given.get(name, given.get(""))
