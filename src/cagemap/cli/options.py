"""Options that several commands share."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from cagemap.cli.subdivision import BoundaryName, CreasingName, SchemeName, UvName
from cagemap.files.suffixes import IMAGE_SUFFIXES, VALUE_SUFFIXES


@dataclass(frozen=True)
class OneOf:
    """What an option may be, for job files, which are checked before anything starts."""

    choices: tuple[object, ...]


@dataclass(frozen=True)
class SomeOf:
    """Words that an option may list, with commas between them."""

    parts: tuple[str, ...]


@dataclass(frozen=True)
class NameOrFile:
    """An option is a file where it ends in one of these, else a name."""

    suffixes: tuple[str, ...]


# What a mask's name ends in where it is a file.
MASK_FILES = (*VALUE_SUFFIXES, *IMAGE_SUFFIXES)

Space = Annotated[
    str,
    typer.Option("--space", help="Of normals and vectors: tangent (MikkTSpace) or object."),
    OneOf(("tangent", "object")),
]
Green = Annotated[
    str, typer.Option("--green", help="Normal map: green up (OpenGL) or down (DirectX)."), OneOf(("up", "down"))
]
MeshFile = Annotated[Path, typer.Argument(help="Control mesh, .obj, .ply or USD.", show_default=False)]
Force = Annotated[
    bool, typer.Option("--force", help="Overwrite files that cagemap did not write, or that were changed since.")
]
ResultFolder = Annotated[Path, typer.Argument(help="Folder that `cagemap match` wrote.", show_default=False)]

SchemeOption = Annotated[
    SchemeName | None,
    typer.Option(
        "--scheme",
        help="Subdivision scheme; none takes the mesh as it is.  [default: as the file says, else loop for triangles]",
        show_default=False,
    ),
]
TargetSchemeOption = Annotated[
    SchemeName | None,
    typer.Option("--target-scheme", help="The target's own scheme, where it differs.", show_default=False),
]
SourceSchemeOption = Annotated[
    SchemeName | None,
    typer.Option("--source-scheme", help="The source's own scheme, such as none for a scan.", show_default=False),
]
BoundaryOption = Annotated[
    BoundaryName | None,
    typer.Option(
        "--boundary",
        help="Whether boundary vertices with a single face stay.  [default: as the file says, else edge-and-corner]",
        show_default=False,
    ),
]
UvOption = Annotated[
    UvName | None,
    typer.Option(
        "--uv-interpolation", help="Where UVs stay linear.  [default: as the file says, else all]", show_default=False
    ),
]
CreasingOption = Annotated[
    CreasingName | None,
    typer.Option(
        "--creasing", help="How creases soften.  [default: as the file says, else uniform]", show_default=False
    ),
]


TargetMaskOption = Annotated[
    str | None,
    typer.Option(
        "--target-mask",
        help="Only this of the target counts: a group or other part by name, values at vertices or faces (.npz, .csv), "
        "an image over its UVs; not:... for all but that.",
        show_default=False,
    ),
    NameOrFile(MASK_FILES),
]
SourceMaskOption = Annotated[
    str | None,
    typer.Option("--source-mask", help="The same of the source.", show_default=False),
    NameOrFile(MASK_FILES),
]
MaskEdgeOption = Annotated[
    float | None,
    typer.Option(
        "--mask-edge",
        min=0.0,
        help="Width of the masks' soft edge, as a share of the model's size.  [default: 0.02 of sets of faces, 0 "
        "of values and images]",
        show_default=False,
    ),
]


class Method(StrEnum):
    """Matching methods."""

    ELASTIC = "elastic"
    HFM = "hfm"
    PAPER = "paper"
