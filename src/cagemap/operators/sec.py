"""Subdivision exterior calculus operators of every level (paper, section 2.2.2).

All levels take their geometry from the finest one: W^l = (S^{f,l})^T W_f S^{f,l}, and M^l likewise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import sparse

from cagemap.mesh import FloatArray, IndexArray
from cagemap.operators.laplacian import areas_and_stiffness
from cagemap.refinement import Refinement, triangulate_control


@dataclass(frozen=True)
class Operators:
    """Mass and stiffness of every level of one refinement, for unit surface area.

    Attributes
    ----------
    mass : tuple of (n_l, n_l) CSR arrays
        M^l, symmetric positive definite; all entries sum to 1. Diagonal at the finest level only.
    stiffness : tuple of (n_l, n_l) CSR arrays
        W^l, symmetric positive semi-definite, W^l 1 = 0.
    scale : float
        Factor from the mesh's own lengths to those of unit area.
    """

    mass: tuple[sparse.csr_array, ...]
    stiffness: tuple[sparse.csr_array, ...]
    scale: float

    @property
    def finest(self) -> int:
        """Number of the finest level."""
        return len(self.mass) - 1

    def areas(self, level: int) -> FloatArray:
        """(n_l,) row sums of the mass matrix of a level, M^l 1: the area that each vertex stands for."""
        return lumped_areas(self.mass[level])

    @property
    def finest_areas(self) -> FloatArray:
        """(n_f,) diagonal of the finest mass matrix."""
        return np.asarray(self.mass[-1].diagonal(), dtype=np.float64)


def lumped_areas(mass: sparse.csr_array) -> FloatArray:
    """(n,) row sums M 1 of a mass matrix: the area that each vertex stands for."""
    return np.asarray(mass.sum(axis=1), dtype=np.float64).ravel()


def restrict(subdivision: sparse.csr_array, fine: sparse.csr_array) -> sparse.csr_array:
    """Galerkin restriction of a symmetric operator by one level: A^l = (S^l)^T A^{l+1} S^l.

    Parameters
    ----------
    subdivision : (n_{l+1}, n_l) CSR array
    fine : (n_{l+1}, n_{l+1}) CSR array, symmetric

    Returns
    -------
    (n_l, n_l) CSR array, symmetric
    """
    coarse = sparse.csr_array(subdivision.T @ (fine @ subdivision))
    coarse.sort_indices()
    return coarse


def restrict_pair(
    subdivision: sparse.csr_array, mass: sparse.csr_array, stiffness: sparse.csr_array, order: IndexArray
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """`restrict` of mass and stiffness at once: one walk over the entries of S for both, no product in between.

    Parameters
    ----------
    subdivision : (n_{l+1}, n_l) CSR array
    mass, stiffness : (n_{l+1}, n_{l+1}) CSR arrays, symmetric
        With the same pattern.
    order : (n_l,) array
        Permutation in which rows are computed; neighbours soon after each other find each other's data in the cache.

    Returns
    -------
    mass, stiffness : (n_l, n_l) CSR arrays, symmetric, sorted
        With the same pattern again.
    """
    n = subdivision.shape[1]
    transposed = sparse.csr_array(subdivision.T)
    room = min(n * n, 64 * n)
    dense = [(np.zeros((size, 2)), np.zeros(size, dtype=np.bool_)) for size in subdivision.shape]
    touched = np.empty(len(subdivision.indptr) - 1, dtype=np.int32)
    while True:
        indices, data, indptr = np.empty(room, dtype=np.int32), np.empty((room, 2)), np.zeros(n + 1, dtype=np.int32)
        entries = _restrict_pair(
            (transposed.indptr, transposed.indices, transposed.data),
            (stiffness.indptr, stiffness.indices, mass.data, stiffness.data),
            (subdivision.indptr, subdivision.indices, subdivision.data),
            order,
            (*dense[0], touched, *dense[1]),
            (indptr, indices, data),
        )
        if entries >= 0:
            break
        room *= 2  # vertices of very high valence
        for row, met in dense:
            row[:], met[:] = 0.0, False
    rank = np.argsort(order)
    masses, stiffnesses = (
        sparse.csr_array((data[:entries, i], indices[:entries], indptr), shape=(n, n))[rank] for i in (0, 1)
    )
    # One index array serves both.
    masses = sparse.csr_array((masses.data, stiffnesses.indices, stiffnesses.indptr), shape=(n, n))
    return masses, stiffnesses


def build_operators(refinement: Refinement) -> Operators:
    """Operators of every level of a refinement, normalised to unit area of the finest level.

    O(n_f) time and memory; a restricted matrix has about 25 nonzeros a row just below the finest level, 50
    further down.
    """
    finest = refinement.levels[-1]
    faces = triangulate_control(refinement.control) if finest.faces is None else finest.faces
    areas, finest_stiffness = areas_and_stiffness(finest.positions, faces)
    area = float(areas.sum())
    masses, stiffnesses = [sparse.csr_array(sparse.diags_array(areas / area))], [finest_stiffness]
    mass = _with_diagonal(finest_stiffness, areas / area)
    orders = _coherent_orders(refinement)
    for level in reversed(range(refinement.n_levels)):
        mass, stiffness = restrict_pair(refinement.matrices[level], mass, stiffnesses[-1], orders[level])
        masses.append(mass)
        stiffnesses.append(stiffness)
    return Operators(tuple(reversed(masses)), tuple(reversed(stiffnesses)), 1.0 / float(np.sqrt(area)))


def _coherent_orders(refinement: Refinement) -> list[IndexArray]:
    """For every level but the finest an order in which vertices of the same region follow each other.

    Levels store vertices, edges and faces in turn, far apart for neighbours; here each follows the place of a parent.
    """
    orders = [np.arange(refinement.levels[0].n_vertices)]
    for subdivision in refinement.matrices[:-1]:
        rank = np.argsort(orders[-1])
        parents = subdivision.indices[subdivision.indptr[:-1]]
        orders.append(np.argsort(rank[parents], kind="stable"))
    return orders


def _with_diagonal(pattern: sparse.csr_array, diagonal: FloatArray) -> sparse.csr_array:
    """A diagonal matrix stored with zeros in the pattern of another one."""
    rows = np.repeat(np.arange(len(diagonal), dtype=pattern.indices.dtype), np.diff(pattern.indptr))
    data = np.where(pattern.indices == rows, diagonal[rows], 0.0)
    return sparse.csr_array((data, pattern.indices, pattern.indptr), shape=pattern.shape)


@njit(cache=True, nogil=True)
def _restrict_pair(transposed, fine, subdivision, order, dense, result):  # type: ignore[no-untyped-def]
    """Rows order[0], order[1], ... of S^T A S for both matrices A; returns the number of entries, -1 if out of room.

    For row i, w = sum_r S_ri A_r, then sum_s w_s S_s, each gathered in a dense row that is zero before and after.
    """
    t_starts, t_rows, t_weights = transposed
    a_starts, a_columns, a_mass, a_stiffness = fine
    s_starts, s_columns, s_weights = subdivision
    middle, met_middle, touched, row, met = dense
    indptr, indices, data = result
    end = 0
    for k in range(len(order)):
        n_touched = 0
        for p in range(t_starts[order[k]], t_starts[order[k] + 1]):
            r, weight = t_rows[p], t_weights[p]
            for q in range(a_starts[r], a_starts[r + 1]):
                s = a_columns[q]
                if not met_middle[s]:
                    met_middle[s] = True
                    touched[n_touched] = s
                    n_touched += 1
                middle[s, 0] += weight * a_mass[q]
                middle[s, 1] += weight * a_stiffness[q]
        begin = end
        for t in range(n_touched):
            s = touched[t]
            w_mass, w_stiffness = middle[s, 0], middle[s, 1]
            met_middle[s], middle[s, 0], middle[s, 1] = False, 0.0, 0.0
            for q in range(s_starts[s], s_starts[s + 1]):
                j = s_columns[q]
                if not met[j]:
                    if end == len(indices):
                        return -1
                    met[j] = True
                    place = end  # insertion sort: rows are short, and those of S are sorted
                    while place > begin and indices[place - 1] > j:
                        indices[place] = indices[place - 1]
                        place -= 1
                    indices[place] = j
                    end += 1
                row[j, 0] += w_mass * s_weights[q]
                row[j, 1] += w_stiffness * s_weights[q]
        for q in range(begin, end):
            j = indices[q]
            data[q, 0], data[q, 1] = row[j, 0], row[j, 1]
            met[j], row[j, 0], row[j, 1] = False, 0.0, 0.0
        indptr[k + 1] = end
    return end
