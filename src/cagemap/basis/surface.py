"""A prepared surface: everything that depends on one control mesh only."""

from __future__ import annotations

from dataclasses import dataclass

from cagemap.basis.hierarchical_basis import HierarchicalBasis
from cagemap.mesh import ControlMesh
from cagemap.operators import Operators
from cagemap.refinement import Refinement


@dataclass(frozen=True)
class Surface:
    """One subdivision surface, refined, with its operators and its basis.

    Expensive to make and worth keeping: it serves every pair that the surface is part of.
    """

    refinement: Refinement
    operators: Operators
    basis: HierarchicalBasis

    @property
    def control(self) -> ControlMesh:
        """The control mesh."""
        return self.refinement.control

    @property
    def finest(self) -> int:
        """Number of the finest level."""
        return len(self.refinement.levels) - 1
