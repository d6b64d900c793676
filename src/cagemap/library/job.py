"""Job files: what to match, with which options, and what to write; validated whole before anything starts.

A job file is TOML. Options have the names of the command line's options, with underscores::

    output = "night"                     # folder of all results, beside the job file

    [options]                            # of `cagemap match`, for every pair
    vertices = 100000

    [[assets]]
    name = "zebra"
    file = "zebra.obj"
    files = { color = "zebra.png" }      # what outputs may ask for as {source.color} or {target.color}

    [[pairs]]
    source = "zebra"                     # a name, a list of names, or "all"
    target = ["horse", "cow"]
    landmarks = "zebra__horse.json"

    [[outputs]]                          # for every pair that has what it asks for
    command = "transfer"
    texture = "{source.color}"
    output = "{target}.png"

    [carry]                              # landmarks of one model travel to all others, see `cagemap.library.carry`
    source = "zebra"
    folder = "landmarks"                 # NAME.json for every other model, beside the job file
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from cagemap.errors import FormatError
from cagemap.files.marks import is_own

ALL = "all"
_PLACEHOLDER = re.compile(r"\{(source|target)(?:\.([A-Za-z0-9_-]+))?\}")
_SHOWN = 50
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
    files : dict of str to Path
        Textures, weights and other files of the model, by names that outputs ask for.
    """

    name: Name
    file: Path
    landmarks: Path | None = None
    part: str | None = None
    files: dict[Name, Path] = {}


class PairRule(_Strict):
    """Which pairs to match: sources times targets, or the spanning tree of some assets in both directions."""

    source: str | list[str] | None = None
    target: str | list[str] | None = None
    tree: str | list[str] | None = None
    landmarks: Path | None = None
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


class _File(_Strict):
    output: Path
    options: dict[str, Any] = {}
    assets: list[Asset] = Field(min_length=1)
    pairs: list[PairRule] = Field(min_length=1)
    outputs: list[OutputRule] = []
    carry: CarryRule | None = None


@dataclass(frozen=True)
class Job:
    """A job file, validated; every path is absolute.

    Attributes
    ----------
    path : Path
        The job file.
    output : Path
        Folder of all results.
    assets : dict of str to Asset
    pairs : tuple of PairRule
        Their options include those of the whole job.
    outputs : tuple of OutputRule
    carry : CarryRule or None
    kinds : dict of str to dict
        Type of every option of every command.
    """

    path: Path
    output: Path
    assets: dict[str, Asset]
    pairs: tuple[PairRule, ...]
    outputs: tuple[OutputRule, ...]
    kinds: dict[str, dict[str, Any]]
    carry: CarryRule | None = None


def read_job(path: str | Path, commands: Mapping[str, type]) -> Job:
    """Read and validate a job file; every problem is named at once, with its line and what to do.

    Parameters
    ----------
    path : path
    commands : mapping of str to dataclass
        What each command of cagemap can be asked: "match" and those that outputs name. Field names are option names.

    Raises
    ------
    FormatError
        If the file cannot be read or anything in it is wrong.
    """
    file = Path(path)
    try:
        text = file.read_bytes().decode("utf-8")
        data = tomllib.loads(text)
    except FileNotFoundError:
        raise FormatError(f"{file}: expected a job file, found none. Check the path.") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise FormatError(f"{file}: expected a TOML file, got a mistake in it: {error}.") from None
    problems = list(_shape_problems(data))
    if not problems:
        parsed = _File.model_validate(data)
        schemas = {name: options_schema(request) for name, request in commands.items()}
        problems = list(_problems(parsed, file.parent, schemas))
    if problems:
        lines = sorted((line_of(text, place), message) for place, message in problems)
        listed = "\n".join(f"  line {line}: {message}" for line, message in lines[:_SHOWN])
        more = f"\n  and {len(lines) - _SHOWN} more" if len(lines) > _SHOWN else ""
        raise FormatError(f"{file}: {len(lines)} problem{'s' * (len(lines) > 1)}; nothing was started.\n{listed}{more}")
    return _resolved(file, parsed, {name: get_type_hints(request) for name, request in commands.items()})


def absolute(value: Any, kind: Any, folder: Path) -> Any:
    """An option's value with relative files taken from a folder; files are found by the option's type."""
    if isinstance(value, str):
        return (
            str(folder / value) if kind is Path or (get_origin(kind) is not tuple and Path in get_args(kind)) else value
        )
    if isinstance(value, list):
        kinds = [part for part in get_args(kind) if part is not Ellipsis] or [None]
        return [absolute(item, kinds[min(i, len(kinds) - 1)], folder) for i, item in enumerate(value)]
    return value


def options_schema(request: type) -> type[BaseModel]:
    """Schema of a command's options from its request dataclass: all optional, nothing else allowed."""
    hints = get_type_hints(request)
    wanted: dict[str, Any] = {field.name: (hints[field.name] | None, None) for field in fields(request)}
    return create_model(f"{request.__name__}Options", __config__=ConfigDict(extra="forbid"), **wanted)


def fill(value: Any, source: Asset, target: Asset) -> Any:
    """A value with ``{source}``, ``{target}`` and ``{source.NAME}`` filled in; None if an asset lacks the file."""
    if isinstance(value, list):
        items = [fill(item, source, target) for item in value]
        return None if None in items else items
    if not isinstance(value, str):
        return value
    sides = {"source": source, "target": target}
    for side, name in _PLACEHOLDER.findall(value):
        if name and name not in sides[side].files:
            return None

    def text(match: re.Match[str]) -> str:
        asset = sides[match[1]]
        return str(asset.files[match[2]]) if match[2] else asset.name

    return _PLACEHOLDER.sub(text, value)


Place = tuple[str | int, ...]


def line_of(text: str, place: Place) -> int:
    """Line (from 1) of the TOML text where a value stands, or the nearest thing around it that has a line."""
    lines: dict[Place, int] = {}
    counts: dict[str, int] = {}
    table: Place = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*\[\[\s*([\w.-]+)\s*\]\]", line):
            counts[header[1]] = counts.get(header[1], -1) + 1
            table = (header[1], counts[header[1]])
        elif header := re.match(r"\s*\[\s*([\w.-]+)\s*\]", line):
            parts = header[1].split(".")
            table = (parts[0], counts[parts[0]], *parts[1:]) if parts[0] in counts else tuple(parts)
        elif key := re.match(r"\s*([\w-]+)(?:\.[\w-]+)*\s*=", line):
            lines.setdefault((*table, key[1]), number)
            continue
        else:
            continue
        lines.setdefault(table, number)
    for length in range(len(place), 0, -1):
        if place[:length] in lines:
            return lines[place[:length]]
    return 1


Problem = tuple[Place, str]


def _shape_problems(data: Any) -> Iterator[Problem]:
    """What does not have the form of a job file."""
    try:
        _File.model_validate(data)
    except ValidationError as error:
        yield from _validation_problems(error, ())


def _validation_problems(error: ValidationError, place: Place) -> Iterator[Problem]:
    for item in error.errors(include_url=False, include_context=False):
        where = (*place, *item["loc"])
        name = ".".join(map(str, where)) or "the file"
        given = repr(item["input"])
        shown = given if len(given) <= 60 else given[:57] + "..."
        said = item["msg"][:1].lower() + item["msg"][1:]
        if item["type"] == "extra_forbidden":
            yield where, f"{name}: there is no such entry. Check its spelling, or remove it."
        elif item["type"] == "missing":
            yield where, f"{name}: is missing. Add it."
        else:
            yield where, f"{name}: {said}, got {shown}."


def _problems(job: _File, folder: Path, schemas: Mapping[str, type[BaseModel]]) -> Iterator[Problem]:
    """What is wrong in a file of the right form."""
    names = [asset.name for asset in job.assets]
    for i, asset in enumerate(job.assets):
        if asset.name in names[:i]:
            yield ("assets", i, "name"), f"assets.{i}.name: {asset.name!r} is taken. Give another name."
        if not (folder / asset.file).is_file():
            yield ("assets", i, "file"), f"assets.{i}.file: {asset.file} does not exist. Check the path."
        if asset.landmarks is not None and not (folder / asset.landmarks).is_file():
            yield ("assets", i, "landmarks"), f"assets.{i}.landmarks: {asset.landmarks} does not exist. Check the path."
        for key, path in asset.files.items():
            if "<UDIM>" not in path.name and not (folder / path).is_file():
                yield ("assets", i, "files"), f"assets.{i}.files.{key}: {path} does not exist. Check the path."
    yield from _option_problems(job.options, schemas["match"], ("options",))
    for i, pair in enumerate(job.pairs):
        yield from _pair_problems(pair, i, names, folder)
        yield from _option_problems(pair.options, schemas["match"], ("pairs", i, "options"))
    if job.carry is not None:
        yield from _carry_problems(job.carry, job.assets)
    for i, output in enumerate(job.outputs):
        options = {"output": output.output or "", **(output.model_extra or {})}
        known = {key for asset in job.assets for key in asset.files}
        for key, value in options.items():
            for side, name in _PLACEHOLDER.findall(value) if isinstance(value, str) else ():
                if name and name not in known:
                    message = f"outputs.{i}.{key}: no asset has a file {name!r} for {{{side}.{name}}}. "
                    yield ("outputs", i, key), message + "Add it to the files of an asset."
        yield from _option_problems(output.model_extra or {}, schemas[output.command], ("outputs", i))
        if output.output is not None and (Path(output.output).is_absolute() or ".." in Path(output.output).parts):
            message = f"outputs.{i}.output: expected a name inside the pair's folder, got {output.output!r}."
            yield ("outputs", i, "output"), f"{message} Give a name without '..'."


def _pair_problems(pair: PairRule, i: int, names: list[str], folder: Path) -> Iterator[Problem]:
    if (pair.tree is None) == (pair.source is None and pair.target is None):
        yield ("pairs", i), f"pairs.{i}: expected source and target, or tree. Give one of them."
    elif pair.tree is None and (pair.source is None or pair.target is None):
        yield ("pairs", i), f"pairs.{i}: expected both source and target. Add the other one, or 'all'."
    for side in ("source", "target", "tree"):
        for name in listed(getattr(pair, side), names):
            if name not in names:
                yield ("pairs", i, side), f"pairs.{i}.{side}: no asset is called {name!r}. Check the name, or add it."
    if pair.landmarks is not None and not (folder / pair.landmarks).is_file():
        yield ("pairs", i, "landmarks"), f"pairs.{i}.landmarks: {pair.landmarks} does not exist. Check the path."


def _carry_problems(carry: CarryRule, assets: list[Asset]) -> Iterator[Problem]:
    named = [asset for asset in assets if asset.name == carry.source]
    if not named:
        yield ("carry", "source"), f"carry.source: no asset is called {carry.source!r}. Check the name, or add it."
    elif named[0].landmarks is None:
        message = f"carry.source: {carry.source!r} has no landmarks. Give it a file: landmarks = ..."
        yield ("carry", "source"), message


def _option_problems(options: dict[str, Any], schema: type[BaseModel], place: Place) -> Iterator[Problem]:
    try:
        schema.model_validate(options)
    except ValidationError as error:
        yield from _validation_problems(error, place)


def listed(names: str | list[str] | None, everything: list[str]) -> list[str]:
    """Names that an entry stands for: one, several, or all."""
    if names is None:
        return []
    return everything if names == ALL else [names] if isinstance(names, str) else names


def _resolved(path: Path, job: _File, kinds: dict[str, dict[str, Any]]) -> Job:
    """Paths made absolute against the job file's folder; the whole job's options put under those of each pair."""
    folder = path.resolve().parent

    def placed(item: Path | None) -> Path | None:
        return None if item is None else folder / item

    def options(pair: PairRule) -> dict[str, Any]:
        merged = {**job.options, **pair.options}
        return {name: absolute(value, kinds["match"][name], folder) for name, value in merged.items()}

    carry = None if job.carry is None else job.carry.model_copy(update={"folder": folder / job.carry.folder})

    def landmarks(asset: Asset) -> Path | None:
        """Those given, or those that were carried to the model and corrected by somebody."""
        carried = None if carry is None or asset.name == carry.source else carry.folder / f"{asset.name}.json"
        corrected = carried is not None and carried.is_file() and not is_own(carried)
        return carried if corrected and asset.landmarks is None else placed(asset.landmarks)

    assets = {
        asset.name: asset.model_copy(
            update={
                "file": folder / asset.file,
                "landmarks": landmarks(asset),
                "files": {name: folder / file for name, file in asset.files.items()},
            }
        )
        for asset in job.assets
    }
    pairs = tuple(
        pair.model_copy(update={"landmarks": placed(pair.landmarks), "options": options(pair)}) for pair in job.pairs
    )
    return Job(path.resolve(), folder / job.output, assets, pairs, tuple(job.outputs), kinds, carry)
