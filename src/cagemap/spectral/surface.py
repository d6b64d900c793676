"""The central value `Surface`: everything that depends on one control mesh only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cagemap.errors import ParameterError
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.numerics.arrays import FloatArray, IndexArray, read_only
from cagemap.numerics.threads import kept, one_blas_thread
from cagemap.operators import Operators, build_operators
from cagemap.operators.coarse_levels import coarsened
from cagemap.operators.laplacian import named_laplacian
from cagemap.spectral.bands import hierarchical_basis
from cagemap.spectral.basis import HierarchicalBasis
from cagemap.spectral.config import MAP_BASIS, BasisConfig
from cagemap.subdivision import Refinement, level_triangles, refine
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import surface_area


def operators_for(refinement: Refinement, config: BasisConfig) -> Operators:
    """Operators of all levels, or of those up to the first with ``config.vertices`` vertices."""
    laplacian = named_laplacian(config.laplacian, config.stabilisation)
    if config.vertices is None:
        return build_operators(refinement, laplacian)
    level = refinement.coarsest_level(config.vertices)
    if config.schedule is not None:
        level = min(max(level, len(config.schedule) - 1), refinement.n_levels)
    return build_operators(refinement.up_to(level), laplacian)


@dataclass(frozen=True, eq=False, repr=False)
class Surface:
    """One surface with what follows from it: its levels, their operators, basis and triangles.

    They are made when they are first asked for, and kept. `cagemap.prepare_surface` makes operators and basis at once.

    Attributes
    ----------
    refinement : Refinement
        As asked for: of a plain mesh the mesh alone. `hierarchy` has the levels that maps are found on.
    config : BasisConfig
        Of the basis.
    """

    refinement: Refinement
    config: BasisConfig = MAP_BASIS

    @classmethod
    def of(
        cls, hierarchy: Refinement, operators: Operators, basis: HierarchicalBasis, config: BasisConfig | None = None
    ) -> Surface:
        """A surface whose operators and basis are there already, on its `hierarchy`."""
        config = BasisConfig(schedule=basis.schedule) if config is None else config
        surface = cls(hierarchy.without_coarse_levels(), config)
        vars(surface).update(hierarchy=hierarchy, operators=operators, basis=basis)  # where cached properties look
        return surface

    @kept
    def hierarchy(self) -> Refinement:
        """All levels: those of the refinement, or the coarse levels of a plain mesh and the mesh, which is the finest.

        Everything below that takes the number of a level counts these.
        """
        return coarsened(self.refinement) if self.refinement.is_plain else self.refinement

    @kept
    def operators(self) -> Operators:
        """Mass and stiffness of every level (paper, section 4.1), up to the one that ``config.vertices`` says."""
        return operators_for(self.hierarchy, self.config)

    @kept
    def basis(self) -> HierarchicalBasis:
        """The hierarchical basis (paper, section 4)."""
        with one_blas_thread():
            return hierarchical_basis(self.hierarchy, self.operators, self.config)

    @property
    def is_prepared(self) -> bool:
        """Whether the basis has been made."""
        return "basis" in vars(self)

    @kept
    def scale(self) -> float:
        """Factor from the file's lengths to those at unit area; that of the operators if they are the finest ones."""
        operators: Operators | None = vars(self).get("operators")
        if operators is not None and operators.finest == self.finest:
            return operators.scale
        return 1.0 / float(np.sqrt(surface_area(self.vertices, self.faces)))

    @property
    def control(self) -> ControlMesh:
        """The control mesh."""
        return self.refinement.control

    @property
    def finest(self) -> int:
        """Number of the finest level of the hierarchy."""
        return self.hierarchy.n_levels

    @property
    def vertices(self) -> FloatArray:
        """(n, 3) vertices of the finest level, in the file's lengths."""
        return read_only(self.refinement.finest.positions)

    @property
    def faces(self) -> IndexArray:
        """(m, 4) or (m, 3) faces of the finest level; triangles where the mesh is not refined and has others."""
        faces = self.refinement.finest.faces
        return read_only(cage_triangles(self.control)[0] if faces is None else faces)

    def triangles(self, level: int) -> TriangleSurface:
        """The triangles of a level between its vertices' places on the finest surface, at unit area.

        n-gons of the control mesh are fans, quads split by the one rule of `cagemap.subdivision.triangles`.

        Raises
        ------
        ParameterError
            If there is no such level.
        """
        if not 0 <= level <= self.finest:
            raise ParameterError(f"level: expected 0 to {self.finest}, got {level}")
        return self.finest_triangles if level == self.finest else self._coarse_triangles[level]

    @kept
    def finest_triangles(self) -> TriangleSurface:
        """The triangles of the finest level, see `triangles`; asks for no coarse levels."""
        triangles = level_triangles(self.refinement, self.refinement.n_levels)
        return TriangleSurface(self.scale * self.vertices, triangles, self.scale)

    @kept
    def _coarse_triangles(self) -> tuple[TriangleSurface, ...]:
        places, levels = self.finest_triangles.positions, self.hierarchy
        return tuple(
            TriangleSurface(places[levels.on_finest(level)], level_triangles(levels, level), self.scale)
            for level in range(self.finest)
        )

    def with_control(self, control: ControlMesh) -> Surface:
        """The same surface from a control mesh with another layout or other materials."""
        return replace(self, refinement=refine(control, self.refinement.n_levels, self.refinement.scheme))

    def require_operators(self, level: int, method: str) -> None:
        """ParameterError if the operators end below a level whose operators a method needs."""
        if self.operators.finest < level:
            raise ParameterError(
                f"{self.control.name}: the method {method} needs operators up to level {level}, got a basis whose "
                f"operators end at level {self.operators.finest}, {self.config}; prepare the surface with "
                f"cagemap.default_basis({method!r}), more `vertices` or `vertices=None`"
            )

    def __repr__(self) -> str:
        basis = self.basis if self.is_prepared else "not prepared"
        return f"Surface({self.control.name}, levels 0 to {self.refinement.n_levels}, {basis})"
