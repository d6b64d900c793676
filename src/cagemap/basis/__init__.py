"""The spectral basis: eigenpairs of every level, joined into one hierarchical basis (paper, section 4)."""

from cagemap.basis.construction import hierarchical_basis
from cagemap.basis.eigen import (
    EigenPairs,
    band_pairs,
    exact_basis,
    lowest_pairs,
    residual_norms,
)
from cagemap.basis.factorization import Factorization, factor
from cagemap.basis.guess import pairs_from_guess
from cagemap.basis.hierarchical import (
    HierarchicalBasis,
    evaluate,
    gram_matrix,
    project,
    row_blocks,
    rows,
)
from cagemap.basis.products import multiply
from cagemap.basis.schedule import BasisConfig
from cagemap.basis.surface import Surface

__all__ = [
    "BasisConfig",
    "EigenPairs",
    "Factorization",
    "HierarchicalBasis",
    "Surface",
    "band_pairs",
    "evaluate",
    "exact_basis",
    "factor",
    "gram_matrix",
    "hierarchical_basis",
    "lowest_pairs",
    "multiply",
    "pairs_from_guess",
    "project",
    "residual_norms",
    "row_blocks",
    "rows",
]
