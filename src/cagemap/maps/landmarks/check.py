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

from cagemap.basis import Surface
from cagemap.geometry.triangles import normalized, triangle_normals
from cagemap.maps.elastic.graph import ElasticGraph
from cagemap.maps.elastic.method import RefinedConfig, refined_map
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
from cagemap.maps.projection.project import finest_surface, level_graph
from cagemap.maps.quality import map_positions
from cagemap.maps.spectral.hierarchical import search_levels
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
        return LandmarkCheck(tuple(replace(suspect, pair=place) for suspect, place in found if place is not None))

    def summary(self) -> dict[str, Any]:
        """The check as plain values for a manifest; every suspect with its sentence as ``message``."""
        return {
            "suspects": [asdict(suspect) | {"message": str(suspect)} for suspect in self.suspects],
            "notes": list(self.notes),
        }


def checked_map(
    pair: Pair, names: Sequence[str], config: RefinedConfig, progress: Progress = lambda stage: None
) -> tuple[PointMap, LandmarkCheck]:
    """`refined_map` without the landmark pairs that turn out to be wrong.

    Returns
    -------
    point_map : PointMap
        Of the trusted pairs.
    check : LandmarkCheck
    """
    count = len(names)
    if count < FEWEST_JUDGED:
        note = f"{count} landmark pairs are too few to tell a wrong one; {FEWEST_JUDGED} or more are checked"
        return refined_map(pair, config, progress), LandmarkCheck(notes=(note,))
    progress("landmark distances")
    level = search_levels(pair, config.hierarchy)
    sides = (pair.target, level[0], pair.target_landmarks), (pair.source, level[1], pair.source_landmarks)
    (target_graph, target), (source_graph, source) = in_threads(lambda side: _measured(*side), sides)
    graphs = target_graph, source_graph
    misplaced = misplaced_pairs(target, source)
    notes: tuple[str, ...] = ()
    if len(misplaced) > MOST_SUSPECTS * count or typical_misfit(target, source, np.arange(count)) > UNRELATED:
        misplaced, notes = misplaced[:0], (CONTRADICTION,)

    def solve(left_out: Collection[int]) -> PointMap:
        return refined_map(trusted_pairs(pair, left_out), config, progress)

    evidence = {int(i): DISTANCES for i in misplaced}
    current = solve(evidence)
    confirmed = [i for i in evidence if miss(pair, current, i)[0] < CONFIRMED]
    if confirmed:
        evidence = {i: how for i, how in evidence.items() if i not in confirmed}
        current = solve(evidence)
    for _ in range(MOST_STRAINED):
        progress("landmark strain")
        kept = np.setdiff1d(np.arange(count), list(evidence))
        strained = strained_pair(*strain(trusted_pairs(pair, evidence), graphs[0], current))
        suspect = None if strained is None else int(kept[strained])
        if suspect is None or typical_misfit(target, source, kept[kept != suspect]) > DISSIMILAR:
            break
        trial = solve([*evidence, suspect])
        if miss(pair, trial, suspect)[0] < CONFIRMED:
            break
        evidence[suspect], current = STRAIN, trial
    suspects = tuple(
        LandmarkSuspect(
            names[i], i, *miss(pair, current, i), source_vertex=int(pair.source_landmarks[i]), evidence=evidence[i]
        )
        for i in sorted(evidence)
    )
    return current, LandmarkCheck(suspects, notes + orientation_notes(trusted_pairs(pair, evidence), graphs))


def _measured(surface: Surface, level: int, landmarks: IndexArray) -> tuple[ElasticGraph, LandmarkDistances]:
    """Graph of a level, and the distances of the landmarks on it."""
    graph = level_graph(surface, level)[0]
    return graph, LandmarkDistances.measure(graph, landmarks)


def trusted_pairs(pair: Pair, left_out: Collection[int]) -> Pair:
    """The same two surfaces without some of the landmarks."""
    kept = np.setdiff1d(np.arange(len(pair.target_landmarks)), list(left_out))
    return replace(pair, target_landmarks=pair.target_landmarks[kept], source_landmarks=pair.source_landmarks[kept])


def miss(pair: Pair, point_map: PointMap, landmark: int) -> tuple[float, int]:
    """How far from its source vertex a map puts a landmark, of sqrt(area), and the control vertex nearest to there."""
    row = slice(pair.target_landmarks[landmark], pair.target_landmarks[landmark] + 1)
    on_source, triangles = finest_surface(pair.source)
    place = map_positions(on_source, triangles, point_map.triangle[row], point_map.barycentric[row])
    distances = np.linalg.norm(on_source[: pair.source.control.n_vertices] - place, axis=1)
    return float(distances[pair.source_landmarks[landmark]]), int(np.argmin(distances))


def strain(pair: Pair, graph: ElasticGraph, point_map: PointMap) -> tuple[ReducedEnergy, FloatArray]:
    """Energy of the landmarks' places at a map that holds them, and these places."""
    on_source, triangles = finest_surface(pair.source)
    found = point_map.triangle[: graph.n]
    images = map_positions(on_source, triangles, found, point_map.barycentric[: graph.n])
    normals = normalized(triangle_normals(on_source, triangles[found]))
    return reduced_energy(graph, images, normals, pair.target_landmarks), on_source[pair.source_landmarks]


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
