"""Masks of finest vertices from what models have: values at control vertices, sets of control faces, a soft edge."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, real_numbers
from cagemap.numerics.kinds import kinds_checked
from cagemap.subdivision import Refinement
from cagemap.surface.triangle_surface import TriangleSurface


@kinds_checked
def vertex_mask(refinement: Refinement, values: FloatArray) -> FloatArray:
    """(n_f,) mask of the finest vertices from values (n_0,) at control vertices (a vertex group), refined with them.

    Raises
    ------
    ParameterError
        If there is not one number from 0 to 1 for each control vertex.
    """
    given = _checked(values, refinement.control.n_vertices, "control vertex")
    return np.clip(refinement.prolong(given, 0, refinement.n_levels), 0.0, 1.0)


@kinds_checked
def face_mask(refinement: Refinement, values: FloatArray) -> FloatArray:
    """(n_f,) mask of the finest vertices from values (m_0,) at control faces (a face set).

    A vertex between faces takes the least of their values, so that nothing leaks out of a set.

    Raises
    ------
    ParameterError
        If there is not one number from 0 to 1 for each control face.
    """
    given = _checked(values, refinement.control.n_faces, "control face")
    finest = refinement.finest
    if finest.faces is None:
        raise ParameterError("face mask: expected a mesh refined at least once, got its control mesh")
    mask = np.ones(finest.n_vertices)
    for corner in finest.faces.T:
        np.minimum.at(mask, corner, given[finest.face_parents])
    return mask


@kinds_checked
def soft_edge(surface: TriangleSurface, mask: FloatArray, width: float) -> FloatArray:
    """(n,) a mask that rises from 0 at its border to its value at a distance inside it; outside it stays 0.

    Parameters
    ----------
    surface : TriangleSurface
        Of the mask's vertices.
    mask : (n,) float64
    width : float
        The distance, along edges, in units of sqrt(area); 0 changes nothing.

    Raises
    ------
    ParameterError
        If the width is negative, or the mask has not one number from 0 to 1 for each vertex.
    """
    if not width >= 0.0:
        raise ParameterError(f"mask edge: expected a width of 0 or more, of sqrt(area), got {width}")
    mask = _checked(mask, surface.n, "vertex of the surface")
    outside = np.flatnonzero(mask <= 0.0)
    if width == 0.0 or not len(outside):
        return mask
    ends = surface.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    lengths = np.linalg.norm(surface.positions[ends[:, 0]] - surface.positions[ends[:, 1]], axis=1)
    # A pair that comes twice would be summed: the same edge in both directions is stored once each.
    first, last = ends.T
    edges = sparse.coo_array((np.maximum(lengths, 1e-12), (first, last)), shape=(surface.n, surface.n)).tocsr()
    edges = edges.maximum(edges.T)
    inside = dijkstra(edges, directed=False, indices=outside, min_only=True, limit=width)
    return mask * np.minimum(inside / width, 1.0)


def _checked(values: FloatArray, count: int, place: str) -> FloatArray:
    given = real_numbers(values, "mask")
    if given.shape != (count,) or not np.all((given >= 0) & (given <= 1)):
        raise ParameterError(
            f"mask: expected {count} numbers from 0 to 1, one a {place}, got shape {given.shape}"
            + (f" from {given.min():g} to {given.max():g}" if given.size else "")
        )
    return given
