"""Check the arrays of a control mesh: shapes, ranges, finite numbers."""

from __future__ import annotations

import numpy as np

from cagemap.errors import InvalidMeshError
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.mesh_report import MeshProblem, count_noun, list_problems, problem_at
from cagemap.numerics.arrays import FloatArray, IndexArray, pair_keys

_EXPORT = "Export the mesh again, or repair the arrays it was built from."


def structure_problems(mesh: ControlMesh) -> tuple[MeshProblem, ...]:
    """Problems of the mesh's arrays; other checks require that there are none."""
    problems = [_positions(mesh), _faces(mesh)]
    if not any(problems):
        problems += [
            _uvs(mesh),
            _labels(mesh),
            _sharp(mesh, "crease", mesh.crease_edges, mesh.crease_sharpness, (2,)) or _loose_creases(mesh),
            _sharp(mesh, "corner", mesh.corner_vertices, mesh.corner_sharpness, ()),
            _holes(mesh),
        ]
    return tuple(problem for problem in problems if problem is not None)


def require_structure(mesh: ControlMesh) -> None:
    """Raise InvalidMeshError if the arrays have problems."""
    broken = structure_problems(mesh)
    if broken:
        raise InvalidMeshError(f"{mesh.name}: expected a mesh, got {len(broken)} problem(s):{list_problems(broken)}")


def _problem(found: str, remedy: str = _EXPORT) -> MeshProblem:
    return MeshProblem("broken data", found, remedy)


def _out_of_range(numbers: IndexArray, count: int, what: str, elements: IndexArray, where: str) -> MeshProblem | None:
    """Problem of elements (k,), each a ``where``, whose numbers (k,) or (k, 2) are not all from 0 to ``count - 1``."""
    outside = (numbers < 0) | (numbers >= count)
    bad = np.unique(elements[outside if outside.ndim == 1 else outside.any(axis=1)])
    found = f"expected {what} from 0 to {count - 1}, got others in {count_noun(len(bad), where)}, {where}s"
    one_based = numbers.size and (numbers.min(), numbers.max()) == (1, count)
    return problem_at("broken data", found, bad, "Numbers start at 0: subtract 1." if one_based else _EXPORT)


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
        of_vertices=True,
    )


def _faces(mesh: ControlMesh) -> MeshProblem | None:
    offsets, indices = mesh.face_offsets, mesh.face_indices
    if offsets.ndim != 1 or indices.ndim != 1 or not _integers(offsets) or not _integers(indices):
        return _problem("expected face_offsets and face_indices to be one-dimensional integer arrays")
    if len(offsets) < 2:
        return _problem("expected at least one face, got none", remedy="Export the control mesh with its faces.")
    if offsets[0] != 0 or offsets[-1] != len(indices):
        return _problem(f"expected face_offsets from 0 to {len(indices)}, got {offsets[0]} to {offsets[-1]}")
    empty = np.flatnonzero(np.diff(offsets) <= 0)
    if len(empty):
        found = f"expected corners on every face, got {len(empty)} face(s) without, faces"
        return problem_at("broken data", found, empty, _EXPORT)
    return _out_of_range(indices, len(mesh.positions), "vertex numbers", mesh.corner_faces, "face")


def _uvs(mesh: ControlMesh) -> MeshProblem | None:
    uvs, indices = mesh.uvs, mesh.uv_indices
    if uvs is None and indices is None:
        return None
    if uvs is None or indices is None or uvs.ndim != 2 or uvs.shape[1] != 2 or not _integers(indices):
        return _problem("expected uvs of shape (p, 2) together with integer uv_indices, or neither")
    if indices.shape != mesh.face_indices.shape:
        return _problem(f"expected one UV index per corner ({len(mesh.face_indices)}), got {indices.shape}")
    bad = np.flatnonzero(~np.isfinite(uvs).all(axis=1))
    found = f"expected finite texture coordinates, got NaN or infinity at {len(bad)}, UVs"
    outside = _out_of_range(indices, len(uvs), "UV indices", mesh.corner_faces, "face")
    return outside or problem_at("broken data", found, bad, _EXPORT)


def _labels(mesh: ControlMesh) -> MeshProblem | None:
    """Problem of colours, or of the numbers of objects, groups and materials."""
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
        problem = _out_of_range(numbers, len(names), f"{what} numbers", np.arange(mesh.n_faces), "face")
        if problem is not None:
            return problem
    return None


def _sharp(
    mesh: ControlMesh, what: str, elements: IndexArray | None, sharpness: FloatArray | None, row: tuple[int, ...]
) -> MeshProblem | None:
    """Problem of creases or corners, arrays with rows of the given shape, and their sharpness."""
    if elements is None and sharpness is None:
        return None
    shaped = elements is not None and elements.ndim == 1 + len(row) and elements.shape[1:] == row
    if elements is None or sharpness is None or not shaped or not _integers(elements):
        array = "crease_edges of shape (k, 2)" if row else "corner_vertices of shape (k,)"
        return _problem(f"expected {array} together with {what}_sharpness, or neither")
    if sharpness.shape != elements.shape[:1]:
        return _problem(f"expected one sharpness per {what} ({len(elements)}), got {sharpness.shape}")
    bad = np.flatnonzero(~(sharpness >= 0))
    found = f"expected sharpness of 0 or more, got {count_noun(len(bad), what)} with less or with NaN, {what}s"
    listed = np.arange(len(elements)) if row else elements
    outside = _out_of_range(elements, mesh.n_vertices, f"vertices of {what}s", listed, what)
    return outside or problem_at("broken data", found, bad, _EXPORT)


def _loose_creases(mesh: ControlMesh) -> MeshProblem | None:
    if mesh.crease_edges is None:
        return None
    of_faces = np.column_stack([mesh.face_indices, mesh.face_indices[mesh.next_corners]])
    loose = ~np.isin(pair_keys(mesh.crease_edges, mesh.n_vertices), pair_keys(of_faces, mesh.n_vertices))
    return problem_at(
        "creases beside the mesh",
        f"expected creases on edges of the mesh, got {loose.sum()} where no edge is, between vertices",
        mesh.crease_edges[loose],
        "Take these creases out, or export the mesh again.",
    )


def _holes(mesh: ControlMesh) -> MeshProblem | None:
    holes = mesh.hole_faces
    if holes is None:
        return None
    if holes.ndim != 1 or not _integers(holes):
        return _problem("expected hole_faces of shape (h,) and an integer type")
    return _out_of_range(holes, mesh.n_faces, "faces of holes", holes, "hole")


def _integers(array: IndexArray) -> bool:
    return bool(np.issubdtype(array.dtype, np.integer))
