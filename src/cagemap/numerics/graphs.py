"""Graphs of numbered nodes, given by the ends of their edges."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from cagemap.numerics.arrays import IndexArray


def components(heads: IndexArray, tails: IndexArray, count: int) -> IndexArray:
    """(count,) number of the connected component of every node, in the order of their lowest nodes."""
    edges = sparse.coo_array((np.ones(len(heads), dtype=np.int8), (heads, tails)), shape=(count, count))
    return np.asarray(connected_components(edges, directed=False)[1], dtype=np.int64)
