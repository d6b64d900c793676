"""Job files: pairs to match, options and outputs; validated before anything starts (docs/jobs.md)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cagemap.errors import FormatError
from cagemap.files.ownership import is_own
from cagemap.files.text import read_toml
from cagemap.jobs.job_checks import find_line, find_problems, parse_job, resolve_files
from cagemap.jobs.job_schema import Asset, CarryRule, CommandOptions, JobFile, OutputRule, PairRule, command_options
from cagemap.mesh.mesh_report import count_noun

# Of one message.
MAX_LISTED_PROBLEMS = 50
# Fields of commands' requests that are not options: other tables of the job file or its results decide them.
EXCLUDED_FIELDS = {
    "match": ("target", "source", "output", "cache"),
    "transfer": ("result", "output"),
    "wrap": tuple(
        "results output target source landmarks map scheme target_scheme source_scheme weld target_weld "
        "source_weld".split()
    ),
    "report": ("result", "output"),
}


@dataclass(frozen=True)
class Job:
    """A validated job file; all paths are absolute."""

    path: Path  # the job file
    output: Path  # folder of all results
    assets: dict[str, Asset]
    pairs: tuple[PairRule, ...]  # their options include those of the whole job
    outputs: tuple[OutputRule, ...]
    commands: dict[str, CommandOptions]
    carry: CarryRule | None = None


def read_job(
    path: str | Path, requests: Mapping[str, type], written: Mapping[str, tuple[str, ...]] = MappingProxyType({})
) -> Job:
    """Read and validate a job file; one error lists all problems with lines and remedies.

    ``requests``: of each command; its fields are the options.
    ``written``: options that name further output files, which are written to the pair's folder.
    """
    file = Path(path)
    try:
        text, data = read_toml(file, "a job file")
    except FormatError as error:
        inside = f" {file / 'job.toml'} is one." if os.path.isfile(file / "job.toml") else ""
        raise FormatError(f"{error}{inside}") from None
    parsed, problems = parse_job(data)
    commands = {
        name: command_options(request, EXCLUDED_FIELDS[name], written.get(name, ()))
        for name, request in requests.items()
    }
    if parsed is not None:
        problems += find_problems(parsed, file.resolve().parent, commands)
    if problems or parsed is None:
        lines = sorted(
            (find_line(text, key_path), f"{'.'.join(map(str, key_path)) or 'the file'}: {message}")
            for key_path, message in problems
        )
        listing = "\n".join(f"  line {line}: {message}" for line, message in lines[:MAX_LISTED_PROBLEMS])
        more = f"\n  and {len(lines) - MAX_LISTED_PROBLEMS} more" if len(lines) > MAX_LISTED_PROBLEMS else ""
        raise FormatError(f"{file}: {count_noun(len(lines), 'problem')}; nothing was started.\n{listing}{more}")
    return _resolve_paths(file, parsed, commands)


def _resolve_paths(path: Path, job: JobFile, commands: dict[str, CommandOptions]) -> Job:
    """Make paths absolute against the job file's folder; merge the job's options into each pair's."""
    folder = path.resolve().parent

    def resolve(file: Path | None) -> Path | None:
        return None if file is None else folder / file

    def options(pair: PairRule) -> dict[str, Any]:
        merged = {**job.options, **pair.options}
        return {name: resolve_files(value, commands["match"].kinds[name], folder) for name, value in merged.items()}

    carry = None if job.carry is None else job.carry.model_copy(update={"folder": folder / job.carry.folder})

    def landmarks(asset: Asset) -> Path | None:
        """The asset's own landmarks, else carried ones that the user has corrected."""
        carried = None if carry is None or asset.name == carry.source else carry.folder / f"{asset.name}.json"
        corrected = carried is not None and carried.is_file() and not is_own(carried)
        return carried if corrected and asset.landmarks is None else resolve(asset.landmarks)

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
        pair.model_copy(
            update={"landmarks": resolve(pair.landmarks), "map": resolve(pair.map), "options": options(pair)}
        )
        for pair in job.pairs
    )
    return Job(path.resolve(), folder / job.output, assets, pairs, tuple(job.outputs), commands, carry)
