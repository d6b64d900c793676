"""Records of cagemap's own JSON files, validated by type."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cagemap.errors import FormatError
from cagemap.files.ownership import is_own

MOST_LEVELS = 12
Name = Annotated[str, Field(pattern=r"^[^\x00]*$")]
Level = Annotated[int, Field(ge=0, le=MOST_LEVELS)]


class Record(BaseModel):
    """A record without type conversion and NaN; unknown entries are kept for newer versions."""

    # Validators are built on first use, since a match only writes records.
    model_config = ConfigDict(strict=True, extra="allow", allow_inf_nan=False, frozen=True, defer_build=True)


class SideRecord(Record):
    """A surface of a result."""

    name: Name
    scheme: dict[str, Any]
    level: Level
    material_names: list[str]


class FileVertexRecord(Record):
    """Number and coordinates of a vertex of a file; older results hold the number alone."""

    number: Annotated[int, Field(ge=0)]
    place: Annotated[list[float], Field(min_length=3, max_length=3)]


class SuspectRecord(Record):
    """A landmark pair that was left out."""

    name: str
    pair: Annotated[int, Field(ge=0)]
    message: str
    distance: float = 0.0
    nearest_vertex: FileVertexRecord | Annotated[int, Field(ge=0)] = 0
    source_vertex: FileVertexRecord | Annotated[int, Field(ge=0)] = 0
    evidence: str = ""


class LandmarkCheckRecord(Record):
    """Suspect landmarks and notes."""

    suspects: list[SuspectRecord] = []
    notes: list[str] = []


class ReadingRecord(Record):
    """One possible alignment of a match: its name, its cost, and pairs of landmarks to exchange."""

    name: str
    cost: float
    exchange: list[Annotated[list[int], Field(min_length=2, max_length=2)]] = []


class ConfidenceRecord(Record):
    """Confidence in a map without landmarks."""

    verdict: Literal["sure", "look at it", "two answers"]
    message: str
    signs: dict[str, float] | None = None
    deciding: Annotated[int, Field(ge=0)] | None = None
    file_vertex: FileVertexRecord | Annotated[int, Field(ge=0)] | None = None
    part: str = ""
    readings: Annotated[list[ReadingRecord], Field(min_length=1)]


class InputRecord(Record):
    """A file that a result was made from."""

    file: Name
    path: Name | None = None
    sha256: str


class TransferRecord(Record):
    """An output of a transfer; paths are relative to the RESULT folder."""

    kind: str
    output: Name
    image: Name | None = None
    mesh: Name | None = None
    tiles: list[int] = [0]


class CurveRecord(Record):
    """A pair of curves, and the distance by which the map misses it."""

    name: str
    mean: float
    worst: float


class QualityRecord(Record):
    """Figures of a map, see `cagemap.QualityFigures`; percentiles by number."""

    flipped_area: float | None = None
    coverage: float | None = None
    dirichlet: float | None = None
    trusted_area: float | None = None
    area_ratio_percentiles: dict[str, float | None] = {}
    aspect_ratio_percentiles: dict[str, float | None] = {}
    warnings: list[str] = []


class BasisRecord(Record):
    """Parameters of a surface's preparation, see `cagemap.BasisConfig`."""

    count: Annotated[int, Field(ge=1)]
    schedule: list[Annotated[int, Field(ge=0)]] | None = None
    accuracy: float | None = None
    literal: bool = False
    vertices: Annotated[int, Field(ge=1)] | None = None
    laplacian: Literal["mean", "alexa-wardetzky", "de-goes-butts-desbrun"] = "mean"
    stabilisation: Annotated[float, Field(gt=0)] = 1.0


class LevelMapRecord(Record):
    """Levels of target and source of a stored map."""

    target: Level
    source: Level


class ResultRecord(Record):
    """``manifest.json`` of a RESULT folder."""

    target: SideRecord
    source: SideRecord
    landmark_names: list[str]
    quality: QualityRecord | None = None
    landmark_check: LandmarkCheckRecord | None = None
    confidence: ConfidenceRecord | None = None
    curves: list[CurveRecord] = []
    notes: list[str] = []
    timings: dict[str, float | None] = {}
    inputs: dict[str, InputRecord] = {}
    transfers: list[TransferRecord] = []
    parameters: dict[str, Any] = {}
    bases: dict[str, BasisRecord] = {}
    level_maps: list[LevelMapRecord] = []
    versions: dict[str, str] = {}
    files: dict[str, str | None] = {}
    peak_memory_bytes: int | None = None
    written_by: str | None = None


class SurfaceRecord(Record):
    """The header of a prepared surface."""

    name: Name
    material_names: list[str]
    scheme: dict[str, Any]
    level: Level
    vertices: Annotated[int, Field(ge=1)]
    basis: BasisRecord
    bands: Annotated[int, Field(ge=1, le=MOST_LEVELS + 1)]


RecordType = TypeVar("RecordType", bound=Record)


def parse_record(kind: type[RecordType], entries: Any, path: Path, remedy: str) -> RecordType:
    """Entries of a file as a record; refuses invalid ones."""
    try:
        return kind.model_validate(entries)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"])) or "the whole file"
        lacks = "lacks" if first["type"] == "missing" else "has something else in"
        raise FormatError(f"{path}: {lacks} '{place}' ({first['msg']}). {remedy}") from error
    except RecursionError as error:
        raise FormatError(f"{path}: is nested too deeply. {remedy}") from error


def read_own_note(path: Path) -> Any:
    """Content of a JSON file that cagemap wrote for itself; None if missing or changed since."""
    try:
        return json.loads(path.read_text(encoding="utf-8")) if is_own(path) else None
    except (OSError, ValueError, RecursionError):
        return None


def to_json(value: Any) -> str:
    """A value as JSON text; arrays become lists, numbers that are not finite null, other types text."""
    return json.dumps(_plain(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {_plain(str(key)): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, str):  # names of files that are not UTF-8 have lone surrogates
        return value.encode("utf-8", "backslashreplace").decode()
    return value if isinstance(value, int | float | bool | None) else _plain(str(value))


def parse_json(text: str, path: Path, remedy: str) -> Any:
    """The value of a JSON text; errors name the file."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: cannot be read ({error}). {remedy}") from error
