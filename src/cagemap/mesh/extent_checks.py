"""Check extents, areas and volumes of a control mesh, relative to its extent or that of a face."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.faces import face_areas, face_extents, signed_volume, with_openings_closed
from cagemap.mesh.mesh_report import MeshProblem, problem_at
from cagemap.mesh.topology import used_vertices
from cagemap.numerics.arrays import IndexArray

# Squares and products of lengths must neither overflow nor vanish in float64 (1e308, 1e-308).
SMALLEST_EXTENT, LARGEST_EXTENT = 1e-60, 1e60
# Least distance of vertices from a line, as a share of the extent. Real cages are above 1e-2.
RELATIVE_WIDTH = 1e-9
# Least face area as a share of the extent squared: edges of 3e-8, the resolution of float32. Real cages are above 1e-9.
RELATIVE_FACE_AREA = 1e-15
# Least face area as a share of its own extent squared: below it cotangents reach 1e9. Real cages are above 1e-3.
RELATIVE_FACE_WIDTH = 1e-9
# Roundness 36 pi V^2 / A^3: 1 for a ball, 0.08 to 0.28 for real cages; below this an open surface has no inside.
OPEN_ROUNDNESS = 0.02


def extent_problem(mesh: ControlMesh) -> MeshProblem | None:
    """Vertices all at one point or on one line, or a size that overflows."""
    used = used_vertices(mesh)
    with np.errstate(over="ignore"):
        extent = float(np.max(np.ptp(mesh.positions[used], axis=0)))
    if extent == 0.0:
        return MeshProblem(
            "no size",
            "expected vertices in different places, got all in one point",
            "Export the mesh again; the transform may have a scale of zero.",
        )
    if not SMALLEST_EXTENT <= extent <= LARGEST_EXTENT:
        return MeshProblem(
            "size",
            f"expected an extent between {SMALLEST_EXTENT:g} and {LARGEST_EXTENT:g} file units, got {extent:.3g}",
            "Scale the mesh.",
        )
    unit = _unit_sized(mesh).positions[used]
    offsets = unit - unit[0]
    lengths = np.linalg.norm(offsets, axis=1)
    farthest = offsets[np.argmax(lengths)]
    widths = np.linalg.norm(np.cross(offsets, farthest), axis=1) / lengths.max() ** 2
    if widths.max() <= RELATIVE_WIDTH:
        return MeshProblem(
            "no area",
            "expected a surface, got all vertices on one line",
            "Export the mesh again; the transform may have scales of zero.",
        )
    return None


def zero_area_problem(mesh: ControlMesh, examined: IndexArray) -> MeshProblem | None:
    """Examined faces (k,) whose corners are on one line or in one point; None without such faces."""
    unit = _unit_sized(mesh)
    areas, extents = face_areas(unit), face_extents(unit)
    flat = (areas <= RELATIVE_FACE_AREA) | (areas <= RELATIVE_FACE_WIDTH * extents**2)
    faces = examined[flat[examined]]
    return problem_at(
        "faces without area",
        f"expected every face to span an area, got {len(faces)} whose corners are on one line or in one point, faces",
        faces,
        "Move their vertices apart, or dissolve the edges of length zero.",
    )


def inside_out_problem(mesh: ControlMesh, loops: Sequence[IndexArray]) -> MeshProblem | None:
    """Problem of a mesh whose faces look inwards, or of a closed mesh without volume; else None.

    An open mesh is first closed with a cone over every loop. It is a problem only if its roundness exceeds
    `OPEN_ROUNDNESS`; a sheet has no inside.
    """
    unit = with_openings_closed(_unit_sized(mesh), loops)
    volume, area = signed_volume(unit), float(face_areas(unit).sum())
    roundness = 36.0 * np.pi * volume * abs(volume) / area**3
    if not loops and abs(roundness) < RELATIVE_WIDTH:
        return MeshProblem(
            "no volume",
            "expected a closed mesh to enclose a volume, got one that is folded flat",
            "Export the mesh again; the transform may have a scale of zero. Delete one side of a flat sheet.",
        )
    if roundness < (-OPEN_ROUNDNESS if loops else 0.0):
        opened = ", judged with its openings closed," if loops else ""
        return MeshProblem(
            "inside out",
            f"expected faces counter-clockwise seen from outside, got a mesh{opened} whose faces all look inwards",
            "Flip all faces (recalculate normals to the outside).",
        )
    return None


def _unit_sized(mesh: ControlMesh) -> ControlMesh:
    """Centre the bounding box of the faces at the origin and scale its longest side to 1."""
    points = mesh.positions[used_vertices(mesh)]
    low, high = points.min(axis=0), points.max(axis=0)
    with np.errstate(over="ignore"):  # a vertex without faces may be anywhere
        return mesh.with_positions((mesh.positions - 0.5 * (low + high)) / np.max(high - low))
