"""Weights of what a body has of its own, such as eyes: pieces that keep their shape move as a whole."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.character.passenger_pieces import EYES, find_pieces
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
    """Parts of the target with weights of the body's nearest vertices, or with common ones.

    A rigid piece, such as an eyeball, has one weight for each joint: of the rigid pieces of ``declined`` parts with the
    same passenger word, or the mean of the body's.

    ``body``: the target's, with weights.
    ``declined``: parts of the source that are not carried.
    """
    assert body.weights is not None
    rigid = [_rigid_groups(part.mesh, point_map.target) for part in own]
    words = {passenger_word(part.name) for part, groups in zip(own, rigid, strict=True) if groups} - {""}
    given = [
        (part, part.weights) for part in declined if part.weights is not None and passenger_word(part.name) in words
    ]
    places, weights, of_word = [np.zeros((0, 3))], [body.weights[:0]], list[str]()
    all_carried = carry_passengers(point_map, [part.mesh for part, _ in given])
    for (part, given_weights), carried in zip(given, all_carried, strict=True):
        for group in _rigid_groups(part.mesh, point_map.source):
            places.append(carried.positions[group])
            weights.append(given_weights[group])
            of_word += [passenger_word(part.name)] * len(group)
    all_places, all_weights = np.concatenate(places), sparse.vstack(weights, format="csr")
    made = []
    for part, groups in zip(own, rigid, strict=True):
        asked = part.mesh.positions
        part_weights = body.weights[nearest_rows(body.mesh.positions, asked)]
        if groups:
            table = part_weights.toarray()
            like = np.flatnonzero(np.array(of_word) == passenger_word(part.name))
            for group in groups if len(like) else ():
                table[group] = all_weights[like[nearest_rows(all_places[like], asked[group])]].toarray()
            part_weights = sparse.csr_array(with_mean_rows(table, groups, influences))
        made.append(replace(part, weights=part_weights))
    return made


def _rigid_groups(mesh: ControlMesh, surface: TriangleSurface) -> list[IndexArray]:
    places = surface.scale * mesh.positions
    return find_pieces(mesh, places, np.zeros(len(places)), None, EYES).rigid_groups()


def with_mean_rows(table: FloatArray, groups: Collection[IndexArray], influences: int | None) -> FloatArray:
    """Weights (n, j), changed in place: rows of each group of vertices are the group's mean."""
    for group in groups:
        table[group] = limit_influences(table[group].mean(axis=0)[None], influences)
    return table


def limit_influences(table: FloatArray, influences: int | None) -> FloatArray:
    """Weights (n, j) of at most ``influences`` joints per row, of sum 1."""
    return normalise_rows(prune_rows(table, influences), np.ones(1))


def nearest_rows(places: FloatArray, asked: FloatArray) -> IndexArray:
    """(m,) row of ``places`` (n, 3) nearest to each point of ``asked`` (m, 3)."""
    return np.asarray(cKDTree(places).query(asked)[1], dtype=np.int64)
