"""Pieces that need not be carried: the target has the part, as a separate piece or in its matched surface.

Used by `cagemap.tasks.carry_character`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from cagemap.character.passenger_pieces import find_pieces
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles, face_areas, keep_faces
from cagemap.mesh.parts import join_meshes, passenger_pieces
from cagemap.mesh.topology import face_components
from cagemap.numerics.arrays import FloatArray, IndexArray, box_diagonal, members_of
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import triangle_areas, triangle_centres

# Least diagonal of a piece, of sqrt(area).
_SMALLEST = 1e-12
# Two pieces are at one place if at least this share of the area of each piece is close to the other piece.
_MIN_CLOSE_SHARE = 0.75
# Largest distance that is close, divided by the larger diagonal of the bounding boxes of the two pieces. Ears of two
# elephants have 0.21 (docs/lab/characters.md).
_MAX_PIECE_DISTANCE = 0.25
# The same of whole parts: ten parts of two MakeHuman bodies have 0.03 at most, tongue and teeth 0.08.
_MAX_PART_DISTANCE = 0.05
# The same of rigid groups, such as eyeballs, of parts that have no others: two balls of one size overlap up to 0.43.
# Eyes that are carried to faces of 741 vertices have up to 0.27.
_MAX_RIGID_DISTANCE = 0.4
# Least ratio of the two diagonals; ears of two elephants have 0.51. Every point of a small ball inside a much larger
# one is close to it, so sizes are compared too.
_MIN_SIZE_RATIO = 0.4
# Largest distance that is close to the surface, divided by the diagonal of the piece's bounding box.
_MAX_SURFACE_DISTANCE = 0.4
# A triangle of the piece is carried to the target, its closest point there is found, and this point is mapped to the
# source. The triangle is away if its distance from the mapped point exceeds its distance from the closest point by this
# much. Distances are divided by the diagonal of the piece's bounding box, on the source and on the target.
_MIN_EXTRA_DISTANCE = 0.1
# The target's surface has a piece itself if at least this share of the piece's area is away. Pieces to leave out (feet,
# legs, hands, heads) have 0.71 or more; pieces to carry have less: trousers over deleted legs 0.59, shoes over deleted
# feet 0.54, other clothes 0 (docs/lab/characters.md).
_MIN_AWAY_SHARE = 0.65


# Numbers of a carried and of an own mesh, and faces of the carried one.
DoubledFaces = tuple[int, int, IndexArray]


def doubled_pieces(carried: Sequence[ControlMesh], own: Sequence[ControlMesh]) -> list[DoubledFaces]:
    """Connected pieces of ``carried`` meshes at the place of pieces of ``own`` meshes."""
    return _at_one_place(
        carried, own, [[*map(face_components, meshes)] for meshes in (carried, own)], _MAX_PIECE_DISTANCE
    )


def doubled_meshes(
    carried: Sequence[ControlMesh], own: Sequence[ControlMesh], surface: TriangleSurface
) -> list[DoubledFaces]:
    """``carried`` meshes at the place of ``own`` meshes, or of rigid groups alone that all are at those of own ones.

    ``surface``: of the target; its unit decides which pieces are rigid, such as eyeballs.
    """
    wholes = [[np.zeros(mesh.n_faces, dtype=np.int64) for mesh in meshes] for meshes in (carried, own)]
    groups = [[_rigid_groups(mesh, surface.scale) for mesh in meshes] for meshes in (carried, own)]
    rigid, own_rigid = ([n for n, labels in enumerate(side) if labels is not None] for side in groups)
    of_groups = _at_one_place(
        [carried[n] for n in rigid],
        [own[n] for n in own_rigid],
        [[labels for labels in side if labels is not None] for side in groups],
        _MAX_RIGID_DISTANCE,
    )
    found = [(rigid[row], own_rigid[number], faces) for row, number, faces in of_groups]
    sizes = np.bincount([row for row, _, _ in found], [len(faces) for _, _, faces in found], len(carried))
    whole = _at_one_place(carried, own, wholes, _MAX_PART_DISTANCE)
    return whole + [one for one in found if sizes[one[0]] == carried[one[0]].n_faces]


def _rigid_groups(mesh: ControlMesh, scale: float) -> IndexArray | None:
    """(f,) rigid group of each face of a mesh, in a unit ``scale`` times its own; None if a face is in none."""
    pieces = find_pieces(cage_triangles(mesh)[0], scale * mesh.positions, np.zeros(mesh.n_vertices), None)
    labels = pieces.group[mesh.face_indices[mesh.face_offsets[:-1]]]
    return labels if pieces.is_rigid[labels].all() else None


def _at_one_place(
    carried: Sequence[ControlMesh],
    own: Sequence[ControlMesh],
    labels_of_faces: Sequence[Sequence[IndexArray]],
    distance: float,
) -> list[DoubledFaces]:
    """Pieces of meshes at one place; those are compared of which each has the other's nearest bounding box.

    ``labels_of_faces``: the piece (f,) of each face, for carried and own meshes.
    ``distance``: the largest that is close, divided by the larger diagonal.
    """
    if not carried or not own:
        return []
    joined, own_joined = join_meshes(carried), join_meshes(own)
    of_mesh, of_own = (np.repeat(np.arange(len(meshes)), [one.n_faces for one in meshes]) for meshes in (carried, own))
    labels, own_labels = (
        np.unique(np.array([of, np.concatenate(labels)]), axis=1, return_inverse=True)[1].ravel()
        for of, labels in zip((of_mesh, of_own), labels_of_faces, strict=True)
    )
    pieces, own_pieces = members_of(labels), members_of(own_labels)
    boxes, own_boxes = _boxes(joined, labels), _boxes(own_joined, own_labels)
    to_own = np.asarray(cKDTree(own_boxes).query(boxes)[1])
    to_carried = np.asarray(cKDTree(boxes).query(own_boxes)[1])
    return [
        (int(of_mesh[faces[0]]), int(of_own[own_faces[0]]), faces - np.searchsorted(of_mesh, of_mesh[faces[0]]))
        for piece, faces in enumerate(pieces)
        for own_faces in [own_pieces[to_own[piece]]]
        if to_carried[to_own[piece]] == piece
        and _are_at_one_place(_surface(joined, faces), _surface(own_joined, own_faces), distance)
    ]


def pieces_in_surface(pieces: ControlMesh, carried: ControlMesh, point_map: PointMap) -> list[IndexArray]:
    """Faces of every connected piece, carried from the source, that the target's matched surface has itself.

    The source has the part (ears, feet) only as a loose piece, so the map takes the target's part to the stump on the
    source's surface, far from the piece. ``carried`` has the faces of ``pieces``, which are at their places on the
    source. Pieces with a passenger's name (shoes) are never among them: the feet under them may have been deleted.
    """
    target, source = point_map.target, point_map.source
    labels, places = face_components(carried), target.scale * carried.positions
    triangles, faces = cage_triangles(carried)
    piece, areas = labels[faces], triangle_areas(places, triangles)
    boxes, source_boxes = target.scale * _boxes(carried, labels), source.scale * _boxes(pieces, labels)
    diagonals, source_diagonals = (
        np.maximum(np.linalg.norm(box[:, 3:] - box[:, :3], axis=1), _SMALLEST)[piece] for box in (boxes, source_boxes)
    )
    nearest, barycentric, distances = closest_points(target.tree, triangle_centres(places, triangles))
    images = np.einsum("mk,mkd->md", barycentric, point_map.images.positions[target.triangles[nearest]])
    to_images = np.linalg.norm(images - triangle_centres(source.scale * pieces.positions, triangles), axis=1)
    close = distances / diagonals
    is_away = (close <= _MAX_SURFACE_DISTANCE) & (to_images / source_diagonals - close >= _MIN_EXTRA_DISTANCE)
    away, whole = (np.bincount(piece, area, len(boxes)) for area in (areas * is_away, areas))
    is_found = (away > 0) & (away >= _MIN_AWAY_SHARE * whole) & ~passenger_pieces(carried, labels, face_areas(carried))
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


def _are_at_one_place(first: TriangleSurface, second: TriangleSurface, distance: float) -> bool:
    small, large = sorted(box_diagonal(side.positions) for side in (first, second))
    reach = distance * large
    return small >= _MIN_SIZE_RATIO * large and _is_close(first, second, reach) and _is_close(second, first, reach)


def _is_close(surface: TriangleSurface, other: TriangleSurface, reach: float) -> bool:
    """Whether most of the area of a surface is within ``reach`` of another surface."""
    distances = closest_points(other.tree, triangle_centres(surface.positions, surface.triangles))[2]
    close = surface.areas[distances <= reach].sum()
    return bool(close > 0 and close >= _MIN_CLOSE_SHARE * surface.areas.sum())
