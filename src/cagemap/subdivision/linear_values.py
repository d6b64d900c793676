"""Values at control vertices or face corners, interpolated linearly over the control faces.

Subdivision smooths what it refines: a weight of 1 at one control vertex is 0.45 at that vertex of the surface. Values
that someone painted on a cage are to arrive as they are, so here they are refined without smoothing: vertices keep
their value, edges take the middle, faces the mean. Each refined value is a convex combination of control values.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.mesh import ControlMesh
from cagemap.mesh.schemes import Loop, Scheme
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.subdivision.topology import CornerTable, children, control_table, split_table
from cagemap.surface.triangles import fan_triangles, triangles


@dataclass(frozen=True, eq=False)
class LinearValues:
    """Functions that are linear on the triangles of a refined level, given by values at the control mesh.

    Attributes
    ----------
    matrix : (p, p0) csr_array
        Values at the nodes of the level from those at the control mesh's; rows are not negative and sum to 1.
    corners : (t, 3) int64
        Node of every corner of the level's triangles.
    """

    matrix: sparse.csr_array
    corners: IndexArray

    def at(self, triangle: IndexArray, barycentric: FloatArray) -> sparse.csr_array:
        """(k, p0) weights of the control mesh's values at points of the surface."""
        k = len(triangle)
        rows = sparse.csr_array(
            (barycentric.ravel(), self.corners[triangle].ravel(), np.arange(0, 3 * k + 1, 3)),
            shape=(k, self.matrix.shape[0]),
        )
        weights = sparse.csr_array(rows @ self.matrix)
        weights.eliminate_zeros()
        weights.sort_indices()
        return weights


def interpolate_linearly(
    control: ControlMesh, nodes: IndexArray, count: int, level: int, scheme: Scheme
) -> LinearValues:
    """Prepare the linear interpolation of values on a control mesh.

    Parameters
    ----------
    control : ControlMesh
    nodes : (c,) int64
        Node of every face corner: its vertex, its UV, or the corner itself. Corners that share a node share its value.
    count : int
        Number of nodes.
    level : int
        Level of the triangles.
    scheme : CatmullClark, Loop, Bilinear or Plain
    """
    if level == 0:
        identity = sparse.csr_array(sparse.eye_array(count, format="csr"))
        return LinearValues(identity, fan_triangles(control.face_offsets, nodes)[0])
    with_faces = not isinstance(scheme, Loop)
    table = control_table(control, nodes, count)
    matrix = _linear_step(table, with_faces)
    for _ in range(level - 1):
        table = split_table(table, scheme)
        matrix = sparse.csr_array(_linear_step(table, with_faces) @ matrix)
    return LinearValues(matrix, triangles(children(table, scheme).astype(np.int64)))


def corner_triangles(control: ControlMesh, level: int, scheme: Scheme) -> IndexArray:
    """(c,) triangle of a level that lies in the tip of every face corner; from level 1 on its first vertex is there."""
    corners = np.arange(len(control.face_indices))
    if level == 0:
        # The fan of a face: its last two corners share the last triangle, its first two the first one.
        faces, sizes = control.corner_faces, control.face_sizes
        within = corners - control.face_offsets[faces]
        return np.asarray((np.cumsum(sizes - 2) - (sizes - 2))[faces] + np.clip(within - 1, 0, sizes[faces] - 3))
    # A child keeps its parent's corner as its own first one (refinement.topology).
    if not isinstance(scheme, Loop):
        return 2 * 4 ** (level - 1) * corners
    return 4 ** (level - 1) * (4 * (corners // 3) + corners % 3)


def _linear_step(table: CornerTable, with_faces: bool) -> sparse.csr_array:
    """(n + e [+ m], n) one step: vertices stay, edges get the middle, faces the mean of their corners."""
    n, e = table.n_vertices, table.n_edges
    one_each = np.flatnonzero(table.forward)
    edges = np.repeat(table.edges[one_each], 2)
    ends = np.stack([table.vertices[one_each], table.vertices[table.following[one_each]]], axis=1).ravel()
    rows: list[NDArray[Any]] = [np.arange(n), n + edges]
    columns: list[NDArray[Any]] = [np.arange(n), ends]
    values: list[FloatArray] = [np.ones(n), np.full(len(edges), 0.5)]
    if with_faces:
        rows.append(n + e + table.faces)
        columns.append(table.vertices)
        values.append(1.0 / np.bincount(table.faces)[table.faces])
    shape = (n + e + (table.n_faces if with_faces else 0), n)
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_array(sparse.coo_array(entries, shape=shape))
