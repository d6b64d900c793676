"""Merging of several parts' results: one mesh for each side, with the parts side by side, and one map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from cagemap.errors import ParameterError
from cagemap.maps.hypotheses.confidence import Confidence
from cagemap.maps.landmarks.check import LandmarkCheck
from cagemap.maps.masks import Masks
from cagemap.maps.pair import point_pairs
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import measure_quality
from cagemap.maps.result import MatchResult, SpectralMap, shared_area_warnings
from cagemap.mesh import ControlMesh, Loop, Plain
from cagemap.mesh.faces import faces_of_one_size, split_into_fans
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.parts import join_meshes
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.spectral import Surface
from cagemap.subdivision import refine
from cagemap.subdivision.topology import control_topology

# Verdicts on maps found without landmarks, surest first.
_DOUBT = ("sure", "look at it", "two answers")


@dataclass(frozen=True, eq=False)
class _Numbers:
    """Numbers of a part's vertices, edges, faces and face corners among those of all parts."""

    vertices: IndexArray
    edges: IndexArray
    faces: IndexArray
    corners: IndexArray


def merge_results(parts: Sequence[MatchResult], provenance: dict[str, Any]) -> MatchResult:
    """Merge results of parts: their meshes become pieces of one mesh.

    ``parts``: results with one level and scheme for each side.
    ``provenance``: entries in addition to those of the last part, whose timings and peak memory count all parts.
    """
    last, provenance = parts[-1], parts[-1].provenance | provenance
    if len(parts) == 1:
        return replace(last, provenance=provenance)
    target, target_numbers, notes = _merge_sides([part.target for part in parts])
    source, source_numbers, more_notes = _merge_sides([part.source for part in parts])
    if notes or more_notes:
        provenance["notes"] = [*provenance.get("notes", ()), *notes, *more_notes]
    target_surface, source_surface = target.finest_triangles, source.finest_triangles
    split = 2 if source.faces.shape[1] == 4 else 1  # triangles of a face
    triangle, barycentric = np.empty(target_surface.n, dtype=np.int64), np.empty((target_surface.n, 3))
    trust = np.empty(target_surface.n)
    for part, target_rows, source_rows in zip(parts, target_numbers, source_numbers, strict=True):
        faces, halves = np.divmod(part.triangle, split)
        triangle[target_rows.vertices] = split * source_rows.faces[faces] + halves
        barycentric[target_rows.vertices], trust[target_rows.vertices] = part.barycentric, part.trust
    point_map = PointMap.from_arrays(target_surface, source_surface, triangle, barycentric)
    landmarks, check = _merged_landmarks(parts), _merged_checks(parts)
    masks = _merged_masks([part.masks for part in parts], (target_numbers, source_numbers))
    area = _merged_masks([part.shared for part in parts], (target_numbers, source_numbers))
    shared = area if area.any else None
    trusted = point_pairs(target, source, check.trusted(landmarks))
    quality = measure_quality(point_map, trusted, masks=masks.within(shared))
    apart = shared_area_warnings(shared, masks, point_map)
    kept = [text for part in parts for text in part.quality.match_warnings]
    return MatchResult(
        target,
        source,
        landmarks,
        point_map,
        replace(quality, trust=trust, warnings=(*kept, *quality.warnings, *apart), match_warnings=tuple(kept)),
        last.timings,
        check,
        confidence=_least_confidence(parts),
        masks=masks,
        shared=shared,
        known_spectral=SpectralMap(
            block_diag(*(part.functional_map for part in parts)),
            np.concatenate([part.spectral.target_eigenvalues for part in parts]),
            np.concatenate([part.spectral.source_eigenvalues for part in parts]),
        ),
        provenance=provenance,
    )


def _merged_masks(parts: Sequence[Masks | None], numbers: tuple[Sequence[_Numbers], Sequence[_Numbers]]) -> Masks:
    """Masks of all parts: 1 on a part without a mask, and no mask of a side where no part has one."""
    merged: list[FloatArray | None] = []
    for side, rows_of_parts in zip(("target", "source"), numbers, strict=True):
        values = np.ones(sum(len(rows.vertices) for rows in rows_of_parts))
        masks = [None if part is None else getattr(part, side) for part in parts]
        for mask, rows in zip(masks, rows_of_parts, strict=True):
            values[rows.vertices] = 1.0 if mask is None else mask
        merged.append(None if all(mask is None for mask in masks) else values)
    return Masks(*merged)


def _merged_landmarks(parts: Sequence[MatchResult]) -> Landmarks:
    """Landmarks and curves of all parts, numbered on the merged meshes."""
    merged, starts = Landmarks.none(), [0, 0]
    for part in parts:
        own = part.landmarks.renumbered(*(partial(np.add, start) for start in starts))
        merged = own if part is parts[0] else merged.joined_with(own)
        starts = [starts[0] + part.target.control.n_vertices, starts[1] + part.source.control.n_vertices]
    return merged


def _least_confidence(parts: Sequence[MatchResult]) -> Confidence | None:
    """The confidence of the least sure part, without positions; None if landmarks decided all maps."""
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
    """Name of a part in messages: that of its object, if it has one of its own, and its size."""
    objects = [] if part.face_objects is None else np.unique(part.face_objects).tolist()
    name = f"part '{part.object_names[objects[0]]}'" if len(objects) == 1 and len(part.object_names) > 1 else "the part"
    return f"{name} of {part.n_faces} faces"


def _merged_checks(parts: Sequence[MatchResult]) -> LandmarkCheck:
    """Landmark checks of all parts, with pairs numbered among those of all parts."""
    suspects, start = [], 0
    for part in parts:
        suspects += [replace(suspect, pair=suspect.pair + start) for suspect in part.suspects]
        start += len(part.landmarks)
    return LandmarkCheck(tuple(suspects), tuple(note for part in parts for note in part.landmark_check.notes))


def _merge_sides(sides: Sequence[Surface]) -> tuple[Surface, list[_Numbers], list[str]]:
    """The parts of one side as one surface, their numbers on it, and notes."""
    refinements = [side.refinement for side in sides]
    level, scheme = refinements[0].finest_level, refinements[0].scheme
    if any((refinement.finest_level, refinement.scheme) != (level, scheme) for refinement in refinements):
        raise ParameterError(
            "parts: expected all to have the same level and scheme, got different ones; match one by one"
        )
    controls = [side.control for side in sides]
    control, notes = replace(join_meshes(controls), scheme=scheme), list[str]()
    if isinstance(scheme, Plain) and faces_of_one_size(control) is None:
        control, controls = split_into_fans(control), [split_into_fans(part) for part in controls]
        notes.append(f"{control.name}: faces of different sizes are split into triangles")
    numbers = part_numbers(controls, level, loop=isinstance(scheme, Loop))
    return Surface(refine(control, level, scheme), sides[0].config), numbers, notes


def part_numbers(controls: Sequence[ControlMesh], level: int, *, loop: bool) -> list[_Numbers]:
    """Numbers of each part's refined elements in the refinement of all parts joined.

    Subdivision numbers vertices by origin: those from vertices, edges, faces; and edges: halves of edges, then those
    across faces. So the parts' numbers are mixed, and are computed level by level.
    """
    tables = [control_topology(control) for control in controls]
    counts = np.array([[t.n_vertices, t.n_edges, t.n_faces, t.n_corners] for t in tables])
    starts = np.cumsum(counts, axis=0) - counts
    parts = [
        _Numbers(*(start + np.arange(count) for start, count in zip(row, part_counts, strict=True)))
        for row, part_counts in zip(starts, counts, strict=True)
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
