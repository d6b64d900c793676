"""The RESULT folder of a match: ``manifest.json`` for people, ``map.npz`` for programs.

It holds all that transfer and report need, so that neither computes a map again nor looks for the input meshes.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import sys
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cagemap import __version__
from cagemap.errors import FormatError
from cagemap.files.atomic import atomic_folder, atomic_path, require_own_folder
from cagemap.files.marks import is_own, mark, seal, stated_checksum
from cagemap.files.mesh_arrays import (
    CONTROL_ARRAYS,
    control_from_arrays,
    control_to_arrays,
    scheme_from_entry,
    scheme_to_entry,
)
from cagemap.files.npz import read_npz, write_npz
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.refinement import Refinement, Scheme, refine, triangles

if TYPE_CHECKING:  # reading a result needs no solvers
    from cagemap.pipeline import MatchResult

FORMAT = "cagemap-result"
FORMAT_VERSION = 1
MANIFEST = "manifest.json"
ARRAYS = "map.npz"

_SIDE_ARRAYS = ("vertices", "faces", "eigenvalues", "landmarks")
_REMEDY = "Run `cagemap match` again."
_LIBRARIES = ("numpy", "scipy", "numba", "rslab", "OpenImageIO", "embreex", "xatlas")


@dataclass(frozen=True)
class Side:
    """One of the two surfaces of a result.

    Attributes
    ----------
    control : ControlMesh
        In the file's own units, like ``vertices``.
    scheme : CatmullClark or Loop
    level : int
        Level of ``vertices`` and ``faces``; vertex i of a level is vertex i of every finer one.
    vertices : (n, 3) float64
    faces : (m, 4) or (m, 3) int64
    eigenvalues : (k,) float64
        Of the unit-area surface.
    landmarks : (p,) int64
        Control vertices, in the order of the other side's.
    """

    control: ControlMesh
    scheme: Scheme
    level: int
    vertices: FloatArray
    faces: IndexArray
    eigenvalues: FloatArray
    landmarks: IndexArray

    def refinement(self) -> Refinement:
        """Every level again, with UVs; cheap, and the same numbers as in the match."""
        return refine(self.control, self.level, self.scheme)


@dataclass(frozen=True)
class Result:
    """A dense map between two refined surfaces, as it is stored.

    Attributes
    ----------
    target, source : Side
        The surface that receives, and the one that gives.
    source_triangles : (t2, 3) int64
        Source vertices of every triangle that ``triangle`` counts.
    triangle : (n1,) int64
        Target vertex i maps to the point ``barycentric[i]`` of source triangle ``triangle[i]``.
    barycentric : (n1, 3) float64
    functional_map : (k1, k2) float64
        C12: source coefficients to target coefficients.
    trust : (n1,) float64
        1 where the map is locally unfolded and stretches little, 0 at folds.
    landmark_errors : (p,) float64
        Of sqrt(source area); also of pairs that the map left out, which the manifest's ``landmark_check`` names.
    landmark_names : tuple of str
    manifest : dict
        What ``manifest.json`` holds: versions, parameters, input hashes, timings in seconds, quality figures.
    """

    target: Side
    source: Side
    source_triangles: IndexArray
    triangle: IndexArray
    barycentric: FloatArray
    functional_map: FloatArray
    trust: FloatArray
    landmark_errors: FloatArray
    landmark_names: tuple[str, ...] = ()
    manifest: dict[str, Any] = field(default_factory=dict)

    def image(self) -> FloatArray:
        """(n1, 3) where every target vertex maps to, in the source file's units."""
        corners = self.source.vertices[self.source_triangles[self.triangle]]
        return np.einsum("nc,ncd->nd", self.barycentric, corners)


def result_of(match: MatchResult, manifest: dict[str, Any] | None = None) -> Result:
    """What of a match is stored.

    Parameters
    ----------
    manifest : dict, optional
        More entries for the manifest, such as input hashes, parameters and further timings.
    """
    quality = match.quality
    left_out = [suspect.pair for suspect in match.suspects]
    errors = np.zeros(len(match.landmarks))
    errors[np.setdiff1d(np.arange(len(errors)), left_out)] = quality.landmark_errors
    errors[left_out] = [suspect.distance for suspect in match.suspects]
    sides = [
        Side(
            control=surface.control,
            scheme=surface.refinement.scheme,
            level=surface.finest,
            vertices=surface.refinement.finest.positions,
            faces=np.asarray(surface.refinement.finest.faces),
            eigenvalues=surface.basis.eigenvalues,
            landmarks=landmarks,
        )
        for surface, landmarks in ((match.target, match.landmarks.target), (match.source, match.landmarks.source))
    ]
    return Result(
        target=sides[0],
        source=sides[1],
        source_triangles=triangles(sides[1].faces),
        triangle=match.point_map.triangle,
        barycentric=match.point_map.barycentric,
        functional_map=match.functional_map,
        trust=quality.trust,
        landmark_errors=errors,
        landmark_names=match.landmarks.names,
        manifest={
            "quality": quality.summary(),
            "landmark_check": match.landmark_check.summary(),
            "timings": dict(match.timings),
        }
        | (manifest or {}),
    )


def landmark_messages(manifest: dict[str, Any]) -> list[str]:
    """Sentences of a manifest about landmarks: pairs that were left out of the map, and other notes."""
    check = manifest.get("landmark_check") or {}
    return [str(suspect["message"]) for suspect in check.get("suspects", [])] + list(map(str, check.get("notes", [])))


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
    for prefix, side in (("target", result.target), ("source", result.source)):
        arrays |= {f"{prefix}_{name}": getattr(side, name) for name in _SIDE_ARRAYS}
        arrays |= control_to_arrays(side.control, f"{prefix}_control_")
    with atomic_folder(folder, (ARRAYS, MANIFEST), force=force, owned=_is_own) as temporary:
        write_npz(temporary / ARRAYS, arrays)
        seal(temporary / ARRAYS)
        manifest = _manifest(result) | {"files": {ARRAYS: stated_checksum(temporary / ARRAYS)}}
        # The manifest comes last: a folder with one is complete, whoever copies it.
        (temporary / MANIFEST).write_text(_to_json(manifest), encoding="utf-8")


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
    kept = [other for other in manifest.get("transfers", []) if other.get("output") != entry.get("output")]
    manifest["transfers"] = [*kept, _plain(entry)]
    manifest["written_by"] = mark()
    with atomic_path(root / MANIFEST, force=True) as temporary:
        temporary.write_text(_to_json(manifest), encoding="utf-8")


def read_result(folder: str | Path) -> Result:
    """Read a RESULT folder.

    Raises
    ------
    FormatError
        If it is missing, incomplete, damaged, or written by a newer version in another format.
    """
    root = Path(folder)
    manifest = read_manifest(root)
    files = manifest.get("files")
    arrays = _read_arrays(root / ARRAYS, files.get(ARRAYS) if isinstance(files, dict) else None)
    try:
        sides = [_side(prefix, manifest, arrays) for prefix in ("target", "source")]
        result = Result(
            target=sides[0],
            source=sides[1],
            source_triangles=arrays["source_triangles"],
            triangle=arrays["triangle"],
            barycentric=arrays["barycentric"],
            functional_map=arrays["functional_map"],
            trust=arrays["trust"],
            landmark_errors=arrays["landmark_errors"],
            landmark_names=tuple(manifest["landmark_names"]),
            manifest=manifest,
        )
    except (KeyError, TypeError, AttributeError) as error:
        raise FormatError(
            f"{root}: {MANIFEST} or {ARRAYS} lacks {error}; the result is incomplete. Run `cagemap match` again."
        ) from error
    _check_shapes(root, result)
    return result


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


def _to_json(manifest: dict[str, Any]) -> str:
    return json.dumps(_plain(manifest), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    """Numbers, strings, lists and dicts that JSON knows; what is not finite becomes null."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, str | int | float | bool | None) else str(value)


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
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError) as error:
        raise FormatError(f"{path}: cannot be read ({error}). Run `cagemap match` again.") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise FormatError(f'{path}: expected "format": "{FORMAT}", so this is not a result of `cagemap match`.')
    version = manifest.get("format_version")
    if not isinstance(version, int) or not 1 <= version <= FORMAT_VERSION:
        written = (manifest.get("versions") or {}).get("cagemap", "another version")
        raise FormatError(
            f"{path}: format version {version}, this cagemap {__version__} reads up to {FORMAT_VERSION}. "
            f"Use cagemap {written} or newer, or run `cagemap match` again."
        )
    return manifest


def _read_arrays(path: Path, checksum: object) -> dict[str, Any]:
    if not path.is_file():
        raise FormatError(f"{path}: is missing, so the result is incomplete. {_REMEDY}")
    arrays = read_npz(path, _REMEDY)
    if checksum is not None and stated_checksum(path) not in (None, checksum):
        raise FormatError(f"{path}: belongs to another {MANIFEST} than the one beside it. {_REMEDY}")
    return arrays


def _side(prefix: str, manifest: dict[str, Any], arrays: dict[str, Any]) -> Side:
    stored = manifest[prefix]
    scheme = scheme_from_entry(stored["scheme"])
    control = control_from_arrays(arrays, f"{prefix}_control_", stored["material_names"], stored["name"], scheme)
    return Side(control, scheme, stored["level"], *(arrays[f"{prefix}_{name}"] for name in _SIDE_ARRAYS))


def _check_shapes(root: Path, result: Result) -> None:
    n1, t2 = len(result.target.vertices), len(result.source_triangles)
    expected = {
        "triangle": (n1,),
        "barycentric": (n1, 3),
        "trust": (n1,),
        "functional_map": (len(result.target.eigenvalues), len(result.source.eigenvalues)),
    }
    for name, shape in expected.items():
        if getattr(result, name).shape != shape:
            raise FormatError(
                f"{root / ARRAYS}: {name} has shape {getattr(result, name).shape}, expected {shape}; "
                "the files do not belong together. Run `cagemap match` again."
            )
    if n1 and not 0 <= result.triangle.min() <= result.triangle.max() < t2:
        raise FormatError(
            f"{root / ARRAYS}: triangle counts past the {t2} source triangles. Run `cagemap match` again."
        )
