"""Prepared surfaces on disk: each surface is refined and given its basis once, for all its pairs.

A stored surface is one uncompressed ``.npz``: the control mesh, the operators and the basis. Refined levels are not
stored; computing them takes no longer than reading them. Every array has a checksum (of the zip format), and files are
written atomically. The name is a hash of everything that the content depends on, so two processes may prepare one
surface at once: both write the same content.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from cagemap import __version__
from cagemap.errors import CagemapError, FormatError
from cagemap.files.atomic import atomic_path
from cagemap.files.meshes.arrays import control_from_arrays, control_to_arrays, scheme_from_entry, scheme_to_entry
from cagemap.files.npz import ArraySpec, check_arrays, check_offsets, read_npz, write_npz
from cagemap.files.ownership import is_own
from cagemap.files.result.manifest import code_version, mesh_hash
from cagemap.files.schema import SurfaceRecord, checked_record, parse_json
from cagemap.files.text import require_file
from cagemap.mesh import ControlMesh, Plain
from cagemap.operators import Operators
from cagemap.operators.coarse_levels import build_levels
from cagemap.pipeline import MAP_BASIS, prepare_surface
from cagemap.spectral import BasisConfig, HierarchicalBasis, Surface
from cagemap.spectral.surface import Progress, no_progress
from cagemap.subdivision import Refinement, Scheme, default_scheme
from cagemap.subdivision.refinement import vertex_counts

FORMAT = "cagemap-surface"
SURFACE_VERSION = 4
SUFFIX = ".surface.npz"

_BASIS_ARRAYS = ("eigenvalues", "residuals", "indices", "gram")
_REMEDY = "Delete the file and prepare the surface again."

logger = logging.getLogger(__name__)

Prepare = Callable[..., Surface]


def surface_key(control: ControlMesh, level: int, scheme: Scheme | None = None, config: BasisConfig = MAP_BASIS) -> str:
    """Hash of everything that a prepared surface depends on; 64 hexadecimal digits.

    ``control``: all its arrays, but not its name.
    ``scheme``: default: the mesh's default scheme.
    ``config``: default: that of `cagemap.pipeline.prepare_surface`.

    Notes
    -----
    The package's code and the version of the format are included, since other code may compute something else.
    """
    scheme = default_scheme(control) if scheme is None else scheme
    parts = {
        "format": [FORMAT, SURFACE_VERSION, code_version()],
        "control": mesh_hash(control),
        "materials": list(control.material_names),
        "level": level,
        "scheme": scheme_to_entry(scheme),
        "basis": asdict(config),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def save_surface(path: str | Path, surface: Surface, *, force: bool = False) -> None:
    """Write a prepared surface to one file, completely or not at all."""
    control, operators, basis = surface.control, surface.operators, surface.basis
    header = {
        "format": FORMAT,
        "format_version": SURFACE_VERSION,
        "cagemap": __version__,
        "name": control.name,
        "material_names": list(control.material_names),
        "scheme": scheme_to_entry(surface.refinement.scheme),
        "level": surface.finest_level,
        "scale": operators.scale,
        "bands": len(basis.bands),
        "operators": len(operators.mass),
    }
    arrays: dict[str, Any] = {"header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)}
    arrays |= control_to_arrays(control, "control_")
    for level, (mass, stiffness) in enumerate(zip(operators.mass, operators.stiffness, strict=True)):
        arrays |= _operator_arrays(level, mass, stiffness, diagonal=level == operators.finest_level)
    arrays |= {f"band_{level}": band for level, band in enumerate(basis.bands)}
    arrays |= {name: getattr(basis, name) for name in _BASIS_ARRAYS}
    with atomic_path(path, force=force) as temporary:
        write_npz(temporary, arrays)


def prepared(
    folder: str | Path,
    control: ControlMesh,
    level: int,
    config: BasisConfig = MAP_BASIS,
    *,
    progress: Progress = no_progress,
    prepare: Prepare = prepare_surface,
) -> Surface:
    """A prepared surface from a folder of stored ones; if missing, prepared now and stored.

    A file that is damaged or does not fit is no error: the surface is prepared again and the file replaced. Nothing is
    stored if the preparation fails.

    ``prepare``: function with the arguments of `cagemap.pipeline.prepare_surface`.
    """
    key = surface_key(control, level, default_scheme(control), config)
    place = _usable_folder(Path(folder)) / (key + SUFFIX)
    if place.is_file():
        progress(f"read prepared {control.name}")
        try:
            if is_own(place):
                return load_surface(place, control, config)
            problem = "it was changed since it was written"
        except FormatError as error:
            problem = str(error)
        logger.warning("%s is prepared again, its stored surface cannot be used: %s", control.name, problem)
        progress(f"prepare {control.name} again, its stored file is damaged")
    surface = prepare(control, level, config, progress=progress)
    progress(f"store prepared {control.name}")
    save_surface(place, surface, force=True)  # its name is a hash of its inputs: any older file may be replaced
    return surface


def load_surface(path: str | Path, control: ControlMesh | None = None, config: BasisConfig | None = None) -> Surface:
    """Read a prepared surface; its refined levels are computed again.

    A ``control`` mesh that is known to equal the stored one replaces it, including its name.
    """
    path = Path(path)
    require_file(path, "a prepared surface")
    arrays = read_npz(path, _REMEDY)
    header = _header(path, arrays)
    scheme = scheme_from_entry(path, header.scheme, _REMEDY)
    if control is None:
        names = header.material_names
        control = control_from_arrays(path, arrays, "control_", names, header.name, _REMEDY, scheme)
    if not header.bands <= header.operators <= header.level + 1:
        raise FormatError(f"{path}: has bands or operators of more levels than there are. {_REMEDY}")
    # Numbers of vertices: those of a subdivision follow from its scheme, those below a plain mesh must be computed.
    below = build_levels(control, 0, scheme) if isinstance(scheme, Plain) else None
    if below is not None and below.finest_level != header.level:
        raise FormatError(
            f"{path}: its plain mesh has {below.finest_level} coarse levels, not {header.level}. {_REMEDY}"
        )
    counts = vertex_counts(control, scheme) if below is None else (mesh.n_vertices for mesh in below.levels)
    sizes = dict(zip(_level_sizes(header.level), counts, strict=False))
    sizes["n_finest"] = sizes[f"n{header.operators - 1}"]
    checked = check_arrays(path, arrays, _specs(header), sizes, _REMEDY)
    for level in range(header.operators):
        check_offsets(path, f"indptr_{level}", checked[f"indptr_{level}"], sizes[f"z{level}"], _REMEDY)
    try:
        refinement = build_levels(control, header.level, scheme) if below is None else below
        operators = _operators(checked, refinement.up_to(header.operators - 1), header.scale)
        bands = tuple(checked[f"band_{level}"] for level in range(header.bands))
        basis = HierarchicalBasis(refinement, operators, bands, *(checked[name] for name in _BASIS_ARRAYS))
    except (CagemapError, ValueError) as error:
        raise FormatError(f"{path}: its arrays do not belong to one surface ({error}). {_REMEDY}") from error
    if sum(basis.schedule) != basis.count:
        raise FormatError(f"{path}: its arrays do not belong to one surface. {_REMEDY}")
    return Surface.of(refinement, operators, basis, config)


def _header(path: Path, arrays: dict[str, Any]) -> SurfaceRecord:
    stored = arrays.get("header")
    if stored is None or stored.dtype != np.uint8:
        raise FormatError(f"{path}: expected a surface stored by cagemap, got something else. Give another file.")
    entries = parse_json(stored.tobytes().decode("utf-8", "replace"), path, _REMEDY)
    if not isinstance(entries, dict) or entries.get("format") != FORMAT:
        raise FormatError(f"{path}: expected a surface stored by cagemap, got something else. Give another file.")
    if entries.get("format_version") != SURFACE_VERSION:
        raise FormatError(
            f"{path}: format version {entries.get('format_version')}, written by cagemap {entries.get('cagemap')}; "
            f"this cagemap {__version__} reads version {SURFACE_VERSION}. {_REMEDY}"
        )
    return checked_record(SurfaceRecord, entries, path, _REMEDY)


def _level_sizes(finest: int) -> list[str]:
    """Names of the levels' numbers of vertices."""
    return [f"n{level}" for level in range(finest + 1)]


def _specs(header: SurfaceRecord) -> dict[str, ArraySpec]:
    """Specs of the operators' and the basis' arrays: z nonzeros on a level, k functions in all."""
    specs = {}
    for level, n in enumerate(_level_sizes(header.operators - 1)):
        z = f"z{level}"
        specs[f"indices_{level}"] = ArraySpec((z,), below=n)
        specs[f"indptr_{level}"] = ArraySpec((f"{n}+1",), below=f"{z}+1")
        specs[f"stiffness_{level}"] = ArraySpec((z,))
        specs[f"mass_{level}"] = ArraySpec((n,) if level == header.operators - 1 else (z,))
    for level in range(header.bands):
        specs[f"band_{level}"] = ArraySpec((f"n{level}", f"k{level}"))
    return specs | {
        "eigenvalues": ArraySpec(("k",)),
        "residuals": ArraySpec(("k",), nan=True),
        "indices": ArraySpec(("k",), below="n_finest"),
        "gram": ArraySpec(("k", "k")),
    }


def _operator_arrays(
    level: int, mass: sparse.csr_array, stiffness: sparse.csr_array, *, diagonal: bool
) -> dict[str, Any]:
    """Mass and stiffness of a level; with one pattern of nonzeros, or diagonal mass at the finest level."""
    arrays = {
        f"indptr_{level}": stiffness.indptr,
        f"indices_{level}": stiffness.indices,
        f"stiffness_{level}": stiffness.data,
    }
    if diagonal:
        return arrays | {f"mass_{level}": mass.diagonal()}
    if not (np.array_equal(mass.indptr, stiffness.indptr) and np.array_equal(mass.indices, stiffness.indices)):
        raise FormatError(
            f"level {level}: expected mass and stiffness with the same pattern of nonzeros, as build_operators makes "
            "them, got others. Build the operators with cagemap.operators.build_operators."
        )
    return arrays | {f"mass_{level}": mass.data}


def _operators(arrays: dict[str, Any], refinement: Refinement, scale: float) -> Operators:
    masses, stiffnesses = [], []
    for level, mesh in enumerate(refinement.levels):
        n = mesh.n_vertices
        pattern = arrays[f"indices_{level}"], arrays[f"indptr_{level}"]
        stiffnesses.append(sparse.csr_array((arrays[f"stiffness_{level}"], *pattern), shape=(n, n)))
        mass = arrays[f"mass_{level}"]
        if level == refinement.finest_level:
            masses.append(sparse.csr_array(sparse.diags_array(mass)))
        else:
            masses.append(sparse.csr_array((mass, *pattern), shape=(n, n)))
    return Operators(tuple(masses), tuple(stiffnesses), float(scale))


def _usable_folder(folder: Path) -> Path:
    """Create a folder, and refuse one that cannot be written, before any work is done."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FormatError(
            f"{folder}: cannot be used as a folder for prepared surfaces ({error.strerror}). Give another folder."
        ) from error
    if not os.access(folder, os.W_OK):
        raise FormatError(f"{folder}: prepared surfaces cannot be written there. Give a folder that you may write to.")
    return folder
