"""Request of `cagemap transfer`: its fields are the command's options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cagemap.errors import ParameterError
from cagemap.tasks.requests.options import (
    CARRIED,
    CHARACTER,
    IMAGES,
    INPUT,
    OUTPUT,
    Force,
    Green,
    MaskEdgeOption,
    Option,
    PythonOnly,
    ResultFolder,
    SourceMaskOption,
    Space,
    TargetMaskOption,
)

BakeKind = Literal["normal", "displacement", "vector-displacement", "ao", "colors", "texture"]
# Kinds of data that are images.
IMAGE_KINDS = ("texture", "displacement", "normal_map", "vector_displacement", "bake", "material_colors")
_MASKED = (*IMAGE_KINDS, "attribute", "weights", "blend_shapes")
# Kinds of data whose transfer reads an option; with other kinds the option is refused.
READ_BY = {
    "usd": ("texture", "attribute", "weights", "blend_shapes"),
    "space": ("normal_map", "vector_displacement", "bake"),
    "green": ("texture", "normal_map", "bake"),
    "as_color": ("texture",),
    "filter": IMAGE_KINDS,
    "detail": ("bake",),
    "detail_texture": ("bake",),
    "rays": ("bake",),
    "influences": ("weights",),
    "only": ("weights",),
    "mirror": ("weights",),
    "kind": ("passenger",),
    "size": IMAGE_KINDS,
    "bits": IMAGE_KINDS,
    "scale": ("displacement", "vector_displacement"),
    "midlevel": ("displacement", "vector_displacement"),
    "unwrap": IMAGE_KINDS,
    "bases": (*IMAGE_KINDS, "attribute", "weights"),
    "target_mask": _MASKED,
    "source_mask": _MASKED,
}


@dataclass(frozen=True)
class TransferRequest:
    """Carry textures, values, rigs or shapes to the target.

    Images are baked into the target's own UV layout, texel by texel, across the source's seams.
    """

    result: ResultFolder
    output: Annotated[Path, Option("Image, values or mesh to write.", OUTPUT, ("-o",))]
    texture: Annotated[
        Path | None,
        Option(
            "Source image, or model file with one; repeat with NAME=IMAGE.",
            CARRIED,
            metavar="IMAGE",
            typed=tuple[str, ...],
        ),
    ] = None
    maps: Annotated[
        tuple[tuple[str, Path], ...], PythonOnly("Images of a material, instead of --texture, with their names.")
    ] = ()
    usd: Annotated[Path | None, Option("Also write a USD layer over the target.", OUTPUT)] = None
    displacement: Annotated[Path | None, Option("Source displacement map: heights along the normal.", CARRIED)] = None
    normal_map: Annotated[
        Path | None, Option("Source normal map; its directions are converted for the target.", CARRIED)
    ] = None
    vector_displacement: Annotated[Path | None, Option("Source vector displacement map.", CARRIED)] = None
    space: Space = "tangent"
    green: Green = "up"
    as_color: Annotated[bool, Option("Texture: treat an image that looks like a normal map as colours.", IMAGES)] = (
        False
    )
    filter: Annotated[
        Literal["smooth", "linear", "nearest"],
        Option("Sampling of enlarged images: smooth, linear, or nearest for labels.", IMAGES),
    ] = "smooth"
    attribute: Annotated[Path | None, Option("Values at the source's control vertices, faces or corners.", CARRIED)] = (
        None
    )
    material_colors: Annotated[bool, Option("Bake the source's material colours.", CARRIED)] = False
    bake: Annotated[
        tuple[BakeKind, ...],
        Option(
            "Bake from a detailed mesh: normal, displacement, vector-displacement, ao, colors, texture.",
            CARRIED,
            typed=str | None,
        ),
    ] = ()
    detail: Annotated[
        Path | None,
        Option(
            "Detailed mesh for --bake, at the same place as the source.  [default: the source, for ao and colors]",
            IMAGES,
        ),
    ] = None
    detail_texture: Annotated[Path | None, Option("Image of the detailed mesh, for --bake texture.", IMAGES)] = None
    rays: Annotated[int, Option("Rays per vertex, for --bake ao.", IMAGES, min=1)] = 128
    source_uvs: Annotated[bool, Option("Give the target the source's UVs; -o is the mesh to write.", CARRIED)] = False
    weights: Annotated[
        Path | None, Option("Skinning weights: .csv, .npz, .npy, .json groups, glTF, FBX or USD.", CARRIED)
    ] = None
    influences: Annotated[int, Option("Weights: most joints per vertex; 0 for all.", CHARACTER, min=0)] = 4
    only: Annotated[
        str | None, Option("Weights: only these joints, with commas; --base has the others.", CHARACTER)
    ] = None
    mirror: Annotated[bool, Option("Weights: make left and right symmetric, by the joints' names.", CHARACTER)] = False
    joints: Annotated[
        Path | None, Option("Skeleton: .json, glTF, FBX, USD; with --weights, names the columns.", CARRIED)
    ] = None
    blend_shapes: Annotated[
        tuple[Path, ...], Option("Source's shapes: mesh, .npz, glTF, FBX, USD or folder; repeat it.", CARRIED)
    ] = ()
    passenger: Annotated[Path | None, Option("Mesh on the source to transfer: clothes, eyes, hair, prop.", CARRIED)] = (
        None
    )
    kind: Annotated[
        Literal["cloth", "rigid", "similarity"] | None,
        Option(
            "Passenger: cloth, rigid or similarity (rigid, locally scaled).  [default: chosen for each piece]",
            CHARACTER,
            ("--as",),
        ),
    ] = None
    write_map: Annotated[bool, Option("Write the map itself, for other programs.", CARRIED)] = False
    level: Annotated[
        int | None, Option("Map of this level of the target (methods hfm, paper).  [default: the finest]", INPUT, min=0)
    ] = None
    size: Annotated[
        int | None,
        Option("Width and height in texels.  [default: the source image's, or 2048]", IMAGES, min=1, max=32767),
    ] = None
    bits: Annotated[
        Literal[8, 16, 32] | None,
        Option("Bits per channel: 8, 16 or 32 (float).  [default: as the source image]", IMAGES, metavar="8|16|32"),
    ] = None
    scale: Annotated[float, Option("Displacement: height that the values 0 to 1 span.", IMAGES)] = 1.0
    midlevel: Annotated[
        float | None,
        Option("Displacement: value that means no displacement.  [default: 0.5 for integers, 0 for floats]", IMAGES),
    ] = None
    bases: Annotated[
        tuple[tuple[str, Path], ...],
        Option(
            "The target's own image or values outside the masks.  [default: transparent]",
            INPUT,
            ("--base",),
            metavar="[NAME=]IMAGE",
            typed=tuple[str, ...],
        ),
    ] = ()
    target_mask: TargetMaskOption = None
    source_mask: SourceMaskOption = None
    mask_edge: MaskEdgeOption = None
    unwrap: Annotated[bool, Option("Make UVs where the target has none; writes that mesh too.", IMAGES)] = False
    force: Force = False

    @classmethod
    def of_words(
        cls, texture: tuple[str, ...], bases: tuple[str, ...], bake: str | None, **others: Any
    ) -> TransferRequest:
        """The request from what is typed: named images and comma-separated kinds of bakes."""
        image, maps = texture_and_maps(texture)
        base, named_bases = texture_and_maps(bases, "--base")
        bakes: Any = tuple(name.strip() for name in bake.split(",")) if bake else ()
        all_bases = named_bases if base is None else (("", base),)
        return cls(texture=image, maps=maps, bases=all_bases, bake=bakes, **others)


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
