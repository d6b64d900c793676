"""The job file in a RESULT folder that repeats its commands: ``cagemap run RESULT/job.toml``."""

from __future__ import annotations

import logging
import re
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

import tomli_w

from cagemap.errors import FormatError
from cagemap.files import INVERT_PREFIX, LAYER_OPTION
from cagemap.files.atomic import one_at_a_time, write_whole
from cagemap.files.ownership import is_own, mark
from cagemap.files.result.manifest import stated, stated_path
from cagemap.tasks.masks import mask_file
from cagemap.tasks.requests.catalogue import WRITTEN

JOB = "job.toml"
# Fields of requests that are no options of a job: paths, and permission to overwrite.
_PLACES = ("target", "source", "result", "results", "output", "cache", "force")
_log = logging.getLogger(__name__)


def note_match(request: Any) -> None:
    """Write the job file of a match or map into its RESULT folder, unless it was edited."""
    folder: Path = request.output
    if (folder / JOB).exists() and not is_own(folder / JOB):
        _log.info("%s: was edited, so this match is not noted in it", folder / JOB)
        return
    paths = {"source": request.source, "target": request.target}
    names = {side: _asset_name(path) for side, path in paths.items()}
    if names["source"].casefold() == names["target"].casefold():
        names = {side: f"{name}-{side}" for side, name in names.items()}
    assets = [{"name": names[side], "file": stated_path(path, folder)} for side, path in paths.items()]
    options, pair = stated_options(request, folder), dict[str, Any](names)
    for name in ("landmarks", "map"):
        if name in options:
            pair[name] = options.pop(name)
    _write(folder / JOB, {"output": "again", "options": options, "assets": assets, "pairs": [pair]})


def note_output(command: str, folder: Path, request: Any) -> None:
    """Add or replace an output in the job file of its RESULT folder, unless it was edited."""
    place = folder / JOB
    if not place.is_file() or not is_own(place):
        _log.info("%s: is not there or was edited, so this %s is not noted in it", place, command)
        return
    options = stated_options(request, folder)
    options |= {
        name: _path_in_pair(getattr(request, name), folder) for name in WRITTEN.get(command, ()) if name in options
    }
    layer = options.get(LAYER_OPTION, "")
    if layer.lower().endswith(".usdc"):  # which several outputs of a job cannot share, see `cagemap.jobs.plan`
        options[LAYER_OPTION] = f"{layer[:-1]}a"
    entry = {"command": command, "output": _path_in_pair(request.output, folder), **options}
    files = {entry[name] for name in ("output", *WRITTEN.get(command, ())) if name in entry}
    with one_at_a_time(folder):
        data = tomllib.loads(place.read_text(encoding="utf-8"))
        outputs = [other for other in data.get("outputs", []) if other.get("output") not in files]
        kept = [_without(other, files - {entry.get(LAYER_OPTION)}) for other in outputs]  # each output adds to a layer
        _write(place, {**data, "outputs": [*kept, entry]})


def _path_in_pair(path: Path, folder: Path) -> str:
    """Where a job writes an output: files beside RESULT into the pair's folder, other folders below it.

    Files of different folders get different paths.
    """
    steps = [step for step in stated_path(path.parent, folder).split("/") if step != "."]
    levels = steps.count("..")
    start = {0: ["inside"], 1: []}.get(levels, [f"above{levels - 1}"])
    return "/".join([*start, *steps[levels:], path.name])


def _without(entry: dict[str, Any], files: set[str]) -> dict[str, Any]:
    """An output entry without options that write one of ``files``."""
    written = WRITTEN.get(entry.get("command", ""), ())
    return {name: value for name, value in entry.items() if name not in written or value not in files}


def stated_options(request: Any, folder: Path) -> dict[str, Any]:
    """Options that differ from the defaults, for TOML; paths are relative to the RESULT folder."""
    options = {}
    for field in fields(request):
        value = getattr(request, field.name)
        if field.name in _PLACES or value is None or value == field.default:
            continue
        # A mask is a name or a file: its suffix decides, not its type.
        file = mask_file(value) if field.name in ("target_mask", "source_mask") else None
        prefix = INVERT_PREFIX if file is not None and value.startswith(INVERT_PREFIX) else ""
        options[field.name] = stated(value, folder) if file is None else prefix + stated_path(file, folder)
    return options


def noted_options(folder: Path) -> dict[str, Any] | None:
    """Options of the match that the job file of a RESULT folder states; None if it is missing or was edited."""
    try:
        return dict(tomllib.loads((folder / JOB).read_text("utf-8"))["options"]) if is_own(folder / JOB) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _asset_name(path: Path) -> str:
    """A valid asset name from a mesh file's name."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", path.stem).strip("-._")[:60] or "model"


def _write(path: Path, data: dict[str, Any]) -> None:
    try:
        content = f"# {mark()}\n# Repeat: cagemap run {path.name}\n{tomli_w.dumps(data)}".encode()
    except UnicodeEncodeError:
        _log.warning("%s: is not written, for a file's name is no text, and a job file holds text alone", path)
        return
    try:
        write_whole(path, content)
    except FormatError as error:  # the result itself is written; its folder may be read-only
        _log.warning("%s What was done is not noted there.", error)
