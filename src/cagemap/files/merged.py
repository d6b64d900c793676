"""Results of several parts as one: the parts side by side in one mesh, and one map between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from cagemap.errors import ParameterError
from cagemap.files.result import Result, Side
from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.masks import Masks
from cagemap.maps.pair import PointPairs
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import measure_quality
from cagemap.mesh import ControlMesh
from cagemap.mesh.curves import Curves
from cagemap.mesh.join import join_meshes
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.refinement import Loop, refine, triangles
from cagemap.refinement.topology import control_topology

# Verdicts about maps found without landmarks, from the surest on.
_DOUBT = ("sure", "look at it", "two answers")


@dataclass(frozen=True, eq=False)
class _Numbers:
    """Where the elements of one part stand among those of all: its vertices, edges, faces and face corners."""

    vertices: IndexArray
    edges: IndexArray
    faces: IndexArray
    corners: IndexArray


def merge_results(parts: Sequence[Result], manifest: dict[str, Any]) -> Result:
    """One result of several, whose meshes become pieces of one.

    Parameters
    ----------
    parts : sequence of Result
        All of one level and scheme a side.
    manifest : dict
        Entries of the manifest beside those that follow from the parts.

    Raises
    ------
    ParameterError
        If levels or schemes differ.
    """
    if len(parts) == 1:
        return replace(parts[0], manifest=parts[0].manifest | manifest)
    target, target_numbers = _merge_sides([part.target for part in parts])
    source, source_numbers = _merge_sides([part.source for part in parts])
    source_triangles = triangles(source.faces)
    split = 2 if source.faces.shape[1] == 4 else 1
    triangle = np.empty(len(target.vertices), dtype=np.int64)
    barycentric, trust = np.empty((len(triangle), 3)), np.empty(len(triangle))
    for part, here, there in zip(parts, target_numbers, source_numbers, strict=True):
        faces, halves = np.divmod(part.triangle, split)
        triangle[here.vertices] = split * there.faces[faces] + halves
        barycentric[here.vertices] = part.barycentric
        trust[here.vertices] = part.trust
    names = tuple(name for part in parts for name in part.landmark_names)
    mine, theirs = (TriangleSurface.from_faces(side.vertices, side.faces) for side in (target, source))
    landmarks = PointPairs.of_vertices(mine, theirs, target.landmarks, source.landmarks)
    masks = Masks(target.mask, source.mask)
    quality = measure_quality(PointMap.from_arrays(mine, theirs, triangle, barycentric), landmarks, names, masks=masks)
    return Result(
        target=target,
        source=source,
        source_triangles=source_triangles,
        triangle=triangle,
        barycentric=barycentric,
        functional_map=block_diag(*(part.functional_map for part in parts)),
        trust=trust,
        landmark_errors=np.concatenate([part.landmark_errors for part in parts]),
        landmark_names=names,
        curves=_merged_curves(parts),
        manifest=parts[0].manifest
        | {
            "quality": quality.summary(),
            "landmark_check": _landmark_checks(parts),
            "confidence": _least_confidence(parts),
            "curves": [entry for part in parts for entry in part.manifest.get("curves") or []],
        }
        | manifest,
    )


def _merged_curves(parts: Sequence[Result]) -> Curves:
    """The curves of all parts, in the numbers of all."""
    every, starts = Curves.none(), [0, 0]
    for part in parts:
        sides = part.curves.target, part.curves.source
        moved = [side.points.corners + start for side, start in zip(sides, starts, strict=True)]
        every = every.beside(part.curves.renumbered(*moved))
        starts = [starts[0] + part.target.control.n_vertices, starts[1] + part.source.control.n_vertices]
    return every


def _least_confidence(parts: Sequence[Result]) -> dict[str, Any] | None:
    """The confidence of the part that is least sure of its map; None where landmarks decided all of them."""
    known, start = [], 0
    for part in parts:
        entry = part.manifest.get("confidence")
        if entry is not None:
            deciding = entry.get("deciding")
            known.append({**entry, "deciding": None if deciding is None else int(deciding) + start})
        start += part.target.control.n_vertices
    return max(known, key=lambda entry: _DOUBT.index(entry["verdict"]), default=None)


def _landmark_checks(parts: Sequence[Result]) -> dict[str, Any]:
    """What was found out about landmarks, pairs numbered among those of all parts."""
    suspects, notes, start = [], [], 0
    for part in parts:
        check = part.manifest.get("landmark_check") or {}
        suspects += [{**entry, "pair": int(entry["pair"]) + start} for entry in check.get("suspects", [])]
        notes += check.get("notes", [])
        start += len(part.landmark_names)
    return {"suspects": suspects, "notes": notes}


def _merge_sides(sides: Sequence[Side]) -> tuple[Side, list[_Numbers]]:
    first = sides[0]
    if any((side.level, side.scheme) != (first.level, first.scheme) for side in sides):
        raise ParameterError("parts: expected all to have the same level and scheme, got different ones; match again")
    control = join_meshes([side.control for side in sides])
    finest = refine(control, first.level, first.scheme).finest
    numbers = part_numbers([side.control for side in sides], first.level, loop=isinstance(first.scheme, Loop))
    starts = np.cumsum([0, *(side.control.n_vertices for side in sides)])
    landmarks = [side.landmarks + start for side, start in zip(sides, starts, strict=False)]
    merged = Side(
        control=replace(control, scheme=first.scheme),
        scheme=first.scheme,
        level=first.level,
        vertices=finest.positions,
        faces=np.asarray(finest.faces),
        eigenvalues=np.concatenate([side.eigenvalues for side in sides]),
        landmarks=np.concatenate(landmarks),
        mask=_merge_masks(sides, numbers),
    )
    return merged, numbers


def _merge_masks(sides: Sequence[Side], numbers: Sequence[_Numbers]) -> FloatArray | None:
    """Masks of all parts side by side; a part without one counts whole."""
    if all(side.mask is None for side in sides):
        return None
    mask = np.ones(sum(len(side.vertices) for side in sides))
    for side, own in zip(sides, numbers, strict=True):
        if side.mask is not None:
            mask[own.vertices] = side.mask
    return mask


def part_numbers(controls: Sequence[ControlMesh], level: int, *, loop: bool) -> list[_Numbers]:
    """Numbers of each part's refined elements in the refinement of all parts joined.

    Subdivision numbers what it makes by kind: vertices, then edges, then faces; the halves of edges before those across
    faces. Pieces are therefore mixed, and followed here from level to level.
    """
    tables = [control_topology(control).table for control in controls]
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
