"""Face-varying values (UVs), refined on their own topology so that seams stay seams."""

from __future__ import annotations

import numpy as np

from cagemap.mesh import FloatArray
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
    at_corners = uvs[table.vertices]
    midpoints = np.empty((table.n_edges, uvs.shape[1]))
    midpoints[table.edges] = 0.5 * (at_corners + at_corners[table.following])
    if not with_face_points:
        return np.concatenate([uvs, midpoints])
    starts = np.flatnonzero(np.diff(table.faces, prepend=-1))
    sizes = np.diff(starts, append=table.n_corners)
    centroids = np.add.reduceat(at_corners, starts, axis=0) / sizes[:, None]
    return np.concatenate([uvs, midpoints, centroids])
