"""The class `Surface`: levels, operators, basis and triangles of one control mesh, and its preparation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from cagemap.errors import ParameterError
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import require_valid
from cagemap.mesh.inputs import MeshLike, arrays_accepted
from cagemap.mesh.schemes import Plain
from cagemap.numerics.arrays import FloatArray, IndexArray, read_only, whole_numbers
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import ThreadPool, in_threads, kept, one_blas_thread
from cagemap.operators import Operators, build_operators
from cagemap.operators.coarse_levels import build_coarse_levels
from cagemap.operators.laplacian import named_laplacian
from cagemap.spectral.basis import (
    HFM_FUNCTIONS,
    MAP_BASIS,
    PAPER_SCHEDULE,
    BasisConfig,
    HierarchicalBasis,
    hierarchical_basis,
)
from cagemap.subdivision import Refinement, default_scheme, level_triangles, refine
from cagemap.subdivision.refinement import vertex_counts
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import surface_area, triangle_areas

Progress = Callable[[str], None]
ENOUGH = 0.75  # least share of the requested vertices that a level must have; the next has four times as many
MOST_LEVELS = 12
DEFAULT_VERTICES = 200_000  # default number of vertices of a match, on each side, approximately
METHODS = ("elastic", "hfm", "paper")  # names of the methods that find a map


@dataclass(frozen=True, eq=False, repr=False)
class Surface:
    """One surface: its levels, their operators, its basis and its triangles.

    All are computed when first read, and cached. `cagemap.prepare_surface` computes operators and basis at once.
    """

    refinement: Refinement  #: subdivision levels, or a plain mesh alone; `hierarchy` has its coarse levels too
    config: BasisConfig = MAP_BASIS  #: parameters of the basis

    @classmethod
    def of(
        cls, hierarchy: Refinement, operators: Operators, basis: HierarchicalBasis, config: BasisConfig | None = None
    ) -> Surface:
        """A surface from existing operators and basis on its `hierarchy`."""
        config = BasisConfig(schedule=basis.schedule) if config is None else config
        surface = cls(hierarchy.without_coarse_levels(), config)
        vars(surface).update(hierarchy=hierarchy, operators=operators, basis=basis)  # where cached properties look
        return surface

    @kept
    def hierarchy(self) -> Refinement:
        """All levels, to which level numbers refer: the refinement's, or a plain mesh's coarse levels and itself."""
        return build_coarse_levels(self.refinement) if self.refinement.is_plain else self.refinement

    @kept
    def operators(self) -> Operators:
        """Mass and stiffness of every level up to the one chosen by ``config.vertices`` (paper, 2.2.2)."""
        config, levels = self.config, self.hierarchy
        laplacian = named_laplacian(config.laplacian, config.stabilisation)
        if config.vertices is None:
            return build_operators(levels, laplacian)
        level = levels.coarsest_level(config.vertices)
        if config.schedule is not None:
            level = min(max(level, len(config.schedule) - 1), levels.finest_level)
        return build_operators(levels.up_to(level), laplacian)

    @kept
    def basis(self) -> HierarchicalBasis:
        """The hierarchical basis (paper, section 4)."""
        with one_blas_thread():
            return hierarchical_basis(self.hierarchy, self.operators, self.config)

    def basis_rows(self, vertices: IndexArray | slice, level: int | None = None) -> FloatArray:
        """(q, k) values of the k basis functions at q vertices of a level (None: the finest level)."""
        level = self.finest_level if level is None else level
        fine = max(level, self.basis.last_level)
        return self.basis.rows(fine, self.hierarchy.vertices_on(fine, level)[vertices])

    @property
    def is_prepared(self) -> bool:
        """Whether the basis has been computed."""
        return "basis" in vars(self)

    @kept
    def scale(self) -> float:
        """Factor from the file's lengths to unit area: the operators' own if "mean" and of the finest level."""
        operators: Operators | None = vars(self).get("operators") if self.config.laplacian == "mean" else None
        if operators is not None and operators.finest_level == self.finest_level:
            return operators.scale
        return 1.0 / float(np.sqrt(surface_area(self.vertices, self.faces)))

    @property
    def control(self) -> ControlMesh:
        """The control mesh."""
        return self.refinement.control

    @property
    def finest_level(self) -> int:
        """Number of the finest level of the hierarchy."""
        return self.hierarchy.finest_level

    @property
    def vertices(self) -> FloatArray:
        """(n, 3) vertices of the finest level, in the file's lengths."""
        return read_only(self.refinement.finest.positions)

    @property
    def faces(self) -> IndexArray:
        """(m, 4) or (m, 3) faces of the finest level; mixed faces of an unrefined mesh are triangulated."""
        return read_only(self.refinement.faces(self.refinement.finest_level))

    def triangles(self, level: int) -> TriangleSurface:
        """Triangles of a level, with its vertices at their finest positions, at unit area.

        n-gons of the control mesh are split into fans, quads by `cagemap.subdivision.triangles`. ParameterError if
        there is no such level.
        """
        if not 0 <= level <= self.finest_level:
            raise ParameterError(f"level: expected 0 to {self.finest_level}, got {level}")
        if level == self.finest_level:
            return self.finest_triangles
        known, levels = self._coarse_triangles, self.hierarchy
        if level not in known:
            positions = self.finest_triangles.positions[levels.on_finest(level)]
            known.setdefault(level, TriangleSurface(positions, level_triangles(levels, level), self.scale))
        return known[level]

    @kept
    def finest_triangles(self) -> TriangleSurface:
        """Triangles of the finest level, see `triangles`; does not compute coarse levels."""
        triangles = level_triangles(self.refinement, self.refinement.finest_level)
        return TriangleSurface(self.scale * self.vertices, triangles, self.scale)

    @kept
    def _coarse_triangles(self) -> dict[int, TriangleSurface]:
        """Triangle surfaces of coarse levels by number; `triangles` adds a level when it is first asked for."""
        return {}

    def with_control(self, control: ControlMesh) -> Surface:
        """The same surface from a control mesh with other UVs or materials."""
        return replace(self, refinement=refine(control, self.refinement.finest_level, self.refinement.scheme))

    def require_operators(self, level: int, method: str) -> None:
        """Raise ParameterError unless there are operators up to ``level``."""
        if self.operators.finest_level < level:
            raise ParameterError(
                f"{self.control.name}: the method {method} needs operators up to level {level}, got a basis whose "
                f"operators end at level {self.operators.finest_level}, {self.config}; prepare the surface with "
                f"cagemap.default_basis({method!r}), more `vertices` or `vertices=None`"
            )

    def __repr__(self) -> str:
        basis = self.basis if self.is_prepared else "not prepared"
        return f"Surface({self.control.name}, levels 0 to {self.refinement.finest_level}, {basis})"


def no_progress(stage: str) -> None:
    """Ignore progress reports."""


@arrays_accepted
def choose_level(control: MeshLike, vertices: int) -> int:
    """Coarsest level, at least 1, with at least three quarters of the requested vertices.

    A plain mesh (scheme none) has level 0 only. ParameterError if the number of vertices is out of range.
    """
    if not 1 <= vertices <= 20_000_000:
        raise ParameterError(f"vertices: expected a number from 1 to 20 000 000, got {vertices}")
    if isinstance(default_scheme(control), Plain):
        return 0
    counts = islice(vertex_counts(control), 1, MOST_LEVELS)
    return next((level for level, n in enumerate(counts, 1) if n >= ENOUGH * vertices), MOST_LEVELS)


@kinds_checked
def default_basis(method: str, level: int = len(PAPER_SCHEDULE) - 1) -> BasisConfig:
    """Basis of a method, for "paper" with a schedule up to ``level``; ParameterError for another method."""
    if method not in METHODS:
        raise ParameterError(f"method: expected one of {', '.join(METHODS)}, got '{method}'")
    if method == "paper":
        return BasisConfig(schedule=PAPER_SCHEDULE[: level + 1])
    return replace(MAP_BASIS, count=HFM_FUNCTIONS) if method == "hfm" else MAP_BASIS


@arrays_accepted
def prepare_surface(
    control: MeshLike, level: int, config: BasisConfig = MAP_BASIS, *, progress: Progress = no_progress
) -> Surface:
    """Refine a control mesh and compute its operators and basis (paper, sections 2.2 and 4).

    The subdivision scheme is ``control.scheme``; without one, Loop for triangle meshes and Catmull-Clark for others.
    ``level`` is the finest level, at least 1; 0 for a plain mesh (scheme none), which is not refined. ``progress`` is
    called with the name of each stage. InvalidMeshError, with the offending elements, if the control mesh is not an
    oriented connected manifold; ParameterError if the level or the number of basis functions is out of range.
    """
    require_valid(control)
    return prepare_checked(control, level, config, progress=progress)


def prepare_checked(
    control: ControlMesh, level: int, config: BasisConfig = MAP_BASIS, *, progress: Progress = no_progress
) -> Surface:
    """`prepare_surface` of a control mesh that is known to be valid."""
    scheme = default_scheme(control)
    if isinstance(scheme, Plain) and level:
        raise ParameterError(f"level: expected 0 of a plain mesh (scheme none), got {level}; bilinear refines it")
    if not isinstance(scheme, Plain) and not 1 <= level <= MOST_LEVELS:
        raise ParameterError(
            f"level: expected 1 to {MOST_LEVELS}, got {level}; level 0 is the control mesh, and only a plain mesh "
            "(scheme none) is matched as it is: use `plain_mesh`"
        )
    with one_blas_thread():
        progress(f"refine {control.name}")
        surface = Surface(refine(control, level, scheme), config)
        for part in ("operators", "basis"):
            progress(f"{part} of {control.name}")
            getattr(surface, part)  # computes and caches it
        return surface


@arrays_accepted
def prepare_surfaces(
    target: MeshLike,
    source: MeshLike,
    levels: tuple[int, int],
    config: BasisConfig | tuple[BasisConfig, BasisConfig] = MAP_BASIS,
    *,
    prepare: Callable[..., Surface] = prepare_surface,
    progress: Progress = no_progress,
) -> tuple[Surface, Surface]:
    """Prepare both surfaces at the same time, in two threads; errors as of `prepare_surface`.

    ``levels`` are the finest levels of target and source, ``config`` is for both or a pair. ``prepare`` makes a surface
    from a control mesh, a level and a configuration. ``progress`` is called once, as the stages would mix.
    """
    if not isinstance(levels, Sequence | np.ndarray) or len(levels) != 2:
        raise ParameterError(f"levels: expected two, the target's and the source's, got {levels}")
    configs = config if isinstance(config, tuple) else (config, config)
    numbers = whole_numbers(levels, "levels").tolist()
    progress(f"prepare {target.name} and {source.name}")
    with one_blas_thread(), ThreadPool(1) as pool:  # before the threads start: the setting is global
        pool.submit(triangle_areas, np.eye(3), np.arange(3)[None])  # loads Numba's kernels; refinement needs none
        surfaces = in_threads(lambda side: prepare(*side), list(zip((target, source), numbers, configs, strict=True)))
    return surfaces[0], surfaces[1]
