"""Tasks of a job: their dependencies, outputs, and keys of all inputs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from cagemap.errors import FormatError
from cagemap.files import INVERT_PREFIX, LAYER_OPTION
from cagemap.files.images.image import texture_files
from cagemap.files.meshes.formats import referred_files
from cagemap.files.result.folder import ARRAYS
from cagemap.files.result.manifest import file_hash
from cagemap.jobs.job import Job
from cagemap.jobs.job_checks import resolve_files
from cagemap.jobs.job_schema import MAP_OPTIONS, Asset, OutputRule, asset_names, fill_placeholders

# Folder inside the output folder with prepared surfaces, notes of finished tasks and locks.
STATE_FOLDER = ".cagemap"
RESULT_FOLDER = "RESULT"
# Composed result of a pair with a doubtful map.
DETOUR_FOLDER = "RESULT-composed"
PICTURE_FILE = "picture.jpg"
# Options of a match that change a prepared surface, also with a side's name before them.
SURFACE_OPTIONS = frozenset(
    (
        "level vertices k schedule laplacian accuracy literal method parameter scheme boundary uv_interpolation "
        "creasing weld uv_set"
    ).split()
)
DEFAULT_OUTPUTS = {"report": "report.html", "wrap": "{target}.obj"}
PairNames = tuple[str, str]
Tree = Callable[[list[Asset]], list[PairNames]]


@dataclass(frozen=True)
class Task:
    """One task: it succeeds as a whole or counts as not done."""

    kind: str  # "prepare", "match", or the command of an output
    name: str  # unique in its plan, and stable from run to run
    key: str  # hash of the content of all inputs, the options and the version of the code
    needs: tuple[str, ...]  # names of tasks that must have succeeded before
    request: dict[str, Any] = field(repr=False)  # arguments of the command, paths as text
    outputs: tuple[str, ...] = ()  # files, patterns or folders that it writes, relative to the job's output folder
    pair: PairNames | None = None  # source and target
    predecessors: tuple[str, ...] = ()  # names of tasks that must have ended before, in success or failure
    # `content_hash` of the input files at planning
    input_hashes: dict[str, str] = field(default_factory=dict, repr=False)
    layer: str = ""  # the USD layer among its outputs, to which other tasks of the pair may add

    @property
    def slug(self) -> str:
        """A file name for the task."""
        letters = "".join(c if c.isalnum() or c in "-_." else "-" for c in self.name)
        return f"{letters[:80]}-{hashlib.sha256(self.name.encode()).hexdigest()[:8]}"


@dataclass(frozen=True)
class Plan:
    """All tasks of a job in an order that respects their needs."""

    root: Path  # the job's output folder
    tasks: tuple[Task, ...]
    pairs: tuple[PairNames, ...]  # source and target of every pair
    omitted_outputs: tuple[str, ...] = ()  # outputs that some pairs do not get, and why


def plan_job(job: Job, version: str, tree: Tree) -> Plan:
    """Plan the tasks of a job; results of another ``version`` of the code are not reused."""
    planner = _Planner(job, version)
    tasks: dict[str, Task] = {}
    omitted_outputs: list[str] = []
    pairs: dict[PairNames, dict[str, Any]] = {}
    for rule in job.pairs:
        for pair in _rule_pairs(rule.source, rule.target, rule.tree, job, tree):
            files = {"landmarks": rule.landmarks, "map": rule.map}
            options = {**rule.options, **{name: str(file) for name, file in files.items() if file is not None}}
            if pairs.setdefault(pair, options) != options:
                raise FormatError(
                    f"{job.path}: {pair[0]} -> {pair[1]} is asked for twice with different options. Keep one of them."
                )
    _require_own_folders(job, pairs)
    for pair, options in pairs.items():
        source, target = (job.assets[name] for name in pair)
        sides = [("target", target), ("source", source)]
        if "map" in options:
            sides, options = [], {name: options[name] for name in ("map", *MAP_OPTIONS) if name in options}
        if any(asset.part for _, asset in sides) or any(name.endswith("part") for name in options):
            sides = []  # parts are known only when both meshes have been read
        surfaces = [planner.prepare(asset, side, options) for side, asset in sides]
        match = planner.match(source, target, options, surfaces)
        picture = planner.picture(match)
        tasks |= {task.name: task for task in (*surfaces, match, picture)}
        earlier: list[Task] = []
        for output_rule in sorted(job.outputs, key=lambda rule: rule.command == "report"):
            task = planner.output(output_rule, source, target, match, earlier)
            if isinstance(task, str):
                omitted_outputs.append(task)
                continue
            overlap = next(
                (path for other in earlier for path in other.outputs if not _may_share(path, task, other)), ""
            )
            if overlap or task.name in tasks:
                are_layers = overlap and overlap == task.layer and any(other.layer == overlap for other in earlier)
                raise FormatError(
                    f"{job.path}: two outputs of {pair[0]} -> {pair[1]} write {overlap or task.outputs[0]}. "
                    f"Rename one{', or name a .usda file, to which both can add' if are_layers else ''}."
                )
            if set(picture.outputs) & set(task.outputs):
                raise FormatError(
                    f"{job.path}: an output of {pair[0]} -> {pair[1]} is called {PICTURE_FILE}, as the job's own "
                    "picture of each pair is. Rename it."
                )
            earlier.append(task)
            tasks[task.name] = task
    return Plan(job.output, tuple(tasks.values()), tuple(pairs), tuple(omitted_outputs))


def pair_folder(pair: PairNames) -> str:
    """Folder of a pair's files, in the job's output folder."""
    source, target = pair
    return f"{source}__{target}"


def _require_own_folders(job: Job, pairs: Iterable[PairNames]) -> None:
    """Refuse pairs with one folder, on disks too that do not tell capitals from small letters."""
    pair_of: dict[str, PairNames] = {}
    for pair in pairs:
        other = pair_of.setdefault(pair_folder(pair).casefold(), pair)
        if other != pair:
            raise FormatError(
                f"{job.path}: {other[0]} -> {other[1]} and {pair[0]} -> {pair[1]} would be written to one folder, "
                f"{pair_folder(pair)}. Rename one of these assets."
            )


def _may_share(path: str, task: Task, earlier: Task) -> bool:
    """Whether a task may write a file of an earlier one: both add to it as a layer. A .usdc has no mark of cagemap."""
    return path not in task.outputs or (path == task.layer == earlier.layer and not path.lower().endswith(".usdc"))


def _rule_pairs(
    source: str | list[str] | None, target: str | list[str] | None, among: str | list[str] | None, job: Job, tree: Tree
) -> Iterator[PairNames]:
    """Source and target of every pair of a rule, without pairs of one asset."""
    names = list(job.assets)
    if among is not None:
        yield from tree([job.assets[name] for name in dict.fromkeys(asset_names(among, names))])
        return
    for source_name in asset_names(source, names):
        for target_name in asset_names(target, names):
            if source_name != target_name:
                yield source_name, target_name


def content_hash(path: str) -> str:
    """Names and hashes of a file and the files that a mesh refers to, a set of tiles, or a folder; the path if missing.

    Names count: they are names of shapes and numbers of tiles.
    """
    files = sorted(Path(path).iterdir()) if Path(path).is_dir() else texture_files(path)
    files = [file for file in files if file.is_file()]
    referred = [other for file in files for other in referred_files(file)]
    return " ".join(f"{file.name} {file_hash(file)}" for file in [*files, *referred]) or path


@dataclass(frozen=True)
class _FileHashes:
    """Hashes of files; each file is read once."""

    of: Callable[[str], str] = field(default_factory=lambda: cache(content_hash))

    def of_value(self, value: Any) -> Any:
        """A value, such as a request, with files replaced by their hashes; ``not:`` before a mask stays."""
        if isinstance(value, dict):
            return {name: self.of_value(item) for name, item in value.items()}
        if isinstance(value, list):
            return [self.of_value(item) for item in value]
        return value.replace(file, self.of(file)) if (file := _file_in(value)) else value

    def files_in(self, value: Any) -> dict[str, str]:
        """Files in a value, such as a request, and their hashes."""
        if isinstance(value, dict | list):
            items = value.values() if isinstance(value, dict) else value
            return {path: content for item in items for path, content in self.files_in(item).items()}
        file = _file_in(value)
        return {file: self.of(file)} if file and self.of(file) != file else {}


def _file_in(value: Any) -> str:
    """The absolute path in an option's value; empty for other values."""
    file = value.removeprefix(INVERT_PREFIX) if isinstance(value, str) else ""
    return file if Path(file).is_absolute() else ""


def task_key(version: str, kind: str, *parts: Any) -> str:
    """Hash of the code's version and of everything that a task depends on."""
    return hashlib.sha256(json.dumps([version, kind, *parts], sort_keys=True, default=str).encode()).hexdigest()


@dataclass(frozen=True)
class _Planner:
    """Makes the tasks of one job."""

    job: Job
    version: str
    hashes: _FileHashes = field(default_factory=_FileHashes)

    @property
    def cache(self) -> str:
        """Folder of prepared surfaces."""
        return str(self.job.output / STATE_FOLDER / "surfaces")

    def prepare(self, asset: Asset, side: str, options: dict[str, Any]) -> Task:
        """The task of one surface; equal preparation for both sides gives the same task."""
        choices = {name: value for name, value in options.items() if name.removeprefix(f"{side}_") in SURFACE_OPTIONS}
        for name, value in (("scheme", asset.scheme), ("weld", asset.weld)):
            if value is not None and f"{side}_{name}" not in options:
                choices[name] = value
        side = side if any(name.startswith(f"{side}_") for name in choices) else "target"
        request = {"asset": asset.name, "file": str(asset.file), "side": side, "options": choices}
        key = task_key(self.version, "prepare", self.hashes.of(str(asset.file)), side, choices)
        input_hashes, request = self.hashes.files_in(request), {**request, "cache": self.cache}
        return Task("prepare", f"prepare {asset.name} {key[:8]}", key, (), request, input_hashes=input_hashes)

    def match(self, source: Asset, target: Asset, options: dict[str, Any], needs: list[Task]) -> Task:
        """The task of a pair's map."""
        folder = f"{pair_folder((source.name, target.name))}/{RESULT_FOLDER}"
        sides = ("target", target), ("source", source)
        inputs: dict[str, Any] = {"target": str(target.file), "source": str(source.file)}
        inputs |= {f"{side}_scheme": asset.scheme for side, asset in sides if asset.scheme is not None}
        inputs |= {f"{side}_weld": asset.weld for side, asset in sides if asset.weld is not None}
        inputs |= {f"{side}_part": asset.part for side, asset in sides if asset.part}
        inputs |= options
        own_points = {"landmarks", "map", "target_points", "source_points"} & set(options)
        if not own_points and source.landmarks is not None and target.landmarks is not None:
            inputs |= {"target_points": str(target.landmarks), "source_points": str(source.landmarks)}
        key = task_key(self.version, "match", self.hashes.of_value(inputs), [task.key for task in needs])
        request = {**inputs, "output": str(self.job.output / folder)}
        request |= {} if "map" in options else {"cache": self.cache}
        pair, needed_names = (source.name, target.name), tuple(task.name for task in needs)
        title, input_hashes = f"match {pair[0]} -> {pair[1]}", self.hashes.files_in(inputs)
        return Task(
            "match", title, key, needed_names, request, (f"{folder}/{ARRAYS}",), pair, input_hashes=input_hashes
        )

    def picture(self, match: Task) -> Task:
        """The task of a pair's small picture on the job's page."""
        assert match.pair is not None
        source, target = match.pair
        folder = match.request["output"]
        request = {"result": folder, "output": str(Path(folder).parent / PICTURE_FILE)}
        key = task_key(self.version, "picture", match.key)
        file = f"{pair_folder(match.pair)}/{PICTURE_FILE}"
        return Task("picture", f"picture {source} -> {target}", key, (match.name,), request, (file,), match.pair)

    def output(self, rule: OutputRule, source: Asset, target: Asset, match: Task, earlier: list[Task]) -> Task | str:
        """The task of an output, or the reason why the pair does not get it.

        Outputs of a pair run one after the other, since each is noted in the pair's RESULT. A report depends on the
        outputs before it.
        """
        pair = f"{source.name} -> {target.name}"
        options: dict[str, Any] = {}
        command = self.job.commands[rule.command]
        name = rule.output or DEFAULT_OUTPUTS.get(rule.command) or f"{{target}}_{rule.command}.png"
        for option, value in {**(rule.model_extra or {}), "output": name}.items():
            filled = fill_placeholders(value, source, target)
            if filled is None:
                return f"{pair}: no {rule.command}, {value} is not among the asset's files"
            in_pair = option in ("output", *command.written)
            options[option] = filled if in_pair else resolve_files(filled, command.kinds[option], self.job.path.parent)
        files = {
            option: Path(pair_folder((source.name, target.name)), options.pop(option)).as_posix()
            for option in ("output", *command.written)
            if option in options
        }
        earlier_keys = [task.key for task in earlier] if rule.command == "report" else []
        key = task_key(
            self.version, rule.command, self.hashes.of_value(options), match.key, *sorted(files.items()), *earlier_keys
        )
        input_hashes, request = self.hashes.files_in(options), {**options, "result": match.request["output"]}
        request |= {option: str(self.job.output / file) for option, file in files.items()}
        title = f"{rule.command} {pair}: {files['output'].partition('/')[2]}"
        predecessors = tuple(task.name for task in earlier[-1:])
        return Task(
            rule.command,
            title,
            key,
            (match.name,),
            request,
            tuple(files.values()),
            match.pair,
            predecessors,
            input_hashes,
            files.get(LAYER_OPTION, ""),
        )
