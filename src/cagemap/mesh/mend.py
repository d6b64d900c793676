"""The steps by which a plain mesh is made ready (`cagemap.mesh.plain`): each takes a mesh and tells what it did."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import InvalidMeshError
from cagemap.geometry.triangles import fan_triangles
from cagemap.mesh.checks import duplicate_faces, keep_faces, repeated_corners, with_corners_of
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.edge_checks import extra_faces
from cagemap.mesh.geometry_checks import inside_out_problem
from cagemap.mesh.measures import face_areas
from cagemap.mesh.topology import EdgeTable, boundary_loops, corner_fans, edge_table, face_components, turned_faces
from cagemap.numerics.arrays import IndexArray
from cagemap.numerics.graphs import components

# Rounds in which faces at edges of more than two faces are taken out; two do for what scans have.
ROUNDS = 20


def representatives(mesh: ControlMesh) -> IndexArray:
    """(n,) the lowest of the vertices that are one: at the very same place, both on borders or joined by an edge."""
    edges = edge_table(mesh)
    places = mesh.positions + 0.0  # of two zeros, one
    ends = edges.vertices
    short = ends[np.all(places[ends[:, 0]] == places[ends[:, 1]], axis=1)]
    border = np.unique(ends[edges.face_counts == 1])
    order = border[np.lexsort(places[border].T)]
    same = np.all(places[order[1:]] == places[order[:-1]], axis=1)
    links = np.concatenate([short, np.column_stack([order[:-1][same], order[1:][same]])])
    if not len(links):
        return np.arange(mesh.n_vertices)
    labels = components(links[:, 0], links[:, 1], mesh.n_vertices)
    return np.unique(labels, return_index=True)[1][labels].astype(np.int64)


def without_holes(mesh: ControlMesh) -> tuple[ControlMesh, int]:
    """Without the faces that the file says are holes, and how many they are."""
    if mesh.hole_faces is None or not len(mesh.hole_faces):
        return replace(mesh, hole_faces=None), 0
    kept = np.delete(np.arange(mesh.n_faces), mesh.hole_faces)
    return replace(keep_faces(mesh, kept), hole_faces=None), len(mesh.hole_faces)


def uniform(mesh: ControlMesh) -> tuple[ControlMesh, int]:
    """As it is if faces are all triangles or all sound quads, else all split into triangles, and how many were odd."""
    sizes = mesh.face_sizes
    size = int(np.bincount(sizes).argmax())
    odd = sizes != size
    odd[repeated_corners(mesh)] |= size == 4
    if size == 3 and not np.any(sizes > 3):
        return mesh, 0  # faces of fewer corners are none
    if size == 4 and not odd.any():
        return mesh, 0
    corners, faces = fan_triangles(mesh.face_offsets, np.arange(len(mesh.face_indices)))
    return with_corners_of(mesh, faces, 3 * np.arange(len(faces) + 1), corners.ravel()), max(int(odd.sum()), 1)


def without_copies(mesh: ControlMesh) -> tuple[ControlMesh, int]:
    """Without faces that visit a vertex twice and copies of faces, and how many they are."""
    bad = np.union1d(repeated_corners(mesh), duplicate_faces(mesh))
    if len(bad) == mesh.n_faces:
        raise InvalidMeshError(f"{mesh.name}: expected faces, got {mesh.n_faces} that visit a vertex twice")
    return (keep_faces(mesh, np.delete(np.arange(mesh.n_faces), bad)), len(bad)) if len(bad) else (mesh, 0)


def manifold(mesh: ControlMesh) -> tuple[ControlMesh, int, int]:
    """An edge has one or two faces, a vertex one fan: fins are taken out, sheets that only touch are cut apart.

    Returns
    -------
    mesh : ControlMesh
        Copies of vertices come last.
    fins, cut : int
        Faces taken out, and vertices that got copies.
    """
    n_faces = mesh.n_faces
    edges = edge_table(mesh)
    if np.any(edges.face_counts > 2):
        mesh = _left(mesh, ~extra_faces(mesh, edges))
    mesh, cut = _cut(mesh)
    for _ in range(ROUNDS):
        edges = edge_table(mesh)
        bad = edges.face_counts > 2
        if not bad.any():
            return mesh, n_faces - mesh.n_faces, cut
        # Faces that run around the cut and meet again: nothing says which of them belong together.
        mesh = _left(mesh, ~np.logical_or.reduceat(bad[edges.corner_edges], mesh.face_offsets[:-1]))
        mesh, more = _cut(mesh)
        cut += more
    raise InvalidMeshError(f"{mesh.name}: expected a surface, got faces that meet in more than two at nearly all edges")


def _left(mesh: ControlMesh, kept: NDArray[np.bool_]) -> ControlMesh:
    if not kept.any():
        raise InvalidMeshError(f"{mesh.name}: expected a surface, got faces that meet in more than two at all edges")
    return keep_faces(mesh, np.flatnonzero(kept))


def _cut(mesh: ControlMesh) -> tuple[ControlMesh, int]:
    """Give every fan of faces around a vertex a vertex of its own; edges of more than two faces join none."""
    edges = edge_table(mesh)
    many = (edges.face_counts > 2)[edges.corner_edges]
    apart = edges.corner_edges.copy()
    apart[many] = len(edges.vertices) + np.arange(many.sum())
    fans = corner_fans(mesh, EdgeTable(edges.vertices, apart, edges.face_counts))
    _, first = np.unique(fans, return_index=True)
    at = mesh.face_indices[first]
    order = np.argsort(at, kind="stable")
    again = np.zeros(len(at), dtype=bool)
    again[order[1:]] = at[order[1:]] == at[order[:-1]]
    if not again.any():
        return mesh, 0
    number = at.copy()
    number[again] = mesh.n_vertices + np.arange(again.sum())
    copied = at[again]

    def with_copies(values: NDArray) -> NDArray:  # type: ignore[type-arg]
        return np.concatenate([values, values[copied]])

    assert mesh.file_vertices is not None
    return replace(
        mesh,
        positions=with_copies(mesh.positions),
        face_indices=number[fans],
        vertex_colors=None if mesh.vertex_colors is None else with_copies(mesh.vertex_colors),
        file_vertices=with_copies(mesh.file_vertices),
    ), len(np.unique(copied))


def oriented(mesh: ControlMesh) -> tuple[ControlMesh, int]:
    """With faces turned so that neighbours agree, in every piece the smaller set of them, and how many they are."""
    faces = turned_faces(mesh, edge_table(mesh))
    if faces is None:
        raise InvalidMeshError(
            f"{mesh.name}: expected a surface with an inside and an outside, got one where no choice of face "
            "directions agrees along all edges (as on a Moebius strip). Cut it where its two sides are joined."
        )
    return turned(mesh, faces), int(faces.sum())


def turned(mesh: ControlMesh, faces: NDArray[np.bool_]) -> ControlMesh:
    """With some faces (m,) turned round; all have one size. First corners stay, and with them how a quad is split."""
    if not faces.any():
        return mesh
    corners = np.arange(len(mesh.face_indices)).reshape(mesh.n_faces, -1)
    corners[faces, 1:] = corners[faces, :0:-1]
    return with_corners_of(mesh, np.arange(mesh.n_faces), mesh.face_offsets, corners.ravel())


def largest_piece(mesh: ControlMesh) -> tuple[ControlMesh, int, float, int]:
    """The connected piece of most area; number of the others, their share of the area and their vertices."""
    labels = face_components(mesh)
    count = int(labels.max()) + 1
    if count == 1:
        return mesh, 0, 0.0, 0
    areas = np.bincount(labels, face_areas(mesh), minlength=count)
    kept = labels == areas.argmax()
    share = 1.0 - float(areas.max() / areas.sum()) if areas.sum() > 0 else 0.0
    vertices = len(np.unique(mesh.face_indices[~kept[mesh.corner_faces]]))
    return keep_faces(mesh, np.flatnonzero(kept)), count - 1, share, vertices


def outwards(mesh: ControlMesh) -> tuple[ControlMesh, bool]:
    """With all faces turned round where they look inwards, and whether they did."""
    if not face_areas(mesh).sum() > 0.0:
        raise InvalidMeshError(f"{mesh.name}: expected a surface with an area, got {mesh.n_faces} faces without")
    problem = inside_out_problem(mesh, openings(mesh))
    if problem is None or problem.kind != "inside out":
        return mesh, False
    return turned(mesh, np.ones(mesh.n_faces, dtype=bool)), True


def openings(mesh: ControlMesh) -> tuple[IndexArray, ...]:
    """Vertices along every boundary loop of a mesh without faults."""
    edges = edge_table(mesh)
    return boundary_loops(mesh, edges, corner_fans(mesh, edges)) or ()
