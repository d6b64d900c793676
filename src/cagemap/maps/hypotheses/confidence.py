"""How sure the answer without landmarks is: what it costs, and by how much the next different one costs more."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cagemap.numerics.arrays import FloatArray

SURE, LOOK, TWO = "sure", "look at it", "two answers"
# Costs of right answers and of wrong ones, and their gaps, measured on pairs whose truth is known (docs/accuracy.md).
SURE_COST = 2.5e-3
SURE_GAP = 1.3
TWO_GAP = 1.12


@dataclass(frozen=True, eq=False)
class Reading:
    """One way in which the target lies on the source, fitted.

    Attributes
    ----------
    name : str
        Where it started, in words.
    cost : float
        Mean squared distances between the surfaces both ways, and the elastic energy; of unit areas.
    positions : (n, 3) float64
        Of the vertices of the target's fitted level, near the source at unit area.
    doubt : float
        See `Start`.
    """

    name: str
    cost: float
    positions: FloatArray
    doubt: float = 1.0


@dataclass(frozen=True, eq=False)
class Confidence:
    """What is known of an answer that no landmark decides.

    Attributes
    ----------
    verdict : str
        "sure", "look at it" or "two answers".
    cost : float
        Of the answer, x 1e4.
    gap : float
        Least cost of a different answer, of this one's; infinite if there is none. Below 1 where files' axes decided.
    readings : tuple of Reading
        The answer, then the different ones, by cost and doubt.
    deciding : int or None
        Control vertex of the target where the two best answers differ most: a landmark there decides.
    """

    verdict: str
    cost: float
    gap: float
    readings: tuple[Reading, ...]
    deciding: int | None

    @classmethod
    def of(cls, readings: tuple[Reading, ...], control_vertices: int) -> Confidence:
        """Judge answers that are all different, best first."""
        best = readings[0]
        gap = min((other.cost for other in readings[1:]), default=float("inf")) / max(best.cost, 1e-12)
        deciding = None
        if len(readings) > 1:
            apart = (best.positions[:control_vertices] - readings[1].positions[:control_vertices]) ** 2
            deciding = int(np.argmax(apart.sum(axis=1)))
        if best.cost <= SURE_COST and gap >= SURE_GAP:
            verdict = SURE
        else:
            verdict = TWO if gap < TWO_GAP else LOOK
        return cls(verdict, 1e4 * best.cost, gap, readings, deciding)

    @property
    def message(self) -> str:
        """One or two sentences for a user."""
        answer = f"without landmarks the target lies on the source {self.readings[0].name}"
        if self.verdict == SURE:
            return f"{answer}; no other way fits nearly as well: sure"
        if self.verdict == TWO:
            return (
                f"two answers: {answer}, but {self.readings[1].name} fits as well. A landmark at target vertex "
                f"{self.deciding} decides"
            )
        hint = f", first at target vertex {self.deciding}" if self.deciding is not None else ""
        return f"look at it: {answer}, and the shapes differ much there. Landmarks make it better{hint}"

    def summary(self) -> dict[str, Any]:
        """Plain values for a manifest."""
        return {
            "verdict": self.verdict,
            "message": self.message,
            "cost": self.cost,
            "gap": self.gap if np.isfinite(self.gap) else None,
            "readings": [{"name": reading.name, "cost": 1e4 * reading.cost} for reading in self.readings],
            "deciding": self.deciding,
        }
