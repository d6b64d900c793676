"""The RESULT folder of a match: ``manifest.json`` for people, ``map.npz`` for programs.

It has everything for transfers and reports; these compute no map and read no input meshes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.atomic import atomic_folder, require_own_folder
from cagemap.files.meshes.arrays import (
    control_from_arrays,
    control_to_arrays,
    curves_from_arrays,
    curves_to_arrays,
    points_from_arrays,
    scheme_from_entry,
    scheme_to_entry,
)
from cagemap.files.npz import Archive, ArraySpec, lie_in_triangles, read_npz, write_npz
from cagemap.files.ownership import is_own, seal, stated_checksum
from cagemap.files.result.manifest import (
    MANIFEST,
    REMEDY,
    read_manifest,
    stored_basis,
    stored_check,
    stored_confidence,
    stored_quality,
    version_entries,
)
from cagemap.files.result.maps import level_arrays, read_level_maps, stored_levels
from cagemap.files.schema import ResultRecord, SideRecord, parse_record, to_json
from cagemap.maps.masks import Masks
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import MatchResult, SpectralMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import in_threads
from cagemap.spectral import Surface
from cagemap.subdivision import refine
from cagemap.subdivision.refinement import vertex_counts

ARRAYS = "map.npz"
_Value = TypeVar("_Value")

_SPECS = {
    "source_triangles": ArraySpec(("t2", 3), below="n2"),
    "triangle": ArraySpec(("n1",), below="t2"),
    "barycentric": ArraySpec(("n1", 3)),
    "functional_map": ArraySpec(("k1", "k2"), optional=True),
    "trust": ArraySpec(("n1",)),
    "landmark_errors": ArraySpec(("p",)),
    "target_shared": ArraySpec(("n1",), optional=True),
    "source_shared": ArraySpec(("n2",), optional=True),
    "runner_up_images": ArraySpec(("r", "c1", 3), optional=True),
}
# Tolerance of stored vertices, relative to the mesh's size: other versions of libraries round differently.
_DRIFT = 1e-6
_SPECTRAL_ARRAYS = ("functional_map", "target_eigenvalues", "source_eigenvalues")
# Entries of a manifest that are fields of a match, or state how the folder was written.
_TYPED = {"quality", "landmark_check", "confidence", "timings", "bases", "target", "source", "landmark_names", "curves"}
_TYPED |= {"level_maps", "shared_area", "written_by", "format", "format_version", "versions", "files"}


@kinds_checked
def write_result(folder: str | Path, result: MatchResult, *, force: bool = False) -> None:
    """Write a RESULT folder; an older result is replaced when the new one is complete.

    Other files in the folder are kept. The functional map is stored if both surfaces are prepared.

    Parameters
    ----------
    folder : path
    result : MatchResult
    force : bool
        Also write into a folder, or replace files, that cagemap did not write.

    Raises
    ------
    FormatError
        If the folder cannot be written, or has files but no result.
    """
    arrays: dict[str, Any] = {
        "source_triangles": _numbers(result.source_triangles),
        "triangle": _numbers(result.triangle),
        "barycentric": result.barycentric,
        "trust": result.trust,
        "landmark_errors": result.landmark_errors,
    }
    if len(result.runner_up_images):
        arrays["runner_up_images"] = result.runner_up_images
    if result.shared is not None:
        arrays |= {"target_shared": result.shared.target, "source_shared": result.shared.source}
    arrays |= level_arrays(result)
    for prefix, side, points, mask in (
        ("target", result.target, result.landmarks.target_points, result.masks.target),
        ("source", result.source, result.landmarks.source_points, result.masks.source),
    ):
        corners = side.refinement.finest.corners
        arrays[f"{prefix}_vertices"] = side.vertices
        arrays[f"{prefix}_faces"] = _numbers(side.faces if corners is None else corners)
        arrays[f"{prefix}_landmarks"] = points.heaviest_corners
        if np.any(points.vertices < 0):
            arrays[f"{prefix}_landmark_corners"] = points.corners
            arrays[f"{prefix}_landmark_weights"] = points.weights
        if mask is not None:
            arrays[f"{prefix}_mask"] = mask
        arrays |= control_to_arrays(side.control, f"{prefix}_control_")
    arrays |= curves_to_arrays(result.landmarks.curves)
    with atomic_folder(folder, (ARRAYS, MANIFEST), force=force, owned=_is_own) as temporary:
        names = _SPECTRAL_ARRAYS if result.has_spectral else ()
        write_npz(temporary / ARRAYS, arrays, lambda: {name: getattr(result.spectral, name) for name in names})
        seal(temporary / ARRAYS)
        manifest = _manifest(result) | {"files": {ARRAYS: stated_checksum(temporary / ARRAYS)}}
        # The manifest is written last: a folder that has one is complete.
        (temporary / MANIFEST).write_text(to_json(manifest), encoding="utf-8")


def _numbers(indices: NDArray[np.integer]) -> NDArray[np.int32]:
    """Indices of finest vertices and triangles as stored: int32, as they are below 2^31."""
    return indices.astype(np.int32, copy=False)


def check_result_folder(folder: str | Path, *, force: bool = False) -> None:
    """Refuse a folder that `write_result` would refuse, before any work is done."""
    require_own_folder(folder, (ARRAYS, MANIFEST), force=force, owned=_is_own)


def _is_own(path: Path) -> bool:
    """Whether cagemap wrote a file of a RESULT folder; before version 0.2 only the manifest's format shows it."""
    if stated_checksum(path) is not None:
        return is_own(path)
    try:
        return read_manifest(path.parent).get("written_by") is None
    except FormatError:
        return False


@kinds_checked
def read_result(folder: str | Path) -> MatchResult:
    """Read the match in a RESULT folder, without prepared surfaces.

    They are prepared when needed: by `cagemap.update_match`, or for a ``result.functional_map`` that is not stored.
    Everything is checked: types, shapes, ranges, and that the files belong together.

    Raises
    ------
    FormatError
        If the folder is missing, incomplete, damaged, or in the format of a newer version.
    """
    root = Path(folder)
    manifest = read_manifest(root)
    record = parse_record(ResultRecord, manifest, root / MANIFEST, REMEDY)
    path, checksum = root / ARRAYS, record.files.get(ARRAYS)
    if not path.is_file():
        raise FormatError(f"{path}: is missing, so the result is incomplete. {REMEDY}")
    archive = Archive(path, read_npz(path, REMEDY), REMEDY)
    if checksum is not None and stated_checksum(path) not in (None, checksum):
        archive.refuse(f"belongs to another {MANIFEST} than the one beside it")
    sizes: dict[str, int] = {}
    sides = [
        _read_side(root, prefix, entry, archive, sizes)
        for prefix, entry in (("target", record.target), ("source", record.source))
    ]
    target, source = in_threads(lambda side: side.surface(archive, record), sides)
    finest = target.finest_triangles, source.finest_triangles
    sizes["t2"] = len(finest[1].triangles)
    arrays = archive.take(_SPECS, sizes)
    _check_parts(root, arrays, finest[1].triangles, record)
    point_map = PointMap.from_arrays(*finest, arrays["triangle"], arrays["barycentric"])
    counts = target.control.n_vertices, source.control.n_vertices
    curves = curves_from_arrays(archive, [curve.name for curve in record.curves], counts)
    names = tuple(record.landmark_names) or tuple(f"point {i}" for i in range(len(sides[0].points)))
    meshes = target.control.name, source.control.name
    landmarks = Landmarks.of_points(names, sides[0].points, sides[1].points, *meshes, curves)
    check = stored_check(record.landmark_check, arrays["landmark_errors"])
    other_answers = arrays.get("runner_up_images", np.zeros((0, 0, 3)))
    functional_map = arrays.get("functional_map")
    return MatchResult(
        target,
        source,
        landmarks,
        point_map,
        stored_quality(record.quality, check, arrays["landmark_errors"], arrays["trust"]),
        {stage: seconds or 0.0 for stage, seconds in record.timings.items()},
        check,
        read_level_maps(archive, record.level_maps, (target, source), point_map, functional_map),
        stored_confidence(record.confidence, point_map, counts[0], other_answers),
        masks=Masks(*(side.arrays.get("mask") for side in sides)),
        shared=_record_of(Masks, arrays.get("target_shared"), arrays.get("source_shared")),
        known_spectral=_record_of(SpectralMap, functional_map, *(side.arrays.get("eigenvalues") for side in sides)),
        provenance={name: value for name, value in manifest.items() if name not in _TYPED},
    )


def _record_of(kind: type[_Value], *arrays: FloatArray | None) -> _Value | None:
    """The value that stored arrays make; None if one of them is missing."""
    return None if any(array is None for array in arrays) else kind(*arrays)


@dataclass(frozen=True, eq=False)
class _Side:
    """A stored surface of a RESULT folder."""

    prefix: str
    control: ControlMesh
    level: int
    arrays: dict[str, Any]  # checked, by name without the prefix
    points: CagePoints

    def surface(self, archive: Archive, record: ResultRecord) -> Surface:
        """The surface, refined again; refuses stored vertices and faces that differ from it."""
        eigenvalues = self.arrays.get("eigenvalues")
        basis = stored_basis(record.bases.get(self.prefix), None if eigenvalues is None else len(eigenvalues))
        surface = Surface(refine(self.control, self.level, self.control.scheme), basis)
        size = float(np.ptp(self.control.positions, axis=0).max())
        same_faces = np.array_equal(surface.faces, self.arrays["faces"])
        if not same_faces or np.abs(surface.vertices - self.arrays["vertices"]).max() > _DRIFT * size:
            archive.refuse(f"{self.prefix}_vertices or faces are not those of the control mesh")
        return surface


def _read_side(root: Path, prefix: str, entry: SideRecord, archive: Archive, sizes: dict[str, int]) -> _Side:
    """A stored surface; adds its sizes to ``sizes``."""
    scheme = scheme_from_entry(root / MANIFEST, entry.scheme, REMEDY)
    control = control_from_arrays(archive, f"{prefix}_control_", entry.material_names, entry.name, scheme)
    number = 1 if prefix == "target" else 2
    sizes |= {
        f"c{number}": control.n_vertices,
        f"n{number}": next(islice(vertex_counts(control, scheme), entry.level, None)),
    }
    specs = {
        "vertices": ArraySpec((f"n{number}", 3)),
        "faces": ArraySpec((f"m{number}", "3|4"), below=f"n{number}"),
        "eigenvalues": ArraySpec((f"k{number}",), optional=True),
        "landmarks": ArraySpec(("p",), below=f"c{number}"),
        "landmark_corners": ArraySpec(("p", 3), below=f"c{number}", optional=True),
        "landmark_weights": ArraySpec(("p", 3), optional=True),
        "mask": ArraySpec((f"n{number}",), optional=True, share=True),
    }
    checked = archive.take({f"{prefix}_{name}": spec for name, spec in specs.items()}, sizes)
    points = points_from_arrays(archive, checked, f"{prefix}_landmark_")
    arrays = {name.removeprefix(f"{prefix}_"): array for name, array in checked.items()}
    points = CagePoints.of_vertices(arrays["landmarks"]) if points is None else points
    return _Side(prefix, control, entry.level, arrays, points)


def _check_parts(root: Path, arrays: dict[str, Any], source_triangles: IndexArray, record: ResultRecord) -> None:
    """Refuse arrays and records that do not belong together."""
    pairs = len(arrays["landmark_errors"])
    faults = {
        "source_triangles are not those of source_faces": not np.array_equal(
            arrays["source_triangles"], source_triangles
        ),
        "barycentric coordinates lie outside their triangles": not lie_in_triangles(arrays["barycentric"]),
        "as many landmark_names as landmarks are expected": len(record.landmark_names) not in (0, pairs),
        "landmark_check names pairs that are not there": any(
            suspect.pair >= pairs for suspect in (record.landmark_check.suspects if record.landmark_check else [])
        ),
    }
    for fault, present in faults.items():
        if present:
            raise FormatError(f"{root}: {fault}; the files do not belong together. {REMEDY}")


def _manifest(result: MatchResult) -> dict[str, Any]:
    sides = {
        prefix: {
            "name": side.control.name,
            "scheme": scheme_to_entry(side.refinement.scheme),
            "level": side.refinement.finest_level,
            "control_vertices": side.control.n_vertices,
            "control_faces": side.control.n_faces,
            "vertices": len(side.vertices),
            "faces": len(side.faces),
            "material_names": list(side.control.material_names),
        }
        for prefix, side in (("target", result.target), ("source", result.source))
    }
    fixed = {**version_entries(), **sides, "landmark_names": list(result.landmarks.names)}
    fixed["level_maps"] = [dict(zip(("target", "source"), one.levels, strict=True)) for one in stored_levels(result)]
    return fixed | {name: value for name, value in result.manifest.items() if name not in {*fixed, "files"}}
