"""Join vertices repeated at one position, as in glTF and FBX files along seams of UVs and normals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from cagemap.errors import InvalidMeshError, ParameterError
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.faces import with_corners_of
from cagemap.mesh.inputs import MeshLike, arrays_accepted
from cagemap.mesh.mesh_report import count_noun
from cagemap.mesh.parts import extract_faces, renumbered_copies
from cagemap.mesh.repairs import RepairedMesh, Repairs
from cagemap.mesh.structure_checks import require_structure
from cagemap.mesh.topology import face_components, face_pieces, mesh_topology, used_vertices
from cagemap.numerics.arrays import (
    FloatArray,
    IndexArray,
    box_diagonal,
    grouped_sums,
    label_components,
    offsets_of,
    pair_keys,
    places_of,
)

# Tolerances that `weld_tolerance` tries, in units of the bounding-box diagonal: equal, rounded to float32, and rounded
# to five digits. Not larger, as borders of separate pieces, such as eyelashes, can be 1e-4 apart.
TOLERANCES = (0.0, 1e-6, 1e-5)
COLOR_STEP = 0.5 / 255  # least difference of colours that shows in 8 bits


@arrays_accepted
def weld_mesh(mesh: MeshLike, tolerance: float | None = None, *, offsets: FloatArray | None = None) -> RepairedMesh:
    """Join border vertices at the same position; the lowest number stays.

    Inner vertices are not joined, so that surfaces in contact stay separate. Repeated corners of a face are merged, and
    faces with fewer than three corners are dropped. Colours of joined vertices are averaged. InvalidMeshError if the
    arrays are no mesh, or no face would be left; ParameterError if the tolerance is not a number from 0 to 0.1.

    ``tolerance`` is the largest distance between vertices that are joined, in units of the bounding-box diagonal; 0
    joins equal ones only. Default: `weld_tolerance`, or 0 if that is None. With ``offsets`` (n, 3 k) of k blend shapes
    only vertices at the same position in all of them are joined, so that closed lips stay separate.

    Examples
    --------
    >>> from cagemap import ControlMesh
    >>> two = ControlMesh.from_faces([(0, 0, 0), (1, 0, 0), (0, 1, 0)] * 2, [(0, 1, 2), (3, 5, 4)])
    >>> weld_mesh(two).mesh.face_indices
    array([0, 1, 2, 0, 2, 1])
    """
    require_structure(mesh)
    if tolerance is not None and not 0.0 <= tolerance <= 0.1:
        raise ParameterError(
            f"{mesh.name}: expected a weld tolerance from 0 to 0.1 of the bounding-box diagonal, got {tolerance}"
        )
    used = (weld_tolerance(mesh, offsets=offsets) or 0.0) if tolerance is None else tolerance
    within = f"within {used:g} of the bounding-box diagonal" if used else "at the same place"
    first = coincident_vertices(mesh, used, offsets=offsets)
    joined = np.flatnonzero(first != np.arange(mesh.n_vertices))
    if not len(joined):
        return RepairedMesh(mesh, first, (f"{mesh.name}: no border vertices {within} to weld",))
    colors, averaged = mean_colors(mesh, first)
    work = _relabelled(replace(mesh, vertex_colors=colors), first)
    work, collapsed = _without_repeats(work)
    if not work.n_faces:
        raise InvalidMeshError(
            f"{mesh.name}: expected faces after welding vertices {within}, got none. Give a smaller tolerance."
        )
    ready = extract_faces(work, np.arange(work.n_faces))
    kept = np.unique(work.face_indices)
    vertex_of = places_of(kept, mesh.n_vertices)[first]
    ready = replace(ready, file_copies=file_copies(mesh, joined, vertex_of))
    notes = [
        f"{mesh.name}: {len(joined)} of {mesh.n_vertices} vertices are welded to others {within}; "
        f"{_pieces(mesh)} became {_pieces(ready)}",
        *([f"{mesh.name}: {collapsed} faces collapsed and are left out"] if collapsed else []),
        *(f"{mesh.name}: {sentence}" for sentence in Repairs(averaged_colors=averaged).sentences()),
    ]
    loose = mesh.n_vertices - int(used_vertices(mesh).sum())
    if loose:
        notes.append(f"{mesh.name}: {loose} vertices of no face are left out")
    return RepairedMesh(ready, vertex_of, tuple(notes))


def file_copies(mesh: ControlMesh, joined: IndexArray, vertex_of: IndexArray) -> IndexArray | None:
    """``file_copies`` of a mesh whose vertices (k,) were joined; ``vertex_of`` (n,): new numbers, -1 if removed."""
    copies = np.column_stack([joined, mesh.file_numbers[0][joined]])
    if mesh.file_copies is not None:
        copies = np.concatenate([copies, mesh.file_copies])
    return renumbered_copies(copies, vertex_of)


def _relabelled(mesh: ControlMesh, first: IndexArray) -> ControlMesh:
    """Replace every vertex by the first coincident one; the larger of two sharpnesses stays."""
    work = replace(mesh, face_indices=first[mesh.face_indices])
    if mesh.crease_edges is not None and mesh.crease_sharpness is not None:
        edges = np.sort(first[mesh.crease_edges], axis=1)
        _, once, number = np.unique(pair_keys(edges, mesh.n_vertices), return_index=True, return_inverse=True)
        work = work.with_creases(edges[once], _largest(mesh.crease_sharpness, number))
    if mesh.corner_vertices is not None and mesh.corner_sharpness is not None:
        corners, number = np.unique(first[mesh.corner_vertices], return_inverse=True)
        work = work.with_corners(corners, _largest(mesh.corner_sharpness, number))
    return work


def _largest(values: FloatArray, groups: IndexArray) -> FloatArray:
    largest = np.full(groups.max(initial=-1) + 1, -np.inf)
    np.maximum.at(largest, groups, values)
    return largest


def _without_repeats(mesh: ControlMesh) -> tuple[ControlMesh, int]:
    """Drop repeated corners, then faces of fewer than three corners; also the number of dropped faces."""
    kept = mesh.face_indices != mesh.face_indices[mesh.next_corners]
    if kept.all():
        return mesh, 0
    sizes = np.add.reduceat(kept, mesh.face_offsets[:-1])
    faces = np.flatnonzero(sizes >= 3)
    corners = np.flatnonzero(kept & (sizes >= 3)[mesh.corner_faces])
    offsets = offsets_of(sizes[faces])
    return with_corners_of(mesh, faces, offsets, corners), mesh.n_faces - len(faces)


def mean_colors(mesh: ControlMesh, first: IndexArray) -> tuple[FloatArray | None, int]:
    """Vertex colours averaged over joined vertices, and the number of vertices whose colour differs from it."""
    colors = mesh.vertex_colors
    if colors is None:
        return None, 0
    known = np.isfinite(colors).all(axis=1)
    sums = grouped_sums(first[known], colors[known], mesh.n_vertices)
    counts = np.bincount(first[known], minlength=mesh.n_vertices)
    with np.errstate(invalid="ignore"):
        mean = (sums / counts[:, None])[first]
    return mean, int(np.sum(known & (np.abs(colors - mean) > COLOR_STEP).any(axis=1)))


def _pieces(mesh: ControlMesh) -> str:
    return count_noun(int(face_components(mesh).max()) + 1, "piece")


def coincident_vertices(
    mesh: ControlMesh, tolerance: float = 0.0, *, collapse: bool = False, offsets: FloatArray | None = None
) -> IndexArray:
    """(n,) lowest border vertex within the tolerance of each border vertex; others stay, so that closed lips do.

    With ``collapse`` the ends of edges of length 0 are joined too.
    """
    topology = mesh_topology(mesh)
    ends = topology.edge_vertices
    border = np.unique(ends[topology.outer_edges])
    places = mesh.positions if offsets is None else np.column_stack([mesh.positions, offsets])
    with np.errstate(over="ignore"):
        diagonal = box_diagonal(mesh.positions[used_vertices(mesh)])
    links = [border[_close_pairs(places[border], tolerance * diagonal)]]
    if collapse:
        links.append(ends[np.all(mesh.positions[ends[:, 0]] == mesh.positions[ends[:, 1]], axis=1)])
    pairs = np.concatenate(links)
    if not len(pairs):
        return np.arange(mesh.n_vertices)
    labels = label_components(pairs[:, 0], pairs[:, 1], mesh.n_vertices)
    return np.unique(labels, return_index=True)[1][labels].astype(np.int64)


def weld_tolerance(mesh: ControlMesh, *, offsets: FloatArray | None = None) -> float | None:
    """Smallest of `TOLERANCES` with the fewest pieces that keeps positions in a face apart; None if none helps."""
    following = mesh.face_indices[mesh.next_corners]
    best, fewest = None, count_pieces(mesh, np.arange(mesh.n_vertices))
    for tolerance in TOLERANCES:
        labels = coincident_vertices(mesh, tolerance, offsets=offsets)
        joined = labels[mesh.face_indices] == labels[following]
        if np.any(mesh.positions[mesh.face_indices[joined]] != mesh.positions[following[joined]]):
            break
        count = count_pieces(mesh, labels)
        if count < fewest:
            best, fewest = tolerance, count
        if fewest == 1:
            break
    return best


def count_pieces(mesh: ControlMesh, labels: IndexArray) -> int:
    """Number of connected pieces after vertices with equal labels (n,) are joined."""
    return len(np.unique(face_pieces(mesh, labels[mesh.face_indices], mesh.n_vertices)))


def _close_pairs(points: FloatArray, distance: float) -> IndexArray:
    """(k, 2) pairs of points to join: chains of equal points, and first points of chains within a distance."""
    places = points + 0.0  # -0.0 becomes 0.0
    order = np.lexsort(places.T)
    repeated = np.all(places[order[1:]] == places[order[:-1]], axis=1)
    equal = np.column_stack([order[:-1][repeated], order[1:][repeated]])
    if not 0.0 < distance < np.inf or len(order) < 2:
        return equal
    first = order[np.concatenate([[True], ~repeated])]
    return np.concatenate([equal, first[cKDTree(places[first]).query_pairs(distance, output_type="ndarray")]])
