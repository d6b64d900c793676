"""A surface as matches know it: everything that depends on one control mesh only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cagemap.errors import ParameterError
from cagemap.mesh import ControlMesh
from cagemap.mesh.measures import cage_triangles
from cagemap.numerics.arrays import FloatArray, IndexArray, read_only
from cagemap.numerics.threads import kept, one_blas_thread
from cagemap.operators import Operators, build_operators
from cagemap.operators.coarse_levels import coarsened, uncoarsened
from cagemap.operators.polygons import named_laplacian
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
    """One subdivision surface with what follows from it: its operators, its basis, the triangles of its levels.

    They are made when they are first asked for, and kept: a surface serves every pair that it is part of.
    `cagemap.prepare_surface` makes operators and basis at once; those of a result that was read are made if a new
    match, or the functional map, needs them.

    Attributes
    ----------
    refinement : Refinement
    config : BasisConfig
        Of the basis.
    given : Surface or None
        The plain mesh as it was given, where this surface has coarse levels below one (`inner`).
    """

    refinement: Refinement
    config: BasisConfig = MAP_BASIS
    given: Surface | None = None

    @classmethod
    def of(
        cls, refinement: Refinement, operators: Operators, basis: HierarchicalBasis, config: BasisConfig | None = None
    ) -> Surface:
        """A surface whose operators and basis are there already; of a plain mesh, on the levels below it."""
        config = BasisConfig(schedule=basis.schedule) if config is None else config
        given = None
        if refinement.places is not None:
            given = cls(uncoarsened(refinement), config)
        surface = cls(refinement, config, given)
        vars(surface).update(operators=operators, basis=basis)  # where cached properties look
        if given is None:
            return surface
        vars(given)["inner"] = surface
        return given

    @kept
    def inner(self) -> Surface:
        """The surface that maps are found on: this one, or that of a plain mesh with coarse levels below it.

        Vertices of the finest level then stand in another order, see `cagemap.operators.coarse_levels.coarsened`.
        """
        if self.refinement.is_plain and self.given is None:
            return Surface(coarsened(self.refinement), self.config, self)
        return self

    @property
    def outer(self) -> Surface:
        """Undo `inner`."""
        return self if self.given is None else self.given

    @kept
    def operators(self) -> Operators:
        """Mass and stiffness of every level (paper, section 4.1), up to the one that ``config.vertices`` says."""
        return operators_for(self.refinement, self.config)

    @kept
    def basis(self) -> HierarchicalBasis:
        """The hierarchical basis (paper, section 4)."""
        with one_blas_thread():
            return hierarchical_basis(self.refinement, self.operators, self.config)

    @property
    def is_prepared(self) -> bool:
        """Whether the basis has been made, of a plain mesh that of the levels below it."""
        return "basis" in vars(self.inner if "inner" in vars(self) else self)

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
        """Number of the finest level."""
        return len(self.refinement.levels) - 1

    @property
    def vertices(self) -> FloatArray:
        """(n, 3) vertices of the finest level, in the file's lengths; those of coarser levels come first."""
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
        if not 0 <= level < len(self.refinement.levels):
            raise ParameterError(f"level: expected 0 to {len(self.refinement.levels) - 1}, got {level}")
        return self._levels[level]

    @kept
    def _levels(self) -> tuple[TriangleSurface, ...]:
        places = self.scale * self.vertices
        return tuple(
            TriangleSurface(places[: mesh.n_vertices], level_triangles(self.refinement, level), self.scale)
            for level, mesh in enumerate(self.refinement.levels)
        )

    def with_control(self, control: ControlMesh) -> Surface:
        """The same surface from a control mesh with another layout or other materials."""
        return replace(self, refinement=refine(control, self.finest, self.refinement.scheme))

    def require_operators(self, level: int, method: str) -> None:
        """Refuse a surface whose operators end below a level whose operators a method needs.

        Raises
        ------
        ParameterError
        """
        if self.operators.finest < level:
            raise ParameterError(
                f"{self.control.name}: the method {method} needs operators up to level {level}, got a basis whose "
                f"operators end at level {self.operators.finest}, {self.config}; prepare the surface with "
                f"cagemap.default_basis({method!r}), more `vertices` or `vertices=None`"
            )

    def __repr__(self) -> str:
        basis = self.inner.basis if self.is_prepared else "not prepared"
        return f"Surface({self.control.name}, levels 0 to {self.finest}, {basis})"
