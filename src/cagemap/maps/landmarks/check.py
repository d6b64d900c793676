"""A map that does not follow a wrong landmark pair: what is out of proportion or strained is left out, and named.

Before the map, distances between landmarks tell which pair lies on the wrong limb; after it, strain tells which one
holds the map where it does not want to be. The map is then computed without that pair and says itself how far off the
pair is; a pair that it confirms is taken back.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from cagemap.maps.elastic.graph import ElasticGraph
from cagemap.maps.elastic.method import elastic_map
from cagemap.maps.elastic.prepared import PreparedPair
from cagemap.maps.landmarks.distances import (
    FEWEST_JUDGED,
    LandmarkDistances,
    misplaced_pairs,
    orientation_agreement,
    typical_misfit,
)
from cagemap.maps.landmarks.strain import ReducedEnergy, reduced_energy, strained_pair
from cagemap.maps.pair import Pair, Progress
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import landmark_errors
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads

# A pair that the map without it misses by less, of sqrt(area), is taken back.
CONFIRMED = 0.03
# Where distances between landmarks typically differ by more (log ratio), shapes differ so much that strain of one pair
# says nothing.
DISSIMILAR = 0.12
# Below this agreement of orientations the landmarks are mirrored as a whole; correct ones measured from 0.45 on.
MIRRORED = -0.2
# If distances accuse a larger share of the pairs, or typically differ by more, it is not known which are right.
# Shuffled pairs measured 0.36 to 0.53, the least alike animals 0.26.
MOST_SUSPECTS = 1 / 3
UNRELATED = 0.32
CONTRADICTION = (
    "the distances between landmarks contradict each other on the two surfaces for so many pairs that all were kept: "
    "the landmark file may belong to other meshes or to the other direction"
)
# Strain is asked for one pair at a time; each costs another map.
MOST_STRAINED = 2

DISTANCES, STRAIN = "distances", "strain"


@dataclass(frozen=True)
class LandmarkSuspect:
    """A pair that was left out of a map.

    Attributes
    ----------
    name : str
    pair : int
        Its place among the landmarks given.
    distance : float
        How far from the given source vertex the map puts the target vertex, of sqrt(area).
    nearest_vertex : int
        Source control vertex nearest to where the map puts the target vertex.
    source_vertex : int
        Source control vertex that was given.
    evidence : str
        "distances" (to the other landmarks, before the map) or "strain" (of the map that followed it).
    """

    name: str
    pair: int
    distance: float
    nearest_vertex: int
    source_vertex: int
    evidence: str

    def __str__(self) -> str:
        """One sentence for a user: what was found and the remedy."""
        found = (
            "its distances to the other landmarks do not fit"
            if self.evidence == DISTANCES
            else "following it strains the map around it, and only there"
        )
        return (
            f"landmark '{self.name}' looks wrong and was left out: {found}, and without it the map leads "
            f"{100 * self.distance:.0f} % of the model's size away from source vertex {self.source_vertex}, to near "
            f"vertex {self.nearest_vertex}. Check this pair; --trust-landmarks (in Python "
            "MatchConfig(check_landmarks=False)) keeps all pairs as they are"
        )


@dataclass(frozen=True)
class LandmarkCheck:
    """What is known about the landmarks of a map.

    Attributes
    ----------
    suspects : tuple of LandmarkSuspect
        Pairs left out.
    notes : tuple of str
        What else a user should know.
    """

    suspects: tuple[LandmarkSuspect, ...] = ()
    notes: tuple[str, ...] = ()

    def trusted(self, landmarks: Landmarks) -> Landmarks:
        """The landmarks checked, without the suspects."""
        return landmarks.without([suspect.pair for suspect in self.suspects])

    def still(self, before: Landmarks, now: Landmarks) -> LandmarkCheck:
        """What is left of the check of some landmarks for others: suspects that are still there as they were."""
        places = {pair: i for i, pair in enumerate(zip(now.target.tolist(), now.source.tolist(), strict=True))}
        found = [
            (suspect, places.get((int(before.target[suspect.pair]), suspect.source_vertex)))
            for suspect in self.suspects
        ]
        kept = tuple(replace(suspect, pair=place) for suspect, place in found if place is not None)
        return LandmarkCheck(kept, self.notes)

    def summary(self) -> dict[str, Any]:
        """The check as plain values for a manifest; every suspect with its sentence as ``message``."""
        return {
            "suspects": [asdict(suspect) | {"message": str(suspect)} for suspect in self.suspects],
            "notes": list(self.notes),
        }


def checked_map(
    prepared: PreparedPair, pair: Pair, names: Sequence[str], progress: Progress = lambda stage: None
) -> tuple[PointMap, LandmarkCheck]:
    """`elastic_map` without the landmark pairs that turn out to be wrong.

    Returns
    -------
    point_map : PointMap
        Of the trusted pairs.
    check : LandmarkCheck
    """
    count = len(names)
    if count < FEWEST_JUDGED:
        note = f"{count} landmark pairs are too few to tell a wrong one; {FEWEST_JUDGED} or more are checked"
        return elastic_map(prepared, pair, progress), LandmarkCheck(notes=(note,))
    progress("landmark distances")
    target, source = _distances(prepared, pair)
    misplaced = misplaced_pairs(target, source)
    notes: tuple[str, ...] = ()
    if len(misplaced) > MOST_SUSPECTS * count or typical_misfit(target, source, np.arange(count)) > UNRELATED:
        misplaced, notes = misplaced[:0], (CONTRADICTION,)

    def solve(left_out: Collection[int]) -> PointMap:
        return elastic_map(prepared, pair.without(left_out), progress)

    evidence = {int(i): DISTANCES for i in misplaced}
    current = solve(evidence)
    confirmed = [i for i in evidence if miss(pair, current, i)[0] < CONFIRMED]
    if confirmed:
        evidence = {i: how for i, how in evidence.items() if i not in confirmed}
        current = solve(evidence)
    for _ in range(MOST_STRAINED):
        progress("landmark strain")
        kept = np.setdiff1d(np.arange(count), list(evidence))
        strained = strained_pair(*strain(pair.without(evidence), prepared.graphs[0], current))
        suspect = None if strained is None else int(kept[strained])
        if suspect is None or typical_misfit(target, source, kept[kept != suspect]) > DISSIMILAR:
            break
        trial = solve([*evidence, suspect])
        if miss(pair, trial, suspect)[0] < CONFIRMED:
            break
        evidence[suspect], current = STRAIN, trial
    suspects = tuple(_suspect(pair, current, names, i, evidence[i]) for i in sorted(evidence))
    return current, LandmarkCheck(suspects, notes + orientation_notes(pair.without(evidence), prepared.graphs))


def checked_changes(
    prepared: PreparedPair,
    pair: Pair,
    names: Sequence[str],
    changed: IndexArray,
    check: LandmarkCheck,
    before: PointMap,
) -> LandmarkCheck:
    """A check of the landmarks of an update: pairs that are new or moved, by their distances to the others.

    Only those are left out that the map from before puts elsewhere too; `checked_map` asks a map of its own.

    Parameters
    ----------
    prepared : PreparedPair
    pair : Pair
        With all landmarks, as they are now.
    names : sequence of str
    changed : (c,) int64
        Places of the pairs to ask about.
    check : LandmarkCheck
        What still holds of the last one.
    before : PointMap
    """
    if not len(changed) or len(pair.landmarks) < FEWEST_JUDGED:
        return check
    out = [suspect.pair for suspect in check.suspects]
    kept = np.setdiff1d(np.arange(len(pair.landmarks)), out)
    target, source = _distances(prepared, pair.without(out))
    wrong = kept[misplaced_pairs(target, source)]
    if len(wrong) > MOST_SUSPECTS * len(kept) or typical_misfit(target, source, np.arange(len(kept))) > UNRELATED:
        return LandmarkCheck(check.suspects, tuple(dict.fromkeys((*check.notes, CONTRADICTION))))
    found = [i for i in np.intersect1d(wrong, changed).tolist() if miss(pair, before, i)[0] >= CONFIRMED]
    new = tuple(_suspect(pair, before, names, i, DISTANCES) for i in found)
    return LandmarkCheck(tuple(sorted((*check.suspects, *new), key=lambda suspect: suspect.pair)), check.notes)


def _distances(prepared: PreparedPair, pair: Pair) -> tuple[LandmarkDistances, LandmarkDistances]:
    """Distances of the landmarks on both surfaces."""
    sides = list(zip(prepared.graphs, (pair.target_landmarks, pair.source_landmarks), strict=True))
    target, source = in_threads(lambda side: LandmarkDistances.measure(*side), sides)
    return target, source


def _suspect(pair: Pair, found: PointMap, names: Sequence[str], place: int, evidence: str) -> LandmarkSuspect:
    """A pair that a map was made without, and where that map puts it."""
    given = int(pair.source_landmarks[place])
    return LandmarkSuspect(names[place], place, *miss(pair, found, place), source_vertex=given, evidence=evidence)


def miss(pair: Pair, point_map: PointMap, landmark: int) -> tuple[float, int]:
    """How far from its source place a map puts a landmark, of sqrt(area), and the control vertex nearest to there."""
    only = pair.landmarks.only([landmark])
    place = only.target.interpolate(point_map.images.positions)
    control = pair.source.triangles(pair.source.finest).positions[: pair.source.control.n_vertices]
    nearest = int(np.argmin(np.linalg.norm(control - place, axis=1)))
    return float(landmark_errors(point_map, only)[0]), nearest


def strain(pair: Pair, graph: ElasticGraph, point_map: PointMap) -> tuple[ReducedEnergy, FloatArray]:
    """Energy of the landmarks' places at a map that holds them, and these places."""
    found = point_map.images.at(slice(0, graph.n))
    return reduced_energy(graph, found.positions, found.normals, pair.target_landmarks), pair.landmarks.source.positions


def orientation_notes(pair: Pair, graphs: tuple[ElasticGraph, ElasticGraph]) -> tuple[str, ...]:
    """A note if the landmarks as a whole are mirrored, which neither distances nor strain of single ones tell."""
    target, source = (
        (graph.positions[landmarks], graph.normals[landmarks])
        for graph, landmarks in zip(graphs, (pair.target_landmarks, pair.source_landmarks), strict=True)
    )
    if orientation_agreement(target, source) > MIRRORED:
        return ()
    return (
        "the landmarks surround each other in the opposite sense on the two surfaces: left and right seem exchanged in "
        "all pairs, or one mesh is mirrored. Exchange them in the landmark file, or mirror one of the meshes",
    )
