"""Subdivision matrices S: one row of weights per finer vertex, in the order vertices, edges, faces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array, vstack

from cagemap.mesh.schemes import CREASE_VERTEX, Bilinear, CatmullClark, Loop, Scheme
from cagemap.mesh.topology import BoolArray, IntArray, Topology
from cagemap.numerics.arrays import FloatArray
from cagemap.subdivision.sharpness import MeshState, sharpen_matrix


class RowFiller:
    """Fill a CSR matrix with rows of known lengths; first entries are the vertices' own weights."""

    def __init__(self, lengths: NDArray[np.integer]) -> None:
        self.indptr = np.zeros(len(lengths) + 1, dtype=np.int32)
        np.cumsum(lengths, out=self.indptr[1:])
        self.indices = np.empty(self.indptr[-1], dtype=np.int32)
        self.data = np.empty(self.indptr[-1], dtype=np.float64)

    def put(
        self, rows: NDArray[np.integer] | slice, offset: IntArray | int, columns: IntArray, weights: object
    ) -> None:
        """Set entry number ``offset`` of each of ``rows``."""
        at = self.indptr[:-1][rows] + offset
        self.indices[at] = columns
        self.data[at] = weights

    def matrix(self, n_columns: int) -> csr_array:
        """The matrix, with repeated entries of a row summed (at valence 2 inside, and for n-gons)."""
        matrix = csr_array((self.data, self.indices, self.indptr), shape=(len(self.indptr) - 1, n_columns))
        matrix.sum_duplicates()
        return matrix


def put_boundary_rows(rows: RowFiller, topology: Topology, corner: BoolArray, weights: tuple[float, float]) -> None:
    """Fill rows of boundary vertices: ``weights`` (own, each boundary neighbour), or 1 at corners."""
    crease = topology.boundary & ~corner
    curve = topology.boundary_corners
    starts, ends = topology.vertices[curve], topology.vertices[topology.following[curve]]
    numbers = np.arange(topology.n_vertices, dtype=np.int32)
    rows.put(numbers[crease], 0, numbers[crease], weights[0])
    rows.put(numbers[corner], 0, numbers[corner], 1.0)
    rows.put(starts[crease[starts]], 1, ends[crease[starts]], weights[1])
    rows.put(ends[crease[ends]], 2, starts[crease[ends]], weights[1])


def put_inner_rows(rows: RowFiller, topology: Topology, own: FloatArray, *rings: tuple[IntArray, FloatArray]) -> None:
    """Fill rows of inner vertices: own weight (n,), then vertex (c,) and weight (n,) of every ring."""
    smooth = ~topology.boundary
    numbers = np.flatnonzero(smooth).astype(np.int32)
    rows.put(numbers, 0, numbers, own[numbers])
    around = np.flatnonzero(smooth[topology.vertices]) if not smooth.all() else slice(None)
    centres = topology.vertices[around]
    first = 1 + len(rings) * topology.ranks[around]
    for place, (columns, weights) in enumerate(rings):
        rows.put(centres, first + place, columns[around], weights[centres])


def _put_edge_rows(rows: RowFiller, topology: Topology, end_weight: float, other_weight: float, n_others: int) -> None:
    """Fill rows of edge points: the two ends, then ``n_others`` other vertices of each adjacent face."""
    forward, backward = topology.edge_corners.T
    interior = backward >= 0
    numbers = np.arange(topology.n_vertices, topology.n_vertices + topology.n_edges, dtype=np.int32)
    weight = np.where(interior, end_weight, 0.5)
    rows.put(numbers, 0, topology.vertices[forward], weight)
    rows.put(numbers, 1, topology.vertices[topology.following[forward]], weight)
    place = 2
    for corner in (forward[interior], backward[interior]):
        for _ in range(n_others):
            corner = topology.previous[corner]
            rows.put(numbers[interior], place, topology.vertices[corner], other_weight)
            place += 1


def vertex_row_lengths(topology: Topology, corner: BoolArray, n_rings: int) -> IntArray:
    """(n,) number of entries in every vertex's row: itself and its rings, or its boundary neighbours."""
    lengths = np.where(topology.boundary, 3, 1 + n_rings * topology.valences)
    lengths[corner] = 1
    return lengths


def rings_of(topology: Topology, scheme: CatmullClark | Loop) -> list[IntArray]:
    """Vertices (c,) next to every corner in its face, and under Catmull-Clark also the opposite ones."""
    neighbours = topology.vertices[topology.following]
    return [neighbours] if isinstance(scheme, Loop) else [neighbours, neighbours[topology.following]]


def regular_matrix(topology: Topology, scheme: CatmullClark | Loop, corner: BoolArray) -> csr_array:
    """Matrix of one step of Catmull-Clark on quads, or of Loop on triangles."""
    rings = rings_of(topology, scheme)
    own_weights, *each = scheme.vertex_weights(topology.valences)
    n_face_points = 0 if isinstance(scheme, Loop) else topology.n_faces
    edge_lengths = np.where(~topology.outer_edges, 2 + 2 * len(rings), 2)
    lengths = vertex_row_lengths(topology, corner, len(rings)), edge_lengths, np.full(n_face_points, 4)
    rows = RowFiller(np.concatenate(lengths))
    put_inner_rows(rows, topology, own_weights, *zip(rings, each, strict=True))
    put_boundary_rows(rows, topology, corner, CREASE_VERTEX)
    _put_edge_rows(rows, topology, *scheme.edge_weights(), n_others=len(rings))
    if n_face_points:
        start = rows.indptr[topology.n_vertices + topology.n_edges]
        rows.indices[start:], rows.data[start:] = topology.vertices, 0.25
    return rows.matrix(topology.n_vertices)


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
    boundary = RowFiller(np.where(topology.boundary | corner, vertex_row_lengths(topology, corner, 0), 0))
    put_boundary_rows(boundary, topology, corner, CREASE_VERTEX)
    vertex_points = (
        diags_array(np.where(smooth, own_weights, 0.0))
        + diags_array(np.where(smooth, neighbour, 0.0)) @ (starts.T @ ends)
        + diags_array(np.where(smooth, face, 0.0)) @ (starts.T @ of_face) @ face_points
        + boundary.matrix(topology.n_vertices)
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
    edges = np.repeat(topology.edges[forward], 2)
    ends = np.stack([topology.vertices[forward], topology.vertices[topology.following[forward]]], axis=1).ravel()
    entries = [(np.arange(n), np.arange(n), np.ones(n)), (n + edges, ends, np.full(len(edges), 0.5))]
    if with_faces:
        entries.append((n + e + topology.faces, topology.vertices, 1.0 / np.bincount(topology.faces)[topology.faces]))
    rows, columns, values = (np.concatenate(arrays) for arrays in zip(*entries, strict=True))
    places = rows.astype(np.int32), columns.astype(np.int32)
    return csr_array(coo_array((values, places), shape=(n + e + (topology.n_faces if with_faces else 0), n)))


def subdivision_matrix(state: MeshState, scheme: Scheme) -> csr_array:
    """Matrix S (n_fine, n_coarse) from a level to the next; rows sum to 1, indices ascend in every row."""
    topology = state.topology
    if isinstance(scheme, Bilinear):
        return linear_matrix(topology)
    if isinstance(scheme, Loop) or topology.has_quads_only:
        matrix = regular_matrix(topology, scheme, state.corner)
    else:
        matrix = polygon_matrix(topology, scheme, state.corner)
    return matrix if state.sharpness is None else sharpen_matrix(matrix, topology, state.sharpness, state.follows)
