"""Whether a control mesh is one that the method can take, and if not, which elements are at fault and what to do.

`check_mesh` reports everything it finds, `require_valid` raises. Geometry is judged relative to the mesh's own size, so
that the unit of the file does not matter. Vertices at the same place are valid, and so are vertices of valence 2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import InvalidMeshError
from cagemap.mesh.control_mesh import ControlMesh, UvSet
from cagemap.mesh.edge_checks import edge_manifold_problem, slit_notes
from cagemap.mesh.geometry_checks import extent_problem, inside_out_problem, zero_area_problem
from cagemap.mesh.mesh_report import MeshReport, Problem, first_few, problem_at
from cagemap.mesh.schemes import Plain
from cagemap.mesh.structure_checks import structure_problems
from cagemap.mesh.topology import (
    EdgeTable,
    boundary_loops,
    corner_fans,
    edge_table,
    face_components,
    turned_faces,
    used_vertices,
    uv_islands,
)
from cagemap.numerics.arrays import FloatArray, IndexArray, pair_keys
from cagemap.numerics.kinds import kinds_checked

SEVERAL = "several components"


@kinds_checked
def check_mesh(mesh: ControlMesh) -> MeshReport:
    """Count the elements of a control mesh and list everything that keeps the method from taking it.

    A fault that would only produce others hides them: copies of faces are named as such and not also as non-manifold
    edges, and faces with a repeated vertex are to be repaired before connectivity is judged.
    """
    blank = MeshReport(mesh.name, len(mesh.positions), None, max(len(mesh.face_offsets) - 1, 0))
    broken = structure_problems(mesh)
    if broken:
        return replace(blank, problems=broken)
    degenerate = repeated_corners(mesh)
    duplicates = duplicate_faces(mesh)
    kept = np.delete(np.arange(mesh.n_faces), duplicates)
    parts = _connect(keep_faces(mesh, kept) if len(duplicates) else mesh)
    problems = [_degenerate_problem(degenerate), _duplicates_problem(duplicates), _isolated_problem(mesh)]
    if not len(degenerate):
        problems += [
            edge_manifold_problem(parts.mesh, parts.edges, kept),
            _vertex_manifold_problem(parts),
            _orientation_problem(parts, kept),
        ]
    problems += [_components_problem(mesh, face_components(mesh)), extent_problem(mesh)]
    if problems[-1] is None and not isinstance(mesh.scheme, Plain):  # slivers of a scan are points of its surface
        problems.append(zero_area_problem(mesh, np.delete(np.arange(mesh.n_faces), degenerate)))
    if parts.loops is not None and not any(problems):
        problems.append(inside_out_problem(mesh, parts.loops))
    report = blank if len(degenerate) else _counts(parts, blank)
    sharp = _length(mesh.crease_edges), _length(mesh.corner_vertices), _length(mesh.hole_faces)
    found = tuple(problem for problem in problems if problem is not None)
    return replace(report, face_sizes=_face_sizes(mesh), sharp=sharp, problems=found)


def _length(values: IndexArray | None) -> int:
    return 0 if values is None else len(values)


@dataclass(frozen=True, eq=False)
class _Parts:
    """A mesh with what several checks ask of its connectivity."""

    mesh: ControlMesh
    edges: EdgeTable
    fans: IndexArray
    turned: NDArray[np.bool_] | None
    loops: tuple[IndexArray, ...] | None


def _connect(mesh: ControlMesh) -> _Parts:
    edges = edge_table(mesh)
    fans = corner_fans(mesh, edges)
    return _Parts(mesh, edges, fans, turned_faces(mesh, edges), boundary_loops(mesh, edges, fans))


def require_valid(mesh: ControlMesh, *, pieces: bool = False) -> None:
    """Raise unless the method can take the mesh.

    Parameters
    ----------
    mesh : ControlMesh
    pieces : bool
        Take a mesh of several components too, each of which was matched for itself.

    Raises
    ------
    InvalidMeshError
        Names every kind of problem, its first elements (0-based, in the file's numbering) and the remedy.
    """
    problems = [problem for problem in check_mesh(mesh).problems if not (pieces and problem.kind == SEVERAL)]
    if problems:
        count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
        listed = "".join(f"\n  - {problem}" for problem in problems)
        raise InvalidMeshError(
            f"{mesh.name}: expected a manifold, consistently oriented mesh of one piece, got {count}:{listed}"
        )


def keep_faces(mesh: ControlMesh, faces: IndexArray) -> ControlMesh:
    """Return the mesh with only some of its faces; vertices and texture coordinates stay as they are."""
    sizes = mesh.face_sizes[faces]
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    corners = np.repeat(mesh.face_offsets[faces] - offsets[:-1], sizes) + np.arange(offsets[-1])
    return with_corners_of(mesh, faces, offsets, corners)


def with_corners_of(mesh: ControlMesh, faces: IndexArray, offsets: IndexArray, corners: IndexArray) -> ControlMesh:
    """Return the mesh with other faces, made of its own face corners.

    Parameters
    ----------
    mesh : ControlMesh
    faces : (k,) int64
        Face that every new one comes from; ascending where there are hole faces.
    offsets : (k + 1,) int64
        Where each new face starts in ``corners``.
    corners : (c,) int64
        Corner of the mesh that every new one is.
    """
    indices = mesh.face_indices[corners]
    creases, sharpness = _creases_left(mesh, indices, offsets)

    def of_faces(values: IndexArray | None) -> IndexArray | None:
        return None if values is None else values[faces]

    return replace(
        mesh,
        face_offsets=offsets,
        face_indices=indices,
        uv_indices=None if mesh.uv_indices is None else mesh.uv_indices[corners],
        uv_sets=tuple(UvSet(one.name, one.uvs, one.uv_indices[corners]) for one in mesh.uv_sets),
        face_materials=of_faces(mesh.face_materials),
        face_objects=of_faces(mesh.face_objects),
        face_groups=of_faces(mesh.face_groups),
        file_faces=of_faces(mesh.file_faces),
        hole_faces=None if mesh.hole_faces is None else np.flatnonzero(np.isin(faces, mesh.hole_faces)),
        crease_edges=creases,
        crease_sharpness=sharpness,
    )


def _creases_left(
    mesh: ControlMesh, indices: IndexArray, offsets: IndexArray
) -> tuple[IndexArray | None, FloatArray | None]:
    """Creases that are edges of the faces kept."""
    if mesh.crease_edges is None or mesh.crease_sharpness is None:
        return None, None
    following = ControlMesh(mesh.positions, offsets, indices).next_corners
    ends = pair_keys(np.column_stack([indices, indices[following]]), mesh.n_vertices)
    there = np.isin(pair_keys(mesh.crease_edges, mesh.n_vertices), ends)
    return mesh.crease_edges[there], mesh.crease_sharpness[there]


def duplicate_faces(mesh: ControlMesh) -> IndexArray:
    """Faces that have the same vertices, in whatever order, as a face of a lower number."""
    copies = []
    for size in np.unique(mesh.face_sizes):
        faces = np.flatnonzero(mesh.face_sizes == size)
        corners = np.sort(mesh.face_indices[mesh.face_offsets[faces][:, None] + np.arange(size)], axis=1)
        order = np.lexsort(corners.T)  # stable: of equal faces the lowest number comes first
        same = np.all(corners[order][1:] == corners[order][:-1], axis=1)
        copies.append(faces[order][1:][same])
    return np.sort(np.concatenate(copies))


def _face_sizes(mesh: ControlMesh) -> tuple[tuple[int, int], ...]:
    sizes, counts = np.unique(mesh.face_sizes, return_counts=True)
    return tuple(zip(sizes.tolist(), counts.tolist(), strict=True))


def _counts(parts: _Parts, blank: MeshReport) -> MeshReport:
    mesh, edges, loops = parts.mesh, parts.edges, parts.loops
    components = np.bincount(face_components(mesh))
    used = used_vertices(mesh)
    edges_at = np.bincount(edges.vertices.ravel(), minlength=mesh.n_vertices)[used]
    euler = int(used.sum()) - len(edges.vertices) + mesh.n_faces
    islands = uv_islands(mesh)
    # 2 - 2 g - b for every piece; vertices that hold two fans together are no surface and have no genus.
    handles, odd = divmod(2 * len(components) - euler - len(loops or ()), 2)
    is_surface = loops is not None and parts.turned is not None and not odd and handles >= 0
    return replace(
        blank,
        n_edges=len(edges.vertices),
        euler_characteristic=euler,
        genus=handles if is_surface else None,
        boundary_edges=len(edges.boundary_corners()),
        boundary_loops=None if loops is None else tuple(tuple(loop.tolist()) for loop in loops),
        notes=slit_notes(mesh, loops),
        component_sizes=tuple(components.tolist()),
        valence_range=(int(edges_at.min()), int(edges_at.max())),
        uv_islands=None if islands is None else int(islands.max()) + 1,
    )


def repeated_corners(mesh: ControlMesh) -> IndexArray:
    """Faces of fewer than three corners, or that visit a vertex twice."""
    faces = mesh.corner_faces
    order = np.lexsort([mesh.face_indices, faces])
    same = (np.diff(mesh.face_indices[order]) == 0) & (np.diff(faces[order]) == 0)
    return np.union1d(np.flatnonzero(mesh.face_sizes < 3), faces[order][1:][same])


def _degenerate_problem(faces: IndexArray) -> Problem | None:
    return problem_at(
        "degenerate faces",
        f"expected at least three different vertices around every face, got {len(faces)} face(s) with fewer or with "
        "one repeated, faces",
        faces,
        "Dissolve the zero-length edges or delete these faces; connectivity is checked after that.",
    )


def _duplicates_problem(faces: IndexArray) -> Problem | None:
    return problem_at(
        "duplicate faces",
        f"expected every face once, got {len(faces)} face(s) with the same vertices as an earlier one, faces",
        faces,
        "Delete these copies.",
    )


def _isolated_problem(mesh: ControlMesh) -> Problem | None:
    unused = np.flatnonzero(~used_vertices(mesh))
    return problem_at(
        "isolated vertices",
        f"expected every vertex to belong to a face, got {len(unused)} without, vertices",
        unused,
        "Delete the loose vertices (this renumbers the others: landmarks must be made for the new file).",
    )


def _vertex_manifold_problem(parts: _Parts) -> Problem | None:
    """Vertices whose faces form several fans. Edges of too many faces are named elsewhere and count as joined here."""
    _, first_corners = np.unique(parts.fans, return_index=True)
    bad = np.flatnonzero(np.bincount(parts.mesh.face_indices[first_corners]) > 1)
    return problem_at(
        "non-manifold vertices",
        f"expected the faces around every vertex to form one fan, got {len(bad)} vertex/vertices where parts of the "
        "surface touch in a point only, vertices",
        bad,
        "Split these vertices (one copy per fan), or add the missing faces between the fans.",
    )


def _orientation_problem(parts: _Parts, numbers: IndexArray) -> Problem | None:
    if parts.turned is None:
        return Problem(
            "one-sided surface",
            "expected a surface with an inside and an outside, got one where no choice of face directions agrees along "
            "all edges (as on a Moebius strip)",
            (),
            "Cut the surface where its two sides are joined.",
        )
    flipped = numbers[parts.turned]
    return problem_at(
        "inconsistent orientation",
        f"expected neighbouring faces to run in the same sense, got {len(flipped)} of {len(numbers)} faces turned "
        "against the others, faces",
        flipped,
        "Flip these faces (recalculate normals to the outside in the modelling program).",
    )


def _components_problem(mesh: ControlMesh, labels: IndexArray) -> Problem | None:
    sizes = np.bincount(labels)
    if len(sizes) == 1:
        return None
    first_faces = np.unique(labels, return_index=True)[1]
    copy = " One is a copy of another in the same place." if _has_copied_component(mesh, labels) else ""
    return Problem(
        SEVERAL,
        f"expected one connected piece, got {len(sizes)} of {first_few(sizes.tolist())} faces, which begin at faces",
        tuple(first_faces.tolist()),
        "Match a part (`find_part` NAME, largest, or each; the check lists them), or delete the pieces not "
        f"wanted.{copy}",
    )


def _has_copied_component(mesh: ControlMesh, labels: IndexArray, examined: int = 16) -> bool:
    """Whether two of the first few components have the same vertex positions."""
    clouds = set()
    for label in range(min(int(labels.max()) + 1, examined)):
        vertices = np.unique(mesh.face_indices[(labels == label)[mesh.corner_faces]])
        points = mesh.positions[vertices]
        cloud = points[np.lexsort(points.T)].tobytes()
        if cloud in clouds:
            return True
        clouds.add(cloud)
    return False
