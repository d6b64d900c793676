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

    [carry]                              # landmarks of one model travel to all others, see `cagemap.jobs.carry`
    source = "zebra"
    folder = "landmarks"                 # NAME.json for every other model, beside the job file
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_type_hints

from cagemap.errors import FormatError
from cagemap.files.ownership import is_own
from cagemap.files.text import require_file
from cagemap.jobs.job_checks import absolute, line_of, parsed_file, problems_of
from cagemap.jobs.job_schema import Asset, CarryRule, JobFile, OutputRule, PairRule, options_schema
from cagemap.mesh.mesh_report import counted

# Problems that are told at most.
_SHOWN = 50
# What requests of commands hold that a job file says by other means, or that its folder of results settles.
_PLACES = {
    "match": ("target", "source", "output", "cache"),
    "transfer": ("result", "output"),
    "wrap": (
        "results",
        "output",
        "target",
        "source",
        "landmarks",
        "scheme",
        "target_scheme",
        "source_scheme",
        "weld",
        "target_weld",
        "source_weld",
    ),
    "report": ("result", "output"),
}


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
    kinds : dict of str to dict
        Type of every option of every command.
    carry : CarryRule, optional
    written : mapping of str to tuple of str
        Options of each command that name files to write beside its output.
    """

    path: Path
    output: Path
    assets: dict[str, Asset]
    pairs: tuple[PairRule, ...]
    outputs: tuple[OutputRule, ...]
    kinds: dict[str, dict[str, Any]]
    carry: CarryRule | None = None
    written: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def read_job(
    path: str | Path, commands: Mapping[str, type], written: Mapping[str, tuple[str, ...]] | None = None
) -> Job:
    """Read and validate a job file; every problem is named at once, with its line and what to do.

    Parameters
    ----------
    path : path
    commands : mapping of str to dataclass
        What each command of cagemap can be asked: "match" and those that outputs name. Field names are option names.
    written : mapping of str to tuple of str, optional
        Options of each command that name files to write beside its output; they go to the pair's folder like it.

    Raises
    ------
    FormatError
        If the file cannot be read or anything in it is wrong.
    """
    file = Path(path)
    try:
        require_file(file, "a job file")
        text = file.read_bytes().decode("utf-8")
        data = tomllib.loads(text)
    except FormatError as error:
        inside = f" {file / 'job.toml'} is one." if (file / "job.toml").is_file() else ""
        raise FormatError(f"{error}{inside}") from None
    except RecursionError:
        raise FormatError(f"{file}: expected a TOML file, got brackets within brackets without end.") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise FormatError(f"{file}: expected a TOML file, got a mistake in it: {error}.") from None
    parsed, problems = parsed_file(data)
    kinds = {name: get_type_hints(request) for name, request in commands.items()}
    if parsed is not None:
        schemas = {name: options_schema(request, _PLACES[name]) for name, request in commands.items()}
        problems += problems_of(parsed, file.parent, schemas, kinds, written or {})
    if problems or parsed is None:
        lines = sorted((line_of(text, place), message) for place, message in problems)
        listed = "\n".join(f"  line {line}: {message}" for line, message in lines[:_SHOWN])
        more = f"\n  and {len(lines) - _SHOWN} more" if len(lines) > _SHOWN else ""
        raise FormatError(f"{file}: {counted(len(lines), 'problem')}; nothing was started.\n{listed}{more}")
    return replace(_resolved(file, parsed, kinds), written=written or {})


def _resolved(path: Path, job: JobFile, kinds: dict[str, dict[str, Any]]) -> Job:
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
        pair.model_copy(update={"landmarks": placed(pair.landmarks), "map": placed(pair.map), "options": options(pair)})
        for pair in job.pairs
    )
    return Job(path.resolve(), folder / job.output, assets, pairs, tuple(job.outputs), kinds, carry)
