"""Values at control vertices or face corners, interpolated linearly over the control faces.

Subdivision smooths what it refines: a weight of 1 at one control vertex is 0.45 at that vertex of the surface. Values
that someone painted on a cage are to arrive as they are, so here they are refined without smoothing: vertices keep
their value, edges take the middle, faces the mean. Each refined value is a convex combination of control values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from cagemap.mesh import ControlMesh
from cagemap.mesh.schemes import Loop, Scheme
from cagemap.mesh.topology import layout_topology
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.subdivision.matrices import linear_matrix
from cagemap.subdivision.topology import children, split_topology
from cagemap.surface.triangles import fan_triangles, triangles


@dataclass(frozen=True, eq=False)
class LinearValues:
    """Functions that are linear on the triangles of a refined level, given by values at the control mesh."""

    #: (p, p0) values at the nodes of the level from those at the control mesh's; rows are not negative and sum to 1
    matrix: sparse.csr_array
    corners: IndexArray  #: (t, 3) node of every corner of the level's triangles

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
    """Prepare the linear interpolation of values on a control mesh, at the triangles of a level.

    ``nodes`` (c,), below ``count``, are of every face corner its vertex, its UV, or the corner itself: corners that
    share a node share its value.
    """
    if level == 0:
        identity = sparse.csr_array(sparse.eye_array(count, format="csr"))
        return LinearValues(identity, fan_triangles(control.face_offsets, nodes)[0])
    with_faces = not isinstance(scheme, Loop)
    topology = layout_topology(control, nodes, count)
    matrix = linear_matrix(topology, with_faces)
    for _ in range(level - 1):
        topology = split_topology(topology, scheme)
        matrix = sparse.csr_array(linear_matrix(topology, with_faces) @ matrix)
    return LinearValues(matrix, triangles(children(topology, scheme).astype(np.int64)))


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
