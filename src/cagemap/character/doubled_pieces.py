"""Pieces of a carried mesh where the target has the same part: as a piece of its own, or in its matched surface."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles, face_areas, keep_faces
from cagemap.mesh.parts import passenger_pieces
from cagemap.mesh.topology import face_components
from cagemap.numerics.arrays import FloatArray, IndexArray, box_diagonal, members_of
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import triangle_areas, triangle_centres

# Two pieces are at one place if at least this share of the area of each piece is close to the other piece.
_MIN_CLOSE_SHARE = 0.75
# Largest distance that is close, divided by the larger diagonal of the bounding boxes of the two pieces. Ears of two
# elephants have 0.21 (docs/lab/characters.md).
_MAX_PIECE_DISTANCE = 0.25
# Least ratio of the two diagonals; ears of two elephants have 0.51. A ball inside a much larger ball is close to it.
_MIN_SIZE_RATIO = 0.4
# A triangle of the target is collapsed if the area of its image, divided by its own area, is less than this.
_MAX_AREA_RATIO = 0.1
# The target's surface has a piece itself if at least this share of the piece's area is close to collapsed triangles.
# Feet have a share of 0.9, clothes of 0 (docs/lab/characters.md).
_MIN_COLLAPSED_SHARE = 0.5
# Largest distance that is close to the surface, divided by the diagonal of the piece's bounding box.
_MAX_SURFACE_DISTANCE = 0.4


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


def pieces_in_surface(carried: ControlMesh, point_map: PointMap) -> list[IndexArray]:
    """Faces of every connected piece of ``carried`` that the target's matched surface has itself.

    The matched source lacks such a part (ears, feet), so the map takes the target's part to almost no area. Pieces
    named as passengers are not among them: shoes, whose feet are deleted.
    """
    target, images = point_map.target, TriangleSurface(point_map.images.positions, point_map.target.triangles)
    is_collapsed = images.areas < _MAX_AREA_RATIO * target.areas
    if not is_collapsed.any():
        return []
    labels, places = face_components(carried), target.scale * carried.positions
    triangles, faces = cage_triangles(carried)
    piece, areas = labels[faces], triangle_areas(places, triangles)
    boxes = target.scale * _boxes(carried, labels)
    reach = _MAX_SURFACE_DISTANCE * np.linalg.norm(boxes[:, 3:] - boxes[:, :3], axis=1)
    nearest, _, distances = closest_points(target.tree, triangle_centres(places, triangles))
    is_inside = is_collapsed[nearest] & (distances <= reach[piece])
    inside, whole = (np.bincount(piece, area, len(boxes)) for area in (areas * is_inside, areas))
    is_found = (
        (inside > 0)
        & (inside >= _MIN_COLLAPSED_SHARE * whole)
        & ~passenger_pieces(carried, labels, face_areas(carried))
    )
    return [faces for number, faces in enumerate(members_of(labels)) if is_found[number]]


def _boxes(mesh: ControlMesh, labels: IndexArray) -> FloatArray:
    """(k, 6) lowest, then highest coordinates of each piece; ``labels`` (m,) are the pieces of faces."""
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
    close = surface.areas[distances <= reach].sum()
    return bool(close > 0 and close >= _MIN_CLOSE_SHARE * surface.areas.sum())
