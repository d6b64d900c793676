"""The match that a RESULT folder was written by: its options and landmark files, for a studio that opens it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cagemap.errors import FormatError, ParameterError
from cagemap.files import INVERT_PREFIX
from cagemap.files.ownership import is_own
from cagemap.files.result.manifest import MANIFEST, REMEDY, input_file
from cagemap.files.schema import ResultRecord
from cagemap.tasks.job_file import JOB
from cagemap.tasks.masks import mask_file
from cagemap.tasks.match_parts import EACH, MATERIAL
from cagemap.tasks.requests.catalogue import Key, Value, request_of
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.options import option_fields

# Fields of a match that the page's form takes over.
MASK_FIELDS = ("target_mask", "source_mask")
FORM_FIELDS = (
    *("level", "vertices", "trust_landmarks", "boundary", "uv_interpolation", "creasing"),
    *(*MASK_FIELDS, "mask_edge", "target_uv_set", "source_uv_set"),
)
LANDMARK_FILES = ("landmarks", "target_points", "source_points", "curves")
LANDMARK_FIELDS = (*LANDMARK_FILES, "exchange_landmarks")
# Fields whose values the files of the pair have; parts and welding tolerances are looked at one by one.
_OPENING_FIELDS = (
    *("scheme", "target_scheme", "source_scheme", "part", "target_part", "source_part"),
    *("weld", "target_weld", "source_weld"),
)
_TAKEN = {*FORM_FIELDS, *LANDMARK_FIELDS, *_OPENING_FIELDS, "answer", "cache"}
# Options that a manifest notes and the page does not have.
_RESEARCH_FIELDS = ("method", "symmetry", "target_vertices", "source_vertices")


@dataclass(frozen=True)
class RecordedMatch:
    """What the studio takes over from the match of a RESULT.

    Attributes
    ----------
    request : MatchRequest
        Options and files that are taken over; paths are absolute.
    lost : tuple of str
        Options that are not taken over, in words.
    notes : tuple of str
    """

    request: MatchRequest
    lost: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def form_values(self) -> dict[Key, Value]:
        """Options for the form that differ from the defaults."""
        values = {name: getattr(self.request, name) for name in FORM_FIELDS}
        return {("match", name): value for name, value in values.items() if value != getattr(MatchRequest, name)}

    @property
    def files(self) -> tuple[Path, ...]:
        """Landmark files and masks."""
        masks = [mask_file(getattr(self.request, name)) for name in MASK_FIELDS]
        named = [getattr(self.request, name) for name in LANDMARK_FILES]
        return tuple(path for path in (*named, *masks) if path is not None)

    @property
    def has_only_pairs(self) -> bool:
        """Whether all landmarks are in one file of pairs for this direction."""
        return not any(getattr(self.request, name) for name in LANDMARK_FIELDS if name != "landmarks")

    def without(self, *names: str) -> RecordedMatch:
        """The match with the defaults of some fields."""
        return replace(self, request=replace(self.request, **{name: getattr(MatchRequest, name) for name in names}))


def recorded_match(
    result: Path, manifest: dict[str, Any], record: ResultRecord, sides: Mapping[str, Path]
) -> RecordedMatch:
    """The match of a RESULT folder.

    Parameters
    ----------
    result : Path
    manifest : dict
    record : ResultRecord
        The manifest, checked.
    sides : mapping of str to Path
        Target and source.

    Raises
    ------
    FormatError
        If an option has an impossible value.
    """
    parameters, lost, notes = record.parameters, _lost_options(result, record.parameters), list[str]()
    names = (*FORM_FIELDS, "exchange_landmarks", "answer")
    values = {name: parameters[name] for name in names if parameters.get(name) is not None}
    for name in LANDMARK_FILES:
        if name in record.inputs:
            file = _recorded_file(result, manifest, record, name, notes)
            lost += [] if file else [f"{_flag(name)} {record.inputs[name].file} (there is no such file any more)"]
            values[name] = file
    for name in MASK_FIELDS:
        file = mask_file(text) if isinstance(text := values.get(name), str) else None
        if file is not None:
            found = next((entry for entry in record.inputs if entry.startswith(f"{name}_")), "")
            first = _recorded_file(result, manifest, record, found, notes) if found else None
            lost += [] if first else [f"{_flag(name)} {file.name} (there is no such file any more)"]
            inverted = INVERT_PREFIX if values[name].startswith(INVERT_PREFIX) else ""
            values[name] = f"{inverted}{first.with_name(file.name)}" if first else None
    if values.get("answer") and any(values.get(name) for name in LANDMARK_FILES):
        lost.append(f"{_flag('answer')} {values.pop('answer')} together with landmarks")
    if (values.get("target_points") is None) != (values.get("source_points") is None):  # one of them is lost
        values |= {"target_points": None, "source_points": None}
    if not any(values.get(name) for name in MASK_FIELDS):
        values.pop("mask_edge", None)
    try:
        request: MatchRequest = request_of("match", {**values, **sides, "output": result})  # type: ignore[assignment]
    except ParameterError as error:
        raise FormatError(f"{result / MANIFEST}: {error} {REMEDY}") from None
    return RecordedMatch(request, tuple(lost), tuple(notes))


def _recorded_file(
    result: Path, manifest: dict[str, Any], record: ResultRecord, name: str, notes: list[str]
) -> Path | None:
    """An input file where it was, with a note if it was changed since; None if there is none."""
    stated = record.inputs[name].path
    path = None if stated is None else (result / stated).resolve()
    if path is None or not path.is_file():
        return None
    if input_file(result, manifest, name) is None:
        notes.append(f"{path.name} was changed since {result.name} was computed; it is used as it is now")
    return path


def _lost_options(result: Path, parameters: Mapping[str, Any]) -> list[str]:
    """Options of the match that the page has no place for, in words."""
    defaults = {name: getattr(MatchRequest, name) for name in _RESEARCH_FIELDS}
    names = {name for name, default in defaults.items() if parameters.get(name, default) not in (default, None)}
    names |= _job_options(result) - _TAKEN
    lost = [_flag(name) + (f" {parameters[name]}" if name == "method" else "") for name in sorted(names)]
    parts = {parameters.get(f"{side}_part") for side in ("target", "source")}
    lost += [f"{_flag('part')} {word}" for word in (EACH, MATERIAL) if word in parts]
    weld = parameters.get("weld")
    return lost if weld in (None, "auto") else [*lost, f"{_flag('weld')} {weld}"]


def _job_options(result: Path) -> set[str]:
    """Names of the options that the RESULT's job file states; none if it was edited."""
    try:
        options = tomllib.loads((result / JOB).read_text(encoding="utf-8"))["options"] if is_own(result / JOB) else {}
        return set(options)
    except (OSError, ValueError, KeyError, TypeError):
        return set()


def _flag(name: str) -> str:
    """An option as it is typed; a research option as ``--set NAME``."""
    options = {field.name: option for field, _, option in option_fields(MatchRequest)}
    option = options.get(name)
    if option is None or not option.setting:
        return f"--{name.replace('_', '-')}" if option is None else option.flag(name)
    side, _, rest = name.partition("_")
    return f"--set {side}.{rest}" if side in ("target", "source") else f"--set {name}"
