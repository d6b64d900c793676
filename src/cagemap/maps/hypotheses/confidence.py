"""Confidence in a map with few landmarks or none: the verdict, and other possible alignments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from cagemap.deform.placement import Placement
from cagemap.deform.problem import PreparedPair, Problem
from cagemap.deform.shared_area import SharedArea
from cagemap.maps.hypotheses.signs import (
    SIGNS,
    TIE,
    describe_signs,
    jump_lengths,
    jump_share,
    median_distortion,
    mirrored_gain,
)
from cagemap.maps.point_map import PointMap

SURE, LOOK, TWO = "sure", "look at it", "two answers"
# Reason shown for a result file without signs.
NOT_JUDGED = "it was matched by an older version of cagemap: match again"


@dataclass(frozen=True, eq=False)
class Confidence:
    """Verdict on a map that its landmarks alone do not determine."""

    verdict: str  #: "sure", "look at it" or "two answers"
    #: The answer, then different ones, by cost and doubt: placements of the deformed level's vertices; in a result, of
    #: all vertices of a plain target
    answers: tuple[Placement, ...]
    signs: Mapping[str, float] = field(default_factory=dict)  #: measured values of `SIGNS`
    deciding: int | None = None  #: control vertex of the target where a landmark would decide
    file_vertex: int | None = None  #: number of this vertex in the target's file, if the target is a part of it
    part: str = ""  #: name of the part, if a result has several

    @classmethod
    def of(
        cls, answers: tuple[Placement, ...], control_vertices: int, signs: Mapping[str, float] | None = None
    ) -> Confidence:
        """Confidence in the first of distinct answers, best first, by their costs and further signs of the first."""
        signs = cost_signs(answers) | dict(signs or {})
        deciding = None
        if len(answers) > 1:
            best, second = (answer.positions[:control_vertices] for answer in answers[:2])
            deciding = int(np.argmax(((best - second) ** 2).sum(axis=1)))
        verdict = SURE if not describe_signs(signs) else TWO if signs["runner_up"] > TIE else LOOK
        return cls(verdict, answers, signs, deciding)

    @property
    def message(self) -> str:
        """One or two sentences for a user, with vertex numbers of the file."""
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


def answer_confidence(problem: Problem, point_map: PointMap, answers: tuple[Placement, ...]) -> Confidence:
    """Confidence in the map of the first of several answers, from the `SIGNS` of a wrong map."""
    prepared, controls = problem.prepared, problem.prepared.target.control.n_vertices
    shared, counts = SharedArea.of_fit(prepared, answers[0].positions), None
    if shared is not None:  # area without a counterpart tells nothing about the map
        counts = shared.within(prepared.masks).of_target(point_map.target.n)
    farthest = jump_lengths(prepared, point_map, counts)
    signs = {"jumps": jump_share(prepared, farthest), "stretched": median_distortion(point_map, counts)}
    confidence = Confidence.of(answers, controls, signs)
    if confidence.verdict == SURE:  # takes as long as all other signs
        signs["mirrored"] = mirrored_gain(problem, answers[0].positions)
        confidence = Confidence.of(answers, controls, signs)
    if signs["jumps"] > SIGNS["jumps"].bound:  # a landmark at the jump decides, not where answers differ
        places = prepared.mesh.positions
        confidence = replace(confidence, deciding=int(cKDTree(places[:controls]).query(places[farthest.argmax()])[1]))
    if confidence.deciding is not None:
        confidence = replace(confidence, deciding=int(prepared.vertices[confidence.deciding]))
    return confidence


def cost_signs(answers: tuple[Placement, ...]) -> dict[str, float]:
    """Signs derived from the costs of answers, best first."""
    best, *different = answers
    cost = 1e4 * best.cost
    runner_up = max((best.cost / max(other.cost, 1e-12) for other in different), default=0.0)
    return {"cost": cost, "turned": 0.0 if best.keeps_axes else cost, "runner_up": runner_up}


def prolong_answers(confidence: Confidence, prepared: PreparedPair) -> Confidence:
    """Prolong answers to all vertices of a plain target; set the deciding vertex' file number."""
    target, numbers = prepared.target, prepared.target.control.file_vertices
    if numbers is not None and confidence.deciding is not None:
        confidence = replace(confidence, file_vertex=int(numbers[confidence.deciding]))
    if not target.refinement.is_plain:
        return confidence

    def prolonged(answer: Placement) -> Placement:
        places = np.array(target.hierarchy.prolong(answer.positions, prepared.levels[0], target.finest))
        places[prepared.vertices] = answer.positions  # prolongation would smooth the known positions
        return replace(answer, positions=places)

    return replace(confidence, answers=tuple(prolonged(answer) for answer in confidence.answers))
