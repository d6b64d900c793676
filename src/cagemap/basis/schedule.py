"""How many eigenpairs each level contributes: the paper's fixed counts, or whatever a tolerance asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.basis.constants import FIXED_ACCURACY, GAP_SEARCH, LEAST_REACH, REACH
from cagemap.basis.error_estimate import ErrorEstimate
from cagemap.errors import ParameterError
from cagemap.operators.polygons import named_laplacian


@dataclass(frozen=True)
class BasisConfig:
    """Parameters of a hierarchical basis.

    Attributes
    ----------
    count : int
        Total number of basis functions k.
    tolerance : float
        Error-controlled schedule: largest relative error of every eigenvalue, measured against the finest level. Maps
        are the same at 1 % as at 5 %, and preparing takes twice as long there (docs/accuracy.md).
    schedule : tuple of int, optional
        The paper's fixed schedule: number of pairs k_l that each level adds, level 0 first. Then ``count`` and
        ``tolerance`` are not used.
    literal : bool
        Fixed schedule only. Definition 2 to the letter: the band of a level is the k_l eigenvectors that follow the
        largest eigenvalue so far, whatever the prolonged basis spans already. Since refined eigenvalues are lower, the
        band then starts a few indices higher, and directions between are lost. Default: the band goes on by index, and
        what the prolonged basis spans is left out.
    accuracy : float, optional
        Convergence of the eigensolver at its own level, relative to the eigenvalues of the inverted problem. Default:
        a thousandth of ``tolerance``, and 1e-5 for a fixed schedule. Levels of more than 12 000 vertices may stop once
        their eigenvalues are within a quarter of ``tolerance``, or 1e-4 of a fixed schedule with 1e-5 or more here.
    vertices : int, optional
        Operators are those of the coarsest level with at least so many vertices, as if it were the finest; functions
        of it refine to all levels. The eigenvalues looked for change by well below 1 % at 20 000 vertices. Default: the
        finest level's, as in the paper.
    laplacian : str
        Of the finest level's quads: "mean" of both triangulations, "alexa-wardetzky" (the paper's) or
        "de-goes-butts-desbrun"; see `cagemap.operators.polygons`.
    stabilisation : float
        lambda of the last two.
    """

    count: int = 300
    tolerance: float = 0.05
    schedule: tuple[int, ...] | None = None
    accuracy: float | None = None
    literal: bool = False
    vertices: int | None = None
    laplacian: str = "mean"
    stabilisation: float = 1.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        counts = (self.count, *(() if self.schedule is None else self.schedule))
        if not all(isinstance(count, int | np.integer) for count in counts):
            raise ParameterError(
                f"count and schedule: expected whole numbers, such as 150 or (100, 50, 50), got {self.count!r} and "
                f"{self.schedule!r}"
            )
        if self.schedule is not None:
            object.__setattr__(self, "schedule", tuple(self.schedule))
        if self.count < 1:
            raise ParameterError(f"count: expected at least 1 basis function, got {self.count}")
        if self.vertices is not None and self.vertices < 1:
            raise ParameterError(f"vertices: expected at least 1, got {self.vertices}")
        if not 0.0 < self.tolerance < 1.0:
            raise ParameterError(
                f"tolerance: expected a relative eigenvalue error between 0 and 1, got {self.tolerance}; 0.05 is usual"
            )
        if self.accuracy is not None and not 0.0 < self.accuracy <= 1e-3:
            raise ParameterError(f"accuracy: expected a residual between 0 and 1e-3, got {self.accuracy}")
        if self.schedule is not None and (
            not self.schedule
            or min(self.schedule) < 0
            or self.schedule[0] < 1
            or any(k != int(k) for k in self.schedule)
        ):
            raise ParameterError(
                f"schedule: expected counts per level such as (100, 50, 50), level 0 first, got {self.schedule}"
            )
        named_laplacian(self.laplacian, self.stabilisation)
        if self.literal and self.schedule is None:
            raise ParameterError(
                "literal: expected a fixed schedule with it, as in Definition 2, got none; give schedule"
            )

    @property
    def solver_accuracy(self) -> float:
        """``accuracy`` or its default."""
        if self.accuracy is not None:
            return self.accuracy
        return FIXED_ACCURACY if self.schedule is not None else min(1e-4, 1e-3 * self.tolerance)

    @property
    def total(self) -> int:
        """Number of basis functions asked for."""
        return self.count if self.schedule is None else sum(self.schedule)


# What the elastic method reads of a basis (`StartConfig.searched_functions`), from levels that its fit sees.
MAP_BASIS = BasisConfig(count=150, vertices=20_000)
# What the method hfm reads. Matches of finer levels than that start from the same map; operators of a coarser level, of
# 2946 vertices for 300 functions, made an error of 1.30 one of 2.01 (docs/accuracy.md).
LARGE_MAP_BASIS = BasisConfig(count=300, vertices=20_000)


def certain_count(vertices: int, tolerance: float) -> int:
    """How many eigenpairs of a level meet a tolerance on all surfaces measured."""
    return int(LEAST_REACH * tolerance ** (1.0 / 3.0) * vertices)


def plausible_count(vertices: int, tolerance: float, seen: float) -> int:
    """How many eigenpairs of a level are worth computing there because they may meet a tolerance.

    Parameters
    ----------
    vertices : int
        Of the level.
    tolerance : float
    seen : float
        How many met it at the level below, scaled to this one's size; 0 where there is none.

    Returns
    -------
    int
        At least 1, at most a third of the level.
    """
    cube_root = tolerance ** (1.0 / 3.0)
    count = float(np.clip(2.0 * seen, LEAST_REACH * cube_root * vertices, REACH * cube_root * vertices))
    return max(1, int(min(count, vertices / 3.0)))


def choose_split(estimate: ErrorEstimate, first: int, wanted: int, tolerance: float) -> tuple[int, int]:
    """How many new pairs of a window a level keeps.

    All pairs kept meet the tolerance. Among the last places that allow it, the window is cut where fewest directions
    are mixed across the cut between this level and the next; that is at a wide gap, never inside a cluster.

    Parameters
    ----------
    estimate : ErrorEstimate
        Of the window of pairs.
    first : int
        How many pairs of the window the basis has already.
    wanted : int
        How many are still wanted in all.
    tolerance : float
        Relative.

    Returns
    -------
    good : int
        Number of new pairs that meet the tolerance.
    kept : int
        Number of new pairs to keep, at most ``good``.
    """
    bad = np.flatnonzero(estimate.errors[first:] > tolerance)
    good = int(bad[0]) if len(bad) else len(estimate.errors) - first
    if good == 0 or good >= wanted:
        return good, min(good, wanted)
    places = np.arange(max(1, int((1.0 - GAP_SEARCH) * good)), good + 1)
    return good, int(places[np.argmin(estimate.leaks[first + places])])
