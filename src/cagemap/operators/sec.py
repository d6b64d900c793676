"""Subdivision exterior calculus operators of every level (paper, section 2.2.2).

All levels take their geometry from the finest one: W^l = (S^{f,l})^T W_f S^{f,l}, and M^l likewise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.mesh.measures import cage_triangles
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.operators.laplacian import gathered
from cagemap.operators.polygons import Laplacian, MeanTriangulation
from cagemap.subdivision import Refinement

# Entries a row that the lower triangle of a restricted matrix gets at first; doubled where they do not suffice.
_FIRST_ROOM = 32


@dataclass(frozen=True, eq=False)
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

    def __repr__(self) -> str:
        return f"Operators({', '.join(str(mass.shape[0]) for mass in self.mass)} vertices, scale {self.scale:.6g})"

    @property
    def finest(self) -> int:
        """Number of the finest level."""
        return len(self.mass) - 1

    def areas(self, level: int) -> FloatArray:
        """(n_l,) row sums of the mass matrix of a level, M^l 1: the area that each vertex stands for."""
        return lumped_areas(self.mass[level])


def lumped_areas(mass: sparse.csr_array) -> FloatArray:
    """(n,) row sums M 1 of a mass matrix: the area that each vertex stands for."""
    return np.asarray(mass.sum(axis=1), dtype=np.float64).ravel()


def restrict_pair(
    subdivision: sparse.csr_array, mass: sparse.csr_array, stiffness: sparse.csr_array, order: IndexArray
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Galerkin restriction by one level, A^l = (S^l)^T A^{l+1} S^l, of mass and stiffness in one pass (2.2.2).

    Both are symmetric and have the same pattern, before and after. Rows are computed in the given order (n_l,), in
    which neighbours should follow each other (cache).
    """
    n = subdivision.shape[1]
    subdivision = subdivision if subdivision.has_sorted_indices else subdivision.sorted_indices()
    transposed = sparse.csr_array(subdivision.T)
    room = min(n * (n + 1) // 2, _FIRST_ROOM * n)
    nowhere = np.iinfo(np.uint32).max
    rows = [(np.empty((size, 2)), np.full(size, nowhere, dtype=np.uint32)) for size in subdivision.shape]
    touched = np.empty(subdivision.shape[0], dtype=np.uint32)
    while True:
        lower = np.zeros(n + 1, dtype=np.int32), np.empty(room, dtype=np.int32), np.empty((room, 2))
        entries = _restrict_pair(
            (transposed.indptr, transposed.indices, transposed.data),
            (stiffness.indptr, stiffness.indices, mass.data, stiffness.data),
            (subdivision.indptr, subdivision.indices, subdivision.data),
            order,
            (*rows[0], touched, *rows[1]),
            lower,
        )
        if entries >= 0:
            break
        room *= 2  # vertices of very high valence
        for _, last in rows:
            last[:] = nowhere
    filled = np.zeros(n + 2, dtype=np.int32)
    arrays = np.empty(2 * entries, dtype=np.int32), np.empty(2 * entries), np.empty(2 * entries)
    _mirror(np.argsort(order), lower, filled, *arrays)
    indices, masses, stiffnesses = (array[: filled[n]] for array in arrays)
    coarse_mass, coarse_stiffness = (
        sparse.csr_array((data, indices, filled[: n + 1]), shape=(n, n)) for data in (masses, stiffnesses)
    )
    return coarse_mass, coarse_stiffness


@kinds_checked
def build_operators(refinement: Refinement, laplacian: Laplacian = MeanTriangulation()) -> Operators:
    """Operators of every level of a refinement, normalised to unit area of the finest level.

    O(n_f) time and memory; a restricted matrix has about 25 nonzeros a row just below the finest level, 50 further
    down.

    Parameters
    ----------
    refinement : Refinement
    laplacian : Laplacian
        Of the finest level's polygons: `MeanTriangulation`, `AlexaWardetzky` (the paper's) or `DeGoesButtsDesbrun`.

    Raises
    ------
    ParameterError
        If the laplacian is none.
    """
    if not callable(getattr(laplacian, "face_terms", None)):
        raise ParameterError(f"laplacian: expected one such as AlexaWardetzky(1.0), got {laplacian!r}")
    finest = refinement.levels[-1]
    faces = cage_triangles(refinement.control)[0] if finest.faces is None else finest.faces
    weights, areas = laplacian.face_terms(finest.positions, faces)
    finest_stiffness = gathered(weights, faces, len(finest.positions))
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
    """For every level but the finest an order of its vertices in which neighbours follow each other."""
    orders = [np.arange(refinement.levels[0].n_vertices)]
    for subdivision in refinement.matrices[:-1]:
        rank = np.argsort(orders[-1])
        parents = subdivision.indices[subdivision.indptr[:-1]]
        orders.append(np.argsort(rank[parents], kind="stable"))
    return orders


def _with_diagonal(pattern: sparse.csr_array, diagonal: FloatArray) -> sparse.csr_array:
    """A diagonal matrix, stored with zeros in the pattern of another one."""
    rows = np.repeat(np.arange(len(diagonal), dtype=pattern.indices.dtype), np.diff(pattern.indptr))
    data = np.where(pattern.indices == rows, diagonal[rows], 0.0)
    return sparse.csr_array((data, pattern.indices, pattern.indptr), shape=pattern.shape)


# Unsigned indices: the sign test of signed ones takes a quarter of the time.
@njit(cache=True, nogil=True)
def _restrict_pair(transposed, fine, subdivision, order, rows, lower):  # type: ignore[no-untyped-def]
    """Lower triangle of S^T A S for both matrices A, row order[0] first; the number of entries, -1 if out of room.

    For row i, w = sum_r S_ri A_r, then sum_s w_s S_s, each gathered in a dense row; an entry counts where i is the last
    row that touched it.
    """
    t_starts, t_rows, t_weights = transposed
    a_starts, a_columns, a_mass, a_stiffness = fine
    s_starts, s_columns, s_weights = subdivision
    middle, last_middle, touched, row, last = rows
    indptr, indices, data = lower
    zero, one, room = np.uint64(0), np.uint64(1), np.uint64(len(indices))
    end = zero
    for k in range(np.uint64(len(order))):
        i = np.uint64(order[k])
        n_touched = zero
        for p in range(np.uint64(t_starts[i]), np.uint64(t_starts[i + one])):
            r, weight = np.uint64(t_rows[p]), t_weights[p]
            for q in range(np.uint64(a_starts[r]), np.uint64(a_starts[r + one])):
                s = np.uint64(a_columns[q])
                if last_middle[s] != i:
                    last_middle[s] = i
                    touched[n_touched] = s
                    n_touched += one
                    middle[s, zero], middle[s, one] = 0.0, 0.0
                middle[s, zero] += weight * a_mass[q]
                middle[s, one] += weight * a_stiffness[q]
        begin = end
        for t in range(n_touched):
            s = np.uint64(touched[t])
            w_mass, w_stiffness = middle[s, zero], middle[s, one]
            for q in range(np.uint64(s_starts[s]), np.uint64(s_starts[s + one])):
                j = np.uint64(s_columns[q])
                if j > i:  # columns ascend
                    break
                if last[j] != i:
                    if end == room:
                        return -1
                    last[j] = i
                    row[j, zero], row[j, one] = 0.0, 0.0
                    place = end  # insertion sort: rows are short, and those of S are sorted
                    while place > begin and indices[place - one] > j:
                        indices[place] = indices[place - one]
                        place -= one
                    indices[place] = j
                    end += one
                row[j, zero] += w_mass * s_weights[q]
                row[j, one] += w_stiffness * s_weights[q]
        for q in range(begin, end):
            j = np.uint64(indices[q])
            data[q, zero], data[q, one] = row[j, zero], row[j, one]
        indptr[k + one] = end
    return np.int64(end)


@njit(cache=True, nogil=True)
def _mirror(rank, lower, filled, indices, first, second):  # type: ignore[no-untyped-def]
    """CSR arrays of two symmetric matrices from their lower triangles, row i at place rank[i]; rows come out sorted.

    ``filled``, zeros (n + 2,), becomes the row starts, at places 0 to n: while row i is filled, place i + 1 is its end.
    """
    starts, columns, data = lower
    n = len(rank)
    for i in range(n):
        for p in range(starts[rank[i]], starts[rank[i] + 1]):
            j = columns[p]
            filled[i + 2] += 1
            if j != i:
                filled[j + 2] += 1
    for i in range(n):
        filled[i + 2] += filled[i + 1]
    for i in range(n):  # what lies right of a diagonal comes with the rows after it
        for p in range(starts[rank[i]], starts[rank[i] + 1]):
            j = columns[p]
            indices[filled[i + 1]], first[filled[i + 1]], second[filled[i + 1]] = j, data[p, 0], data[p, 1]
            filled[i + 1] += 1
            if j != i:
                indices[filled[j + 1]], first[filled[j + 1]], second[filled[j + 1]] = i, data[p, 0], data[p, 1]
                filled[j + 1] += 1
