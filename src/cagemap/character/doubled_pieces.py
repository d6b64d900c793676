"""Pieces of a carried mesh where the target has pieces of its own."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles, keep_faces
from cagemap.numerics.arrays import FloatArray, IndexArray, label_components
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.triangles import triangle_areas, triangle_centres

# Pieces are at one place if this share of the area of each is within this distance of the other, of the larger
# diagonal of their bounding boxes: ears of two elephants have 0.21 (docs/lab/characters.md).
_SHARE = 0.75
_MAX_DISTANCE = 0.25
# Least ratio of the diagonals: ears of two elephants have 0.51. The distances do not see a ball in a larger one.
_MIN_SIZE_RATIO = 0.4


def _faces_of_pieces(mesh: ControlMesh) -> list[IndexArray]:
    """Faces of every connected piece."""
    labels = label_components(mesh.face_indices, mesh.face_indices[mesh.next_corners], mesh.n_vertices)
    of_faces = labels[mesh.face_indices[mesh.face_offsets[:-1]]]
    order = np.argsort(of_faces, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(of_faces[order])) + 1)


def doubled_pieces(carried: ControlMesh, own: ControlMesh) -> list[IndexArray]:
    """Faces of every piece of ``carried`` at whose place ``own`` has a piece.

    Each piece of ``own`` stands for at most one piece: the one whose bounding box is nearest to its own.
    """
    pieces = _faces_of_pieces(carried)
    sides = [[_triangles(mesh, faces) for faces in _faces_of_pieces(mesh)] for mesh in (carried, own)]
    boxes = [np.array([_box(corners) for corners in side]) for side in sides]
    to_own = np.asarray(cKDTree(boxes[1]).query(boxes[0])[1])
    to_carried = np.asarray(cKDTree(boxes[0]).query(boxes[1])[1])
    return [
        faces
        for piece, faces in enumerate(pieces)
        if to_carried[to_own[piece]] == piece and _are_at_one_place(sides[0][piece], sides[1][to_own[piece]])
    ]


def _triangles(mesh: ControlMesh, faces: IndexArray) -> FloatArray:
    """(t, 3, 3) corners of the triangles of some faces."""
    return np.asarray(mesh.positions[cage_triangles(keep_faces(mesh, faces))[0]])


def _box(corners: FloatArray) -> FloatArray:
    return np.concatenate([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))])


def _are_at_one_place(first: FloatArray, second: FloatArray) -> bool:
    small, large = sorted(float(np.linalg.norm(np.ptp(one.reshape(-1, 3), axis=0))) for one in (first, second))
    reach = _MAX_DISTANCE * large
    return small >= _MIN_SIZE_RATIO * large and _is_near(first, second, reach) and _is_near(second, first, reach)


def _is_near(corners: FloatArray, others: FloatArray, reach: float) -> bool:
    """Whether most of the area of triangles is within ``reach`` of other ones."""
    points, other_points = corners.reshape(-1, 3), others.reshape(-1, 3)
    triangles, other_triangles = (np.arange(len(one)).reshape(-1, 3) for one in (points, other_points))
    centres, areas = triangle_centres(points, triangles), triangle_areas(points, triangles)
    distances = closest_points(build_tree(other_points, other_triangles), centres)[2]
    return bool(areas[distances <= reach].sum() >= _SHARE * areas.sum())
