"""Schema of job files: tables, and the options of each command."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, create_model

ALL_ASSETS = "all"
# Options of a pair whose map is given, as of `cagemap map`; the job's other options are of its matches alone.
MAP_OPTIONS = ("level", "weld", "target_weld", "source_weld", "target_mask", "source_mask", "mask_edge")
PLACEHOLDER = re.compile(r"\{(source|target)(?:\.([A-Za-z0-9_-]+))?\}")
Scheme = Literal["catmull-clark", "loop", "bilinear", "none"]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=80)]


class _StrictModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Asset(_StrictModel):
    """One model of the library."""

    name: Name  # letters, digits, ``.``, ``_`` and ``-``: it names folders and files
    file: Path  # control mesh
    landmarks: Path | None = None  # landmarks of this mesh by name, for pairs that have no file of their own
    # Name of the part to match (`--part` of `cagemap match`), unless the pair has `target_part` or `source_part`
    part: str | None = None
    # As `--scheme`, for this side; a pair's options `target_scheme` and `source_scheme` take precedence
    scheme: Scheme | None = None
    # As `--weld`, for this side; a pair's options `target_weld` and `source_weld` take precedence
    weld: str | None = None
    files: dict[Name, Path] = {}  # textures, weights and other files of the model, by the names that outputs use


class PairRule(_StrictModel):
    """Pairs to match: all sources with all targets, or a spanning tree in both directions.

    A ``map`` is a given point map of one pair, imported as by `cagemap map` instead of a match.
    """

    source: str | list[str] | None = None
    target: str | list[str] | None = None
    tree: str | list[str] | None = None
    landmarks: Path | None = None
    map: Path | None = None
    options: dict[str, Any] = {}


class CarryRule(_StrictModel):
    """The model whose landmarks are carried to the others, and the folder of their files."""

    source: str
    folder: Path


class OutputRule(BaseModel):
    """An output of every pair: a command of cagemap with its options."""

    model_config = ConfigDict(extra="allow", frozen=True)
    command: Literal["transfer", "wrap", "report"]
    output: str | None = None


class JobFile(_StrictModel):
    """The whole file."""

    output: Path
    options: dict[str, Any] = {}
    assets: list[Asset] = Field(min_length=1)
    pairs: list[PairRule] = Field(min_length=1)
    outputs: list[OutputRule] = []
    carry: CarryRule | None = None


@dataclass(frozen=True)
class CommandOptions:
    """Options of a command in job files."""

    schema: type[BaseModel]  # all optional, no others allowed
    kinds: dict[str, Any]  # types with their annotations
    written: tuple[str, ...]  # options that name further files to write, in the pair's folder


def command_options(request: type, excluded: Iterable[str], written: tuple[str, ...]) -> CommandOptions:
    """Options of a command from its request, without ``excluded`` fields."""
    kinds = get_type_hints(request, include_extras=True)
    fields: dict[str, Any] = {name: (kind | None, None) for name, kind in kinds.items() if name not in excluded}
    schema = create_model(f"{request.__name__}Options", __config__=ConfigDict(extra="forbid"), **fields)
    return CommandOptions(schema, kinds, written)


def fill_placeholders(value: Any, source: Asset, target: Asset) -> Any:
    """A value with its placeholders filled in; None if an asset lacks the file."""
    if isinstance(value, list):
        items = [fill_placeholders(item, source, target) for item in value]
        return None if None in items else items
    if not isinstance(value, str):
        return value
    sides = {"source": source, "target": target}
    for side, name in PLACEHOLDER.findall(value):
        if name and name not in sides[side].files:
            return None

    def text(match: re.Match[str]) -> str:
        asset = sides[match[1]]
        return str(asset.files[match[2]]) if match[2] else asset.name

    return PLACEHOLDER.sub(text, value)


def asset_names(names: str | list[str] | None, all_names: list[str]) -> list[str]:
    """Names of an entry: one, several, or all assets."""
    if names is None:
        return []
    return all_names if names == ALL_ASSETS else [names] if isinstance(names, str) else names
