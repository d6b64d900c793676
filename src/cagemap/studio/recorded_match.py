"""The match that a RESULT folder was written by: its options and landmark files, for a studio that opens it.

What the studio cannot repeat is listed (``lost``): the caller then keeps that RESULT and bakes into another folder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cagemap.errors import FormatError, ParameterError
from cagemap.files import INVERT_PREFIX
from cagemap.files.result.manifest import MANIFEST, REMEDY, input_file, stated_file
from cagemap.files.schema import ResultRecord
from cagemap.tasks.job_file import JOB, noted_options
from cagemap.tasks.masks import mask_file
from cagemap.tasks.match_parts import EACH, MATERIAL
from cagemap.tasks.requests.catalogue import Key, Value, request_of
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.options import option_fields
from cagemap.tasks.requests.settings import moved_options
from cagemap.tasks.subdivision import AUTO

# Fields of a match that the page's form takes over.
MASK_FIELDS = ("target_mask", "source_mask")
FORM_FIELDS = (
    *("level", "vertices", "trust_landmarks", "boundary", "uv_interpolation", "creasing"),
    *(*MASK_FIELDS, "mask_edge", "target_uv_set", "source_uv_set"),
)
LANDMARK_FILES = ("landmarks", "target_points", "source_points", "curves")
LANDMARK_FIELDS = (*LANDMARK_FILES, "exchange_landmarks")
_WELD_FIELDS = ("weld", "target_weld", "source_weld")
# Fields that are taken over or compared, here or where files are opened (schemes, parts); the cache changes nothing.
_KNOWN_FIELDS = {
    *(*FORM_FIELDS, *LANDMARK_FIELDS, *_WELD_FIELDS, "answer", "cache"),
    *("scheme", "target_scheme", "source_scheme", "part", "target_part", "source_part"),
}


@dataclass(frozen=True)
class RecordedMatch:
    """What the studio takes over from the match of a RESULT."""

    request: MatchRequest  # options and files that are taken over; paths are absolute
    # name of the chosen alignment of several that were possible (``--answer``); '' for the first one, or if landmarks
    # determined it
    answer_name: str = ""
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
        """Whether all landmarks, if any, are in one file of pairs, target and source as in the match."""
        return not any(getattr(self.request, name) for name in LANDMARK_FIELDS if name != "landmarks")

    def without_answer(self) -> RecordedMatch:
        """The match from the first alignment."""
        return replace(self.with_defaults_of("answer"), answer_name="")

    def with_defaults_of(self, *names: str) -> RecordedMatch:
        """The match with the defaults of some fields."""
        return replace(self, request=replace(self.request, **{name: getattr(MatchRequest, name) for name in names}))


def match_of_result(
    result: Path, manifest: dict[str, Any], record: ResultRecord, sides: Mapping[str, Path]
) -> tuple[RecordedMatch, list[str]]:
    """The match of a RESULT folder, and reasons why the studio cannot repeat it, in words.

    ``record``: the manifest, checked.
    ``sides``: target and source.
    FormatError if an option has an impossible value.
    """
    parameters, lost, notes = record.parameters, _lost_options(result, manifest, record), list[str]()
    names = (*FORM_FIELDS, *_WELD_FIELDS, "exchange_landmarks", "answer")
    values = {name: parameters[name] for name in names if parameters.get(name) is not None}
    for name in LANDMARK_FILES:
        if name in record.inputs:
            file = _recorded_file(result, manifest, name, notes)
            lost += [] if file else [f"{_flag(name)} {record.inputs[name].file} (there is no such file any more)"]
            values[name] = file
    for name in MASK_FIELDS:  # of the tiles of a mask the first is an input
        file = mask_file(text) if isinstance(text := values.get(name), str) else None
        if file is not None:
            found = next((entry for entry in record.inputs if entry.startswith(f"{name}_")), "")
            first = _recorded_file(result, manifest, found, notes) if found else None
            lost += [] if first else [f"{_flag(name)} {file.name} (there is no such file any more)"]
            inverted = INVERT_PREFIX if values[name].startswith(INVERT_PREFIX) else ""
            values[name] = f"{inverted}{first.with_name(file.name)}" if first else None
    if (values.get("target_points") is None) != (values.get("source_points") is None):  # one of the two is lost
        values |= {"target_points": None, "source_points": None}
    if not any(values.get(name) for name in MASK_FIELDS):
        values.pop("mask_edge", None)
    try:
        request: MatchRequest = request_of("match", {**values, **sides, "output": result})  # type: ignore[assignment]
    except ParameterError as error:
        raise FormatError(f"{result / MANIFEST}: {error} {REMEDY}") from None
    answers = () if record.confidence is None else number_duplicates([one.name for one in record.confidence.readings])
    name = "".join(answers[request.answer : request.answer + 1]) if request.answer else ""
    match = RecordedMatch(request, name, tuple(notes))
    if request.answer and (not name or any(getattr(request, file) for file in LANDMARK_FILES)):
        lost.append(f"{_flag('answer')} {request.answer}{' together with landmarks' if name else ''}")
        match = match.without_answer()
    return match, lost


def number_duplicates(names: Sequence[str]) -> tuple[str, ...]:
    """Names of answers, with a number after each repetition."""
    counts = [names[: i + 1].count(name) for i, name in enumerate(names)]
    return tuple(f"{name} ({count})" if count > 1 else name for name, count in zip(names, counts, strict=True))


def lost_welds(request: MatchRequest, welds: tuple[str | None, str | None]) -> list[str]:
    """Welding of a match that differs from how the studio welded target and source, in words."""
    lost = []
    for side, used in zip(("target", "source"), welds, strict=True):
        asked, flag = getattr(request, f"{side}_weld") or request.weld, _flag(f"{side}_weld")
        if asked not in (AUTO, used) and not (asked and used and float(asked) == float(used)):
            unasked = f"it was matched without {flag}; the studio welds within {used}"
            lost.append(f"{flag} {asked}" if asked else unasked)
    return lost


def _recorded_file(result: Path, manifest: dict[str, Any], name: str, notes: list[str]) -> Path | None:
    """An input file at its recorded place, with a note if it was changed since; None if it is not there."""
    path = stated_file(result, manifest, name)
    if path is not None and input_file(result, manifest, name) is None:
        notes.append(f"{path.name} was changed since {result.name} was computed; it is used as it is now")
    return None if path is None else path.resolve()


def _lost_options(result: Path, manifest: dict[str, Any], record: ResultRecord) -> list[str]:
    """Options of the match that the page has no place for, and other reasons why it cannot be repeated, in words."""
    parameters = record.parameters
    if "way" in manifest:
        return [f"it is composed of the maps {' -> '.join(map(str, reversed(manifest['way'])))}"]
    if not parameters:
        return ["it does not say how it was computed"]
    if "map" in record.inputs:
        return ["it is a map that `cagemap map` read from a file"]
    options = noted_options(result)
    if options is None:  # the manifest does not have all options
        return [f"its {JOB}, which has the options, was edited or is missing"]
    names = sorted(set(options) - _KNOWN_FIELDS)
    lost = [_flag(name) + (f" {options[name]}" if name == "method" else "") for name in names]
    parts = {parameters.get(f"{side}_part") for side in ("target", "source")}
    return lost + [f"{_flag('part')} {word}" for word in (EACH, MATERIAL) if word in parts]


def _flag(name: str) -> str:
    """An option as it is typed; a research option as ``--set NAME``."""
    flags = {field.name: option.flag(field.name) for field, _, option in option_fields(MatchRequest)}
    flag = flags.get(name, name)
    return moved_options(MatchRequest).get(flag, flag).partition("=")[0]
