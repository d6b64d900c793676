"""Subdivision exterior calculus operators of every level (paper, section 2.2.2).

All levels take their geometry from the finest one: W^l = (S^{f,l})^T W_f S^{f,l}, and M^l likewise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from cagemap.mesh import FloatArray
from cagemap.operators.laplacian import stiffness, vertex_areas
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

    @property
    def finest_areas(self) -> FloatArray:
        """(n_f,) diagonal of the finest mass matrix."""
        return np.asarray(self.mass[-1].diagonal(), dtype=np.float64)


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


def build_operators(refinement: Refinement) -> Operators:
    """Operators of every level of a refinement, normalised to unit area of the finest level.

    O(n_f) time and memory; a restricted matrix has about 25 nonzeros a row just below the finest level, 50 further down.
    """
    finest = refinement.levels[-1]
    faces = triangulate_control(refinement.control) if finest.faces is None else finest.faces
    areas = vertex_areas(finest.positions, faces)
    area = float(areas.sum())
    masses = [sparse.csr_array(sparse.diags_array(areas / area))]
    stiffnesses = [stiffness(finest.positions, faces)]
    # Mass and stiffness have the same pattern below the finest level: as real and imaginary part of one matrix they take one
    # sparse product instead of two.
    both = sparse.csr_array(masses[0] + 1j * stiffnesses[0])
    for subdivision in reversed(refinement.matrices):
        both = restrict(subdivision, both)
        masses.append(_like(both, both.data.real))
        stiffnesses.append(_like(both, both.data.imag))
    return Operators(tuple(reversed(masses)), tuple(reversed(stiffnesses)), 1.0 / float(np.sqrt(area)))


def _like(matrix: sparse.csr_array, data: FloatArray) -> sparse.csr_array:
    """Return a matrix with the pattern of another one, its own copy of the data."""
    return sparse.csr_array((np.ascontiguousarray(data), matrix.indices, matrix.indptr), shape=matrix.shape)
