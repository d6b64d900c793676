"""Which directions of a band of eigenpairs the prolonged basis does not have yet (paper, sections 4.3 and 4.4)."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from cagemap.basis.constants import CLUSTER
from cagemap.numerics.arrays import FloatArray, IndexArray


def clusters(values: FloatArray) -> IndexArray:
    """(m,) number of the cluster of nearly equal eigenvalues that each of an ascending list belongs to."""
    steps = np.diff(values) > CLUSTER * np.maximum(np.abs(values[1:]), 1e-3 * abs(values[-1]))
    return np.concatenate([[0], np.cumsum(steps)])


def new_directions(
    values: FloatArray, overlap: FloatArray, gram: FloatArray, present: int
) -> tuple[FloatArray, IndexArray]:
    """Rotate a window of eigenpairs inside its clusters and drop what the prolonged basis already spans.

    Inside a cluster any rotation gives eigenvectors. It is rotated so that each vector is either in the prolonged span
    as far as possible, or out of it: then a cluster that the previous level has cut is completed by exactly the missing
    directions. The window starts ``present`` pairs below the end of the prolonged basis, so exactly that many of its
    directions are there already: the ones with the largest overlap.

    Parameters
    ----------
    values : (m,) array
        Ascending eigenvalues of the window.
    overlap : (k, m) array
        <prolonged basis, window> in the mass inner product; the window is orthonormal.
    gram : (k, k) array
        <prolonged basis, prolonged basis>.
    present : int
        How many of the window's directions the prolonged basis holds.

    Returns
    -------
    rotation : (m, m - present) array
        Window vectors times this are the new directions, in ascending order.
    positions : (m - present,) array
        Place of each in the window.
    """
    m = len(values)
    if present == 0:
        return np.eye(m), np.arange(m)
    # In an orthonormal basis of the prolonged span a squared column norm is the share of a vector inside that span.
    inside = linalg.solve_triangular(linalg.cholesky(gram, lower=True), overlap, lower=True)
    rotation = np.eye(m)
    share = np.sum(inside**2, axis=0)
    labels = clusters(values)
    for label in np.flatnonzero(np.bincount(labels) > 1):
        members = np.flatnonzero(labels == label)
        squares, turn = linalg.eigh(inside[:, members].T @ inside[:, members])
        if squares[0] > 0.5 or squares[-1] < 0.5:  # not cut: its vectors stay as they are
            continue
        # Ascending shares: turn them round so that the missing directions come last, next to the following pairs.
        share[members] = squares[::-1]
        rotation[np.ix_(members, members)] = turn[:, ::-1]
    positions = np.sort(np.argsort(-share, kind="stable")[present:])
    return rotation[:, positions], positions
