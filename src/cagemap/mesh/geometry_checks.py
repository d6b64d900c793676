"""Whether the positions of a control mesh span a surface: size, face areas, inside and outside.

All tolerances are relative to the mesh's own extent D or to a face's own extent d.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.measures import face_areas, face_extents, signed_volume
from cagemap.mesh.mesh_report import Problem, problem_at
from cagemap.mesh.topology import used_vertices
from cagemap.numerics.arrays import IndexArray

# Squares and products of lengths must neither overflow nor vanish in float64 (1e308, 1e-308).
SMALLEST_EXTENT, LARGEST_EXTENT = 1e-60, 1e60
# Third power of rounding away from a line: real cages are above 1e-2.
RELATIVE_WIDTH = 1e-9
# A face of area below 1e-15 D^2 has edges of 3e-8 D, the resolution of float32 positions. The smallest face among the
# real cages tried has 1e-9 D^2.
RELATIVE_FACE_AREA = 1e-15
# A face of area below 1e-9 d^2 is a line to cotangent weights (they would be 1e9). The thinnest seen has 1e-3 d^2.
RELATIVE_FACE_WIDTH = 1e-9
# 36 pi V^2 / A^3 is 1 for a ball and 0.08 to 0.28 for the real cages tried; below this an open surface has no inside.
OPEN_ROUNDNESS = 0.02


def extent_problem(mesh: ControlMesh) -> Problem | None:
    """Refuse a mesh whose vertices are all at one point or on one line, or whose size overflows."""
    points = mesh.positions[used_vertices(mesh)]
    with np.errstate(over="ignore"):
        extent = float(np.max(points.max(axis=0) - points.min(axis=0)))
    if extent == 0.0:
        return Problem(
            "no size",
            "expected vertices in different places, got all in one point",
            (),
            "Export the mesh again; the transform may have a scale of zero.",
        )
    if not SMALLEST_EXTENT <= extent <= LARGEST_EXTENT:
        return Problem(
            "size",
            f"expected an extent between {SMALLEST_EXTENT:g} and {LARGEST_EXTENT:g} file units, got {extent:.3g}",
            (),
            "Scale the mesh.",
        )
    unit = _normalised(mesh).positions[used_vertices(mesh)]
    offsets = unit - unit[0]
    lengths = np.linalg.norm(offsets, axis=1)
    farthest = offsets[np.argmax(lengths)]
    widths = np.linalg.norm(np.cross(offsets, farthest), axis=1) / lengths.max() ** 2
    if widths.max() <= RELATIVE_WIDTH:
        return Problem(
            "no area",
            "expected a surface, got all vertices on one line",
            (),
            "Export the mesh again; the transform may have scales of zero.",
        )
    return None


def zero_area_problem(mesh: ControlMesh, examined: IndexArray) -> Problem | None:
    """Refuse faces whose corners are on one line, or that are points next to the size of the mesh."""
    unit = _normalised(mesh)
    areas, extents = face_areas(unit), face_extents(unit)
    flat = (areas <= RELATIVE_FACE_AREA) | (areas <= RELATIVE_FACE_WIDTH * extents**2)
    faces = examined[flat[examined]]
    return problem_at(
        "faces without area",
        f"expected every face to span an area, got {len(faces)} whose corners are on one line or in one point, faces",
        faces,
        "Move their vertices apart, or dissolve the edges of length zero.",
    )


def inside_out_problem(mesh: ControlMesh, loops: Sequence[IndexArray]) -> Problem | None:
    """Refuse a mesh whose faces look inwards, and a closed one that encloses nothing.

    An open mesh is closed with a cone over every loop first, and judged only where that encloses a good part of what
    a ball of the same area would; a sheet has no inside.
    """
    unit = with_openings_closed(_normalised(mesh), loops)
    volume, area = signed_volume(unit), float(face_areas(unit).sum())
    roundness = 36.0 * np.pi * volume * abs(volume) / area**3
    if not loops and abs(roundness) < RELATIVE_WIDTH:
        return Problem(
            "no volume",
            "expected a closed mesh to enclose a volume, got one that is folded flat",
            (),
            "Export the mesh again; the transform may have a scale of zero. Delete one side of a flat sheet.",
        )
    if roundness < (-OPEN_ROUNDNESS if loops else 0.0):
        opened = ", judged with its openings closed," if loops else ""
        return Problem(
            "inside out",
            f"expected faces counter-clockwise seen from outside, got a mesh{opened} whose faces all look inwards",
            (),
            "Flip all faces (recalculate normals to the outside).",
        )
    return None


def with_openings_closed(mesh: ControlMesh, loops: Sequence[IndexArray]) -> ControlMesh:
    """Close every boundary loop with triangles to its centroid."""
    if not loops:
        return mesh
    centres = np.array([mesh.positions[loop].mean(axis=0) for loop in loops])
    cones = [
        np.column_stack([np.roll(loop, -1), loop, np.full(len(loop), mesh.n_vertices + i)])
        for i, loop in enumerate(loops)
    ]
    caps = np.concatenate(cones)
    return ControlMesh(
        np.concatenate([mesh.positions, centres]),
        np.concatenate([mesh.face_offsets, mesh.face_offsets[-1] + 3 * np.arange(1, len(caps) + 1)]),
        np.concatenate([mesh.face_indices, caps.ravel()]),
    )


def _normalised(mesh: ControlMesh) -> ControlMesh:
    """Move the middle of the bounding box of the faces to the origin and make its longest side 1."""
    points = mesh.positions[used_vertices(mesh)]
    low, high = points.min(axis=0), points.max(axis=0)
    with np.errstate(over="ignore"):  # a loose vertex may lie anywhere
        return mesh.with_positions((mesh.positions - 0.5 * (low + high)) / np.max(high - low))
