"""Parameters of the spectral basis and of the eigensolver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cagemap.errors import ParameterError
from cagemap.numerics.kinds import Config
from cagemap.operators.laplacian import named_laplacian
from cagemap.subdivision import Refinement


@dataclass(frozen=True)
class BasisConfig(Config):
    """Parameters of a spectral basis: ``count`` functions of one level, or bands of several levels."""

    RANGES: ClassVar = {"count": (1, np.inf), "vertices": (1, np.inf)}

    #: number of functions k; the default is reduced on smaller meshes. They are computed at the coarsest level with at
    #: least ``MIN_VERTICES`` and ``VERTICES_PER_FUNCTION * count`` vertices; eigenvalues there are 0.1 to 4 % above the
    #: finest level's.
    count: int = 100
    #: instead of ``count``: number of functions k_l that each level adds, level 0 first (paper, Definition 2)
    schedule: tuple[int, ...] | None = None
    accuracy: float = 1e-5  #: convergence of the eigensolver, relative to the eigenvalues of the inverted problem
    #: only with a schedule. True: a band is the k_l eigenvectors above the largest eigenvalue so far (Definition 2); it
    #: starts a few indices too high, as eigenvalues of finer levels are lower. False: a band continues at the index
    #: after the last band, without the directions that the refined coarser bands span already.
    literal: bool = False
    #: build operators at the coarsest level with at least so many vertices, as if it were the finest. Default: at the
    #: finest level, as in the paper.
    vertices: int | None = None
    #: Laplacian of quads: "mean" of both triangulations, "alexa-wardetzky" (the paper's) or "de-goes-butts-desbrun";
    #: see `cagemap.operators.laplacian`
    laplacian: str = "mean"
    stabilisation: float = 1.0  #: stabilisation weight lambda of the last two Laplacians

    def __post_init__(self) -> None:
        """Check the ranges."""
        super().__post_init__()
        if not 0.0 < self.accuracy <= 1e-3:
            raise ParameterError(f"accuracy: expected a residual between 0 and 1e-3, got {self.accuracy}")
        if self.schedule is not None and not any(self.schedule):
            raise ParameterError(f"schedule: expected counts, such as (100, 50), level 0 first, got {self.schedule}")
        named_laplacian(self.laplacian, self.stabilisation)
        if self.literal and self.schedule is None:
            raise ParameterError("literal: expected a schedule with it (Definition 2), got none; give schedule")

    def bands(self, refinement: Refinement, finest: int) -> tuple[int, ...]:
        """Number of functions that each level adds: the schedule, or all at one level up to ``finest``."""
        if self.schedule is not None:
            return self.schedule
        level = min(refinement.coarsest_level(max(MIN_VERTICES, VERTICES_PER_FUNCTION * self.count)), finest)
        return (*(0,) * level, self.count)


# Least vertices, and least vertices per function, of the level at which a basis is computed. Maps of six human pairs
# are then those of a basis with eigenvalues within 5 % of the finest level's (docs/lab/spectral.md).
MIN_VERTICES = 3000
VERTICES_PER_FUNCTION = 20

# Basis of the default method. Operators of 20 000 vertices and this accuracy change eigenvalues by less than 1 %; more
# functions do not improve maps (docs/lab/spectral.md).
MAP_BASIS = BasisConfig(accuracy=1e-3, vertices=20_000)
# Number of functions of the method "hfm".
HFM_FUNCTIONS = 150
# Functions per level of "paper". With 100 on level 0, as in Table 1, eqs. 14-16 have no effect (docs/paper/blocks.md).
PAPER_SCHEDULE = (50, 100)


@dataclass(frozen=True)
class SolverConfig(Config):
    """Numbers of the eigensolver."""

    dense_rows: int = 800  #: most rows for which a dense solve is faster than Lanczos
    largest_dense_rows: int = 5_000  #: most rows for a dense solve if more than a fifth of the spectrum is wanted
    rank: float = 1e-13  #: relative eigenvalue of a coarse mass matrix below which subdivision maps a direction to zero
    single_accuracy: float = 1e-5  #: from this accuracy on the Krylov space is in single precision, which changes less
    shifts: int = 3  #: number of shifts tried if a factorisation reports no inertia
    extra_pairs: int = 8  #: pairs computed on both sides of a band, to count eigenvalues below a gap among them
    loose: float = 1e-2  #: largest residual of the extra pairs
    well_conditioned: float = 1e-6  #: inverse squared condition of a block above which one Cholesky QR suffices
    dependent: float = 1e-14  #: inverse squared condition of a block below which a direction is lost
    overlap: int = 12  #: pairs computed below the start of a band, to determine which the refined bands span
    cluster: float = 1e-4  #: relative gap below which eigenvalues count as one repeated eigenvalue
    ill_conditioned: float = 100.0  #: condition of the Gram matrix above which functions are nearly dependent
    seed: int = 20190708  #: random seed of the first block


SOLVER = SolverConfig()
