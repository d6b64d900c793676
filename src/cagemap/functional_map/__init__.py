"""Functional maps: eq. 13 at level 0, eqs. 14-16 block by block above."""

from cagemap.functional_map.extension import (
    OperatorWeights,
    SpectralData,
    coarse_functional_map,
    extend_functional_map,
)
from cagemap.functional_map.solve import Commutator, laplacian_penalties, solve_functional_map

__all__ = [
    "Commutator",
    "OperatorWeights",
    "SpectralData",
    "coarse_functional_map",
    "extend_functional_map",
    "laplacian_penalties",
    "solve_functional_map",
]
