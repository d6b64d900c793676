"""``manifest.json`` of a RESULT folder: what was matched, how, and what came of it, for people and programs."""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import sys
from collections.abc import Mapping
from functools import cache
from importlib import metadata, resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np

from cagemap import __version__
from cagemap.deform.placement import Placement
from cagemap.errors import FormatError
from cagemap.files.atomic import one_at_a_time, write_whole
from cagemap.files.meshes.arrays import CONTROL_ARRAYS
from cagemap.files.ownership import mark
from cagemap.files.schema import (
    BasisRecord,
    ConfidenceRecord,
    LandmarkCheckRecord,
    QualityRecord,
    ResultRecord,
    checked_record,
    parse_json,
    to_json,
)
from cagemap.files.text import read_text
from cagemap.maps.hypotheses.confidence import LOOK, SURE, Confidence
from cagemap.maps.hypotheses.signs import describe_signs
from cagemap.maps.landmarks.check import LandmarkCheck, LandmarkSuspect
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import QualityFigures
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import CagePoints, Landmarks
from cagemap.numerics.arrays import FloatArray
from cagemap.spectral import BasisConfig
from cagemap.spectral.config import MAP_BASIS

_log = logging.getLogger(__name__)

FORMAT = "cagemap-result"
FORMAT_VERSION = 1
MANIFEST = "manifest.json"
REMEDY = "Run `cagemap match` again."

_LIBRARIES = ("numpy", "scipy", "numba", "rslab", "OpenImageIO", "embreex", "xatlas")


def stated_path(path: str | Path, folder: str | Path) -> str:
    """How a manifest names a file: relative to the RESULT folder, so that both can be moved together.

    A file on another drive, which no relative path reaches, is named by its file name alone.
    """
    file, root = os.path.realpath(path), os.path.realpath(folder)
    try:
        return Path(os.path.relpath(file, root)).as_posix()
    except ValueError:
        return Path(file).name


def stated(value: Any, folder: str | Path) -> Any:
    """A value of a manifest or job file; paths in it, or in lists of it, by `stated_path`."""
    if isinstance(value, list | tuple):
        return [stated(item, folder) for item in value]
    return stated_path(value, folder) if isinstance(value, Path) else value


def stated_inputs(files: Mapping[str, Path], folder: Path) -> dict[str, dict[str, str]]:
    """How a manifest names what a result is made from: a file's name, its place, and the hash of its content.

    To be asked before the files are read: one that is replaced meanwhile is then told from what was read. Files that
    are none are for their readers to refuse.
    """
    return {
        name: {"file": path.name, "path": stated_path(path, folder), "sha256": file_hash(path)}
        for name, path in files.items()
        if path.is_file()
    }


def input_file(folder: str | Path, manifest: dict[str, Any], side: str) -> Path | None:
    """The mesh file that a result was made from, if it is still where it was and has not changed."""
    entry = (manifest.get("inputs") or {}).get(side) or {}
    path, digest = entry.get("path"), entry.get("sha256")
    if not isinstance(path, str) or not isinstance(digest, str):
        return None
    file = Path(folder) / path
    return file if file.is_file() and file_hash(file) == digest else None


def read_files(folder: str | Path, manifest: dict[str, Any]) -> list[Path]:
    """Every file that a result was made from, where it was then: no output may take its place."""
    entries = (manifest.get("inputs") or {}).values()
    return [Path(folder) / entry["path"] for entry in entries if isinstance(entry.get("path"), str)]


def file_hash(path: str | Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def mesh_hash(control: ControlMesh) -> str:
    """SHA-256 of a control mesh's arrays, for meshes that never were a file."""
    digest = hashlib.sha256()
    for name in CONTROL_ARRAYS:
        array = getattr(control, name)
        digest.update(f"{name}:{None if array is None else (array.dtype.str, array.shape)};".encode())
        digest.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def peak_memory() -> int | None:
    """Largest resident memory of this process so far, in bytes; None where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    usage = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(usage) * (1 if sys.platform == "darwin" else 1024)


def note_transfer(folder: str | Path, entry: dict[str, Any]) -> None:
    """Add to a result's manifest what was made with it: "kind", "output" and others; the same output replaces.

    Paths are noted by `stated_path`. A folder that cannot be written to is warned of.
    """
    root = Path(folder)
    entry = {name: stated(value, root) for name, value in entry.items()}
    with one_at_a_time(root):
        manifest = read_manifest(root)
        record = checked_record(ResultRecord, manifest, root / MANIFEST, REMEDY)
        kept = [one.model_dump(exclude_unset=True) for one in record.transfers if one.output != entry["output"]]
        manifest |= {"transfers": [*kept, entry], "written_by": mark()}
        try:
            write_whole(root / MANIFEST, to_json(manifest), force=True)
        except FormatError as error:  # the output itself is there; a RESULT may be somebody else's
            _log.warning("%s What was made with it is not noted there.", error)


def read_manifest(root: Path) -> dict[str, Any]:
    """What ``manifest.json`` of a RESULT folder holds."""
    path = root / MANIFEST
    if not path.is_file():
        found = f"no {MANIFEST} in it" if root.is_dir() else "a file" if root.exists() else "nothing of that name"
        raise FormatError(
            f"{root}: expected a result folder of `cagemap match`, found {found}. "
            "Give the folder that was passed to `cagemap match -o`."
        )
    manifest = parse_json(read_text(path, "the manifest of a result"), path, REMEDY)
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise FormatError(f'{path}: expected "format": "{FORMAT}", so this is not a result of `cagemap match`.')
    version = manifest.get("format_version")
    if not isinstance(version, int) or isinstance(version, bool) or not 1 <= version <= FORMAT_VERSION:
        versions = manifest.get("versions")
        written = versions.get("cagemap", "another version") if isinstance(versions, dict) else "another version"
        raise FormatError(
            f"{path}: format version {version}, this cagemap {__version__} reads up to {FORMAT_VERSION}. "
            f"Use cagemap {written} or newer, or run `cagemap match` again."
        )
    return manifest


def written_with() -> dict[str, Any]:
    """Entries of a manifest that say what wrote it."""
    return {
        "written_by": mark(),
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "versions": {"cagemap": __version__, "python": platform.python_version(), **_library_versions()},
    }


@cache
def _library_versions() -> dict[str, str]:
    versions = {}
    for name in _LIBRARIES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions


def stored_basis(record: BasisRecord | None, count: int | None) -> BasisConfig:
    """How a surface was prepared; of a result that does not say, with as many functions as it has eigenvalues."""
    if record is None:
        return MAP_BASIS if not count else BasisConfig(count=count)
    schedule = None if record.schedule is None else tuple(record.schedule)
    accuracy = BasisConfig.accuracy if record.accuracy is None else record.accuracy  # None in older results
    return BasisConfig(
        record.count, schedule, accuracy, record.literal, record.vertices, record.laplacian, record.stabilisation
    )


def stored_landmarks(names: list[str], points: tuple[CagePoints, CagePoints], meshes: tuple[str, str]) -> Landmarks:
    """Landmarks at points of both meshes; without names they are numbered."""
    titles = tuple(names) or tuple(f"pair {i}" for i in range(len(points[0].corners)))
    return Landmarks.of_points(titles, *points, *meshes)


def stored_check(record: LandmarkCheckRecord | None, errors: FloatArray) -> LandmarkCheck:
    """What was found about landmarks, whose errors (p,) are those of all pairs."""
    if record is None:
        return LandmarkCheck()
    suspects = tuple(
        LandmarkSuspect(s.name, s.pair, float(errors[s.pair]), s.nearest_vertex, s.source_vertex, s.evidence)
        for s in record.suspects
    )
    return LandmarkCheck(suspects, tuple(record.notes))


def stored_quality(
    record: QualityRecord | None, check: LandmarkCheck, errors: FloatArray, trust: FloatArray
) -> QualityFigures:
    """Figures of a map, whose landmark errors (p,) are those of all pairs."""
    trusted = np.setdiff1d(np.arange(len(errors)), [suspect.pair for suspect in check.suspects])
    summary: dict[str, Any] = {} if record is None else record.model_dump()
    return QualityFigures.of_summary(summary, errors[trusted], trust)


def stored_confidence(
    record: ConfidenceRecord | None, answer: PointMap, controls: int, others: FloatArray
) -> Confidence | None:
    """The verdict on an answer; no longer sure where a sign is beyond the bound of now, or none was written.

    ``controls``: control vertices n_0 of the target.
    ``others``: (r, n_0, 3), where the other answers put them, in the file's lengths.
    """
    if record is None:
        return None
    places = [answer.images.at(slice(controls)).positions, *(answer.source.scale * other for other in others)]
    nowhere = np.zeros((0, 3))
    answers = tuple(
        Placement(
            places[i] if i < len(places) else nowhere,
            1e-4 * stored.cost,
            name=stored.name,
            exchange=tuple((a, b) for a, b in stored.exchange),
        )
        for i, stored in enumerate(record.readings)
    )
    doubtful = record.verdict == SURE and (record.signs is None or describe_signs(record.signs))
    verdict = LOOK if doubtful else record.verdict
    return Confidence(verdict, answers, record.signs or {}, record.deciding, record.file_vertex, record.part)


# Mean distance, of sqrt(area), from which a curve counts as missed.
_CURVE_MISSED = 0.005


def assurance(manifest: dict[str, Any]) -> str:
    """What a manifest says of a map with few landmarks or none that is sure, which warns of nothing; else nothing."""
    confidence = manifest.get("confidence") or {}
    return str(confidence.get("message", "")) if confidence.get("verdict") == SURE else ""


def landmark_messages(manifest: dict[str, Any]) -> list[str]:
    """What a manifest warns of about landmarks: a map that is not sure without them, what is left out or missed."""
    check, confidence = manifest.get("landmark_check") or {}, manifest.get("confidence") or {}
    doubt = [str(confidence["message"])] if "message" in confidence and not assurance(manifest) else []
    left_out = [str(suspect["message"]) for suspect in check.get("suspects", [])]
    missed = [
        f"curve '{curve['name']}' is missed by {100 * curve['mean']:.1f} % of the model's size (at most "
        f"{100 * curve['worst']:.0f} %): it contradicts other landmarks or the shapes; look at it in the report"
        for curve in manifest.get("curves") or []
        if curve["mean"] > _CURVE_MISSED
    ]
    return doubt + left_out + missed + list(map(str, check.get("notes", [])))


@cache  # the code that runs is that of the start
def code_version() -> str:
    """Version of the package and 16 hexadecimal digits that change with any of its Python files."""
    digest = hashlib.sha256()
    for name, content in _sources(resources.files("cagemap"), ""):
        digest.update(f"{name}:{len(content)};".encode())
        digest.update(content)
    return f"{__version__}+{digest.hexdigest()[:16]}"


def _sources(folder: Traversable, prefix: str) -> list[tuple[str, bytes]]:
    """Name and content of the Python files below a folder, in the order of their names."""
    found: list[tuple[str, bytes]] = []
    for entry in sorted(folder.iterdir(), key=lambda item: item.name):
        if entry.is_dir():
            found += _sources(entry, f"{prefix}{entry.name}/")
        elif entry.name.endswith(".py"):
            found.append((prefix + entry.name, entry.read_bytes()))
    return found
