"""Eigenfunctions of a surface, functional maps from point matches, and ZoomOut (paper, sections 2.1 and 4)."""

from cagemap.spectral.basis import MAP_BASIS as MAP_BASIS
from cagemap.spectral.basis import BasisConfig as BasisConfig
from cagemap.spectral.basis import HierarchicalBasis as HierarchicalBasis
from cagemap.spectral.basis import hierarchical_basis as hierarchical_basis
from cagemap.spectral.eigenpairs import EigenPairs as EigenPairs
from cagemap.spectral.eigenpairs import band_pairs as band_pairs
from cagemap.spectral.eigenpairs import exact_basis as exact_basis
from cagemap.spectral.eigenpairs import residual_norms as residual_norms
from cagemap.spectral.surface import Surface as Surface
