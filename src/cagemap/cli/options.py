"""Options that several commands share."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

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
    str, Option(help="Of normals and vectors: tangent (MikkTSpace) or object."), OneOf(("tangent", "object"))
]
Green = Annotated[str, Option(help="Normal map: green up (OpenGL) or down (DirectX)."), OneOf(("up", "down"))]
MeshFile = Annotated[Path, Argument(metavar="MESH", help="Control mesh, .obj, .ply, .off, .stl or USD.")]
Force = Annotated[
    bool, Option("--force", help="Overwrite files that cagemap did not write, or that were changed since.")
]
ResultFolder = Annotated[Path, Argument(metavar="RESULT", help="Folder that `cagemap match` wrote.")]

SchemeOption = Annotated[
    SchemeName | None,
    Option(
        help="Subdivision scheme; none takes the mesh as it is.  [default: as the file says, else loop for triangles]"
    ),
]
TargetSchemeOption = Annotated[SchemeName | None, Option(help="The target's own scheme, where it differs.")]
SourceSchemeOption = Annotated[SchemeName | None, Option(help="The source's own scheme, such as none for a scan.")]
TargetPartOption = Annotated[str | None, Option(help="As --part, of the target alone.")]
SourcePartOption = Annotated[str | None, Option(help="As --part, of the source alone.")]
BoundaryOption = Annotated[
    BoundaryName | None,
    Option(
        help="Whether boundary vertices with a single face stay.  [default: as the file says, else edge-and-corner]"
    ),
]
UvOption = Annotated[UvName | None, Option(help="Where UVs stay linear.  [default: as the file says, else all]")]
CreasingOption = Annotated[
    CreasingName | None, Option(help="How creases soften.  [default: as the file says, else uniform]")
]


TargetMaskOption = Annotated[
    str | None,
    Option(
        help="Only this of the target counts: a group or other part by name, values at vertices or faces (.npz, .csv), "
        "an image over its UVs; not:... for all but that."
    ),
    NameOrFile(MASK_FILES),
]
SourceMaskOption = Annotated[str | None, Option(help="The same of the source."), NameOrFile(MASK_FILES)]
MaskEdgeOption = Annotated[
    float | None,
    Option(
        min=0.0,
        help="Width of the masks' soft edge, as a share of the model's size.  [default: 0.02 of sets of faces, 0 "
        "of values and images]",
    ),
]


class Method(StrEnum):
    """Matching methods."""

    ELASTIC = "elastic"
    HFM = "hfm"
    PAPER = "paper"
