"""``manifest.json`` of a RESULT folder: what was matched, how, and what came of it, for people and programs."""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import sys
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from cagemap import __version__
from cagemap.errors import FormatError
from cagemap.files.atomic import one_at_a_time, write_whole
from cagemap.files.meshes.arrays import CONTROL_ARRAYS
from cagemap.files.ownership import mark
from cagemap.files.schema import ResultRecord, checked_record, parse_json, to_json
from cagemap.files.text import read_text
from cagemap.mesh import ControlMesh

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
    """Add to a result's manifest what was baked from it, so that a report can show it; the same output replaces.

    A folder that cannot be written to is warned of.

    Parameters
    ----------
    entry : dict
        With "kind", "output" (path of the image) and what it was made of.

    Raises
    ------
    FormatError
        If the folder is not a result.
    """
    root = Path(folder)
    with one_at_a_time(root):
        manifest = read_manifest(root)
        record = checked_record(ResultRecord, manifest, root / MANIFEST, REMEDY)
        kept = [
            other.model_dump(exclude_unset=True) for other in record.transfers if other.output != entry.get("output")
        ]
        manifest["transfers"] = [*kept, entry]
        manifest["written_by"] = mark()
        try:
            write_whole(root / MANIFEST, to_json(manifest), force=True)
        except FormatError as error:  # the output itself is there; a RESULT may be somebody else's
            _log.warning("%s What was made with it is not noted there.", error)


def read_manifest(root: Path) -> dict[str, Any]:
    """What ``manifest.json`` of a RESULT folder holds.

    Raises
    ------
    FormatError
        If the folder is no result of a version that this one reads.
    """
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
