"""Pieces of a carried mesh where the target has pieces of its own."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles, keep_faces
from cagemap.mesh.topology import face_components
from cagemap.numerics.arrays import FloatArray, IndexArray, box_diagonal, members_of
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import triangle_centres

# Two pieces are at one place if at least this share of the area of each piece is close to the other piece.
_MIN_CLOSE_SHARE = 0.75
# Largest distance that is close, divided by the larger diagonal of the bounding boxes of the two pieces. Ears of two
# elephants have 0.21 (docs/lab/characters.md).
_MAX_PIECE_DISTANCE = 0.25
# Least ratio of the two diagonals; ears of two elephants have 0.51. A ball inside a much larger ball is close to it.
_MIN_SIZE_RATIO = 0.4


def doubled_pieces(carried: ControlMesh, own: ControlMesh) -> list[IndexArray]:
    """Faces of every connected piece of ``carried`` that is at the place of a piece of ``own``.

    Each piece of ``own`` counts for one piece of ``carried`` only: the one with the nearest bounding box.
    """
    labels, own_labels = face_components(carried), face_components(own)
    pieces, own_pieces = members_of(labels), members_of(own_labels)
    boxes, own_boxes = _boxes(carried, labels), _boxes(own, own_labels)
    to_own = np.asarray(cKDTree(own_boxes).query(boxes)[1])
    to_carried = np.asarray(cKDTree(boxes).query(own_boxes)[1])
    return [
        faces
        for piece, faces in enumerate(pieces)
        if to_carried[to_own[piece]] == piece
        and _are_at_one_place(_surface(carried, faces), _surface(own, own_pieces[to_own[piece]]))
    ]


def _boxes(mesh: ControlMesh, labels: IndexArray) -> FloatArray:
    """(k, 6) lowest and highest coordinates of each piece; ``labels`` (m,) are the pieces of faces."""
    corners = mesh.positions[mesh.face_indices]
    boxes = np.full((int(labels.max()) + 1, 6), np.inf)
    np.minimum.at(boxes, labels[mesh.corner_faces], np.column_stack([corners, -corners]))
    return boxes * np.array([1, 1, 1, -1, -1, -1])


def _surface(mesh: ControlMesh, faces: IndexArray) -> TriangleSurface:
    """Triangles of some faces, in the mesh's own unit; every triangle has three vertices of its own."""
    corners = mesh.positions[cage_triangles(keep_faces(mesh, faces))[0]]
    return TriangleSurface(corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3))


def _are_at_one_place(first: TriangleSurface, second: TriangleSurface) -> bool:
    small, large = sorted(box_diagonal(side.positions) for side in (first, second))
    reach = _MAX_PIECE_DISTANCE * large
    return small >= _MIN_SIZE_RATIO * large and _is_close(first, second, reach) and _is_close(second, first, reach)


def _is_close(surface: TriangleSurface, other: TriangleSurface, reach: float) -> bool:
    """Whether most of the area of a surface is within ``reach`` of another surface."""
    distances = closest_points(other.tree, triangle_centres(surface.positions, surface.triangles))[2]
    return bool(surface.areas[distances <= reach].sum() >= _MIN_CLOSE_SHARE * surface.areas.sum())
