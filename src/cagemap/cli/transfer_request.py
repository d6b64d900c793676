"""`cagemap transfer`: its options, each said once, for the command line, job files and the studio's page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from cagemap.cli.command import Outcome, asks, in_stages
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
from cagemap.cli.progress import Stages


@dataclass(frozen=True)
class TransferRequest:
    """What the user asked for; several images have names, and a base without one lies under all of them."""

    result: ResultFolder
    output: Annotated[
        Path,
        Option(
            "-o", "--output", help="Image to write; with --attribute a .npy, .npz or .csv, with --source-uvs a mesh."
        ),
    ]
    texture: Annotated[
        Path | None,
        Option(
            help="Source texture: colour, roughness, any image. Several as NAME=IMAGE, once each; -o gets their names."
        ),
    ] = None
    maps: tuple[tuple[str, Path], ...] = ()  # of --texture, where they have names
    usd: Annotated[
        Path | None, Option(help="Also write a USD layer over the target that has the textures or attributes.")
    ] = None
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
        Option(
            help="How a source image is read where it does not shrink: smooth or linear; nearest, everywhere, for "
            "labels and ID maps, whose colours must not mix."
        ),
        OneOf(("smooth", "linear", "nearest")),
    ] = "smooth"
    attribute: Annotated[
        Path | None,
        Option(help="Values at the source's control vertices, faces or corners: .npy, .npz, .csv; groups in .json."),
    ] = None
    material_colors: Annotated[bool, Option("--material-colors", help="Bake the source's material colours.")] = False
    bake: Annotated[
        tuple[str, ...],
        Option(
            help="From a detailed mesh: normal, displacement, vector-displacement, ao, colors, texture; several with "
            "commas."
        ),
        SomeOf(("normal", "displacement", "vector-displacement", "ao", "colors", "texture")),
    ] = ()
    detail: Annotated[
        Path | None, Option(help="Bake: mesh that lies on the source.  [default: the source, for ao and colors]")
    ] = None
    detail_texture: Annotated[Path | None, Option(help="Bake texture: the detailed mesh's own image.")] = None
    rays: Annotated[int, Option(min=1, help="Bake ao: rays for every vertex of the mesh.")] = 128
    source_uvs: Annotated[
        bool, Option("--source-uvs", help="Give the target the source's UVs; -o names the mesh, and seams are listed.")
    ] = False
    weights: Annotated[
        Path | None, Option(help="Skinning weights of the source's cage, a column a joint: .csv, .npz.")
    ] = None
    influences: Annotated[int, Option(min=0, help="Weights: at most so many joints a vertex; 0 for all.")] = 4
    joints: Annotated[Path | None, Option(help="Skeleton of the source, .json; with --weights its names.")] = None
    blend_shapes: Annotated[
        tuple[Path, ...], Option(help="Shapes of the source's cage: .obj, .npz or a folder; repeat it for more.")
    ] = ()
    write_map: Annotated[
        bool,
        Option("--write-map", help="The map itself, for other programs: .npy, .npz, .mtx, .vts, .mhclo or .proxy."),
    ] = False
    level: Annotated[
        int | None,
        Option(
            min=0, help="Take the map of this level of the target, of --method hfm or paper.  [default: the finest]"
        ),
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
            help="The target's own image (or values), which stays outside the masks; for several maps as "
            "NAME=IMAGE.  [default: alpha]",
        ),
    ] = ()
    target_mask: TargetMaskOption = None
    source_mask: SourceMaskOption = None
    mask_edge: MaskEdgeOption = None
    unwrap: Annotated[
        bool,
        Option("--unwrap", help="Give a target without UVs a layout, and write a mesh that has it beside the image."),
    ] = False
    force: Force = False


def base_of(request: TransferRequest, name: str = "") -> Path | None:
    """What lies outside the masks of a map, or of all of them."""
    given = dict(request.bases)
    return given.get(name, given.get(""))


def _read(texture: tuple[str, ...], bases: tuple[str, ...], bake: str | None, **others: Any) -> TransferRequest:
    """The request of a command line, where an image may have a name and kinds of bakes are listed with commas."""
    from cagemap.cli.texture_maps import texture_and_maps

    image, maps = texture_and_maps(texture)
    whole, named = texture_and_maps(bases, "--base")
    kinds = tuple(name.strip() for name in bake.split(",")) if bake else ()
    under = named if whole is None else (("", whole),)
    return TransferRequest(texture=image, maps=maps, bases=under, bake=kinds, **others)


@asks(TransferRequest, said={"texture": tuple[str, ...], "bases": tuple[str, ...], "bake": str | None}, read=_read)
@in_stages
def transfer(request: TransferRequest, stages: Stages) -> Outcome:
    """Carry textures, values, rigs or shapes to the target.

    Images are baked into the target's own UV layout, texel by texel, across the source's seams.
    """
    from cagemap.cli.transfer import run_transfer

    return run_transfer(request, stages)
