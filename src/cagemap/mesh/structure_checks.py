"""Check the arrays of a control mesh: shapes, ranges, finite numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import InvalidMeshError
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.mesh_report import MeshProblem, list_problems, problem_at
from cagemap.numerics.arrays import FloatArray, pair_keys

_EXPORT = "Export the mesh again, or repair the arrays it was built from."


def structure_problems(mesh: ControlMesh) -> tuple[MeshProblem, ...]:
    """Problems of the mesh's arrays; other checks require that there are none."""
    problems = [_positions(mesh), _offsets(mesh)]
    if not any(problems):
        problems += [_indices(mesh), _uvs(mesh), _materials(mesh), _creases(mesh), _corners(mesh), _holes(mesh)]
    return tuple(problem for problem in problems if problem is not None)


def require_structure(mesh: ControlMesh) -> None:
    """Raise InvalidMeshError if the arrays have problems."""
    broken = structure_problems(mesh)
    if broken:
        raise InvalidMeshError(f"{mesh.name}: expected a mesh, got {len(broken)} problem(s):{list_problems(broken)}")


def _problem(found: str, remedy: str = _EXPORT) -> MeshProblem:
    return MeshProblem("broken data", found, (), remedy)


def _problem_at(found: str, elements: NDArray[np.int64]) -> MeshProblem | None:
    return problem_at("broken data", found, elements, _EXPORT)


def _positions(mesh: ControlMesh) -> MeshProblem | None:
    positions = mesh.positions
    if positions.ndim != 2 or positions.shape[1] != 3 or positions.dtype != np.float64:
        return _problem(f"expected positions of shape (n, 3) and type float64, got {positions.shape} {positions.dtype}")
    bad = np.flatnonzero(~np.isfinite(positions).all(axis=1))
    return problem_at(
        "positions that are not numbers",
        f"expected finite positions, got NaN or infinity at {len(bad)} vertex/vertices, vertices",
        bad,
        "Move these vertices to where they belong, or delete them.",
    )


def _offsets(mesh: ControlMesh) -> MeshProblem | None:
    offsets, indices = mesh.face_offsets, mesh.face_indices
    if offsets.ndim != 1 or indices.ndim != 1 or not _integers(offsets) or not _integers(indices):
        return _problem("expected face_offsets and face_indices to be one-dimensional integer arrays")
    if len(offsets) < 2:
        return _problem("expected at least one face, got none", remedy="Export the control mesh with its faces.")
    if offsets[0] != 0 or offsets[-1] != len(indices):
        return _problem(f"expected face_offsets from 0 to {len(indices)}, got {offsets[0]} to {offsets[-1]}")
    empty = np.flatnonzero(np.diff(offsets) <= 0)
    return _problem_at(f"expected corners on every face, got {len(empty)} face(s) without, faces", empty)


def _indices(mesh: ControlMesh) -> MeshProblem | None:
    outside = (mesh.face_indices < 0) | (mesh.face_indices >= mesh.n_vertices)
    faces = np.unique(mesh.corner_faces[outside])
    return _problem_at(
        f"expected vertex numbers from 0 to {mesh.n_vertices - 1}, got others in {len(faces)} face(s), faces", faces
    )


def _uvs(mesh: ControlMesh) -> MeshProblem | None:
    uvs, indices = mesh.uvs, mesh.uv_indices
    if uvs is None and indices is None:
        return None
    if uvs is None or indices is None or uvs.ndim != 2 or uvs.shape[1] != 2 or not _integers(indices):
        return _problem("expected uvs of shape (p, 2) together with integer uv_indices, or neither")
    if indices.shape != mesh.face_indices.shape:
        return _problem(f"expected one UV index per corner ({len(mesh.face_indices)}), got {indices.shape}")
    faces = np.unique(mesh.corner_faces[(indices < 0) | (indices >= len(uvs))])
    bad = np.flatnonzero(~np.isfinite(uvs).all(axis=1))
    return _problem_at(
        f"expected UV indices from 0 to {len(uvs) - 1}, got others in {len(faces)} face(s), faces", faces
    ) or _problem_at(f"expected finite texture coordinates, got NaN or infinity at {len(bad)}, UVs", bad)


def _materials(mesh: ControlMesh) -> MeshProblem | None:
    colors, count = mesh.material_colors, len(mesh.material_names)
    if colors is not None and colors.shape != (count, 3):
        return _problem(f"expected material_colors of shape ({count}, 3), got {colors.shape}")
    if mesh.vertex_colors is not None and mesh.vertex_colors.shape != (mesh.n_vertices, 3):
        return _problem(f"expected vertex_colors of shape ({mesh.n_vertices}, 3), got {mesh.vertex_colors.shape}")
    for what, numbers, names in mesh.partitions:
        if numbers is None:
            continue
        if numbers.shape != (mesh.n_faces,) or not _integers(numbers):
            return _problem(f"expected one integer {what} per face ({mesh.n_faces}), got {numbers.shape}")
        bad = np.flatnonzero((numbers < 0) | (numbers >= len(names)))
        if len(bad):
            return _problem_at(
                f"expected {what} numbers from 0 to {len(names) - 1}, got others on {len(bad)} face(s), faces", bad
            )
    return None


def _creases(mesh: ControlMesh) -> MeshProblem | None:
    edges, sharpness = mesh.crease_edges, mesh.crease_sharpness
    if edges is None and sharpness is None:
        return None
    if edges is None or sharpness is None or edges.ndim != 2 or edges.shape[1] != 2 or not _integers(edges):
        return _problem("expected crease_edges of shape (k, 2) together with crease_sharpness, or neither")
    if sharpness.shape != (len(edges),):
        return _problem(f"expected one sharpness per crease ({len(edges)}), got {sharpness.shape}")
    outside = ((edges < 0) | (edges >= mesh.n_vertices)).any(axis=1)
    if outside.any():
        return _problem_at(
            f"expected creases between vertices 0 to {mesh.n_vertices - 1}, got {outside.sum()} with others, creases",
            np.flatnonzero(outside),
        )
    of_faces = np.column_stack([mesh.face_indices, mesh.face_indices[mesh.next_corners]])
    loose = ~np.isin(pair_keys(edges, mesh.n_vertices), pair_keys(of_faces, mesh.n_vertices))
    if loose.any():
        return MeshProblem(
            "creases beside the mesh",
            f"expected creases on edges of the mesh, got {loose.sum()} where no edge is, between vertices",
            tuple((a, b) for a, b in edges[loose].tolist()),
            "Take these creases out, or export the mesh again.",
        )
    return _sharpness(sharpness, "creases")


def _corners(mesh: ControlMesh) -> MeshProblem | None:
    vertices, sharpness = mesh.corner_vertices, mesh.corner_sharpness
    if vertices is None and sharpness is None:
        return None
    if vertices is None or sharpness is None or vertices.ndim != 1 or not _integers(vertices):
        return _problem("expected corner_vertices of shape (k,) together with corner_sharpness, or neither")
    if sharpness.shape != vertices.shape:
        return _problem(f"expected one sharpness per corner ({len(vertices)}), got {sharpness.shape}")
    outside = vertices[(vertices < 0) | (vertices >= mesh.n_vertices)]
    return _problem_at(
        f"expected corners at vertices 0 to {mesh.n_vertices - 1}, got {len(outside)} others", outside
    ) or _sharpness(sharpness, "corners")


def _sharpness(sharpness: FloatArray, what: str) -> MeshProblem | None:
    bad = np.flatnonzero(~(sharpness >= 0))
    return _problem_at(f"expected sharpness of 0 or more, got {len(bad)} {what} with less or with NaN, {what}", bad)


def _holes(mesh: ControlMesh) -> MeshProblem | None:
    holes = mesh.hole_faces
    if holes is None:
        return None
    if holes.ndim != 1 or not _integers(holes):
        return _problem("expected hole_faces of shape (h,) and an integer type")
    outside = holes[(holes < 0) | (holes >= mesh.n_faces)]
    return _problem_at(f"expected holes at faces 0 to {mesh.n_faces - 1}, got {len(outside)} others", outside)


def _integers(array: NDArray[np.int64]) -> bool:
    return bool(np.issubdtype(array.dtype, np.integer))
