"""Checks of job files: all problems at once, each with its line and a remedy."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

from pydantic import ValidationError

from cagemap.errors import wrong_values
from cagemap.files import INVERT_PREFIX
from cagemap.files.images.image import texture_files
from cagemap.jobs.job_schema import (
    ALL_ASSETS,
    MAP_OPTIONS,
    PLACEHOLDER,
    Asset,
    CommandOptions,
    JobFile,
    PairRule,
    asset_names,
)

KeyPath = tuple[str | int, ...]
# Of a file's or folder's name: 255 on most file systems, less what temporary names add.
MAX_NAME_BYTES = 240


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


# Entry, and what is wrong with it and what to do.
JobProblem = tuple[KeyPath, str]


def parse_job(data: Any) -> tuple[JobFile | None, list[JobProblem]]:
    """The job file without invalid entries, None if that is impossible; and the problems."""
    try:
        return JobFile.model_validate(data), []
    except ValidationError as error:
        problems = wrong_values(error)
    key_paths = [key_path for key_path, _ in problems]
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


def find_problems(job: JobFile, folder: Path, commands: Mapping[str, CommandOptions]) -> Iterator[JobProblem]:
    """Problems of a file that passes the schema: names, files, options."""
    names = [asset.name for asset in job.assets]
    folded = [name.casefold() for name in names]  # they name files, and some disks ignore capitals
    yield from _folder_problems(("output",), folder, job.output)
    for i, asset in enumerate(job.assets):
        if folded[i] in folded[:i]:
            yield ("assets", i, "name"), f"{asset.name!r} is taken. Give another name."
        yield from _missing(("assets", i, "file"), folder, asset.file)
        yield from _missing(("assets", i, "landmarks"), folder, asset.landmarks)
        for key, path in asset.files.items():
            if not _exists(folder / path):
                yield ("assets", i, "files", key), _MISSING.format(path)
    yield from _option_problems(job.options, commands["match"], ("options",), folder)
    for i, pair in enumerate(job.pairs):
        yield from _pair_problems(pair, i, names, folder)
        yield from _map_problems(pair, i, job.assets, folder)
        yield from _option_problems(pair.options, commands["match"], ("pairs", i, "options"), folder)
    sources = [asset for asset in job.assets if job.carry is not None and asset.name == job.carry.source]
    if job.carry is not None and not sources:
        yield ("carry", "source"), f"no asset is called {job.carry.source!r}. Check the name, or add it."
    elif sources and sources[0].landmarks is None:
        yield ("carry", "source"), f"{sources[0].name!r} has no landmarks. Give it a file: landmarks = ..."
    if job.carry is not None:
        yield from _folder_problems(("carry", "folder"), folder, job.carry.folder)
    file_names = {key for asset in job.assets for key in asset.files}
    for i, output in enumerate(job.outputs):
        options = {"output": output.output or "", **(output.model_extra or {})}
        for key, value in options.items():
            for side, name in (match for text in _texts(value) for match in PLACEHOLDER.findall(text)):
                if name and name not in file_names:
                    message = f"no asset has a file {name!r} for {{{side}.{name}}}. Add it to the files of an asset."
                    yield ("outputs", i, key), message
        command = commands[output.command]
        yield from _option_problems(output.model_extra or {}, command, ("outputs", i), folder)
        for name in ("output", *command.written):
            value = options.get(name)
            if isinstance(value, str) and (Path(value).is_absolute() or ".." in Path(value).parts):
                message = f"expected a name inside the pair's folder, got {value!r}. Give a name without '..'."
                yield ("outputs", i, name), message
            elif isinstance(value, str):
                yield from _too_long(("outputs", i, name), Path(PLACEHOLDER.sub(max(names, key=len), value)))


def _folder_problems(entry: KeyPath, folder: Path, path: Path) -> Iterator[JobProblem]:
    """Problems of a folder that is written."""
    yield from _too_long(entry, path)
    if os.path.isfile(folder / path):
        yield entry, f"expected a folder, got the file {path}. Give another name."


def _too_long(entry: KeyPath, path: Path) -> Iterator[JobProblem]:
    """A problem if no file system has room for a name of a path that is written."""
    if max(len(os.fsencode(part)) for part in path.parts or ("",)) > MAX_NAME_BYTES:
        yield entry, f"{max(path.parts, key=len)!r} is too long. Give a shorter name."


def _pair_problems(pair: PairRule, i: int, names: list[str], folder: Path) -> Iterator[JobProblem]:
    if (pair.tree is None) == (pair.source is None and pair.target is None):
        yield ("pairs", i), "expected source and target, or tree. Give one of them."
    elif pair.tree is None and (pair.source is None or pair.target is None):
        yield ("pairs", i), "expected both source and target. Add the other one, or 'all'."
    for side in ("source", "target", "tree"):
        for name in asset_names(getattr(pair, side), names):
            if name not in names:
                yield ("pairs", i, side), f"no asset is called {name!r}. Check the name, or add it."
    named = {name for side in (pair.source, pair.target, pair.tree) for name in asset_names(side, names)}
    if len(named) == 1:
        yield ("pairs", i), f"expected two different assets, got {named.pop()!r} alone. Name another one."
    yield from _missing(("pairs", i, "landmarks"), folder, pair.landmarks)


def _map_problems(pair: PairRule, i: int, assets: list[Asset], folder: Path) -> Iterator[JobProblem]:
    """Problems of a given map: needs one pair of unchanged meshes, takes only `MAP_OPTIONS`."""
    if pair.map is None:
        return
    entry = ("pairs", i, "map")
    yield from _missing(entry, folder, pair.map)
    if any(not isinstance(side, str) or side == ALL_ASSETS for side in (pair.source, pair.target)):
        yield entry, "expected one source and one target. Name them, one map for each pair."
    if pair.landmarks is not None or set(pair.options) - set(MAP_OPTIONS):
        listed = ", ".join(MAP_OPTIONS)
        yield entry, f"a map that is given takes {listed} only. Remove the landmarks and other options."
    for asset in assets:
        if asset.name in (pair.source, pair.target) and (asset.part or asset.scheme or asset.weld):
            yield entry, f"{asset.name!r} has a part, a scheme or a weld. Name a file that is the whole mesh."


_MISSING = "{} does not exist. Check the path."


def _missing(entry: KeyPath, folder: Path, file: Path | None) -> Iterator[JobProblem]:
    if file is not None and not os.path.isfile(folder / file):
        yield entry, _MISSING.format(file)


def _option_problems(
    options: dict[str, Any], command: CommandOptions, key_path: KeyPath, folder: Path
) -> Iterator[JobProblem]:
    """Problems of a command's options, and missing files that they name, but for those that are written.

    Names with placeholders are not checked.
    """
    try:
        command.schema.model_validate(options)
    except ValidationError as error:
        yield from (((*key_path, *entry), text) for entry, text in wrong_values(error))
    for name, value in options.items():
        kind = command.kinds.get(name)
        for text, resolved in zip(_texts(value), _texts(resolve_files(value, kind, folder)), strict=True):
            is_file = name not in command.written and (resolved != text or (kind is Path and Path(text).is_absolute()))
            if is_file and "{" not in text and not _exists(Path(resolved.removeprefix(INVERT_PREFIX))):
                yield (*key_path, name), _MISSING.format(text)


def _exists(path: Path) -> bool:
    """Whether a file, a folder or a tile of a set exists; no error for names that are too long."""
    return os.path.exists(path) or any(os.path.isfile(file) for file in texture_files(path))


def _texts(value: Any) -> list[str]:
    """The texts in an option's value."""
    if isinstance(value, list):
        return [text for item in value for text in _texts(item)]
    return [value] if isinstance(value, str) else []


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
