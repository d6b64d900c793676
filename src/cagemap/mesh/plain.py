"""Repair plain meshes, such as scans and generated meshes, so that they can be matched without subdivision.

Matching needs a connected, oriented manifold. Faults are repaired where the repair is unambiguous; other faces and
vertices are removed. `cagemap.mesh.repairs.Repairs` counts the changes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import InvalidMeshError
from cagemap.mesh.checks import ONE_SIDED, extent_problem, extra_faces, inside_out_problem, zero_area_problem
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.faces import (
    degenerate_faces,
    duplicate_faces,
    face_areas,
    keep_faces,
    reversed_corners,
    with_corners_of,
)
from cagemap.mesh.inputs import MeshLike, arrays_accepted
from cagemap.mesh.parts import body_areas, extract_faces
from cagemap.mesh.repairs import RepairedMesh, Repairs
from cagemap.mesh.schemes import Plain
from cagemap.mesh.structure_checks import require_structure
from cagemap.mesh.topology import (
    boundary_loops,
    corner_fans,
    face_components,
    mesh_topology,
    turned_faces,
    used_vertices,
)
from cagemap.mesh.weld import coincident_vertices, file_copies, mean_colors, weld_tolerance
from cagemap.numerics.arrays import IndexArray
from cagemap.surface.triangles import polygon_triangles

MAX_FIN_ROUNDS = 20  # most rounds of removing faces at edges of more than two faces; scans need two


@arrays_accepted
def plain_mesh(mesh: MeshLike) -> RepairedMesh:
    """Repair a mesh so that it can be matched without subdivision (scheme none).

    Joins repeated vertices, removes degenerate and duplicate faces, separates parts that only touch, orients faces
    consistently and keeps one piece. A mesh without these faults keeps its vertex and face numbers.
    InvalidMeshError if the arrays are no mesh, or the mesh is one-sided or has no area.
    """
    require_structure(mesh)
    extent = extent_problem(mesh)
    if extent is not None and extent.kind == "size":
        raise InvalidMeshError(f"{mesh.name}: {extent}")
    work = replace(
        mesh.without_sharpness(),
        scheme=Plain(),
        file_vertices=np.arange(mesh.n_vertices),  # numbers on the mesh given; replaced by those in the file below
        file_faces=np.arange(mesh.n_faces),
        file_copies=None,
    )
    representative = coincident_vertices(work, collapse=True)
    joined = np.flatnonzero(representative != np.arange(mesh.n_vertices))
    averaged = 0
    if len(joined):
        colors, averaged = mean_colors(mesh, representative)
        work = replace(work, face_indices=representative[work.face_indices], vertex_colors=colors)
    holes = np.zeros(0, dtype=np.int64) if mesh.hole_faces is None else mesh.hole_faces
    work = keep_faces(work, np.delete(np.arange(mesh.n_faces), holes)) if len(holes) else work
    work = replace(work, hole_faces=None)
    if not np.any(work.face_sizes >= 3):
        raise InvalidMeshError(f"{mesh.name}: expected faces of three corners or more that are no holes, got none")
    work, split = _of_one_face_size(work)
    bad = np.union1d(degenerate_faces(work), duplicate_faces(work))
    if len(bad) == work.n_faces:
        raise InvalidMeshError(f"{mesh.name}: expected faces, got {work.n_faces} that visit a vertex twice")
    work = keep_faces(work, np.delete(np.arange(work.n_faces), bad)) if len(bad) else work
    work, fins, cut = _manifold(work)
    faces = turned_faces(mesh_topology(work))
    if faces is None:
        raise InvalidMeshError(f"{mesh.name}: {ONE_SIDED.found}. {ONE_SIDED.remedy}")
    work = turn_faces(work, faces)
    kept, aside = _largest_piece(work)
    work, turned = keep_faces(work, kept) if aside.pieces else work, int(faces[kept].sum())
    if not face_areas(work).sum() > 0.0:
        raise InvalidMeshError(
            f"{mesh.name}: expected a surface with an area, got {work.n_faces} faces without. "
            "Repair it in a modelling program."
        )
    problem = inside_out_problem(work, _loops(work))
    inwards = problem is not None and problem.kind == "inside out"
    work = turn_faces(work, np.ones(work.n_faces, dtype=bool)) if inwards else work
    repairs = replace(
        aside,
        joined_vertices=len(joined),
        averaged_colors=averaged,
        split_faces=split,
        dropped_faces=len(bad) + len(holes),
        fins=fins,
        cut_vertices=cut,
        turned_faces=work.n_faces - turned if inwards else turned,
        pieces_weld=(weld_tolerance(mesh) or 0.0) if aside.pieces else 0.0,
        loose_vertices=int(mesh.n_vertices - used_vertices(mesh).sum()),
    )
    changed = bool(repairs.summary())
    ready = extract_faces(work, np.arange(work.n_faces)) if changed else work
    sliver = zero_area_problem(ready, np.arange(ready.n_faces))
    repairs = replace(repairs, slivers=0 if sliver is None else len(sliver.elements), openings=len(_loops(ready)))
    vertices, own_faces = ready.file_numbers
    vertex_of = np.full(mesh.n_vertices, -1, dtype=np.int64)
    vertex_of[vertices[::-1]] = np.arange(len(vertices))[::-1]  # the first copy of a split vertex
    vertex_of = vertex_of[representative]
    numbers = mesh.file_vertices, mesh.file_faces
    if changed:
        numbers = mesh.file_numbers[0][vertices], mesh.file_numbers[1][own_faces]
    copies = file_copies(mesh, joined, vertex_of)
    ready = replace(ready, file_vertices=numbers[0], file_faces=numbers[1], file_copies=copies)
    notes = tuple(f"{ready.name}: {sentence}" for sentence in repairs.sentences())
    return RepairedMesh(ready, vertex_of, notes, repairs)


def _of_one_face_size(mesh: ControlMesh) -> tuple[ControlMesh, int]:
    """Split faces into triangles unless all are triangles, or valid quads; also the number of other faces."""
    sizes = mesh.face_sizes
    size = int(np.bincount(sizes).argmax())
    odd = sizes != size
    odd[degenerate_faces(mesh)] |= size == 4
    if size == 3 and not np.any(sizes > 3):
        return mesh, 0  # faces of fewer corners are removed later
    if size == 4 and not odd.any():
        return mesh, 0
    corners, faces = polygon_triangles(mesh.positions, mesh.face_offsets, mesh.face_indices)
    return with_corners_of(mesh, faces, 3 * np.arange(len(faces) + 1), corners.ravel()), max(int(odd.sum()), 1)


def _manifold(mesh: ControlMesh) -> tuple[ControlMesh, int, int]:
    """Remove fins and separate sheets that only touch; also counts of removed faces and cut vertices."""
    n_faces, cut, topology = mesh.n_faces, 0, mesh_topology(mesh)
    surplus = extra_faces(topology)
    for _ in range(MAX_FIN_ROUNDS):
        if surplus.all():
            break
        mesh = keep_faces(mesh, np.flatnonzero(~surplus)) if surplus.any() else mesh
        mesh, newly_cut = _one_fan_per_vertex(mesh)
        cut, topology = cut + newly_cut, mesh_topology(mesh)
        bad = topology.face_counts > 2
        if not bad.any():
            return mesh, n_faces - mesh.n_faces, cut
        # Faces joined around the split vertices: it is ambiguous which of them belong together.
        surplus = np.logical_or.reduceat(bad[topology.edges], mesh.face_offsets[:-1])
    raise InvalidMeshError(
        f"{mesh.name}: expected a surface, got faces that meet in more than two at nearly all edges. "
        "Repair it in a modelling program."
    )


def _one_fan_per_vertex(mesh: ControlMesh) -> tuple[ControlMesh, int]:
    """Give every fan of faces its own vertex, copies last; also the number of vertices copied."""
    topology = mesh_topology(mesh)
    many = (topology.face_counts > 2)[topology.edges]  # such edges join no faces
    edges = topology.edges.copy()
    edges[many] = topology.n_edges + np.arange(many.sum())
    fans = corner_fans(replace(topology, edges=edges))
    _, first = np.unique(fans, return_index=True)
    vertices = mesh.face_indices[first]
    order = np.argsort(vertices, kind="stable")
    repeated = np.zeros(len(vertices), dtype=bool)
    repeated[order[1:]] = vertices[order[1:]] == vertices[order[:-1]]
    if not repeated.any():
        return mesh, 0
    number = vertices.copy()
    number[repeated] = mesh.n_vertices + np.arange(repeated.sum())
    copied = vertices[repeated]
    source = np.concatenate([np.arange(mesh.n_vertices), copied])
    return replace(
        mesh,
        positions=mesh.positions[source],
        face_indices=number[fans],
        vertex_colors=None if mesh.vertex_colors is None else mesh.vertex_colors[source],
        file_vertices=mesh.file_numbers[0][source],
    ), len(np.unique(copied))


def turn_faces(mesh: ControlMesh, faces: NDArray[np.bool_]) -> ControlMesh:
    """Reverse faces (m,) of a mesh, keeping first corners and quads' diagonals."""
    if not faces.any():
        return mesh
    corners = np.arange(len(mesh.face_indices))
    corners = np.where(faces[mesh.corner_faces], reversed_corners(mesh.face_offsets), corners)
    return with_corners_of(mesh, np.arange(mesh.n_faces), mesh.face_offsets, corners)


def _largest_piece(mesh: ControlMesh) -> tuple[IndexArray, Repairs]:
    """Faces of the connected piece of largest area (`body_areas`); also counts of the other pieces."""
    labels = face_components(mesh)
    count = int(labels.max()) + 1
    if count == 1:
        return np.arange(mesh.n_faces), Repairs()
    of_faces = face_areas(mesh)
    areas, body = np.bincount(labels, of_faces), body_areas(mesh, labels, of_faces).argmax()
    kept = labels == body
    share = 1.0 - float(areas[body] / areas.sum()) if areas.sum() > 0 else 0.0
    vertices = len(np.unique(mesh.face_indices[~kept[mesh.corner_faces]]))
    aside = Repairs(pieces=count - 1, pieces_share=share, pieces_vertices=vertices)
    return np.flatnonzero(kept), aside


def _loops(mesh: ControlMesh) -> tuple[IndexArray, ...]:
    topology = mesh_topology(mesh)
    return boundary_loops(topology, corner_fans(topology)) or ()
