"""Reject landmark outliers; report landmarks that merely strain the map.

Distances between landmarks find suspects before the map. A suspect is left out only if a coarse fit without it is much
cheaper than one with it, and if the map without it puts it elsewhere. After the map, strain is measured: how far each
landmark would move if released. Strained pairs may be right, so they are kept and reported.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from cagemap.deform.config import LandmarkConfig
from cagemap.deform.fit import coarse_fit, landmark_start
from cagemap.deform.multi_start import FEWEST_LANDMARKS, zoomout_start
from cagemap.deform.placement import Placement
from cagemap.deform.problem import Problem
from cagemap.maps.hypotheses.confidence import AS_GIVEN, TWO, Confidence, cost_signs
from cagemap.maps.hypotheses.search import search_placements
from cagemap.maps.hypotheses.starts import mutually_nearest
from cagemap.maps.landmarks.suspects import (
    OrientedPoints,
    exchanged_sides,
    misplaced_pairs,
    orientation_agreement,
    position_rows,
    released_shifts,
    strain_system,
    strained_pair,
    typical_misfit,
)
from cagemap.maps.pair import Progress
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import landmark_errors
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import face_areas
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.mesh_report import FileVertex
from cagemap.mesh.topology import handle_count, label_cells
from cagemap.numerics.arrays import FloatArray, IndexArray

CONTRADICTION = (
    "the distances between landmarks contradict each other on the two surfaces for so many pairs that all were kept: "
    "the landmark file may belong to other meshes or to the other direction"
)

TOO_FEW = "the landmark pairs are too few to tell a wrong one; by default 6 or more are checked"

MIRRORED = (
    "the landmarks surround each other in the opposite sense on the two surfaces: left and right seem exchanged in all "
    "pairs, or one mesh is mirrored. Exchange them in the landmark file, or mirror one of the meshes"
)
ON_ALL_PAIRS = TOO_FEW, CONTRADICTION, MIRRORED  # no longer true once any pair changes

# Folded share of the target's area that suggests landmarks of other meshes: least and most (beyond, the map is inside
# out). Correct landmarks of 24 pairs of humans and animals fold 0.3 % at most.
FOREIGN_FOLDED = 0.05, 0.5

OFFSETS = (0.0, 0.25, 0.5, 0.75)  # of lattices of cells in which small handles are found: borders cut some

# Why suspected pairs are kept.
NO_BETTER = "the map is hardly better without"
EXTRA_HANDLES = "one surface has handles that the other lacks, as if parts that touch had grown together"

DISTANCES, SIDES = "distances", "sides"
EVIDENCE = {
    DISTANCES: "its distances to the other landmarks do not fit",
    SIDES: "the other landmarks lie around it in the opposite sense, as if two had been exchanged",
}


@dataclass(frozen=True)
class LandmarkSuspect:
    """A pair that was left out of a map."""

    name: str
    pair: int  # its index among the landmarks given
    distance: float  # distance of the map's image from the given source vertex, of sqrt(area)
    nearest_vertex: FileVertex  # source control vertex nearest to the map's image
    source_vertex: FileVertex  # source control vertex that was given
    evidence: str  # "distances": to the other landmarks; "sides": the orientation of the others around it

    def __str__(self) -> str:
        return (
            f"landmark '{self.name}' looks wrong and was left out: {EVIDENCE.get(self.evidence, EVIDENCE[DISTANCES])}, "
            "a map that follows it costs much more, and without it the map leads "
            f"{100 * self.distance:.0f} % of the model's size away from source vertex {self.source_vertex}, to near "
            f"vertex {self.nearest_vertex}. Check this pair, or trust all pairs as they "
            "are (`check_landmarks=False`)"
        )


@dataclass(frozen=True, eq=False)
class LandmarkCheck:
    """Result of the landmark check of a map."""

    suspects: tuple[LandmarkSuspect, ...] = ()  # pairs left out
    notes: tuple[str, ...] = ()  # further messages for a user
    # (p,) shift of each pair if it were released; 0 for pairs that were left out, added or moved; empty if unknown
    strains: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def left_out(self) -> list[int]:
        """Indices of the suspects."""
        return [suspect.pair for suspect in self.suspects]

    def trusted(self, landmarks: Landmarks) -> Landmarks:
        """The landmarks without the suspects."""
        return landmarks.without(self.left_out)

    def for_changed(self, before: Landmarks, now: Landmarks) -> LandmarkCheck:
        """The check for changed landmarks: without notes on changed pairs, and `ON_ALL_PAIRS` if any changed."""
        places = {pair: i for i, pair in enumerate(now.places)}
        placed = [(suspect, places.get(before.places[suspect.pair])) for suspect in self.suspects]
        kept = tuple(replace(suspect, pair=place) for suspect, place in placed if place is not None)
        was, remaining = (set(zip(one.names, one.places, strict=True)) for one in (before, now))
        changed = [f"'{name}'" for name, _ in was - remaining]
        outdated = () if was == remaining else ON_ALL_PAIRS
        notes = tuple(note for note in self.notes if note not in outdated and not any(name in note for name in changed))
        known = dict(zip(before.places, self.strains.tolist(), strict=False))  # no strains: unknown
        return LandmarkCheck(kept, notes, np.array([known.get(pair, 0.0) for pair in now.places if known]))

    def summary(self) -> dict[str, Any]:
        """The check as plain values for a manifest; every suspect with its sentence as ``message``."""
        return {
            "suspects": [asdict(suspect) | {"message": str(suspect)} for suspect in self.suspects],
            "notes": list(self.notes),
            "strains": self.strains.tolist(),
        }


def landmark_outliers(problem: Problem, progress: Progress) -> tuple[dict[int, str], list[str]]:
    """Pairs to leave out with the evidence, if a coarse fit without them is much cheaper; and notes about others."""
    config = problem.prepared.elastic.landmarks
    progress("compare landmarks")
    suspected, notes = suspected_pairs(problem)
    if suspected and has_merged_parts(problem):
        return {}, [kept_note(problem, suspected, EXTRA_HANDLES)]
    if suspected:
        progress("map without doubtful landmarks")
        costs = coarse_map_cost(problem), coarse_map_cost(problem.without(suspected))
        min_cost_ratios = {DISTANCES: config.slip_by_distances, SIDES: config.slip_by_sides}
        if costs[0] < max(min_cost_ratios[evidence] for evidence in suspected.values()) * costs[1]:
            return {}, [kept_note(problem, suspected, NO_BETTER)]
    return suspected, notes


def suspected_pairs(problem: Problem, left_out: Collection[int] = ()) -> tuple[dict[int, str], list[str]]:
    """Suspected pairs with the evidence, ``left_out`` not compared; and a note if too few pairs agree to tell."""
    count, config = len(problem.landmarks), problem.prepared.elastic.landmarks
    if count < config.fewest_judged:
        return {}, [TOO_FEW]
    kept, problem = np.setdiff1d(np.arange(count), list(left_out)), problem.without(left_out)
    all_pairs, distances = np.arange(len(kept)), problem.landmark_distances
    if typical_misfit(*distances, all_pairs, config) > config.max_typical_misfit:
        return {}, [CONTRADICTION]
    misplaced = misplaced_pairs(*distances, config)
    if len(misplaced) > config.max_suspects * len(kept):
        return {}, [CONTRADICTION]
    if len(misplaced):
        return dict.fromkeys(kept[misplaced].tolist(), DISTANCES), []
    exchanged = exchanged_sides(distances, *_oriented_points(problem), config)
    return dict.fromkeys(kept[list(exchanged or ())].tolist(), SIDES), []


def _oriented_points(problem: Problem) -> tuple[OrientedPoints, OrientedPoints]:
    """Positions and normals of the landmarks of target and source."""
    sides = zip(problem.prepared.graphs, problem.landmark_vertices, strict=True)
    target, source = ((graph.positions[landmarks], graph.normals[landmarks]) for graph, landmarks in sides)
    return target, source


def has_merged_parts(problem: Problem) -> bool:
    """Whether large handles differ, as where a scan merges hand and hip, so that geodesic distances are too short."""
    target, source = problem.prepared.target.control, problem.prepared.source.control
    if handle_count(target) == handle_count(source):
        return False
    config = problem.prepared.elastic.landmarks
    return large_handles(target, config) != large_handles(source, config)


def large_handles(mesh: ControlMesh, config: LandmarkConfig) -> int:
    """Number of handles larger than a cell, for the lattice whose cells contain most handles."""
    size = 0.5 * config.min_distance * float(np.sqrt(face_areas(mesh).sum()))
    return handle_count(mesh) - max(handle_count(mesh, label_cells(mesh, size, offset)) for offset in OFFSETS)


def coarse_map_cost(problem: Problem) -> float:
    """Cost of the best coarse fit that meets the landmarks."""
    clusters = problem.coarse_clusters
    return min(coarse_fit(problem, start(problem, clusters)).cost for start in (zoomout_start, landmark_start))


def kept_note(problem: Problem, suspected: dict[int, str], why: str) -> str:
    """Note about suspected pairs that were kept, and why."""
    listed = ", ".join(f"'{problem.landmarks.names[i]}'" for i in sorted(suspected))
    kept = f"{why}, so all were kept"
    if SIDES in suspected.values():
        return (
            f"landmarks {listed} seem to be exchanged on one of the surfaces: the others lie around them in the "
            f"opposite sense. Look at them; {kept}"
        )
    return (
        f"the distances of {listed} to the other landmarks differ between the surfaces more than those of the others; "
        f"{kept}"
    )


def check_on_map(
    problem: Problem, point_map: PointMap, outliers: dict[int, str], notes: Sequence[str]
) -> LandmarkCheck:
    """Check of all landmarks, by a map without the outliers: their distances from it, and the strain of the others."""
    names, config = problem.landmarks.names, problem.prepared.elastic.landmarks
    count = len(names)
    if count < config.fewest_judged:
        return LandmarkCheck(notes=tuple(notes))
    trusted, kept = problem.without(outliers), np.setdiff1d(np.arange(count), list(outliers))
    images, places = point_map.images.at(problem.prepared.vertices), trusted.landmarks.source.positions
    graph, vertices = problem.prepared.energy.graph, trusted.landmark_vertices[0]
    system = strain_system(graph, images.positions, images.normals, vertices, problem.prepared.elastic)
    strains = np.zeros(count)
    strains[kept] = np.linalg.norm(released_shifts(system, places, position_rows(len(kept))), axis=1)
    strained, strain_notes = strained_pair(system, places, strains[kept], config), list[str]()
    if strained is not None:
        typical = typical_misfit(*problem.landmark_distances, np.delete(kept, strained), config)
        if typical <= config.max_strain_misfit:
            strain_notes.append(
                f"landmark '{names[kept[strained]]}' strains the map around it and nowhere else: released, it would "
                f"move by about {100 * strains[kept[strained]]:.0f} % of the model's size. It was kept; if it is a "
                "mistake, correct it"
            )
    suspects = tuple(_suspect(problem, point_map, i, outliers[i]) for i in sorted(outliers))
    return LandmarkCheck(suspects, (*notes, *strain_notes), strains)


def _suspect(problem: Problem, found: PointMap, pair: int, evidence: str) -> LandmarkSuspect:
    """Suspect for a pair that was left out of a map."""
    source, only = problem.prepared.source, problem.landmarks.only([pair])
    places = only.target.interpolate(found.images.positions)[0], only.source.positions[0]
    control = source.finest_triangles.positions[: source.control.n_vertices]
    nearest, given = (int(np.linalg.norm(control - place, axis=1).argmin()) for place in places)
    in_file, distance = source.control.file_vertex, float(landmark_errors(found, only)[0])
    return LandmarkSuspect(only.names[0], pair, distance, in_file(nearest), in_file(given), evidence)


def check_changes(problem: Problem, changed: IndexArray, check: LandmarkCheck, before: PointMap) -> LandmarkCheck:
    """Check pairs ``changed`` (c,) of an update by distances; left out if the map from before contradicts them too."""
    config = problem.prepared.elastic.landmarks
    suspected, notes = suspected_pairs(problem, check.left_out)
    wrong = {i: evidence for i, evidence in suspected.items() if i in changed}
    if wrong and has_merged_parts(problem):
        wrong, notes = {}, [kept_note(problem, wrong, EXTRA_HANDLES)]
    new = (_suspect(problem, before, i, evidence) for i, evidence in wrong.items())
    contradicted = [suspect for suspect in new if suspect.distance >= config.max_confirmed_miss]
    suspects = tuple(sorted((*check.suspects, *contradicted), key=lambda suspect: suspect.pair))
    return replace(check, suspects=suspects, notes=tuple(dict.fromkeys((*check.notes, *notes))))


def check_mirrored(
    problem: Problem, given: Placement, outliers: Collection[int], check: LandmarkCheck, progress: Progress
) -> tuple[Confidence | None, LandmarkCheck]:
    """Two answers if the landmarks are mirrored, as given and exchanged; and the check, with a note about it.

    Landmarks are mirrored if they surround each other in opposite senses on the two surfaces, and cost much more than
    no landmarks. The exchange is that of the best map without landmarks; None if it exchanges too few. Distances and
    strain show none of this.
    """
    landmarks, config = problem.landmarks, problem.prepared.elastic.landmarks
    if len(landmarks) < config.fewest_judged:
        return None, check
    if orientation_agreement(*_oriented_points(problem.without(outliers)), config) > config.mirrored_agreement:
        return None, check
    best = search_placements(problem.without(range(len(landmarks))), progress)[0]
    if given.cost < config.min_mirrored_cost * best.cost:
        return None, check
    check = replace(check, notes=(*check.notes, MIRRORED))
    images = best.map_positions[problem.landmark_vertices[0]]
    exchange, _ = mutually_nearest(images, landmarks.source.positions, config.exchange_distance)
    if len(exchange) < FEWEST_LANDMARKS:
        return None, check
    pairs = tuple(map(tuple, exchange.tolist()))
    exchanged = replace(best.as_answer("with left and right of the landmarks exchanged"), exchange=pairs)
    answers = given.as_answer(AS_GIVEN), exchanged
    return Confidence(TWO, answers, cost_signs(answers)), check


def foreign_warnings(folded: float, count: int, left_out: int) -> tuple[str, ...]:
    """A warning if a map of ``count`` landmarks, without those left out, folds much of the target's area."""
    if not count or not FOREIGN_FOLDED[0] < folded < FOREIGN_FOLDED[1]:
        return ()
    others = f" and {left_out} of {count} landmarks were left out" if left_out else ""
    return (
        f"are these landmarks of these meshes? {100 * folded:.0f} % of the target is folded over{others}. Look at the "
        "landmarks on both meshes, and at which file they belong to",
    )
