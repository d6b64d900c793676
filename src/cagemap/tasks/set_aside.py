"""Place unmatched pieces of the target (eyes, teeth, buttons of one mesh) on the source, one by one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cagemap.character.own_parts import nearest_rows
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import face_centres, keep_faces
from cagemap.mesh.topology import vertex_pieces
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.alignment import fit_similarity
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.tasks.bodies import Bodies
from cagemap.transfer.baking import Transfer
from cagemap.transfer.locate import map_surface
from cagemap.transfer.textured_surface import TexturedSurface

# Matched vertices around each vertex of a piece, to whose images the piece is fitted.
_AROUND = 16
# Share of the way from a corner to its face's centre; such points distinguish corners at one place.
_INWARD = 0.1
# Barycentric coordinates below this are set to 0.
_LEAST_WEIGHT = 1e-6


@dataclass(frozen=True, eq=False)
class SetAside:
    """Unmatched vertices, corners and faces of the target, and their nearest ones on the source."""

    # `vertices`, `corners`, `faces`: (k,) of the given target
    vertices: IndexArray
    corners: IndexArray
    faces: IndexArray
    # `source_vertices`, `source_corners`, `source_faces`: (k,) nearest ones of the given source, of any piece
    source_vertices: IndexArray
    source_corners: IndexArray
    source_faces: IndexArray
    places: FloatArray  # (k, 3) vertices placed on the source, in its file's units
    turns: FloatArray  # (k, 3, 3) source offset as a row vector times it is the vertex's offset


def lay_set_aside(bodies: Bodies) -> SetAside:
    """Place every unmatched piece on the source by the similarity transform of the matched surface around it."""
    target, source = (part.mesh for part in bodies.given)
    vertex_of = bodies.ready[0].vertex_of
    vertices = np.flatnonzero(vertex_of < 0)
    if not len(vertices):
        empty = np.zeros(0, dtype=np.int64)
        return SetAside(empty, empty, empty, empty, empty, empty, np.zeros((0, 3)), np.zeros((0, 3, 3)))
    faces = np.flatnonzero(np.maximum.reduceat(vertex_of[target.face_indices], target.face_offsets[:-1]) < 0)
    corners = np.flatnonzero(np.isin(target.corner_faces, faces))
    rest = keep_faces(target, faces)
    pieces = vertex_pieces(rest)[vertices]
    places, turns = _place_pieces(bodies, target.positions[vertices], pieces)
    moved = target.positions.copy()
    moved[vertices] = places
    laid = rest.with_positions(moved)
    source_corners = nearest_rows(_corner_points(source), _corner_points(laid))
    source_vertices = nearest_rows(source.positions, places)
    # The vertex of the nearest corner, not the nearest vertex: layers of cloth have vertices at one place.
    number = np.full(target.n_vertices, -1, dtype=np.int64)
    number[vertices] = np.arange(len(vertices))
    source_vertices[number[rest.face_indices]] = source.face_indices[source_corners]
    source_faces = nearest_rows(face_centres(source), face_centres(laid)) if len(faces) else faces
    return SetAside(vertices, corners, faces, source_vertices, source_corners, source_faces, places, turns)


def piece_transfer(aside: SetAside, target: ControlMesh, source: ControlMesh) -> Transfer:
    """Transfer of the pieces set aside, to closest points of the source's control faces.

    ``aside``: has at least one face.
    """
    rest = keep_faces(target, aside.faces)
    laid = target.positions.copy()
    laid[aside.vertices] = aside.places
    sides = TexturedSurface.of_mesh(rest), TexturedSurface.of_mesh(source)
    surfaces = [TriangleSurface.from_faces(side.positions, side.triangles) for side in sides]
    triangle, weights, _ = closest_points(surfaces[1].tree, surfaces[1].scale * laid)
    weights = np.where(weights < _LEAST_WEIGHT, 0.0, weights)  # keeps vertices on vertices exact
    barycentric = weights / weights.sum(axis=1, keepdims=True)
    point_map = PointMap.from_arrays(surfaces[0], surfaces[1], triangle, barycentric)
    return Transfer(*sides, point_map, map_surface(*sides, point_map))


def _place_pieces(bodies: Bodies, positions: FloatArray, pieces: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Positions (k, 3) on the source of vertices of pieces (k,), and inverse rotations with scale (k, 3, 3)."""
    point_map = bodies.result.point_map
    target, source, images = point_map.target, point_map.source, point_map.images.positions
    points = target.scale * positions
    around = np.asarray(cKDTree(target.positions).query(points, k=min(_AROUND, target.n))[1])
    places, turns = np.empty_like(points), np.empty((len(points), 3, 3))
    order = np.argsort(pieces, kind="stable")
    for piece in np.split(order, np.flatnonzero(np.diff(pieces[order])) + 1):
        near = np.unique(around[piece])
        rotation, scale, shift = fit_similarity(target.positions[near], images[near])
        places[piece] = (scale * points[piece] @ rotation.T + shift) / source.scale
        turns[piece] = rotation * (source.scale / (scale * target.scale))
    return places, turns


def _corner_points(mesh: ControlMesh) -> FloatArray:
    """(c, 3) points inside faces near their corners."""
    if not mesh.n_faces:
        return np.zeros((0, 3))
    corners, centres = mesh.positions[mesh.face_indices], face_centres(mesh)[mesh.corner_faces]
    return np.asarray(corners + _INWARD * (centres - corners))
