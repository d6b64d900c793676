"""A prepared surface: everything that depends on one control mesh only."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from cagemap.basis.hierarchical_basis import HierarchicalBasis
from cagemap.geometry.surface import TriangleSurface
from cagemap.mesh import ControlMesh
from cagemap.operators import Operators
from cagemap.refinement import Refinement, level_triangles


@dataclass(frozen=True, eq=False, repr=False)
class Surface:
    """One subdivision surface, refined, with its operators and its basis.

    Expensive to make and worth keeping: it serves every pair that the surface is part of. So do its triangles, made
    once when they are first asked for, with all that they keep (areas, normals, the tree for closest points).
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

    def triangles(self, level: int) -> TriangleSurface:
        """The triangles of a level between its vertices' places on the finest surface, at unit area.

        n-gons of the control mesh are fans, quads split by the one rule of `cagemap.refinement.triangles`.
        """
        return self._levels[level]

    @cached_property
    def _levels(self) -> tuple[TriangleSurface, ...]:
        scale = self.operators.scale
        places = scale * self.refinement.finest.positions
        return tuple(
            TriangleSurface(places[: mesh.n_vertices], level_triangles(self.refinement, level), scale)
            for level, mesh in enumerate(self.refinement.levels)
        )

    def __repr__(self) -> str:
        return f"Surface({self.control.name}, levels 0 to {self.finest}, {self.basis})"
