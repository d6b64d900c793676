"""Whether the arrays of a control mesh fit together at all: shapes, ranges, finite numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.mesh_report import Problem

_EXPORT = "Export the mesh again, or repair the arrays it was built from."


def structure_problems(mesh: ControlMesh) -> tuple[Problem, ...]:
    """List what keeps the arrays from describing a mesh; further checks make sense only where this is empty."""
    found = [_positions(mesh), _offsets(mesh)]
    if not any(found):
        found += [_indices(mesh), _uvs(mesh), _materials(mesh)]
    return tuple(problem for problem in found if problem is not None)


def _problem(found: str, elements: NDArray[np.int64] | None = None, remedy: str = _EXPORT) -> Problem:
    return Problem("broken data", found, () if elements is None else tuple(elements.tolist()), remedy)


def _positions(mesh: ControlMesh) -> Problem | None:
    positions = mesh.positions
    if positions.ndim != 2 or positions.shape[1] != 3 or positions.dtype != np.float64:
        return _problem(f"expected positions of shape (n, 3) and type float64, got {positions.shape} {positions.dtype}")
    bad = np.flatnonzero(~np.isfinite(positions).all(axis=1))
    if len(bad):
        return Problem(
            "positions that are not numbers",
            f"expected finite positions, got NaN or infinity at {len(bad)} vertex/vertices, vertices",
            tuple(bad.tolist()),
            "Move these vertices to where they belong, or delete them.",
        )
    return None


def _offsets(mesh: ControlMesh) -> Problem | None:
    offsets, indices = mesh.face_offsets, mesh.face_indices
    if offsets.ndim != 1 or indices.ndim != 1 or not _integers(offsets) or not _integers(indices):
        return _problem("expected face_offsets and face_indices to be one-dimensional integer arrays")
    if len(offsets) < 2:
        return _problem("expected at least one face, got none", remedy="Export the control mesh with its faces.")
    if offsets[0] != 0 or offsets[-1] != len(indices):
        return _problem(f"expected face_offsets from 0 to {len(indices)}, got {offsets[0]} to {offsets[-1]}")
    empty = np.flatnonzero(np.diff(offsets) <= 0)
    if len(empty):
        return _problem(f"expected corners on every face, got {len(empty)} face(s) without, faces", empty)
    return None


def _indices(mesh: ControlMesh) -> Problem | None:
    outside = (mesh.face_indices < 0) | (mesh.face_indices >= mesh.n_vertices)
    if not outside.any():
        return None
    faces = np.unique(mesh.corner_faces[outside])
    return _problem(
        f"expected vertex numbers from 0 to {mesh.n_vertices - 1}, got others in {len(faces)} face(s), faces", faces
    )


def _uvs(mesh: ControlMesh) -> Problem | None:
    uvs, indices = mesh.uvs, mesh.uv_indices
    if uvs is None and indices is None:
        return None
    if uvs is None or indices is None or uvs.ndim != 2 or uvs.shape[1] != 2 or not _integers(indices):
        return _problem("expected uvs of shape (p, 2) together with integer uv_indices, or neither")
    if indices.shape != mesh.face_indices.shape:
        return _problem(f"expected one UV index per corner ({len(mesh.face_indices)}), got {indices.shape}")
    outside = (indices < 0) | (indices >= len(uvs))
    if outside.any():
        faces = np.unique(mesh.corner_faces[outside])
        return _problem(
            f"expected UV indices from 0 to {len(uvs) - 1}, got others in {len(faces)} face(s), faces", faces
        )
    bad = np.flatnonzero(~np.isfinite(uvs).all(axis=1))
    if len(bad):
        return _problem(f"expected finite texture coordinates, got NaN or infinity at {len(bad)}, UVs", bad)
    return None


def _materials(mesh: ControlMesh) -> Problem | None:
    materials, colors, count = mesh.face_materials, mesh.material_colors, len(mesh.material_names)
    if colors is not None and colors.shape != (count, 3):
        return _problem(f"expected material_colors of shape ({count}, 3), got {colors.shape}")
    if materials is None:
        return None
    if materials.shape != (mesh.n_faces,) or not _integers(materials):
        return _problem(f"expected one integer material per face ({mesh.n_faces}), got {materials.shape}")
    bad = np.flatnonzero((materials < 0) | (materials >= count))
    if len(bad):
        return _problem(
            f"expected material numbers from 0 to {count - 1}, got others on {len(bad)} face(s), faces", bad
        )
    return None


def _integers(array: NDArray[np.int64]) -> bool:
    return bool(np.issubdtype(array.dtype, np.integer))
