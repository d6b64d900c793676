"""Request of `cagemap transfer`: its fields are the command's options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.errors import ParameterError
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
    """Carry textures, values, rigs or shapes to the target.

    Images are baked into the target's own UV layout, texel by texel, across the source's seams.
    """

    result: ResultFolder
    output: Annotated[
        Path,
        Option(("-o", "--output"), help="Image, values or mesh to write."),
    ]
    texture: Annotated[
        Path | None,
        Option(help="Source image, or model file with one; repeat with NAME=IMAGE."),
    ] = None
    maps: tuple[tuple[str, Path], ...] = ()  # images of --texture with names
    usd: Annotated[Path | None, Option(help="Also write a USD layer over the target.")] = None
    displacement: Annotated[Path | None, Option(help="Source displacement along the normal.")] = None
    normal_map: Annotated[
        Path | None, Option(help="Source normal map; its directions are converted for the target.")
    ] = None
    vector_displacement: Annotated[Path | None, Option(help="Source vector displacement.")] = None
    space: Space = "tangent"
    green: Green = "up"
    as_color: Annotated[
        bool, Option(("--as-color",), help="Texture: treat an image that looks like a normal map as colours.")
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
    material_colors: Annotated[bool, Option(("--material-colors",), help="Bake the source's material colours.")] = False
    bake: Annotated[
        tuple[str, ...],
        Option(help="Bake from a detailed mesh: normal, displacement, vector-displacement, ao, colors, texture."),
        SomeOf(("normal", "displacement", "vector-displacement", "ao", "colors", "texture")),
    ] = ()
    detail: Annotated[
        Path | None,
        Option(
            help="Detailed mesh for --bake, at the same place as the source.  [default: the source, for ao and colors]"
        ),
    ] = None
    detail_texture: Annotated[Path | None, Option(help="Image of the detailed mesh, for --bake texture.")] = None
    rays: Annotated[int, Option(min=1, help="Rays per vertex, for --bake ao.")] = 128
    source_uvs: Annotated[
        bool, Option(("--source-uvs",), help="Give the target the source's UVs; -o is the mesh to write.")
    ] = False
    weights: Annotated[
        Path | None, Option(help="Skinning weights: .csv, .npz, .npy, .json groups, glTF, FBX or USD.")
    ] = None
    influences: Annotated[int, Option(min=0, help="Weights: most joints per vertex; 0 for all.")] = 4
    only: Annotated[str | None, Option(help="Weights: only these joints, with commas; --base has the others.")] = None
    mirror: Annotated[
        bool, Option(("--mirror",), help="Weights: make left and right symmetric, by the joints' names.")
    ] = False
    joints: Annotated[
        Path | None, Option(help="Skeleton: .json, glTF, FBX, USD; with --weights, names the columns.")
    ] = None
    blend_shapes: Annotated[
        tuple[Path, ...], Option(help="Source's shapes: mesh, .npz, glTF, FBX, USD or folder; repeat it.")
    ] = ()
    passenger: Annotated[Path | None, Option(help="Mesh on the source to transfer: clothes, eyes, hair, prop.")] = None
    kind: Annotated[
        str | None,
        Option(
            ("--as",),
            help="Passenger: cloth, rigid or similarity (rigid, locally scaled).  [default: chosen for each piece]",
        ),
        OneOf(("cloth", "rigid", "similarity")),
    ] = None
    write_map: Annotated[
        bool,
        Option(("--write-map",), help="Write the map itself, for other programs."),
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
        int | None,
        Option(help="Bits per channel: 8, 16 or 32 (float).  [default: as the source image]"),
        OneOf((8, 16, 32)),
    ] = None
    scale: Annotated[float, Option(help="Displacement: source height between the values 0 and 1.")] = 1.0
    midlevel: Annotated[
        float | None,
        Option(help="Displacement: value of zero displacement.  [default: 0.5 for integers, 0 for floats]"),
    ] = None
    bases: Annotated[
        tuple[tuple[str, Path], ...],
        Option(
            ("--base",),
            help="The target's own image or values outside the masks; [NAME=]IMAGE.  [default: transparent]",
        ),
    ] = ()
    target_mask: TargetMaskOption = None
    source_mask: SourceMaskOption = None
    mask_edge: MaskEdgeOption = None
    unwrap: Annotated[
        bool,
        Option(("--unwrap",), help="Make UVs where the target has none; writes that mesh too."),
    ] = False
    force: Force = False


def texture_and_maps(
    given: Sequence[str], option: str = "--texture"
) -> tuple[Path | None, tuple[tuple[str, Path], ...]]:
    """A single image, or the named maps of a material, from texts such as ``albedo=skin.png``."""
    named = [(name, Path(path)) for name, sign, path in (text.partition("=") for text in given) if sign and path]
    if len(given) == 1 and (not named or Path(given[0]).exists()):
        return Path(given[0]), ()
    if not given:
        return None, ()
    require_map_names(named if len(named) == len(given) else [("", Path(text)) for text in given], option)
    return None, tuple(named)


def require_map_names(maps: Sequence[tuple[str, Path]], option: str = "--texture") -> None:
    """Refuse several images without distinct names."""
    names = [name for name, _ in maps]
    if not all(names) or len({name.casefold() for name in names}) != len(names):
        given = ", ".join(f"{name}={path}" if name else str(path) for name, path in maps)
        raise ParameterError(
            f"{option}: expected one image, or several as NAME=IMAGE with a name of its own each, got {given}."
        )
    if any(not name.replace("_", "").replace("-", "").isalnum() for name in names):
        raise ParameterError(f"{option}: expected names of letters, digits, - and _, since files are named by them.")


def base_of(request: TransferRequest, name: str = "") -> Path | None:
    """Base image or values of a map outside the masks, or the base of all maps."""
    given = dict(request.bases)
    return given.get(name, given.get(""))
