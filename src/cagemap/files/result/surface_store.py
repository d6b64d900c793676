"""Prepared surfaces on disk: each surface is refined and given its basis once, for all its pairs.

A stored surface is one uncompressed ``.npz``: the control mesh and the basis. Refined levels and operators are computed
again, which is quick. Two processes may prepare one surface at once: the name is that of the content (`surface_key`).
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Callable
from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from cagemap import __version__
from cagemap.errors import CagemapError, FormatError, ParameterError
from cagemap.files.atomic import atomic_path
from cagemap.files.meshes.arrays import control_from_arrays, control_to_arrays, scheme_from_entry, scheme_to_entry
from cagemap.files.npz import Archive, ArraySpec, read_npz, write_npz
from cagemap.files.ownership import is_own
from cagemap.files.result.manifest import code_version, mesh_hash, stored_basis
from cagemap.files.schema import SurfaceRecord, parse_json, parse_record
from cagemap.files.text import require_file
from cagemap.mesh import ControlMesh, Plain, Scheme
from cagemap.pipeline import MAP_BASIS, prepare_surface
from cagemap.spectral import BasisConfig, HierarchicalBasis, Surface
from cagemap.subdivision import default_scheme, refine
from cagemap.subdivision.refinement import vertex_counts

FORMAT = "cagemap-surface"
SURFACE_VERSION = 5
SUFFIX = ".surface.npz"

_BASIS_ARRAYS = {
    "eigenvalues": ArraySpec(("k",)),
    "residuals": ArraySpec(("k",), nan=True),
    "indices": ArraySpec(("k",), below="n_finest"),
    "gram": ArraySpec(("k", "k")),
}
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
        "level": int(level),
        "scheme": scheme_to_entry(scheme),
        "basis": asdict(config),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def save_surface(path: str | Path, surface: Surface, *, force: bool = False) -> None:
    """Write a prepared surface to one file, completely or not at all.

    ParameterError if its operators are not those of its config, with which reading computes them.
    """
    expected = Surface(surface.refinement, surface.config).operators
    kinds = (surface.operators.mass, expected.mass), (surface.operators.stiffness, expected.stiffness)
    if any(len(a) != len(b) or any((x - y).data.any() for x, y in zip(a, b, strict=True)) for a, b in kinds):
        raise ParameterError(
            f"{surface.control.name}: its operators are not those of its config, and a stored surface has none. "
            "Give the config that they were made with, or store the matrices yourself."
        )
    control, basis, refinement = surface.control, surface.basis, surface.refinement
    header = {
        "format": FORMAT,
        "format_version": SURFACE_VERSION,
        "cagemap": __version__,
        "name": control.name,
        "material_names": list(control.material_names),
        "scheme": scheme_to_entry(refinement.scheme),
        "level": refinement.finest_level,
        "vertices": refinement.finest.n_vertices,
        "basis": asdict(surface.config),
        "bands": len(basis.bands),
    }
    arrays: dict[str, Any] = {"header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)}
    arrays |= control_to_arrays(control, "control_")
    arrays |= {f"band_{level}": band for level, band in enumerate(basis.bands)}
    arrays |= {name: getattr(basis, name) for name in _BASIS_ARRAYS}
    with atomic_path(path, force=force) as temporary:
        write_npz(temporary, arrays)


def load_or_prepare(
    folder: str | Path,
    control: ControlMesh,
    level: int,
    config: BasisConfig = MAP_BASIS,
    *,
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
        try:
            if is_own(place):
                return load_surface(place, control)
            problem = "it was changed since it was written"
        except FormatError as error:
            problem = str(error)
        logger.warning("%s is prepared again, its stored surface cannot be used: %s", control.name, problem)
    surface = prepare(control, level, config)
    save_surface(place, surface, force=True)  # its name is a hash of its inputs: any older file may be replaced
    return surface


def load_surface(path: str | Path, control: ControlMesh | None = None) -> Surface:
    """Read a prepared surface.

    A ``control`` mesh that is known to equal the stored one replaces it, including its name.
    """
    path = Path(path)
    require_file(path, "a prepared surface")
    archive = Archive(path, read_npz(path, _REMEDY), _REMEDY)
    header = _header(archive)
    scheme = scheme_from_entry(path, header.scheme, _REMEDY)
    if control is None:
        control = control_from_arrays(archive, "control_", header.material_names, header.name, scheme)
    level = 0 if isinstance(scheme, Plain) else header.level
    counts = list(islice(vertex_counts(control, scheme), level + 1))  # before memory runs out
    if (header.level, header.vertices) != (level, counts[-1]):
        archive.refuse(f"level {header.level} of its mesh has not {header.vertices} vertices, as stated")
    try:
        surface = Surface(refine(control, level, scheme), stored_basis(header.basis, None))
        sizes = {f"n{level}": mesh.n_vertices for level, mesh in enumerate(surface.hierarchy.levels)}
        sizes["n_finest"] = surface.operators.mass[-1].shape[0]
        specs = {f"band_{level}": ArraySpec((f"n{level}", f"k{level}")) for level in range(header.bands)}
        checked = archive.take(specs | _BASIS_ARRAYS, sizes)
        bands = tuple(checked[name] for name in specs)
        rest = (checked[name] for name in _BASIS_ARRAYS)
        basis = HierarchicalBasis(surface.hierarchy, surface.operators, bands, *rest)
    except FormatError:
        raise
    except (CagemapError, ValueError) as error:
        archive.refuse(f"its arrays do not belong to one surface ({error})")
    if sum(basis.schedule) != basis.count:
        archive.refuse("its arrays do not belong to one surface")
    return Surface.of(surface.hierarchy, surface.operators, basis, surface.config)


def _header(archive: Archive) -> SurfaceRecord:
    path, stored = archive.path, archive.arrays.get("header")
    entries = None
    if stored is not None and stored.dtype == np.uint8:
        entries = parse_json(stored.tobytes().decode("utf-8", "replace"), path, _REMEDY)
    if not isinstance(entries, dict) or entries.get("format") != FORMAT:
        raise FormatError(f"{path}: expected a surface stored by cagemap, got something else. Give another file.")
    if entries.get("format_version") != SURFACE_VERSION:
        raise FormatError(
            f"{path}: format version {entries.get('format_version')}, written by cagemap {entries.get('cagemap')}; "
            f"this cagemap {__version__} reads version {SURFACE_VERSION}. {_REMEDY}"
        )
    return parse_record(SurfaceRecord, entries, path, _REMEDY)


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
