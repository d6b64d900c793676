"""Face-varying values (UVs), refined on their own topology so that seams stay seams."""

from __future__ import annotations

import numpy as np

from cagemap.numerics.arrays import FloatArray
from cagemap.refinement.topology import CornerTable


def refine_uvs(table: CornerTable, uvs: FloatArray, *, with_face_points: bool) -> FloatArray:
    """One linear step: values stay, edges get midpoints, faces (Catmull-Clark only) the mean of their corners.

    OpenSubdiv calls it ``FVAR_LINEAR_ALL``.

    Parameters
    ----------
    table : CornerTable
        Corner table of the UV layout.
    uvs : (p, 2) float64

    Returns
    -------
    (p + e, 2) or (p + e + m, 2) float64
    """
    # One corner of every edge is enough: the others would write the same value.
    chosen = np.flatnonzero(table.forward)
    midpoints = np.empty((table.n_edges, uvs.shape[1]))
    midpoints[table.edges[chosen]] = 0.5 * (uvs[table.vertices[chosen]] + uvs[table.vertices[table.following[chosen]]])
    if not with_face_points:
        return np.concatenate([uvs, midpoints])
    if table.has_only(4):
        a, b, c, d = (uvs[table.vertices[k::4]] for k in range(4))
        return np.concatenate([uvs, midpoints, 0.25 * ((a + c) + (b + d))])
    starts = np.flatnonzero(np.diff(table.faces, prepend=-1))
    sizes = np.diff(starts, append=table.n_corners)
    centroids = np.add.reduceat(uvs[table.vertices], starts, axis=0) / sizes[:, None]
    return np.concatenate([uvs, midpoints, centroids])
