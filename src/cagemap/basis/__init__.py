"""The spectral basis: eigenpairs of every level, joined into one hierarchical basis (paper, section 4)."""

from cagemap.basis.construction import hierarchical_basis
from cagemap.basis.eigen import (
    EigenPairs,
    band_pairs,
    exact_basis,
    lowest_pairs,
    residual_norms,
)
from cagemap.basis.guess import pairs_from_guess
from cagemap.basis.hierarchical_basis import (
    HierarchicalBasis,
    evaluate,
    gram_matrix,
    project,
    row_blocks,
    rows,
)
from cagemap.basis.schedule import BasisConfig
from cagemap.basis.surface import Surface

__all__ = [
    "BasisConfig",
    "EigenPairs",
    "HierarchicalBasis",
    "Surface",
    "band_pairs",
    "evaluate",
    "exact_basis",
    "gram_matrix",
    "hierarchical_basis",
    "lowest_pairs",
    "pairs_from_guess",
    "project",
    "residual_norms",
    "row_blocks",
    "rows",
]
