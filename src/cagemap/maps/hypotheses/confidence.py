"""How sure an answer with few landmarks or none is: its cost, and by how much the next different one costs more."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cagemap.deform.prepared import PreparedPair
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import flipped_triangles, stretches, weighted_percentiles
from cagemap.numerics.arrays import FloatArray

SURE, LOOK, TWO = "sure", "look at it", "two answers"
# What right answers and wrong ones measure, on pairs whose truth is known and on absurd ones (docs/lab/accuracy.md).
SURE_COST = 5e-4
# Files nearly always agree in their axes: an answer that turns them must fit as bodies of one kind do. A striding body
# lay back to front on a sitting one for 2.9e-4, with no rival.
SURE_TURNED_COST = 1e-4
SURE_GAP = 1.3
TWO_GAP = 1.12
DIFFERENT = "the shapes differ much there"
# Names of answers that landmarks decide.
AS_GIVEN = "as the landmarks are given"
EXCHANGED = "with left and right of the landmarks exchanged"
TURNED = "with a limb turned otherwise about its axis"
# Shapes that truly correspond hardly fold, and most of the surface is not sheared much.
SURE_FOLDED = 0.01
SURE_ASPECT = 1.6
# A landmark leaves no rival, whatever the map is like elsewhere: a fox on a cow, held by its chin, was 5.8 off with a
# median shear of 1.6. A tenth of the area is sheared more than 3.0 to 5.4 times in such maps, 1.3 to 2.6 in most right
# ones; two right maps of crouching bodies, with 3.0 and 3.2, are no longer sure.
SURE_SHEARED = 2.7
# Measured: hind legs that end at the hocks leave 4 % of the source to nothing, right answers up to 1 %.
SURE_UNREACHED = 0.02
# Share of the target's area at which the map jumps across a contact (`Jumps`): 0 in most right maps, 9 to 38 % where
# limbs lie on other limbs; 4 % with one hand on the hip that it touches (docs/lab/accuracy.md).
SURE_JUMPS = 0.02
# How many times better the target may lie on the source's mirror image: at most 1.01 in 24 pairs of bodies and animals
# that are sure; 3.3 and 9 where strides are opposite and legs changed places, 1.26 and more of a foot on the other.
SURE_MIRRORED = 1.2


@dataclass(frozen=True)
class MapShape:
    """How much a map bends its target out of shape, whatever the shapes are.

    Attributes
    ----------
    folded : float
        Share of the target's area that the map turns over.
    aspect : float
        Median ratio of the two stretches of the surface, by area.
    unreached : float
        Share of the source's area that lies far from all that the map leads to: limbs that nothing came to.
    sheared : float
        The ratio of stretches that a tenth of the area exceeds.
    jumps : float
        Share of the target's area at which the map jumps across a contact.
    """

    folded: float = 0.0
    aspect: float = 1.0
    unreached: float = 0.0
    sheared: float = 1.0
    jumps: float = 0.0

    @classmethod
    def of(cls, found: PointMap, unreached: float = 0.0, jumps: float = 0.0) -> MapShape:
        """Measure a map."""
        target, images = found.target, found.images
        folded = target.areas @ flipped_triangles(images, target.triangles) / target.areas.sum()
        largest, smallest = stretches(target.positions, images.positions, target.triangles)
        aspect, sheared = weighted_percentiles(largest / np.maximum(smallest, 1e-9), target.areas, [50.0, 90.0])
        return cls(float(folded), float(aspect), unreached, float(sheared), jumps)

    @property
    def sound(self) -> bool:
        """Whether shapes that truly correspond may be bent so much."""
        bent = self.folded <= SURE_FOLDED and self.aspect <= SURE_ASPECT and self.sheared <= SURE_SHEARED
        return bent and self.unreached <= SURE_UNREACHED and self.jumps <= SURE_JUMPS


def may_be_sure(cost: float, gap: float, shape: MapShape, most: float = SURE_COST, mirrored: float = 1.0) -> bool:
    """Whether an answer of such a cost, so far from the next different one in it, with such a map, is called sure.

    ``mirrored`` is how many times better the target lies on the source's mirror image.
    """
    return cost <= most and shape.sound and gap >= SURE_GAP and mirrored <= SURE_MIRRORED


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
        Of the vertices of the target's fitted level, near the source at unit area; in a result, of all vertices of a
        plain target.
    doubt : float
        See `Start`.
    exchange : tuple of (int, int)
        Places of landmarks whose target points belong to the source points of others, in this reading.
    """

    name: str
    cost: float
    positions: FloatArray
    doubt: float = 1.0
    exchange: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True, eq=False)
class Confidence:
    """What is known of an answer that landmarks alone do not decide.

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
    shape : MapShape
        Of the answer.
    file_vertex : int or None
        Number of `deciding` in the target's file, where the target is a part of it.
    part : str
        Whose answer this is, where a result has several parts.
    mirrored : float
        How many times better the target lies on the source's mirror image; 1 where nobody asked.
    """

    verdict: str
    cost: float
    gap: float
    readings: tuple[Reading, ...]
    deciding: int | None
    shape: MapShape = MapShape()
    file_vertex: int | None = None
    part: str = ""
    mirrored: float = 1.0

    @classmethod
    def of(cls, readings: tuple[Reading, ...], control_vertices: int, shape: MapShape = MapShape()) -> Confidence:
        """Judge answers that are all different, best first."""
        best = readings[0]
        gap = min((other.cost for other in readings[1:]), default=float("inf")) / max(best.cost, 1e-12)
        deciding = None
        if len(readings) > 1:
            apart = (best.positions[:control_vertices] - readings[1].positions[:control_vertices]) ** 2
            deciding = int(np.argmax(apart.sum(axis=1)))
        most = SURE_COST if best.doubt == 1.0 else SURE_TURNED_COST
        if may_be_sure(best.cost, gap, shape, most):
            verdict = SURE
        else:
            verdict = TWO if gap < TWO_GAP else LOOK
        return cls(verdict, 1e4 * best.cost, gap, readings, deciding, shape)

    def seen_mirrored(self, gain: float) -> Confidence:
        """The same, known that the target lies so many times better on the source's mirror image."""
        doubtful = self.verdict == SURE and gain > SURE_MIRRORED
        return replace(self, verdict=LOOK if doubtful else self.verdict, mirrored=gain)

    @property
    def message(self) -> str:
        """One or two sentences for a user, who counts vertices as the file does."""
        return f"{self.part}: {self._sentences}" if self.part else self._sentences

    @property
    def _sentences(self) -> str:
        vertex = self.deciding if self.file_vertex is None else self.file_vertex
        if any(reading.exchange for reading in self.readings):
            return (
                "two answers: the landmarks surround each other in the opposite sense on the two surfaces. The map "
                f"meets them {self.readings[0].name}; {self.readings[1].name} there is another (`answer=1`)"
            )
        if self.readings[0].name == AS_GIVEN:
            return (
                f"look at it: {self.readings[1].name} the landmarks are met nearly as cheaply ({self.gap:.2f} times "
                f"the cost). A landmark at target vertex {vertex} decides; `answer=1` takes the other map"
            )
        answer = f"the target lies on the source {self.readings[0].name}"
        if self.verdict == SURE:
            return f"{answer}; no other way fits nearly as well: sure"
        if self.verdict == TWO:
            return (
                f"two answers: {answer}, but {self.readings[1].name} fits as well (`answer=1`). A landmark at "
                f"target vertex {vertex} decides"
            )
        hint = f", first at target vertex {vertex}" if self.deciding is not None else ""
        missing = self.shape.unreached
        why = f"nothing comes to {100 * missing:.0f} % of the source" if missing > SURE_UNREACHED else DIFFERENT
        if self.shape.jumps > SURE_JUMPS:
            why = f"it jumps across a contact at {100 * self.shape.jumps:.0f} % of the target"
        if self.mirrored > SURE_MIRRORED:
            why = (
                f"it fits the source's mirror image {self.mirrored:.1f} times as well: a left part on a right one, or "
                "poses with left and right exchanged. Mirror one of the files if that is so"
            )
        return f"look at it: {answer}, and {why}. Landmarks make it better{hint}"

    def summary(self) -> dict[str, Any]:
        """Plain values for a manifest."""
        return {
            "verdict": self.verdict,
            "message": self.message,
            "cost": self.cost,
            "gap": self.gap if np.isfinite(self.gap) else None,
            "readings": [
                {
                    "name": reading.name,
                    "cost": 1e4 * reading.cost,
                    "exchange": [list(pair) for pair in reading.exchange],
                }
                for reading in self.readings
            ],
            "deciding": self.deciding,
            "file_vertex": self.file_vertex,
            "part": self.part,
            "folded": self.shape.folded,
            "aspect": self.shape.aspect,
            "unreached": self.shape.unreached,
            "sheared": self.shape.sheared,
            "jumps": self.shape.jumps,
            "mirrored": self.mirrored,
        }


def at_finest(confidence: Confidence, prepared: PreparedPair) -> Confidence:
    """Answers for the level that is deformed, as answers for all vertices of a plain target.

    The vertex that decides gets its number in the target's file too, where the target is a part of it.
    """
    target, numbers = prepared.target, prepared.target.control.file_vertices
    if numbers is not None and confidence.deciding is not None:
        confidence = replace(confidence, file_vertex=int(numbers[confidence.deciding]))
    if not target.refinement.is_plain:
        return confidence

    def prolonged(reading: Reading) -> Reading:
        places = np.array(target.hierarchy.prolong(reading.positions, prepared.levels[0], target.finest))
        places[prepared.vertices] = reading.positions  # prolonged, those that are known would be smoothed
        return replace(reading, positions=places)

    return replace(confidence, readings=tuple(prolonged(reading) for reading in confidence.readings))
