"""``manifest.json`` of a RESULT folder: inputs, parameters and outcome of a match, for people and programs."""

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
from cagemap.files.meshes.formats import geometry_files
from cagemap.files.ownership import mark
from cagemap.files.schema import (
    BasisRecord,
    ConfidenceRecord,
    FileVertexRecord,
    LandmarkCheckRecord,
    QualityRecord,
    ResultRecord,
    parse_json,
    parse_record,
    to_json,
)
from cagemap.files.text import read_text
from cagemap.maps.hypotheses.confidence import LOOK, SURE, Confidence, describe_signs
from cagemap.maps.landmarks.check import LandmarkCheck, LandmarkSuspect
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import QualityFigures
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import FileVertex
from cagemap.numerics.arrays import FloatArray
from cagemap.spectral import BasisConfig
from cagemap.spectral.basis import MAP_BASIS

_log = logging.getLogger(__name__)

FORMAT = "cagemap-result"
MANIFEST_VERSION = 1
MANIFEST = "manifest.json"
REMEDY = "Run `cagemap match` again."

_LIBRARIES = ("numpy", "scipy", "numba", "rslab", "OpenImageIO", "embreex", "xatlas")


def stated_path(path: str | Path, folder: str | Path) -> str:
    """A file's path in a manifest: relative to the RESULT folder, so that both can be moved together.

    A file on another drive, which has no relative path, is stated by its name alone.
    """
    file, root = os.path.realpath(path), os.path.realpath(folder)
    try:
        return Path(os.path.relpath(file, root)).as_posix()
    except ValueError:
        return Path(file).name


def stated(value: Any, folder: str | Path) -> Any:
    """A value for a manifest or job file; paths, also in lists, by `stated_path`."""
    if isinstance(value, list | tuple):
        return [stated(item, folder) for item in value]
    return stated_path(value, folder) if isinstance(value, Path) else value


def stated_inputs(files: Mapping[str, Path], folder: Path) -> dict[str, dict[str, str]]:
    """Entries of a manifest for input files: name, path, and hash of the content.

    Compute them before the files are read, so that a file replaced meanwhile is detected. Missing files are skipped;
    readers report them.
    """
    return {
        name: {"file": path.name, "path": stated_path(path, folder), "sha256": _input_hash(path)}
        for name, path in files.items()
        if path.is_file()
    }


def stated_file(folder: str | Path, manifest: dict[str, Any], name: str) -> Path | None:
    """An input file of a result, changed or not; None if it was moved."""
    path = ((manifest.get("inputs") or {}).get(name) or {}).get("path")
    file = Path(folder) / path if isinstance(path, str) else None
    return file if file is not None and file.is_file() else None


def input_file(folder: str | Path, manifest: dict[str, Any], side: str) -> Path | None:
    """The mesh file that a result was made from; None if it was moved or changed."""
    file = stated_file(folder, manifest, side)
    if file is None or not isinstance(digest := manifest["inputs"][side].get("sha256"), str):
        return None
    # Manifests of older versions contain the hash of the mesh file only, without the files that it refers to.
    return file if file_hash(file) == digest or _input_hash(file) == digest else None


def _input_hash(path: Path) -> str:
    """SHA-256 of a file; of a mesh in several files (`geometry_files`), SHA-256 of the hashes of all."""
    others = geometry_files(path)
    hashes = [file_hash(file) for file in (path, *others)]
    return hashlib.sha256("".join(hashes).encode()).hexdigest() if others else hashes[0]


def read_files(folder: str | Path, manifest: dict[str, Any]) -> list[Path]:
    """All files that a result was made from, by their paths then; outputs must not replace them."""
    entries = (manifest.get("inputs") or {}).values()
    return [Path(folder) / entry["path"] for entry in entries if isinstance(entry.get("path"), str)]


def file_hash(path: str | Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def mesh_hash(control: ControlMesh) -> str:
    """SHA-256 of a control mesh's arrays, for meshes without a file."""
    digest = hashlib.sha256()
    for name in CONTROL_ARRAYS:
        array = getattr(control, name)
        digest.update(f"{name}:{None if array is None else (array.dtype.str, array.shape)};".encode())
        digest.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def peak_memory() -> int | None:
    """Peak resident memory of this process in bytes; None if the system does not report it."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    usage = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(usage) * (1 if sys.platform == "darwin" else 1024)


def note_transfer(folder: str | Path, entry: dict[str, Any]) -> None:
    """Add an output ("kind", "output", ...) to a result's manifest; replaces the entry of the same output.

    Paths are stated by `stated_path`. If the folder cannot be written, this only warns.
    """
    root = Path(folder)
    entry = {name: stated(value, root) for name, value in entry.items()}
    with one_at_a_time(root):
        manifest = read_manifest(root)
        record = parse_record(ResultRecord, manifest, root / MANIFEST, REMEDY)
        kept = [
            transfer.model_dump(exclude_unset=True)
            for transfer in record.transfers
            if transfer.output != entry["output"]
        ]
        manifest |= {"transfers": [*kept, entry], "written_by": mark()}
        try:
            write_whole(root / MANIFEST, to_json(manifest), force=True)
        except FormatError as error:  # the output is written; the RESULT may belong to another user
            _log.warning("%s What was made with it is not noted there.", error)


def read_manifest(root: Path) -> dict[str, Any]:
    """The content of a RESULT folder's ``manifest.json``."""
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
    if not isinstance(version, int) or isinstance(version, bool) or not 1 <= version <= MANIFEST_VERSION:
        versions = manifest.get("versions")
        written = versions.get("cagemap", "another version") if isinstance(versions, dict) else "another version"
        raise FormatError(
            f"{path}: format version {version}, this cagemap {__version__} reads up to {MANIFEST_VERSION}. "
            f"Use cagemap {written} or newer, or run `cagemap match` again."
        )
    return manifest


def version_entries() -> dict[str, Any]:
    """Entries of a manifest for its format, and for versions of cagemap, Python and libraries."""
    return {
        "written_by": mark(),
        "format": FORMAT,
        "format_version": MANIFEST_VERSION,
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
    """Parameters of a surface's basis; for old results without a record, the default with ``count`` functions."""
    if record is None:
        return MAP_BASIS if not count else BasisConfig(count=count)
    schedule = None if record.schedule is None else tuple(record.schedule)
    accuracy = BasisConfig.accuracy if record.accuracy is None else record.accuracy  # None in older results
    return BasisConfig(
        record.count, schedule, accuracy, record.literal, record.vertices, record.laplacian, record.stabilisation
    )


def stored_check(record: LandmarkCheckRecord | None, errors: FloatArray) -> LandmarkCheck:
    """The check of landmarks, with suspects' errors from those (p,) of all pairs."""
    if record is None:
        return LandmarkCheck()
    suspects = tuple(
        LandmarkSuspect(
            s.name,
            s.pair,
            float(errors[s.pair]),
            _file_vertex(s.nearest_vertex),
            _file_vertex(s.source_vertex),
            s.evidence,
        )
        for s in record.suspects
    )
    return LandmarkCheck(suspects, tuple(record.notes))


def _file_vertex(record: FileVertexRecord | int) -> FileVertex:
    if isinstance(record, int):
        return FileVertex(record)
    x, y, z = record.place
    return FileVertex(record.number, (x, y, z))


def stored_quality(
    record: QualityRecord | None, check: LandmarkCheck, errors: FloatArray, trust: FloatArray
) -> QualityFigures:
    """Quality figures of a map, with landmark errors from those (p,) of all pairs."""
    trusted = np.setdiff1d(np.arange(len(errors)), [suspect.pair for suspect in check.suspects])
    summary: dict[str, Any] = {} if record is None else record.model_dump()
    return QualityFigures.of_summary(summary, errors[trusted], trust)


def stored_confidence(
    record: ConfidenceRecord | None, answer: PointMap, controls: int, others: FloatArray
) -> Confidence | None:
    """The confidence in an answer; "sure" is withdrawn if a sign exceeds its present bound or none is stored.

    ``controls``: number n_0 of the target's control vertices.
    ``others``: (r, n_0, 3), positions in the other answers, in the file's units.
    """
    if record is None:
        return None
    places = [answer.images.at(slice(controls)).positions, *(answer.source.scale * positions for positions in others)]
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
    vertex = None if record.file_vertex is None else _file_vertex(record.file_vertex)
    return Confidence(verdict, answers, record.signs or {}, record.deciding, vertex, record.part)


# Mean distance, in units of sqrt(area), from which a curve counts as missed.
_CURVE_MISSED = 0.005


def sure_message(manifest: dict[str, Any]) -> str:
    """Message of a manifest that a map without enough landmarks is sure; '' otherwise."""
    confidence = manifest.get("confidence") or {}
    return str(confidence.get("message", "")) if confidence.get("verdict") == SURE else ""


def doubt_message(manifest: dict[str, Any]) -> str:
    """Message of a manifest that a map without enough landmarks may be a wrong one; '' otherwise."""
    return "" if sure_message(manifest) else str((manifest.get("confidence") or {}).get("message", ""))


def landmark_messages(manifest: dict[str, Any]) -> list[str]:
    """Warnings of a manifest about landmarks: doubtful maps, pairs left out, curves missed."""
    check, doubt = manifest.get("landmark_check") or {}, doubt_message(manifest)
    left_out = [str(suspect["message"]) for suspect in check.get("suspects", [])]
    missed = [
        f"curve '{curve['name']}' is missed by {100 * curve['mean']:.1f} % of the model's size (at most "
        f"{100 * curve['worst']:.0f} %): it contradicts other landmarks or the shapes; look at it in the report"
        for curve in manifest.get("curves") or []
        if curve["mean"] > _CURVE_MISSED
    ]
    return ([doubt] if doubt else []) + left_out + missed + list(map(str, check.get("notes", [])))


@cache  # a process runs the code that it imported at its start
def code_version() -> str:
    """Version of the package, and 16 hexadecimal digits that change with any of its Python files."""
    digest = hashlib.sha256()
    for name, content in _sources(resources.files("cagemap"), ""):
        digest.update(f"{name}:{len(content)};".encode())
        digest.update(content)
    return f"{__version__}+{digest.hexdigest()[:16]}"


def _sources(folder: Traversable, prefix: str) -> list[tuple[str, bytes]]:
    """Name and content of the Python files below a folder, sorted by name."""
    sources: list[tuple[str, bytes]] = []
    for entry in sorted(folder.iterdir(), key=lambda item: item.name):
        if entry.is_dir():
            sources += _sources(entry, f"{prefix}{entry.name}/")
        elif entry.name.endswith(".py"):
            sources.append((prefix + entry.name, entry.read_bytes()))
    return sources
