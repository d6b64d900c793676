"""The spectral basis: eigenpairs of every level, joined into one hierarchical basis (paper, section 4)."""

from cagemap.basis.construction import hierarchical_basis
from cagemap.basis.eigen import EigenPairs, band_pairs, exact_basis, residual_norms
from cagemap.basis.guess import pairs_from_guess
from cagemap.basis.hierarchical_basis import HierarchicalBasis
from cagemap.basis.schedule import BasisConfig
from cagemap.basis.surface import Surface

__all__ = [
    "BasisConfig",
    "EigenPairs",
    "HierarchicalBasis",
    "Surface",
    "band_pairs",
    "exact_basis",
    "hierarchical_basis",
    "pairs_from_guess",
    "residual_norms",
]
