"""Mass and stiffness of every level by subdivision exterior calculus (SEC; paper, section 2.2.2).

All levels take their geometry from the finest one: W^l = (S^{f,l})^T W_f S^{f,l}, and M^l likewise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.operators.laplacian import Laplacian, MeanTriangulation, assemble_stiffness
from cagemap.subdivision import Refinement


@dataclass(frozen=True, eq=False)
class Operators:
    """Mass and stiffness matrices of every level of a refinement, at unit surface area.

    Attributes
    ----------
    mass : tuple of (n_l, n_l) CSR arrays
        M^l, symmetric positive definite; all entries sum to 1. Diagonal at the finest level only.
    stiffness : tuple of (n_l, n_l) CSR arrays
        W^l, symmetric positive semi-definite, W^l 1 = 0.
    scale : float
        Factor from the mesh's lengths to lengths at unit area.
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
        """(n_l,) vertex areas of a level: the row sums M^l 1 of its mass matrix."""
        return lumped_areas(self.mass[level])


def lumped_areas(mass: sparse.csr_array) -> FloatArray:
    """(n,) vertex areas: the row sums M 1 of a mass matrix."""
    return np.asarray(mass.sum(axis=1), dtype=np.float64).ravel()


@kinds_checked
def build_operators(refinement: Refinement, laplacian: Laplacian = MeanTriangulation()) -> Operators:
    """Operators of every level of a refinement, at unit area of the finest level (2.2.2, Lemma 5).

    ``laplacian`` of the finest level is `MeanTriangulation`, `AlexaWardetzky` (the paper's) or `DeGoesButtsDesbrun`.
    O(n_f) time and memory. Restricted matrices have about 25 nonzeros per row just below the finest level, 50 on
    coarser levels. ParameterError if ``laplacian`` is no Laplacian.
    """
    if not callable(getattr(laplacian, "face_terms", None)):
        raise ParameterError(f"laplacian: expected one such as AlexaWardetzky(1.0), got {laplacian!r}")
    finest = refinement.levels[-1]
    faces = refinement.faces(refinement.n_levels)
    weights, areas = laplacian.face_terms(finest.positions, faces)
    area = float(areas.sum())
    # One complex matrix W + i M: one product restricts both, and they keep the same pattern.
    both = sparse.csr_array(
        assemble_stiffness(weights, faces, len(finest.positions)) + sparse.diags_array(1j * areas / area)
    )
    masses, stiffnesses = [sparse.csr_array(sparse.diags_array(areas / area))], [_with_values(both, both.data.real)]
    for subdivision in reversed(refinement.matrices):
        both = sparse.csr_array(subdivision.T @ (both @ subdivision))
        both.sort_indices()
        masses.append(_with_values(both, both.data.imag))
        stiffnesses.append(_with_values(both, both.data.real))
    return Operators(tuple(reversed(masses)), tuple(reversed(stiffnesses)), 1.0 / float(np.sqrt(area)))


def _with_values(matrix: sparse.csr_array, values: FloatArray) -> sparse.csr_array:
    """A matrix with the same pattern and other values."""
    arrays = np.ascontiguousarray(values), matrix.indices, matrix.indptr
    return sparse.csr_array(arrays, shape=matrix.shape)
