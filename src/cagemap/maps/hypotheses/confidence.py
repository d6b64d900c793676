"""The verdict on a map with few landmarks or none: whether it is sure, and which other alignments there are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cagemap.deform.placement import Placement
from cagemap.deform.problem import PreparedPair
from cagemap.maps.hypotheses.signs import TIE, describe_signs

SURE, LOOK, TWO = "sure", "look at it", "two answers"
# Names of answers that landmarks decide.
AS_GIVEN = "as the landmarks are given"
EXCHANGED = "with left and right of the landmarks exchanged"
TURNED = "with a limb turned otherwise about its axis"
# Of a result that was written before signs were.
NOT_JUDGED = "it was matched by an older version of cagemap: match again"


@dataclass(frozen=True, eq=False)
class Confidence:
    """The verdict on a map that landmarks alone do not decide."""

    verdict: str  #: "sure", "look at it" or "two answers"
    #: The answer, then the different ones, by cost and doubt: of the vertices of the level that is deformed; in a
    #: result, of all vertices of a plain target
    answers: tuple[Placement, ...]
    signs: Mapping[str, float] = field(default_factory=dict)  #: measured values of `SIGNS`
    deciding: int | None = None  #: control vertex of the target where a landmark decides
    file_vertex: int | None = None  #: its number in the target's file, where the target is a part of that
    part: str = ""  #: whose answer this is, where a result has several parts

    @classmethod
    def of(
        cls, answers: tuple[Placement, ...], control_vertices: int, signs: Mapping[str, float] | None = None
    ) -> Confidence:
        """Judge answers that are all different, best first, by the costs and further signs of the best."""
        signs = cost_signs(answers) | dict(signs or {})
        deciding = None
        if len(answers) > 1:
            best, other = (answer.positions[:control_vertices] for answer in answers[:2])
            deciding = int(np.argmax(((best - other) ** 2).sum(axis=1)))
        verdict = SURE if not describe_signs(signs) else TWO if signs["runner_up"] > TIE else LOOK
        return cls(verdict, answers, signs, deciding)

    @property
    def message(self) -> str:
        """One or two sentences for a user, who counts vertices as the file does."""
        return f"{self.part}: {self._sentences}" if self.part else self._sentences

    @property
    def _sentences(self) -> str:
        best, *others = self.answers
        vertex = self.deciding if self.file_vertex is None else self.file_vertex
        if any(answer.exchange for answer in self.answers):
            return (
                "two answers: the landmarks surround each other in the opposite sense on the two surfaces. The map is "
                f"made {best.name}, another one {others[0].name} (`answer=1`)"
            )
        if best.name == AS_GIVEN:
            times = others[0].cost / max(best.cost, 1e-12)
            return (
                f"look at it: a map {others[0].name} fits almost as well, at {times:.2f} times the cost (`answer=1`). "
                f"A landmark at target vertex {vertex} decides"
            )
        answer = f"the target is aligned with the source {best.name}"
        if self.verdict == SURE:
            return f"sure: {answer}; no other alignment fits nearly as well"
        if self.verdict == TWO:
            return (
                f"two answers: {answer}, but the alignment {others[0].name} fits as well (`answer=1`). A landmark at "
                f"target vertex {vertex} decides"
            )
        why = next(iter(describe_signs(self.signs)), NOT_JUDGED)
        hint = f", first at target vertex {vertex}" if self.deciding is not None else ""
        return f"look at it: {answer}, but {why}. Add landmarks{hint}"

    def summary(self) -> dict[str, Any]:
        """Plain values for a manifest."""
        return {
            "verdict": self.verdict,
            "message": self.message,
            "readings": [
                {
                    "name": answer.name,
                    "cost": 1e4 * answer.cost,
                    "exchange": [list(pair) for pair in answer.exchange],
                }
                for answer in self.answers
            ],
            "signs": dict(self.signs),
            "deciding": self.deciding,
            "file_vertex": self.file_vertex,
            "part": self.part,
        }


def cost_signs(answers: tuple[Placement, ...]) -> dict[str, float]:
    """Signs that the costs of the answers are, the first one's."""
    best, *others = answers
    cost = 1e4 * best.cost
    runner_up = max((best.cost / max(other.cost, 1e-12) for other in others), default=0.0)
    return {"cost": cost, "turned": cost if best.doubt > 1.0 else 0.0, "runner_up": runner_up}


def prolong_answers(confidence: Confidence, prepared: PreparedPair) -> Confidence:
    """Answers for all vertices of a plain target, from those of a level; the deciding vertex also as in its file."""
    target, numbers = prepared.target, prepared.target.control.file_vertices
    if numbers is not None and confidence.deciding is not None:
        confidence = replace(confidence, file_vertex=int(numbers[confidence.deciding]))
    if not target.refinement.is_plain:
        return confidence

    def prolonged(answer: Placement) -> Placement:
        places = np.array(target.hierarchy.prolong(answer.positions, prepared.levels[0], target.finest))
        places[prepared.vertices] = answer.positions  # prolonged, those that are known would be smoothed
        return replace(answer, positions=places)

    return replace(confidence, answers=tuple(prolonged(answer) for answer in confidence.answers))
