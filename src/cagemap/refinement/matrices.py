"""Subdivision matrices S: one row of masks per vertex of the finer level, rows in the order vertices, edges, faces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array, eye_array, vstack

from cagemap.mesh.schemes import CREASE_VERTEX, Bilinear, CatmullClark, Loop, Scheme
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.refinement.sharpness import Sharpness, sharpened
from cagemap.refinement.topology import BoolArray, IntArray, Topology


def boundary_corners(topology: Topology, scheme: Scheme) -> BoolArray:
    """(n,) boundary vertices that stay in place: those with a single face, if the boundary rule says so."""
    if scheme.boundary != "edge_and_corner":
        return np.zeros(topology.table.n_vertices, dtype=bool)
    return topology.boundary & (topology.valences == 1)


class RowFiller:
    """Writes rows of known lengths straight into CSR arrays; each row starts with its own vertex's weight."""

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
        """Finish: columns of every row ascending, each once.

        A vertex can be met twice in a row's stencil around interior vertices of valence 2, and in a cage's n-gons.
        """
        matrix = csr_array((self.data, self.indices, self.indptr), shape=(len(self.indptr) - 1, n_columns))
        matrix.sum_duplicates()
        return matrix


def put_boundary_rows(rows: RowFiller, topology: Topology, corner: BoolArray, weights: tuple[float, float]) -> None:
    """Fill the rows of boundary vertices with ``weights`` (own, each neighbour along the curve), of corners with 1."""
    table, crease = topology.table, topology.boundary & ~corner
    curve = topology.boundary_corners
    starts, ends = table.vertices[curve], table.vertices[table.following[curve]]
    numbers = np.arange(table.n_vertices, dtype=np.int32)
    rows.put(numbers[crease], 0, numbers[crease], weights[0])
    rows.put(numbers[corner], 0, numbers[corner], 1.0)
    rows.put(starts[crease[starts]], 1, ends[crease[starts]], weights[1])
    rows.put(ends[crease[ends]], 2, starts[crease[ends]], weights[1])


def put_inner_rows(rows: RowFiller, topology: Topology, own: FloatArray, *rings: tuple[IntArray, FloatArray]) -> None:
    """Fill the rows of inner vertices: own weight, then for every corner around one entry per ring.

    ``own`` is per vertex; a ring is, per corner, the vertex and, per vertex, the weight.
    """
    table, smooth = topology.table, ~topology.boundary
    numbers = np.flatnonzero(smooth).astype(np.int32)
    rows.put(numbers, 0, numbers, own[numbers])
    around = np.flatnonzero(smooth[table.vertices]) if not smooth.all() else slice(None)
    centres = table.vertices[around]
    first = 1 + len(rings) * topology.ranks[around]
    for place, (columns, weights) in enumerate(rings):
        rows.put(centres, first + place, columns[around], weights[centres])


def _put_edge_rows(rows: RowFiller, topology: Topology, end_weight: float, *others: tuple[int, float]) -> None:
    """Fill the rows of edge points: the two ends, then, on both sides, vertices so many corners behind the edge."""
    table = topology.table
    forward, backward = topology.edge_corners.T
    interior = backward >= 0
    numbers = np.arange(table.n_vertices, table.n_vertices + table.n_edges, dtype=np.int32)
    weight = np.where(interior, end_weight, 0.5)
    rows.put(numbers, 0, table.vertices[forward], weight)
    rows.put(numbers, 1, table.vertices[table.following[forward]], weight)
    place = 2
    for side in (forward[interior], backward[interior]):
        for steps, other_weight in others:
            corner = side
            for _ in range(steps):
                corner = table.previous[corner]
            rows.put(numbers[interior], place, table.vertices[corner], other_weight)
            place += 1


def vertex_row_lengths(topology: Topology, corner: BoolArray, n_rings: int) -> IntArray:
    """(n,) entries of every vertex' row: itself and its rings, or on the boundary its neighbours along the curve."""
    lengths = np.where(topology.boundary, 3, 1 + n_rings * topology.valences)
    lengths[corner] = 1
    return lengths


def quad_matrix(topology: Topology, scheme: CatmullClark, corner: BoolArray) -> csr_array:
    """One step of Catmull-Clark on a mesh of quads, from the masks written out for quads."""
    table = topology.table
    interior = topology.edge_corners[:, 1] >= 0
    rows = RowFiller(
        np.concatenate([vertex_row_lengths(topology, corner, 2), np.where(interior, 6, 2), np.full(table.n_faces, 4)])
    )
    own, neighbour, opposite = scheme.quad_vertex_weights(topology.valences)
    neighbours = table.vertices[table.following]
    opposites = neighbours[table.following]
    put_inner_rows(rows, topology, own, (neighbours, neighbour), (opposites, opposite))
    put_boundary_rows(rows, topology, corner, CREASE_VERTEX)
    end_weight, other_weight = scheme.quad_edge_weights()
    _put_edge_rows(rows, topology, end_weight, (1, other_weight), (2, other_weight))
    faces_start = rows.indptr[table.n_vertices + table.n_edges]
    rows.indices[faces_start:] = table.vertices
    rows.data[faces_start:] = 0.25
    return rows.matrix(table.n_vertices)


def triangle_matrix(topology: Topology, scheme: Loop, corner: BoolArray) -> csr_array:
    """One step of Loop."""
    table = topology.table
    interior = topology.edge_corners[:, 1] >= 0
    rows = RowFiller(np.concatenate([vertex_row_lengths(topology, corner, 1), np.where(interior, 4, 2)]))
    own, neighbour = scheme.vertex_weights(topology.valences)
    put_inner_rows(rows, topology, own, (table.vertices[table.following], neighbour))
    put_boundary_rows(rows, topology, corner, CREASE_VERTEX)
    _put_edge_rows(rows, topology, scheme.edge_weights()[0], (1, scheme.edge_weights()[1]))
    return rows.matrix(table.n_vertices)


def polygon_matrix(topology: Topology, scheme: CatmullClark, corner: BoolArray) -> csr_array:
    """One step of Catmull-Clark on faces of any size, as the paper states it: through the new face points.

    Used for the control mesh, and by tests as the definition that `quad_matrix` must reproduce.
    """
    table, smooth = topology.table, ~topology.boundary
    shape = (table.n_corners, table.n_vertices)
    here = _selection(table.vertices, shape)
    ends = _selection(table.vertices[table.following], shape)
    of_face = _selection(table.faces, (table.n_corners, table.n_faces))
    of_edge = _selection(table.edges, (table.n_corners, table.n_edges))
    sizes = np.bincount(table.faces, minlength=table.n_faces)
    face_points = diags_array(1 / sizes) @ (of_face.T @ here)

    own, neighbour, face = scheme.vertex_weights(topology.valences)
    vertex_points = (
        diags_array(np.where(smooth, own, 0.0))
        + diags_array(np.where(smooth, neighbour, 0.0)) @ (here.T @ ends)
        + diags_array(np.where(smooth, face, 0.0)) @ (here.T @ of_face) @ face_points
        + _boundary_points(topology, corner)
    )
    interior = topology.edge_corners[:, 1] >= 0
    forward = topology.edge_corners[:, 0]
    face_weight = 0.5 * np.bincount(table.edges, scheme.face_edge_weights(sizes)[table.faces])
    edge_points = (
        diags_array(np.where(interior, 0.5 - face_weight, 0.5)) @ (here[forward] + ends[forward])
        + diags_array(np.where(interior, face_weight, 0.0)) @ (of_edge.T @ of_face) @ face_points
    )
    stacked = csr_array(vstack([vertex_points, edge_points, face_points], format="csr"))
    stacked.eliminate_zeros()
    stacked.sort_indices()
    return stacked


def _selection(columns: IntArray, shape: tuple[int, int]) -> csr_array:
    """Matrix with a single 1 in every row."""
    return csr_array((np.ones(shape[0]), columns, np.arange(shape[0] + 1, dtype=np.int32)), shape=shape)


def _boundary_points(topology: Topology, corner: BoolArray) -> csr_array:
    """(n, n) rows of boundary vertices and corners; the others are empty."""
    rows = RowFiller(np.where(topology.boundary | corner, vertex_row_lengths(topology, corner, 0), 0))
    put_boundary_rows(rows, topology, corner, CREASE_VERTEX)
    return rows.matrix(topology.table.n_vertices)


def bilinear_matrix(topology: Topology) -> csr_array:
    """One step without smoothing: vertices stay, edge points are midpoints, face points means of the corners."""
    table = topology.table
    shape = (table.n_corners, table.n_vertices)
    here, ends = (_selection(corners, shape) for corners in (table.vertices, table.vertices[table.following]))
    forward = topology.edge_corners[:, 0]
    of_face = _selection(table.faces, (table.n_corners, table.n_faces))
    face_points = diags_array(1 / np.bincount(table.faces)) @ (of_face.T @ here)
    vertex_points = eye_array(table.n_vertices, format="csr")
    stacked = csr_array(vstack([vertex_points, 0.5 * (here[forward] + ends[forward]), face_points], format="csr"))
    stacked.sort_indices()
    return stacked


def subdivision_matrix(
    topology: Topology,
    scheme: Scheme,
    corner: BoolArray | None = None,
    sharpness: Sharpness | None = None,
    follows: IndexArray | None = None,
) -> csr_array:
    """S of one step: (n_fine, n_coarse) CSR, rows sum to 1, int32 indices ascending in every row.

    Parameters
    ----------
    topology : Topology
    scheme : CatmullClark, Loop or Bilinear
    corner : (n,) bool, optional
        Boundary vertices that stay in place. Default: `boundary_corners`.
    sharpness : Sharpness, optional
        Creases and corners beyond the boundary.
    follows : (n,) int64, optional
        See `vertex_rules`.
    """
    if isinstance(scheme, Bilinear):
        return bilinear_matrix(topology)
    corner = boundary_corners(topology, scheme) if corner is None else corner
    if isinstance(scheme, Loop):
        matrix = triangle_matrix(topology, scheme, corner)
    elif topology.table.has_only(4):
        matrix = quad_matrix(topology, scheme, corner)
    else:
        matrix = polygon_matrix(topology, scheme, corner)
    return matrix if sharpness is None else sharpened(matrix, topology, sharpness, follows)
