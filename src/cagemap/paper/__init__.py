"""The paper's method: descriptors, functional maps level by level, point maps (sections 5.1 - 5.4); and `hfm`."""

from cagemap.paper.constraints import Constraints, DescriptorConfig, MapWeights, SpectralData, gather_constraints
from cagemap.paper.equations import extend_functional_map, solve_functional_map
from cagemap.paper.hfm import HfmConfig, hfm_map
from cagemap.paper.method import PaperConfig, paper_map

__all__ = [
    "Constraints",
    "DescriptorConfig",
    "HfmConfig",
    "MapWeights",
    "PaperConfig",
    "SpectralData",
    "extend_functional_map",
    "gather_constraints",
    "hfm_map",
    "paper_map",
    "solve_functional_map",
]
