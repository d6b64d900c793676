"""Subdivision matrices S: one row of weights per finer vertex, in the order vertices, edges, faces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array, vstack

from cagemap.mesh.schemes import CREASE_VERTEX, Bilinear, CatmullClark, Loop, Scheme
from cagemap.mesh.topology import BoolArray, IntArray, Topology
from cagemap.numerics.arrays import FloatArray
from cagemap.subdivision.topology import MeshState, vertex_rules

Entries: TypeAlias = tuple[NDArray[np.integer], NDArray[np.integer], FloatArray]  # rows, columns, weights


def subdivision_matrix(state: MeshState, scheme: Scheme) -> csr_array:
    """Matrix S (n_fine, n_coarse) from a level to the next; rows sum to 1, indices ascend in every row."""
    topology = state.topology
    if isinstance(scheme, Bilinear):
        return linear_matrix(topology)
    quads = topology.n_corners == 4 * topology.n_faces and np.array_equal(
        topology.faces[::4], np.arange(topology.n_faces)
    )
    if quads or isinstance(scheme, Loop):
        matrix = regular_matrix(topology, scheme, state.corner)
    else:
        matrix = polygon_matrix(topology, scheme, state.corner)
    return _sharpened(matrix, state) if state.is_sharp else matrix


def regular_matrix(topology: Topology, scheme: CatmullClark | Loop, corner: BoolArray) -> csr_array:
    """Matrix of one step of Catmull-Clark on quads, or of Loop on triangles."""
    n, n_points = topology.n_vertices, topology.n_vertices + topology.n_edges
    neighbours = topology.vertices[topology.following]  # of every corner in its face, then the opposite vertices
    rings = [neighbours] if isinstance(scheme, Loop) else [neighbours, neighbours[topology.following]]
    own_weights, *each = scheme.vertex_weights(topology.valences)
    entries: list[Entries] = [
        *_inner_entries(topology, own_weights, *zip(rings, each, strict=True)),
        *_boundary_entries(topology, corner),
        *_edge_entries(topology, *scheme.edge_weights(), n_others=len(rings)),
    ]
    if isinstance(scheme, Loop):
        return _matrix_of(entries, (n_points, n))
    entries.append((n_points + topology.faces, topology.vertices, np.full(topology.n_corners, 0.25)))
    return _matrix_of(entries, (n_points + topology.n_faces, n))


def _inner_entries(topology: Topology, own: FloatArray, *rings: tuple[IntArray, FloatArray]) -> list[Entries]:
    """Entries of inner vertices: own weight (n,), then vertex (c,) and weight (n,) of every ring."""
    numbers = np.flatnonzero(~topology.boundary).astype(np.int32)
    around = np.flatnonzero(~topology.boundary[topology.vertices])
    centres = topology.vertices[around]
    return [(numbers, numbers, own[numbers]), *((centres, ring[around], weights[centres]) for ring, weights in rings)]


def _boundary_entries(topology: Topology, corner: BoolArray) -> list[Entries]:
    """Entries of boundary vertices: those of a crease, or 1 at corners."""
    own_weight, neighbour_weight = CREASE_VERTEX
    crease, curve = topology.boundary & ~corner, topology.boundary_corners
    starts, ends = topology.vertices[curve], topology.vertices[topology.following[curve]]
    own = np.flatnonzero(crease | corner).astype(np.int32)
    return [
        (own, own, np.where(corner[own], 1.0, own_weight)),
        *(
            (
                vertices[crease[vertices]],
                neighbours[crease[vertices]],
                np.full(crease[vertices].sum(), neighbour_weight),
            )
            for vertices, neighbours in ((starts, ends), (ends, starts))
        ),
    ]


def _edge_entries(topology: Topology, end_weight: float, other_weight: float, n_others: int) -> list[Entries]:
    """Entries of edge points: the two ends, and ``n_others`` other vertices of each adjacent face."""
    forward, backward = topology.edge_corners.T
    interior = backward >= 0
    numbers = np.arange(topology.n_vertices, topology.n_vertices + topology.n_edges, dtype=np.int32)
    weight = np.where(interior, end_weight, 0.5)
    entries: list[Entries] = [
        (numbers, topology.vertices[corner], weight) for corner in (forward, topology.following[forward])
    ]
    for corner in (forward[interior], backward[interior]):
        for _ in range(n_others):
            corner = topology.previous[corner]
            entries.append((numbers[interior], topology.vertices[corner], np.full(len(corner), other_weight)))
    return entries


def polygon_matrix(topology: Topology, scheme: CatmullClark, corner: BoolArray) -> csr_array:
    """Matrix of one step of Catmull-Clark on faces of any size, by way of face points [CC78]."""
    smooth = ~topology.boundary
    shape = (topology.n_corners, topology.n_vertices)
    starts = _selection(topology.vertices, shape)
    ends = _selection(topology.vertices[topology.following], shape)
    of_face = _selection(topology.faces, (topology.n_corners, topology.n_faces))
    of_edge = _selection(topology.edges, (topology.n_corners, topology.n_edges))
    sizes = np.bincount(topology.faces, minlength=topology.n_faces)
    face_points = diags_array(1 / sizes) @ (of_face.T @ starts)

    own_weights, neighbour, face = scheme.polygon_vertex_weights(topology.valences)
    vertex_points = (
        diags_array(np.where(smooth, own_weights, 0.0))
        + diags_array(np.where(smooth, neighbour, 0.0)) @ (starts.T @ ends)
        + diags_array(np.where(smooth, face, 0.0)) @ (starts.T @ of_face) @ face_points
        + _matrix_of(_boundary_entries(topology, corner), (topology.n_vertices,) * 2)
    )
    interior = ~topology.outer_edges
    forward = topology.edge_corners[:, 0]
    face_weight = 0.5 * np.bincount(topology.edges, scheme.face_edge_weights(sizes)[topology.faces])
    edge_points = (
        diags_array(np.where(interior, 0.5 - face_weight, 0.5)) @ (starts[forward] + ends[forward])
        + diags_array(np.where(interior, face_weight, 0.0)) @ (of_edge.T @ of_face) @ face_points
    )
    stacked = csr_array(vstack([vertex_points, edge_points, face_points], format="csr"))
    stacked.eliminate_zeros()
    stacked.sort_indices()
    return stacked


def _selection(columns: IntArray, shape: tuple[int, int]) -> csr_array:
    """Sparse matrix with a single 1 in every row, at the given columns."""
    return csr_array((np.ones(shape[0]), columns, np.arange(shape[0] + 1, dtype=np.int32)), shape=shape)


def linear_matrix(topology: Topology, with_faces: bool = True) -> csr_array:
    """Matrix of one linear step: vertices stay, edges get midpoints, faces the mean of their corners."""
    n, e = topology.n_vertices, topology.n_edges
    forward = np.flatnonzero(topology.forward)
    numbers, edges = np.arange(n, dtype=np.int32), n + topology.edges[forward]
    half = np.full(len(forward), 0.5)
    entries: list[Entries] = [(numbers, numbers, np.ones(n))]
    entries += [(edges, topology.vertices[corner], half) for corner in (forward, topology.following[forward])]
    if with_faces:
        entries.append((n + e + topology.faces, topology.vertices, 1.0 / np.bincount(topology.faces)[topology.faces]))
    return _matrix_of(entries, (n + e + (topology.n_faces if with_faces else 0), n))


def _matrix_of(entries: Sequence[Entries], shape: tuple[int, int]) -> csr_array:
    """Sparse matrix of all entries; repeated ones are summed (at valence 2 inside, and for n-gons)."""
    rows, columns, weights = (np.concatenate(arrays) for arrays in zip(*entries, strict=True))
    return csr_array((weights, (rows.astype(np.int32), columns.astype(np.int32))), shape=shape)


def _sharpened(matrix: csr_array, state: MeshState) -> csr_array:
    """Apply the crease and corner rules to a one-step subdivision matrix S (n_fine, n) with boundary rules."""
    topology, n = state.topology, state.topology.n_vertices
    ends, vertices = topology.edge_ends, np.arange(n)
    smooth, crease, crease_after, corner = vertex_rules(state)
    # An edge of sharpness s < 1 is blended, s sharp and 1 - s smooth, unless both its halves are still creases.
    hard = np.where(np.all(state.halves > 0, axis=1), 1.0, state.edges)
    hard[topology.outer_edges] = 0.0  # boundary edges have their midpoint already
    # A boundary row of the matrix is kept where the boundary is the vertex's only crease.
    unchanged = topology.boundary & (crease == 1)
    smooth_part = np.ones(matrix.shape[0])
    smooth_part[:n] = np.where(unchanged, 1.0, smooth)
    smooth_part[n : n + len(ends)] = 1.0 - hard
    own_weight, neighbour_weight = CREASE_VERTEX
    crease = np.where(unchanged, 0.0, crease)
    along = (state.edges[:, None] > 0) * crease[ends] + (state.halves > 0) * crease_after[ends]
    sharp_edges = np.flatnonzero(hard)
    parts: list[Entries] = [
        (vertices, vertices, corner + own_weight * (crease + crease_after)),
        (ends[:, 0], ends[:, 1], neighbour_weight * along[:, 0]),
        (ends[:, 1], ends[:, 0], neighbour_weight * along[:, 1]),
        (n + sharp_edges, ends[sharp_edges, 0], hard[sharp_edges] / 2),
        (n + sharp_edges, ends[sharp_edges, 1], hard[sharp_edges] / 2),
    ]
    result = csr_array(diags_array(smooth_part) @ matrix + _matrix_of(parts, matrix.shape))
    result.eliminate_zeros()
    result.sort_indices()
    return result
