"""Eigenfunctions of a surface, functional maps from point matches, and ZoomOut (paper, sections 2.1 and 4)."""

from cagemap.spectral.basis import HierarchicalBasis, hierarchical_basis
from cagemap.spectral.config import MAP_BASIS, BasisConfig
from cagemap.spectral.eigenpairs import EigenPairs, band_pairs, exact_basis, residual_norms
from cagemap.spectral.surface import Surface

__all__ = [
    "MAP_BASIS",
    "BasisConfig",
    "EigenPairs",
    "HierarchicalBasis",
    "Surface",
    "band_pairs",
    "exact_basis",
    "hierarchical_basis",
    "residual_norms",
]
