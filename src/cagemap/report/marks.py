"""Places of a result that need a look, as numbered marks on the models."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from cagemap.maps.hypotheses.confidence import SURE
from cagemap.maps.quality import flipped_triangles
from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.report.shown import ShownSurface
from cagemap.surface.triangles import triangle_areas

TARGET, SOURCE = "target", "source"
# Trust of a place below which it is marked, and share of the surface that a marked place has at least.
DOUBTFUL, MIN_SHARE = 0.5, 5e-4
# Marks of one kind, the largest places first.
MAX_MARKS = 4
DECIDES = "a landmark here tells which answer is right"


@dataclass(frozen=True)
class Mark:
    """A place and what is wrong there.

    Attributes
    ----------
    number : int
        From 1; landmarks have one number on both models.
    side : str
        "target" or "source".
    vertex : int
        Of the finest level.
    text : str
    """

    number: int
    side: str
    vertex: int
    text: str


def find_marks(
    result: MatchResult, target: ShownSurface, source: ShownSurface, source_reached: NDArray[np.bool_]
) -> tuple[Mark, ...]:
    """Marks of a result: what decides, landmarks that were left out, folds, stretches, and what is not reached."""
    marks = list[Mark]()

    def add(text: str, *places: tuple[str, int]) -> None:
        number = 1 + max((mark.number for mark in marks), default=0)
        marks.extend(Mark(number, side, int(vertex), text) for side, vertex in places)

    confidence = result.confidence
    if confidence is not None and confidence.verdict != SURE and confidence.deciding is not None:
        add(DECIDES, (TARGET, confidence.deciding))
    pairs = result.landmarks
    for suspect in result.suspects:
        add(
            f"landmark '{suspect.name}' was left out",
            (TARGET, pairs.target_points.nearest_vertices[suspect.pair]),
            (SOURCE, pairs.source_points.nearest_vertices[suspect.pair]),
        )
    counted = result.masks if result.shared is None else result.shared.within(result.masks)
    low = (result.trust < DOUBTFUL) & (counted.joint(result.point_map) > 0)
    turned = np.zeros(len(low), dtype=np.bool_)
    triangles = result.point_map.target.triangles
    turned[triangles[flipped_triangles(result.point_map.images, triangles)]] = True
    for vertex, share in places(low[target.vertices], target):
        folded = turned[target.vertices[vertex]]
        add(
            f"{'folded over' if folded else 'stretched strongly'}: {_percent(share)} of the target",
            (TARGET, target.vertices[vertex]),
        )
    missed = ~source_reached & (counted.of_source(len(result.source.vertices))[source.vertices] > 0)
    for vertex, share in places(missed, source):
        add(f"nothing from here arrives: {_percent(share)} of the source", (SOURCE, source.vertices[vertex]))
    return tuple(marks)


def places(chosen: NDArray[np.bool_], shown: ShownSurface) -> list[tuple[int, float]]:
    """The largest connected places of chosen vertices (n,): a vertex in the middle of each, its share of the area."""
    triangles = shown.triangles
    areas = triangle_areas(shown.positions, triangles)
    inside = chosen[triangles].sum(axis=1) >= 2
    if not inside.any():
        return []
    faces = triangles[inside]
    n = len(shown.positions)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = sparse.coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    label = connected_components(graph, directed=False)[1][faces[:, 0]]
    share = np.bincount(label, weights=areas[inside]) / areas.sum()
    largest = [piece for piece in np.argsort(-share)[:MAX_MARKS] if share[piece] >= MIN_SHARE]
    return [
        (_middle(shown.positions, faces[label == piece], areas[inside][label == piece]), float(share[piece]))
        for piece in largest
    ]


def with_marks(text: str, marks: tuple[Mark, ...]) -> str:
    """A message with marks in the place of coordinates and numbers of vertices."""
    decides = next((mark for mark in marks if mark.text == DECIDES), None)
    text = re.sub(r", worst at \([^)]*\) of the target's file", "", text)
    text = re.sub(r" away from source vertex \d+, to near vertex \d+", " away from its mark", text)
    return re.sub(r"at target vertex \d+", f"at mark {decides.number}" if decides else "there", text)


def _middle(positions: FloatArray, triangles: IndexArray, areas: FloatArray) -> int:
    """The vertex of some triangles that is nearest to their centre."""
    centre = np.average(positions[triangles].mean(axis=1), axis=0, weights=areas)
    vertices = np.unique(triangles)
    return int(vertices[np.linalg.norm(positions[vertices] - centre, axis=1).argmin()])


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if share >= 0.001 else "under 0.1 %"
