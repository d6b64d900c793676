"""Checks of job files: all problems at once, each with its line and a remedy."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

from pydantic import BaseModel, ValidationError

from cagemap.errors import expected_value
from cagemap.files import INVERT_PREFIX
from cagemap.files.images.image import texture_files
from cagemap.jobs.job_schema import (
    ALL_ASSETS,
    MAP_OPTIONS,
    PLACEHOLDER,
    Asset,
    CarryRule,
    JobFile,
    PairRule,
    asset_names,
)

KeyPath = tuple[str | int, ...]


def find_line(text: str, key_path: KeyPath) -> int:
    """Line (from 1) of an entry in TOML text, or of the nearest table around it."""
    lines: dict[KeyPath, int] = {}
    counts: dict[str, int] = {}
    table: KeyPath = ()
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
    for length in range(len(key_path), 0, -1):
        if key_path[:length] in lines:
            return lines[key_path[:length]]
    return 1


JobProblem = tuple[KeyPath, str]


def parse_job(data: Any) -> tuple[JobFile | None, list[JobProblem]]:
    """The job file without invalid entries, None if that is impossible; and the problems."""
    try:
        return JobFile.model_validate(data), []
    except ValidationError as error:
        problems = list(_validation_problems(error, ()))
        key_paths = [item["loc"] for item in error.errors()]
    # An output without its command is invalid: then everything else is checked without outputs.
    for removed in (key_paths, [key_path[:1] if key_path[:1] == ("outputs",) else key_path for key_path in key_paths]):
        with suppress(ValidationError):
            return JobFile.model_validate(_remove_entries(data, removed)), problems
    return None, problems


def _remove_entries(data: Any, key_paths: Iterable[KeyPath]) -> Any:
    """A copy without some entries of tables."""
    copy: Any = deepcopy(data)
    for key_path in key_paths:
        parent: Any
        key: Any
        parent, key, entry = None, None, copy
        for step in key_path:
            exists = step in entry if isinstance(entry, dict) else isinstance(entry, list) and step in range(len(entry))
            if not exists:
                break
            parent, key, entry = entry, step, entry[step]
        if isinstance(parent, dict):
            parent.pop(key, None)
    return copy


def _validation_problems(error: ValidationError, key_path: KeyPath) -> Iterator[JobProblem]:
    for item in error.errors(include_url=False):
        entry = (*key_path, *item["loc"])
        name = ".".join(map(str, entry)) or "the file"
        value = repr(item["input"])
        excerpt = value if len(value) <= 60 else value[:57] + "..."
        if item["type"] == "extra_forbidden":
            yield entry, f"{name}: there is no such entry. Check its spelling, or remove it."
        elif item["type"] == "missing":
            yield entry, f"{name}: is missing. Add it."
        else:
            yield entry, f"{name}: expected {expected_value(item)}, got {excerpt}. Correct it."


def find_problems(
    job: JobFile,
    folder: Path,
    schemas: Mapping[str, type[BaseModel]],
    kinds: Mapping[str, dict[str, Any]],
    output_options: Mapping[str, tuple[str, ...]],
) -> Iterator[JobProblem]:
    """Problems of a file that passes the schema: names, files, options."""
    names = [asset.name for asset in job.assets]
    if (folder / job.output).is_file():
        yield ("output",), f"output: expected a folder for all results, got the file {job.output}. Give another name."
    for i, asset in enumerate(job.assets):
        if asset.name in names[:i]:
            yield ("assets", i, "name"), f"assets.{i}.name: {asset.name!r} is taken. Give another name."
        if not (folder / asset.file).is_file():
            yield ("assets", i, "file"), f"assets.{i}.file: {asset.file} does not exist. Check the path."
        if asset.landmarks is not None and not (folder / asset.landmarks).is_file():
            yield ("assets", i, "landmarks"), f"assets.{i}.landmarks: {asset.landmarks} does not exist. Check the path."
        for key, path in asset.files.items():
            if not _exists(folder / path):
                yield ("assets", i, "files"), f"assets.{i}.files.{key}: {path} does not exist. Check the path."
    yield from _option_problems(job.options, schemas["match"], ("options",))
    yield from _file_problems(job.options, kinds["match"], folder, ("options",))
    for i, pair in enumerate(job.pairs):
        yield from _pair_problems(pair, i, names, folder)
        yield from _map_problems(pair, i, job.assets, folder)
        yield from _option_problems(pair.options, schemas["match"], ("pairs", i, "options"))
        yield from _file_problems(pair.options, kinds["match"], folder, ("pairs", i, "options"))
    if job.carry is not None:
        yield from _carry_problems(job.carry, job.assets)
    for i, output in enumerate(job.outputs):
        options = {"output": output.output or "", **(output.model_extra or {})}
        file_names = {key for asset in job.assets for key in asset.files}
        for key, value in options.items():
            for side, name in (match for text in _texts(value) for match in PLACEHOLDER.findall(text)):
                if name and name not in file_names:
                    message = f"outputs.{i}.{key}: no asset has a file {name!r} for {{{side}.{name}}}. "
                    yield ("outputs", i, key), message + "Add it to the files of an asset."
        yield from _option_problems(output.model_extra or {}, schemas[output.command], ("outputs", i))
        file_options = output_options.get(output.command, ())
        for name in ("output", *file_options):
            value = options.get(name)
            if isinstance(value, str) and (Path(value).is_absolute() or ".." in Path(value).parts):
                message = f"outputs.{i}.{name}: expected a name inside the pair's folder, got {value!r}."
                yield ("outputs", i, name), f"{message} Give a name without '..'."
        input_options = {name: value for name, value in (output.model_extra or {}).items() if name not in file_options}
        yield from _file_problems(input_options, kinds[output.command], folder, ("outputs", i))


def _pair_problems(pair: PairRule, i: int, names: list[str], folder: Path) -> Iterator[JobProblem]:
    if (pair.tree is None) == (pair.source is None and pair.target is None):
        yield ("pairs", i), f"pairs.{i}: expected source and target, or tree. Give one of them."
    elif pair.tree is None and (pair.source is None or pair.target is None):
        yield ("pairs", i), f"pairs.{i}: expected both source and target. Add the other one, or 'all'."
    for side in ("source", "target", "tree"):
        for name in asset_names(getattr(pair, side), names):
            if name not in names:
                yield ("pairs", i, side), f"pairs.{i}.{side}: no asset is called {name!r}. Check the name, or add it."
    named = {name for side in (pair.source, pair.target, pair.tree) for name in asset_names(side, names)}
    if len(named) == 1:
        message = f"pairs.{i}: expected two different assets, got {named.pop()!r} alone. Name another one."
        yield ("pairs", i), message
    if pair.landmarks is not None and not (folder / pair.landmarks).is_file():
        yield ("pairs", i, "landmarks"), f"pairs.{i}.landmarks: {pair.landmarks} does not exist. Check the path."


def _map_problems(pair: PairRule, i: int, assets: list[Asset], folder: Path) -> Iterator[JobProblem]:
    """Problems of a given map: needs one pair of unchanged meshes, takes only `MAP_OPTIONS`."""
    if pair.map is None:
        return
    entry = ("pairs", i, "map")
    if not (folder / pair.map).is_file():
        yield entry, f"pairs.{i}.map: {pair.map} does not exist. Check the path."
    if any(not isinstance(side, str) or side == ALL_ASSETS for side in (pair.source, pair.target)):
        yield entry, f"pairs.{i}.map: expected one source and one target. Name them, one map for each pair."
    if pair.landmarks is not None or set(pair.options) - set(MAP_OPTIONS):
        message = f"pairs.{i}.map: a map that is given takes {', '.join(MAP_OPTIONS)} only. "
        yield entry, message + "Remove the landmarks and other options."
    for asset in assets:
        if asset.name in (pair.source, pair.target) and (asset.part or asset.scheme or asset.weld):
            yield (
                entry,
                f"pairs.{i}.map: {asset.name!r} has a part, a scheme or a weld. Name a file that is the whole mesh.",
            )


def _carry_problems(carry: CarryRule, assets: list[Asset]) -> Iterator[JobProblem]:
    sources = [asset for asset in assets if asset.name == carry.source]
    if not sources:
        yield ("carry", "source"), f"carry.source: no asset is called {carry.source!r}. Check the name, or add it."
    elif sources[0].landmarks is None:
        message = f"carry.source: {carry.source!r} has no landmarks. Give it a file: landmarks = ..."
        yield ("carry", "source"), message


def _file_problems(
    options: dict[str, Any], kinds: dict[str, Any], folder: Path, key_path: KeyPath
) -> Iterator[JobProblem]:
    """Missing files that options name; names with placeholders are not checked."""
    for name, value in options.items():
        for text, resolved in zip(_texts(value), _texts(resolve_files(value, kinds.get(name), folder)), strict=True):
            is_file = resolved != text or (kinds.get(name) is Path and Path(text).is_absolute())
            if is_file and "{" not in text and not _exists(Path(resolved.removeprefix(INVERT_PREFIX))):
                entry = (*key_path, name)
                yield entry, f"{'.'.join(map(str, entry))}: {text} does not exist. Check the path."


def _exists(path: Path) -> bool:
    """Whether a file, a folder or a tile of a set exists."""
    return path.exists() or any(file.is_file() for file in texture_files(path))


def _texts(value: Any) -> list[str]:
    """The texts in an option's value."""
    if isinstance(value, list):
        return [text for item in value for text in _texts(item)]
    return [value] if isinstance(value, str) else []


def _option_problems(options: dict[str, Any], schema: type[BaseModel], key_path: KeyPath) -> Iterator[JobProblem]:
    try:
        schema.model_validate(options)
    except ValidationError as error:
        yield from _validation_problems(error, key_path)


def resolve_files(value: Any, kind: Any, folder: Path) -> Any:
    """An option's value with relative files made absolute; the option's type shows which are files.

    A mask is a file by its suffix, which the type's annotation lists.
    """
    kind, *annotations = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    if isinstance(value, str):
        file = value.removeprefix(INVERT_PREFIX)
        if any(Path(file).suffix.lower() in getattr(annotation, "suffixes", ()) for annotation in annotations):
            return value.removesuffix(file) + str(folder / file)
        return (
            str(folder / value) if kind is Path or (get_origin(kind) is not tuple and Path in get_args(kind)) else value
        )
    if isinstance(value, list):
        kinds = [part for part in get_args(kind) if part is not Ellipsis] or [None]
        return [resolve_files(item, kinds[min(i, len(kinds) - 1)], folder) for i, item in enumerate(value)]
    return value
