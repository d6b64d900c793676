"""How many eigenpairs each level contributes: the paper's fixed counts, or whatever a tolerance asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError

FloatArray = NDArray[np.float64]

# Relative eigenvalue error of pair j at a level with n vertices is about (j / (REACH n))^3 on smooth parts; real
# surfaces do worse, so pairs beyond this share of a level need not be computed there at all.
REACH = 0.4
# How far below the last good pair a level may stop in order to end at a wide gap.
_GAP_SEARCH = 0.25


@dataclass(frozen=True)
class BasisConfig:
    """Parameters of a hierarchical basis.

    Attributes
    ----------
    count : int
        Total number of basis functions k.
    tolerance : float
        Error-controlled schedule: largest relative error of every eigenvalue, measured against the finest level.
    schedule : tuple of int, optional
        The paper's fixed schedule: number of pairs k_l that each level adds, level 0 first. Then ``count`` and
        ``tolerance`` are not used.
    accuracy : float
        Convergence of the eigensolver at its own level: residual relative to the eigenvalue.
    """

    count: int = 300
    tolerance: float = 0.01
    schedule: tuple[int, ...] | None = None
    accuracy: float = 1e-6

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.count < 1:
            raise ParameterError(f"count: expected at least 1 basis function, got {self.count}")
        if not 0.0 < self.tolerance < 1.0:
            raise ParameterError(
                f"tolerance: expected a relative eigenvalue error between 0 and 1, got {self.tolerance}; 0.01 is the default"
            )
        if not 0.0 < self.accuracy <= 1e-3:
            raise ParameterError(f"accuracy: expected a residual between 0 and 1e-3, got {self.accuracy}")
        if self.schedule is not None and (
            not self.schedule
            or min(self.schedule) < 0
            or self.schedule[0] < 1
            or any(k != int(k) for k in self.schedule)
        ):
            raise ParameterError(
                f"schedule: expected counts per level such as (100, 50, 50), level 0 first and not empty, got {self.schedule}"
            )

    @property
    def total(self) -> int:
        """Number of basis functions asked for."""
        return self.count if self.schedule is None else sum(self.schedule)


def plausible_count(vertices: int, tolerance: float) -> int:
    """How many eigenpairs of a level could meet a tolerance at best; never more than a third of the level."""
    return max(1, int(vertices * min(1.0 / 3.0, REACH * tolerance ** (1.0 / 3.0))))


def choose_split(values: FloatArray, excess: FloatArray, tolerance: float) -> int:
    """How many leading pairs of a list to keep at their level.

    All pairs kept meet the tolerance. Among the last places that allow it, the list is cut where the gap between
    eigenvalues is widest compared with their error, because pairs closer to each other than their error are mixed
    between levels, and cutting through them would lose a direction.

    Parameters
    ----------
    values : (m,) array
        Ascending eigenvalues.
    excess : (m,) array
        Estimated absolute error of each, not negative.
    tolerance : float
        Relative.

    Returns
    -------
    int
        0 to m.
    """
    scale = np.maximum(values, 1e-3 * values[-1])
    bad = np.flatnonzero(excess > tolerance * scale)
    limit = int(bad[0]) if len(bad) else len(values)
    if limit == 0 or limit == len(values):
        return limit
    places = np.arange(max(1, int((1.0 - _GAP_SEARCH) * limit)), limit + 1)
    gaps = values[places] - values[places - 1]
    errors = np.maximum(excess[places - 1], excess[places])
    return int(places[np.argmax(gaps / np.maximum(errors, 1e-12 * scale[places]))])
