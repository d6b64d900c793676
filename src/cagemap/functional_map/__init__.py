"""Functional maps: eq. 13 at level 0, eqs. 14-16 block by block above."""

from cagemap.functional_map.constraints import SPACING, Constraints, MapWeights, SpectralData
from cagemap.functional_map.extension import extend_functional_map, split_operators
from cagemap.functional_map.solve import laplacian_penalties, solve_functional_map

__all__ = [
    "SPACING",
    "Constraints",
    "MapWeights",
    "SpectralData",
    "extend_functional_map",
    "laplacian_penalties",
    "solve_functional_map",
    "split_operators",
]
