"""The RESULT folder of a match: ``manifest.json`` for people, ``map.npz`` for programs.

It holds all that transfer and report need, so that neither computes a map again nor looks for the input meshes.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import sys
from importlib import metadata
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cagemap import __version__
from cagemap.errors import FormatError
from cagemap.files.atomic import atomic_folder, atomic_path, require_own_folder
from cagemap.files.forms import Form, check_arrays
from cagemap.files.marks import is_own, mark, seal, stated_checksum
from cagemap.files.mesh_arrays import (
    CONTROL_ARRAYS,
    control_from_arrays,
    control_to_arrays,
    curves_from_arrays,
    curves_to_arrays,
    points_from_arrays,
    scheme_from_entry,
    scheme_to_entry,
)
from cagemap.files.npz import read_npz, write_npz
from cagemap.files.result_values import Result, Side, landmark_messages, result_of
from cagemap.files.schema import ResultRecord, SideRecord, checked_record, parse_json, to_json
from cagemap.files.text import read_text
from cagemap.mesh import ControlMesh
from cagemap.refinement import Scheme, triangles
from cagemap.refinement.counts import vertex_counts

if TYPE_CHECKING:  # reading a result needs no solvers
    from cagemap.pipeline import MatchResult

__all__ = [
    "ARRAYS",
    "MANIFEST",
    "Result",
    "Side",
    "check_result_folder",
    "file_hash",
    "input_file",
    "landmark_messages",
    "mesh_hash",
    "note_transfer",
    "peak_memory",
    "read_manifest",
    "read_result",
    "result_of",
    "result_record",
    "stated_path",
    "write_result",
]

FORMAT = "cagemap-result"
FORMAT_VERSION = 1
MANIFEST = "manifest.json"
ARRAYS = "map.npz"

_FORMS = {
    "source_triangles": Form(("t2", 3), below="n2"),
    "triangle": Form(("n1",), below="t2"),
    "barycentric": Form(("n1", 3)),
    "functional_map": Form(("k1", "k2")),
    "trust": Form(("n1",)),
    "landmark_errors": Form(("p",)),
    "runner_up_images": Form(("r", "c1", 3), optional=True),
}
# What barycentric coordinates may lie beside [0, 1] and a sum of 1.
_ROUNDING = 1e-6
_SIDE_ARRAYS = ("vertices", "faces", "eigenvalues", "landmarks")
_REMEDY = "Run `cagemap match` again."
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


def input_file(folder: str | Path, manifest: dict[str, Any], side: str) -> Path | None:
    """The mesh file that a result was made from, if it is still where it was and has not changed."""
    entry = (manifest.get("inputs") or {}).get(side) or {}
    path, digest = entry.get("path"), entry.get("sha256")
    if not isinstance(path, str) or not isinstance(digest, str):
        return None
    file = Path(folder) / path
    return file if file.is_file() and file_hash(file) == digest else None


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


def write_result(folder: str | Path, result: Result | MatchResult, *, force: bool = False) -> None:
    """Write a RESULT folder; an older result there is replaced, and only when the new one is complete.

    Other files in the folder stay as they are.

    Parameters
    ----------
    folder : path
    result : Result or MatchResult
        What `cagemap.match` gives is stored by way of `result_of`, which also takes further entries of the manifest.
    force : bool
        Write into a folder, and over files of the same names, that cagemap did not write.

    Raises
    ------
    FormatError
        If the folder cannot be written, or holds something that is not a result.
    """
    if not isinstance(result, Result):
        result = result_of(result)
    arrays: dict[str, Any] = {
        "source_triangles": result.source_triangles,
        "triangle": result.triangle,
        "barycentric": result.barycentric,
        "functional_map": result.functional_map,
        "trust": result.trust,
        "landmark_errors": result.landmark_errors,
    }
    if len(result.runner_up_images):
        arrays["runner_up_images"] = result.runner_up_images
    for prefix, side in (("target", result.target), ("source", result.source)):
        arrays |= {f"{prefix}_{name}": getattr(side, name) for name in _SIDE_ARRAYS}
        if side.landmark_points is not None:
            arrays[f"{prefix}_landmark_corners"] = side.landmark_points.corners
            arrays[f"{prefix}_landmark_weights"] = side.landmark_points.weights
        if side.mask is not None:
            arrays[f"{prefix}_mask"] = side.mask
        arrays |= control_to_arrays(side.control, f"{prefix}_control_")
    arrays |= curves_to_arrays(result.curves)
    with atomic_folder(folder, (ARRAYS, MANIFEST), force=force, owned=_is_own) as temporary:
        write_npz(temporary / ARRAYS, arrays)
        seal(temporary / ARRAYS)
        manifest = _manifest(result) | {"files": {ARRAYS: stated_checksum(temporary / ARRAYS)}}
        # The manifest comes last: a folder with one is complete, whoever copies it.
        (temporary / MANIFEST).write_text(to_json(manifest), encoding="utf-8")


def check_result_folder(folder: str | Path, *, force: bool = False) -> None:
    """Refuse a folder that `write_result` would refuse, before any work is done for it."""
    require_own_folder(folder, (ARRAYS, MANIFEST), force=force, owned=_is_own)


def _is_own(path: Path) -> bool:
    """Whether cagemap wrote a file of a RESULT folder; versions before 0.2 left no mark but their manifest's format."""
    if stated_checksum(path) is not None:
        return is_own(path)
    try:
        return read_manifest(path.parent).get("written_by") is None
    except FormatError:
        return False


def note_transfer(folder: str | Path, entry: dict[str, Any]) -> None:
    """Add to a result's manifest what was baked from it, so that a report can show it; the same output replaces.

    Parameters
    ----------
    entry : dict
        With "kind", "output" (path of the image) and what it was made of.

    Raises
    ------
    FormatError
        If the folder is not a result or cannot be written.
    """
    root = Path(folder)
    manifest = read_manifest(root)
    record = checked_record(ResultRecord, manifest, root / MANIFEST, _REMEDY)
    kept = [other.model_dump(exclude_unset=True) for other in record.transfers if other.output != entry.get("output")]
    manifest["transfers"] = [*kept, entry]
    manifest["written_by"] = mark()
    with atomic_path(root / MANIFEST, force=True) as temporary:
        temporary.write_text(to_json(manifest), encoding="utf-8")


def read_result(folder: str | Path) -> Result:
    """Read a RESULT folder.

    Everything in it is checked: types, shapes, ranges, and that the parts belong together.

    Raises
    ------
    FormatError
        If it is missing, incomplete, damaged, or written by a newer version in another format.
    """
    root = Path(folder)
    manifest = read_manifest(root)
    record = checked_record(ResultRecord, manifest, root / MANIFEST, _REMEDY)
    stored = _read_arrays(root / ARRAYS, record.files.get(ARRAYS))
    sizes: dict[str, int] = {}
    target, source = (
        _read_side(root, prefix, entry, stored, sizes)
        for prefix, entry in (("target", record.target), ("source", record.source))
    )
    sizes["t2"] = len(triangles(source.faces))
    arrays = check_arrays(root / ARRAYS, stored, _FORMS, sizes, _REMEDY)
    names, counts = [curve.name for curve in record.curves], (target.control.n_vertices, source.control.n_vertices)
    curves = curves_from_arrays(root / ARRAYS, stored, names, counts, _REMEDY)
    named = tuple(record.landmark_names)
    result = Result(target, source, **arrays, landmark_names=named, curves=curves, manifest=manifest)
    _check_parts(root, result, record)
    return result


def result_record(result: Result) -> ResultRecord:
    """The manifest of a result as a typed record.

    Raises
    ------
    FormatError
        If something in it is of another type.
    """
    return checked_record(ResultRecord, json.loads(to_json(_manifest(result))), Path(MANIFEST), _REMEDY)


def _read_side(root: Path, prefix: str, entry: SideRecord, stored: dict[str, Any], sizes: dict[str, int]) -> Side:
    """One surface, with sizes of its own prefix added to those known."""
    path = root / ARRAYS
    scheme = scheme_from_entry(root / MANIFEST, entry.scheme, _REMEDY)
    names = entry.material_names
    control = control_from_arrays(path, stored, f"{prefix}_control_", names, entry.name, _REMEDY, scheme)
    number = 1 if prefix == "target" else 2
    sizes |= {f"c{number}": control.n_vertices, f"n{number}": _expected_vertices(control, scheme, entry.level)}
    forms = {f"{prefix}_{name}": form for name, form in _side_forms(number).items()}
    arrays = check_arrays(path, stored, forms, sizes, _REMEDY)
    points = points_from_arrays(path, arrays, f"{prefix}_landmark_", _REMEDY)
    own = {name: arrays[f"{prefix}_{name}"] for name in _SIDE_ARRAYS}
    side = Side(control, scheme, entry.level, **own, landmark_points=points, mask=arrays.get(f"{prefix}_mask"))
    low, high = control.positions.min(axis=0), control.positions.max(axis=0)
    slack = (high - low).max()  # refined vertices are averages of control vertices
    if np.any(side.vertices < low - slack) or np.any(side.vertices > high + slack):
        raise FormatError(f"{path}: {prefix}_vertices lie far from their control mesh. {_REMEDY}")
    return side


def _expected_vertices(control: ControlMesh, scheme: Scheme, level: int) -> int:
    return next(islice(vertex_counts(control, scheme), level, None))


def _side_forms(number: int) -> dict[str, Form]:
    return {
        "vertices": Form((f"n{number}", 3)),
        "faces": Form((f"m{number}", "3|4"), below=f"n{number}"),
        "eigenvalues": Form((f"k{number}",)),
        "landmarks": Form(("p",), below=f"c{number}"),
        "landmark_corners": Form(("p", 3), below=f"c{number}", optional=True),
        "landmark_weights": Form(("p", 3), optional=True),
        "mask": Form((f"n{number}",), optional=True, share=True),
    }


def _check_parts(root: Path, result: Result, record: ResultRecord) -> None:
    """Refuse sound parts that do not belong together."""
    faults = {
        "source_triangles are not those of source_faces": not np.array_equal(
            result.source_triangles, triangles(result.source.faces)
        ),
        "barycentric coordinates lie outside their triangles": bool(
            np.any(result.barycentric < -_ROUNDING) or np.any(np.abs(result.barycentric.sum(axis=1) - 1) > _ROUNDING)
        ),
        "as many landmark_names as landmarks are expected": len(record.landmark_names)
        not in (0, len(result.landmark_errors)),
        "landmark_check names pairs that are not there": any(
            suspect.pair >= len(result.landmark_errors)
            for suspect in (record.landmark_check.suspects if record.landmark_check else [])
        ),
    }
    for fault, found in faults.items():
        if found:
            raise FormatError(f"{root}: {fault}; the files do not belong together. {_REMEDY}")


def _manifest(result: Result) -> dict[str, Any]:
    sides = {
        prefix: {
            "name": side.control.name,
            "scheme": scheme_to_entry(side.scheme),
            "level": side.level,
            "control_vertices": side.control.n_vertices,
            "control_faces": side.control.n_faces,
            "vertices": len(side.vertices),
            "faces": len(side.faces),
            "material_names": list(side.control.material_names),
        }
        for prefix, side in (("target", result.target), ("source", result.source))
    }
    fixed = {
        "written_by": mark(),
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "versions": {"cagemap": __version__, "python": platform.python_version(), **_library_versions()},
        **sides,
        "landmark_names": list(result.landmark_names),
    }
    return fixed | {name: value for name, value in result.manifest.items() if name not in {*fixed, "files"}}


def _library_versions() -> dict[str, str]:
    versions = {}
    for name in _LIBRARIES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions


def read_manifest(root: Path) -> dict[str, Any]:
    """What ``manifest.json`` of a RESULT folder holds.

    Raises
    ------
    FormatError
        If the folder is no result of a version that this one reads.
    """
    path = root / MANIFEST
    if not path.is_file():
        raise FormatError(
            f"{root}: expected a result folder of `cagemap match`, found no {MANIFEST} in it. "
            "Give the folder that was passed to `cagemap match -o`."
        )
    manifest = parse_json(read_text(path, "the manifest of a result"), path, _REMEDY)
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


def _read_arrays(path: Path, checksum: str | None) -> dict[str, Any]:
    if not path.is_file():
        raise FormatError(f"{path}: is missing, so the result is incomplete. {_REMEDY}")
    arrays = read_npz(path, _REMEDY)
    if checksum is not None and stated_checksum(path) not in (None, checksum):
        raise FormatError(f"{path}: belongs to another {MANIFEST} than the one beside it. {_REMEDY}")
    return arrays
