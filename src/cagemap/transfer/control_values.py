"""Carry values of the source's control mesh to the target's: at vertices, at face corners, UV sets.

Every value of the target is a convex combination of the source's values, so the identity map returns them. Of labels
the one with the largest weight is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import merged_corners
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.subdivision import Refinement
from cagemap.subdivision.face_varying import corner_triangles, interpolate_linearly
from cagemap.surface.triangles import triangle_neighbors
from cagemap.transfer.attributes import largest_share
from cagemap.transfer.baking import Transfer
from cagemap.transfer.locate import locate_centers, walk_from

# Texture coordinates of one vertex that differ by less are equal.
_SAME_UV = 1e-7
# A seam lies between two walks' ends if more than this share of their weights differs.
_MAX_WEIGHT_CHANGE = 0.5


def control_weights(point_map: PointMap, target: Refinement, source: Refinement) -> sparse.csr_array:
    """(c1, c2) weights of the source's control vertices at every control vertex of the target.

    Source values are interpolated linearly over control faces at the image of the vertex, so rows are not negative,
    sum to 1, and have at most as many entries as a source face has corners.
    """
    control = source.control
    linear, corners = interpolate_linearly(
        control, control.face_indices, control.n_vertices, source.finest_level, source.scheme
    )
    rows = target.control.n_vertices
    return _weights_at(linear, corners[point_map.triangle[:rows]], point_map.barycentric[:rows])


def _weights_at(linear: sparse.csr_array, corners: IndexArray, barycentric: FloatArray) -> sparse.csr_array:
    """(k, p0) weights of the control mesh's values at points, by their triangles' corners (k, 3) in ``linear``."""
    k = len(corners)
    places = corners.ravel(), np.arange(0, 3 * k + 1, 3)
    rows = sparse.csr_array((barycentric.ravel(), *places), shape=(k, linear.shape[0]))
    weights = sparse.csr_array(rows @ linear)
    weights.eliminate_zeros()
    weights.sort_indices()
    return weights


def combine(weights: sparse.csr_array, values: NDArray[Any]) -> NDArray[Any]:
    """Weighted means of values; of labels (integers, booleans) the one with the largest weight, or the smaller of two.

    ``weights`` (c1, c2), not negative, have at least one entry in each row. A row of several integers in ``values``,
    (c2,) or (c2, q), is one label. Returns (c1,) or (c1, q), of the same kind.
    """
    values = np.asarray(values)
    if len(values) != weights.shape[1]:
        raise ParameterError(f"expected {weights.shape[1]} rows of values, got {len(values)}")
    if values.dtype.kind not in "iub":
        return np.asarray(weights @ values.astype(np.float64))
    distinct, number = np.unique(values, axis=0, return_inverse=True)
    owners = np.repeat(np.arange(weights.shape[0]), np.diff(weights.indptr))
    winners = largest_share(owners, number.ravel()[weights.indices], weights.data, weights.shape[0])
    return distinct[winners]


def corner_weights(
    transfer: Transfer, target: Refinement, source: Refinement, nodes: IndexArray, count: int
) -> tuple[sparse.csr_array, NDArray[np.bool_]]:
    """Weights (c1, p2) of source nodes at target face corners; (m1,) whether a source seam crosses a face.

    ``nodes`` (c2,), below ``count``, are the nodes of the corners of the source's control faces, each of one vertex;
    faces that do not share nodes along an edge have a seam there. A corner takes its value from its own side of a seam:
    the walk from the centre of the refined triangle at the corner to the image of its vertex does not cross seams.
    """
    control = target.control
    linear, corners = interpolate_linearly(source.control, nodes, count, source.finest_level, source.scheme)
    sides = triangle_neighbors(corners)
    tips = corner_triangles(control, target.finest_level, target.scheme)
    centres = locate_centers(transfer.mapped)
    points = transfer.mapped.mapped[control.face_indices]
    triangle, barycentric = walk_from(transfer.mapped.frames, sides, centres[tips], points)
    weights = _weights_at(linear, corners[triangle], barycentric)
    return weights, _crossed_faces(transfer, control, linear, corners, sides, centres)


def _crossed_faces(
    transfer: Transfer,
    control: ControlMesh,
    linear: sparse.csr_array,
    corners: IndexArray,
    sides: NDArray[np.int32],
    centres: IndexArray,
) -> NDArray[np.bool_]:
    """(m1,) whether a seam separates the images of two neighbouring refined triangles of a face."""
    target = transfer.target
    face = target.face_parents[target.triangle_faces]
    neighbors = triangle_neighbors(target.triangles)
    near, corner = np.nonzero(neighbors > np.arange(len(face))[:, None])
    far = neighbors[near, corner]
    inside = (face[near] == face[far]) & (centres[near] != centres[far])
    near, far = near[inside], far[inside]
    points = transfer.mapped.mapped[target.triangles[far]].mean(axis=1)
    triangle, barycentric = walk_from(transfer.mapped.frames, sides, centres[near], points)
    triangle_beyond, beyond = walk_from(transfer.mapped.frames, sides, centres[far], points)
    change = _weights_at(linear, corners[triangle], barycentric) - _weights_at(linear, corners[triangle_beyond], beyond)
    apart = 0.5 * abs(change).sum(axis=1)
    crossed = np.zeros(control.n_faces, dtype=np.bool_)
    crossed[face[near[apart > _MAX_WEIGHT_CHANGE]]] = True
    return crossed


@dataclass(frozen=True, eq=False)
class CarriedUvs:
    """The source's texture coordinates on the target's faces."""

    uvs: FloatArray  # (p, 2)
    uv_indices: IndexArray  # (c1,) corners of one vertex with equal texture coordinates share them
    crossed: IndexArray  # (k,) target faces over which a seam of the source runs


def carry_uvs(transfer: Transfer, target: Refinement, source: Refinement) -> CarriedUvs:
    """The source's texture coordinates at the target's corners: the source's image fits the target."""
    control = source.control
    if control.uvs is None or control.uv_indices is None:
        raise ParameterError(f"{control.name}: expected a source with texture coordinates to carry, it has none")
    values, nodes = merged_corners(control.face_indices, control.uvs[control.uv_indices])
    weights, crossed = corner_weights(transfer, target, source, nodes, len(values))
    uvs = weights @ values
    _, indices = merged_corners(target.control.face_indices, np.rint(uvs / _SAME_UV))
    first = np.unique(indices, return_index=True)[1]
    return CarriedUvs(uvs[first], indices, np.flatnonzero(crossed))
