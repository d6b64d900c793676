"""Schema of job files: tables, and the options of each command."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, create_model

ALL = "all"
PLACEHOLDER = re.compile(r"\{(source|target)(?:\.([A-Za-z0-9_-]+))?\}")
Scheme = Literal["catmull-clark", "loop", "bilinear", "none"]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=80)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Asset(_Strict):
    """One model of the library.

    Attributes
    ----------
    name : str
        Letters, digits, ``.``, ``_`` and ``-``: it names folders and files.
    file : Path
        Control mesh.
    landmarks : Path, optional
        Landmarks of this mesh by name, for pairs that have no file of their own.
    part : str, optional
        As `--part` of `cagemap match`, for this side.
    scheme : str, optional
        As `--scheme`, for this side; `target_scheme` and `source_scheme` among the options of a pair go first.
    weld : str, optional
        As `--weld`, for this side; `target_weld` and `source_weld` among the options of a pair go first.
    files : dict of str to Path
        Textures, weights and other files of the model, by names that outputs ask for.
    """

    name: Name
    file: Path
    landmarks: Path | None = None
    part: str | None = None
    scheme: Scheme | None = None
    weld: str | None = None
    files: dict[Name, Path] = {}


class PairRule(_Strict):
    """Which pairs to match: sources times targets, or the spanning tree of some assets in both directions.

    A ``map`` is anyone's point map of one pair, taken as `cagemap map` does in place of a match.
    """

    source: str | list[str] | None = None
    target: str | list[str] | None = None
    tree: str | list[str] | None = None
    landmarks: Path | None = None
    map: Path | None = None
    options: dict[str, Any] = {}


class CarryRule(_Strict):
    """Whose landmarks travel to the other models, and the folder of the files that are made for those."""

    source: str
    folder: Path


class OutputRule(BaseModel):
    """What to write for every pair: a command of cagemap with its options."""

    model_config = ConfigDict(extra="allow", frozen=True)
    command: Literal["transfer", "wrap", "report"]
    output: str | None = None


class JobFile(_Strict):
    """The whole file."""

    output: Path
    options: dict[str, Any] = {}
    assets: list[Asset] = Field(min_length=1)
    pairs: list[PairRule] = Field(min_length=1)
    outputs: list[OutputRule] = []
    carry: CarryRule | None = None


def options_schema(request: type, places: Iterable[str] = ()) -> type[BaseModel]:
    """Schema of a command's options from its request dataclass: all optional, nothing else allowed.

    Parameters
    ----------
    request : dataclass
        Bounds of the command line's options are bounds here too, and so are ``choices`` that they are annotated with.
    places : iterable of str
        Fields that the job file says by other means.
    """
    wanted: dict[str, Any] = {}
    for name, kind in get_type_hints(request, include_extras=True).items():
        if name in places:
            continue
        plain, *said = get_args(kind) if get_origin(kind) is Annotated else (kind,)
        choices = _bound(said, "choices")
        plain = plain if choices is None else Literal[choices]
        wanted[name] = (plain | None, Field(None, ge=_bound(said, "min"), le=_bound(said, "max")))
    return create_model(f"{request.__name__}Options", __config__=ConfigDict(extra="forbid"), **wanted)


def _bound(said: list[Any], name: str) -> Any:
    return next((getattr(one, name) for one in said if getattr(one, name, None) is not None), None)


def fill(value: Any, source: Asset, target: Asset) -> Any:
    """A value with ``{source}``, ``{target}`` and ``{source.NAME}`` filled in; None if an asset lacks the file."""
    if isinstance(value, list):
        items = [fill(item, source, target) for item in value]
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


def listed(names: str | list[str] | None, everything: list[str]) -> list[str]:
    """Names that an entry stands for: one, several, or all."""
    if names is None:
        return []
    return everything if names == ALL else [names] if isinstance(names, str) else names
