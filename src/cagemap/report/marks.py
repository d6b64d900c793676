"""Numbered marks of doubtful places on the models."""

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
from cagemap.mesh.mesh_report import PLACE, VERTEX
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.report.shown import DisplaySurface
from cagemap.surface.triangles import triangle_areas

TARGET, SOURCE = "target", "source"
# Trust below which a place is marked, and the smallest marked share of the surface's area.
MAX_MARKED_TRUST, MIN_MARKED_AREA = 0.5, 5e-4
# Largest places first.
MAX_MARKS_PER_KIND = 4
DECIDING_TEXT = "a landmark here tells which answer is right"


@dataclass(frozen=True)
class Mark:
    """A place and what is wrong there."""

    number: int  # from 1; landmarks have one number on both models
    side: str  # "target" or "source"
    vertex: int  # of the finest level
    text: str


def find_marks(
    result: MatchResult, target: DisplaySurface, source: DisplaySurface, source_reached: NDArray[np.bool_]
) -> tuple[Mark, ...]:
    """Mark the deciding landmark, outliers, folds, stretches, and unreached parts of a result."""
    marks = list[Mark]()

    def add(text: str, *points: tuple[str, int]) -> None:
        number = 1 + max((mark.number for mark in marks), default=0)
        marks.extend(Mark(number, side, int(vertex), text) for side, vertex in points)

    confidence = result.confidence
    if confidence is not None and confidence.verdict != SURE and confidence.deciding is not None:
        add(DECIDING_TEXT, (TARGET, confidence.deciding))
    pairs = result.landmarks
    for suspect in result.suspects:
        add(
            f"landmark '{suspect.name}' was left out",
            (TARGET, pairs.target_points.heaviest_corners[suspect.pair]),
            (SOURCE, pairs.source_points.heaviest_corners[suspect.pair]),
        )
    counted = result.masks.within(result.shared)
    is_doubtful = (result.trust < MAX_MARKED_TRUST) & (counted.joint(result.point_map) > 0)
    is_folded = np.zeros(len(is_doubtful), dtype=np.bool_)
    triangles = result.point_map.target.triangles
    is_folded[triangles[flipped_triangles(result.point_map.images, triangles)]] = True
    for vertex, share, region in largest_regions(is_doubtful[target.vertices], target):
        folded = is_folded[target.vertices[region]].mean() > 0.5
        add(
            f"{'folded over' if folded else 'stretched strongly'}: {_percent(share)} of the target",
            (TARGET, target.vertices[vertex]),
        )
    is_missed = ~source_reached & (counted.of_source(len(result.source.vertices))[source.vertices] > 0)
    for vertex, share, _ in largest_regions(is_missed, source):
        add(f"nothing from here arrives: {_percent(share)} of the source", (SOURCE, source.vertices[vertex]))
    return tuple(marks)


def largest_regions(selected: NDArray[np.bool_], display: DisplaySurface) -> list[tuple[int, float, IndexArray]]:
    """The largest connected regions of selected vertices (n,): central vertex, share of the area, vertices."""
    triangles = display.triangles
    areas = triangle_areas(display.positions, triangles)
    is_inside = selected[triangles].sum(axis=1) >= 2
    if not is_inside.any():
        return []
    faces = triangles[is_inside]
    n = len(display.positions)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = sparse.coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    label = connected_components(graph, directed=False)[1][faces[:, 0]]
    share = np.bincount(label, weights=areas[is_inside]) / areas.sum()
    regions = []
    for number in np.argsort(-share)[:MAX_MARKS_PER_KIND]:
        if share[number] >= MIN_MARKED_AREA:
            of_region = label == number
            vertex = _central_vertex(display.positions, faces[of_region], areas[is_inside][of_region])
            regions.append((vertex, float(share[number]), np.unique(faces[of_region])))
    return regions


def name_marks(text: str, marks: tuple[Mark, ...]) -> str:
    """A message that names marks instead of coordinates and vertex numbers."""
    deciding = next((mark for mark in marks if mark.text == DECIDING_TEXT), None)
    text = re.sub(PLACE, "", text)
    text = re.sub(rf" away from source {VERTEX}, to near {VERTEX}", " away from its mark", text)
    return re.sub(f"at target {VERTEX}", f"at mark {deciding.number}" if deciding else "there", text)


def _central_vertex(positions: FloatArray, triangles: IndexArray, areas: FloatArray) -> int:
    """The vertex of some triangles nearest to their centre."""
    centre = np.average(positions[triangles].mean(axis=1), axis=0, weights=areas)
    vertices = np.unique(triangles)
    return int(vertices[np.linalg.norm(positions[vertices] - centre, axis=1).argmin()])


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if share >= 0.001 else "under 0.1 %"
