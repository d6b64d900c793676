"""Results of several parts as one: the parts side by side in one mesh, and one map between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from cagemap.deform.shared_area import SharedArea
from cagemap.errors import ParameterError
from cagemap.maps.hypotheses.confidence import Confidence
from cagemap.maps.hypotheses.signs import JUMPING
from cagemap.maps.landmarks.check import LandmarkCheck
from cagemap.maps.masks import Masks
from cagemap.maps.pair import point_pairs
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import measure_quality, unshared_warnings
from cagemap.maps.result import MatchResult, SpectralMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.curves import Curves
from cagemap.mesh.landmarks import CagePoints, Landmarks
from cagemap.mesh.parts import join_meshes
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.spectral import Surface
from cagemap.subdivision import Loop, refine
from cagemap.subdivision.topology import control_topology
from cagemap.surface.triangle_surface import TriangleSurface

# Verdicts about maps found without landmarks, from the surest on.
_DOUBT = ("sure", "look at it", "two answers")


@dataclass(frozen=True, eq=False)
class _Numbers:
    """Where the elements of one part stand among those of all: its vertices, edges, faces and face corners."""

    vertices: IndexArray
    edges: IndexArray
    faces: IndexArray
    corners: IndexArray


def merge_results(parts: Sequence[MatchResult], provenance: dict[str, Any]) -> MatchResult:
    """One result of several, whose meshes become pieces of one.

    ``parts``: all of one level and scheme a side.
    ``provenance``: entries beside those of the first part.
    """
    first, provenance = parts[0], parts[0].provenance | provenance
    if len(parts) == 1:
        return replace(first, provenance=provenance)
    target, target_numbers = _merge_sides([part.target for part in parts])
    source, source_numbers = _merge_sides([part.source for part in parts])
    mine, theirs = target.finest_triangles, source.finest_triangles
    split = 2 if source.faces.shape[1] == 4 else 1
    triangle, barycentric = np.empty(mine.n, dtype=np.int64), np.empty((mine.n, 3))
    for part, here, there in zip(parts, target_numbers, source_numbers, strict=True):
        faces, halves = np.divmod(part.triangle, split)
        triangle[here.vertices] = split * there.faces[faces] + halves
        barycentric[here.vertices] = part.barycentric
    point_map = PointMap.from_arrays(mine, theirs, triangle, barycentric)
    landmarks, check = _merged_landmarks(parts), _merged_checks(parts)
    trusted = check.trusted(landmarks)
    masks = Masks(
        _merged_mask([part.masks.target for part in parts], target_numbers),
        _merged_mask([part.masks.source for part in parts], source_numbers),
    )
    shared = _merged_shared(parts, (mine, theirs), (target_numbers, source_numbers))
    counted = masks if shared is None else shared.within(masks)
    quality = measure_quality(point_map, point_pairs(target, source, trusted), trusted.names, masks=counted)
    apart = () if shared is None else unshared_warnings(shared.target_share, shared.source_share)
    jumps = [text for part in parts for text in part.quality.warnings if text.startswith(JUMPING)]
    trust = np.empty(mine.n)
    for part, here in zip(parts, target_numbers, strict=True):
        trust[here.vertices] = part.trust
    return MatchResult(
        target,
        source,
        landmarks,
        point_map,
        replace(quality, trust=trust, warnings=(*jumps, *quality.warnings, *apart)),
        first.timings,
        check,
        confidence=_least_confidence(parts),
        masks=masks,
        shared=shared,
        known_spectral=_merged_spectral(parts),
        provenance=provenance,
    )


def _merged_spectral(parts: Sequence[MatchResult]) -> SpectralMap:
    """Functional maps of the parts as blocks of one."""
    return SpectralMap(
        block_diag(*(part.functional_map for part in parts)),
        np.concatenate([part.spectral.target_eigenvalues for part in parts]),
        np.concatenate([part.spectral.source_eigenvalues for part in parts]),
    )


def _merged_mask(masks: Sequence[FloatArray | None], numbers: Sequence[_Numbers]) -> FloatArray | None:
    """Masks of all parts side by side; a part without one counts whole."""
    if all(mask is None for mask in masks):
        return None
    merged = np.ones(sum(len(own.vertices) for own in numbers))
    for mask, own in zip(masks, numbers, strict=True):
        if mask is not None:
            merged[own.vertices] = mask
    return merged


def _merged_shared(
    parts: Sequence[MatchResult],
    surfaces: tuple[TriangleSurface, TriangleSurface],
    numbers: tuple[Sequence[_Numbers], Sequence[_Numbers]],
) -> SharedArea | None:
    """Shared area of all parts; a closed part, which was not asked, counts whole."""
    known = [part.shared for part in parts]
    target = _merged_mask([None if one is None else one.target for one in known], numbers[0])
    source = _merged_mask([None if one is None else one.source for one in known], numbers[1])
    return None if target is None or source is None else SharedArea.of_vertices(surfaces, (target, source))


def _merged_landmarks(parts: Sequence[MatchResult]) -> Landmarks:
    """Landmarks of all parts, on the meshes of all parts."""
    sides = []
    for side in ("target", "source"):
        counts = [getattr(part, side).control.n_vertices for part in parts]
        points = [getattr(part.landmarks, f"{side}_points") for part in parts]
        starts = np.cumsum([0, *counts[:-1]])
        corners = [own.corners + start for own, start in zip(points, starts, strict=True)]
        sides.append(CagePoints(np.concatenate(corners), np.concatenate([own.weights for own in points])))
    names = tuple(name for part in parts for name in part.landmark_names)
    first = parts[0].landmarks
    landmarks = Landmarks.of_points(names, sides[0], sides[1], first.target_name, first.source_name)
    return replace(landmarks, curves=_merged_curves(parts))


def _merged_curves(parts: Sequence[MatchResult]) -> Curves:
    """The curves of all parts, in the numbers of all."""
    every, starts = Curves.none(), [0, 0]
    for part in parts:
        sides = part.curves.target, part.curves.source
        moved = [side.points.corners + start for side, start in zip(sides, starts, strict=True)]
        every = every.joined_with(part.curves.renumbered(*moved))
        starts = [starts[0] + part.target.control.n_vertices, starts[1] + part.source.control.n_vertices]
    return every


def _least_confidence(parts: Sequence[MatchResult]) -> Confidence | None:
    """The confidence of the part that is least sure of its map; None where landmarks decided all of them.

    Where its answers put the vertices of that part is left out.
    """
    known, start = [], 0
    for part in parts:
        if part.confidence is not None:
            deciding = part.confidence.deciding
            known.append(
                replace(
                    part.confidence,
                    deciding=None if deciding is None else deciding + start,
                    part=_title(part.target.control),
                    answers=tuple(replace(one, positions=one.positions[:0]) for one in part.confidence.answers),
                )
            )
        start += part.target.control.n_vertices
    return max(known, key=lambda one: _DOUBT.index(one.verdict), default=None)


def _title(part: ControlMesh) -> str:
    """What a part is called in messages: its object's name, where it has one of its own, and its size."""
    objects = [] if part.face_objects is None else np.unique(part.face_objects).tolist()
    name = f"part '{part.object_names[objects[0]]}'" if len(objects) == 1 and len(part.object_names) > 1 else "the part"
    return f"{name} of {part.n_faces} faces"


def _merged_checks(parts: Sequence[MatchResult]) -> LandmarkCheck:
    """What was found out about landmarks, pairs numbered among those of all parts."""
    suspects, start = [], 0
    for part in parts:
        suspects += [replace(suspect, pair=suspect.pair + start) for suspect in part.suspects]
        start += len(part.landmarks)
    return LandmarkCheck(tuple(suspects), tuple(note for part in parts for note in part.landmark_check.notes))


def _merge_sides(sides: Sequence[Surface]) -> tuple[Surface, list[_Numbers]]:
    refinements = [side.refinement for side in sides]
    level, scheme = refinements[0].n_levels, refinements[0].scheme
    if any((one.n_levels, one.scheme) != (level, scheme) for one in refinements):
        raise ParameterError(
            "parts: expected all to have the same level and scheme, got different ones; match one by one"
        )
    control = replace(join_meshes([side.control for side in sides]), scheme=scheme)
    numbers = part_numbers([side.control for side in sides], level, loop=isinstance(scheme, Loop))
    return Surface(refine(control, level, scheme), sides[0].config), numbers


def part_numbers(controls: Sequence[ControlMesh], level: int, *, loop: bool) -> list[_Numbers]:
    """Numbers of each part's refined elements in the refinement of all parts joined.

    Subdivision numbers what it makes by kind: vertices, then edges, then faces; the halves of edges before those across
    faces. Pieces are therefore mixed, and followed here from level to level.
    """
    tables = [control_topology(control) for control in controls]
    counts = np.array([[t.n_vertices, t.n_edges, t.n_faces, t.n_corners] for t in tables])
    starts = np.cumsum(counts, axis=0) - counts
    parts = [
        _Numbers(*(start + np.arange(count) for start, count in zip(row, own, strict=True)))
        for row, own in zip(starts, counts, strict=True)
    ]
    total = counts.sum(axis=0)
    for _ in range(level):
        parts = [_children(part, total, loop=loop) for part in parts]
        n, e, f, c = total.tolist()
        total = np.array([n + e, 2 * e + c, 4 * f, 12 * f] if loop else [n + e + f, 2 * e + c, c, 4 * c])
    return parts


def _children(part: _Numbers, total: IndexArray, *, loop: bool) -> _Numbers:
    n, e = int(total[0]), int(total[1])
    new_vertices = [part.vertices, n + part.edges, *([] if loop else [n + e + part.faces])]
    halves = (2 * part.edges[:, None] + [0, 1]).ravel()
    faces = (4 * part.faces[:, None] + np.arange(4)).ravel() if loop else part.corners
    size = 3 if loop else 4
    return _Numbers(
        vertices=np.concatenate(new_vertices),
        edges=np.concatenate([halves, 2 * e + part.corners]),
        faces=faces,
        corners=(size * faces[:, None] + np.arange(size)).ravel(),
    )
