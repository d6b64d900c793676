"""Weights of what a body has of its own, such as eyes: pieces that keep their shape move as a whole."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.character.body_frames import SignedDistances
from cagemap.character.passenger_pieces import find_pieces
from cagemap.character.passengers import carry_passengers
from cagemap.character.values import Part
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.parts import passenger_word
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.transfer.skin import normalise_rows, prune_rows


def own_parts_with_weights(
    own: Sequence[Part], body: Part, declined: Sequence[Part], point_map: PointMap, influences: int | None
) -> list[Part]:
    """Parts of the target with weights of the body's nearest vertices.

    A rigid piece, such as an eyeball, has one weight for each joint: of the rigid pieces of ``declined`` parts with the
    same passenger word, or the mean of the body's.

    ``body``: the target's, with weights.
    ``declined``: parts of the source that are not carried.
    """
    words = {passenger_word(part.name) for part in own} - {""}
    like = [part for part in declined if part.weights is not None and passenger_word(part.name) in words]
    places = [one.positions for one in carry_passengers(point_map, [part.mesh for part in like])]
    carried = [_rigid_vertices(part, point_map.source, at) for part, at in zip(like, places, strict=True)]
    return [_with_weights(part, body, carried, point_map.target, influences) for part in own]


# Name of a part, (k, 3) places on the target of vertices of its rigid pieces, and their weights (k, j).
_RigidVertices = tuple[str, FloatArray, sparse.csr_array]


def _rigid_vertices(part: Part, surface: TriangleSurface, places: FloatArray) -> _RigidVertices:
    assert part.weights is not None
    rows = np.concatenate([np.zeros(0, dtype=np.int64), *_rigid_groups(part.mesh, surface)])
    return part.name, places[rows], part.weights[rows]


def _with_weights(
    part: Part, body: Part, carried: Sequence[_RigidVertices], surface: TriangleSurface, influences: int | None
) -> Part:
    assert body.weights is not None
    places = part.mesh.positions
    table = body.weights[nearest_rows(body.mesh.positions, places)].toarray()
    groups = _rigid_groups(part.mesh, surface)
    like = [one for one in carried if len(one[1]) and passenger_word(one[0]) == passenger_word(part.name)]
    if like:
        like_places, weights = np.concatenate([one[1] for one in like]), sparse.vstack([one[2] for one in like])
        for group in groups:
            table[group] = weights.tocsr()[nearest_rows(like_places, places[group])].toarray()
    return replace(part, weights=with_mean_rows(table, groups, influences))


def _rigid_groups(mesh: ControlMesh, surface: TriangleSurface) -> list[IndexArray]:
    places = surface.scale * mesh.positions
    return find_pieces(mesh, places, SignedDistances.of(surface, places).heights, None).rigid_groups()


def with_mean_rows(table: FloatArray, groups: Collection[IndexArray], influences: int | None) -> sparse.csr_array:
    """Weights (n, j) whose rows of each group of vertices are the group's mean, of at most ``influences`` joints."""
    for group in groups:
        table[group] = normalise_rows(prune_rows(table[group].mean(axis=0)[None], influences), np.ones(1))
    return sparse.csr_array(table)


def nearest_rows(places: FloatArray, asked: FloatArray) -> IndexArray:
    """(m,) row of ``places`` (n, 3) nearest to each point of ``asked`` (m, 3)."""
    return np.asarray(cKDTree(places).query(asked)[1], dtype=np.int64)
