"""Skinning weights and blend shapes of the target's own parts, such as eyes, lashes and teeth."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.character.passenger_pieces import PIECES, PieceConfig, find_pieces
from cagemap.character.passengers import carry_passengers
from cagemap.character.values import Part
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.parts import join_meshes, passenger_word
from cagemap.numerics.arrays import FloatArray, IndexArray, box_diagonal, label_components
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.transfer.skin import normalise_rows, prune_rows

# Words of parts that move with the skin at their roots, and of parts in the mouth.
_HAIRS = ("lash", "brow", "beard", "moustache")
_IN_MOUTH = ("teeth", "tooth", "tongue", "gum")
# A root's distance from the skin counts this much more than its distance from the vertex (docs/lab/characters.md).
_ROOT_WEIGHT = 5.0
_ROOTS = 8  # of a vertex, so that a strip of lashes does not tear
# Of a part's size: shapes that move it by less are left out.
_MIN_SHIFT = 1e-3


def own_parts_with_weights(
    own: Sequence[Part], body: Part, left_out: Sequence[Part], point_map: PointMap, influences: int | None
) -> list[Part]:
    """Parts of the target with the weights of the nearest vertices of its body.

    All vertices of a rigid piece, such as an eyeball with its iris, have the mean of these weights, or of those of the
    rigid pieces of ``left_out`` parts with the same passenger word.

    ``body``: the target's, with weights.
    ``left_out``: parts of the source that are not carried.
    """
    assert body.weights is not None
    if not own:
        return []
    mesh = join_meshes([part.mesh for part in own])
    ends = np.cumsum([part.mesh.n_vertices for part in own])
    groups = rigid_groups(mesh, point_map.target)
    parts_of = [np.unique(np.searchsorted(ends, group, side="right")).tolist() for group in groups]
    words = [max(passenger_word(own[number].name) for number in numbers) for numbers in parts_of]
    given = [
        (part, part.weights)
        for part in left_out
        if part.weights is not None and passenger_word(part.name) in {*words} - {""}
    ]
    places, weights, words_of_rows = [np.zeros((0, 3))], [body.weights[:0]], list[str]()
    all_carried = carry_passengers(point_map, [part.mesh for part, _ in given])
    for (part, given_weights), carried in zip(given, all_carried, strict=True):
        for group in rigid_groups(part.mesh, point_map.source):
            places.append(carried.positions[group])
            weights.append(given_weights[group])
            words_of_rows += [passenger_word(part.name)] * len(group)
    all_places, all_weights = np.concatenate(places), sparse.vstack(weights, format="csr")
    own_weights = body.weights[nearest_rows(body.mesh.positions, mesh.positions)]
    means, rows = [own_weights], np.arange(mesh.n_vertices)
    for number, (group, word) in enumerate(zip(groups, words, strict=True)):
        of_word = np.flatnonzero(np.array(words_of_rows) == word)
        found = own_weights[group]
        if len(of_word):
            found = all_weights[of_word[nearest_rows(all_places[of_word], mesh.positions[group])]]
        means.append(sparse.csr_array(limit_influences(found.toarray().mean(axis=0)[None], influences)))
        rows[group] = mesh.n_vertices + number
    table = sparse.vstack(means, format="csr")
    return [replace(part, weights=table[of_part]) for part, of_part in zip(own, np.split(rows, ends[:-1]), strict=True)]


def own_parts_with_shapes(
    own: Sequence[Part],
    skin: FloatArray,
    shapes: Mapping[str, FloatArray],
    left_out: Sequence[Part],
    point_map: PointMap,
) -> list[Part]:
    """Parts of the target with shapes: lashes, brows and beards of the skin, teeth and tongues of ``left_out`` parts.

    Shapes that a part has itself stay.

    ``skin``: (m, 3) vertices of the target's body, and ``shapes`` their offsets.
    ``left_out``: parts of the source that are not carried.
    """
    made = []
    for part in own:
        word = passenger_word(part.name)
        twin = next((one for one in left_out if one.shapes and passenger_word(one.name) == word), None)
        if twin is not None and word in _IN_MOUTH:
            (carried,) = carry_passengers(point_map, [twin.mesh])
            rows = nearest_rows(carried.positions, part.mesh.positions)
            made.append(_with_shapes(part, {n: carried.carry_offsets(one)[rows] for n, one in twin.shapes.items()}))
        else:
            made.append(with_shapes_of_skin(part, skin, shapes))
    return made


def with_shapes_of_skin(part: Part, skin: FloatArray, shapes: Mapping[str, FloatArray]) -> Part:
    """Lashes, brows or a beard with the shapes of a skin (m, 3) that move their roots; other parts unchanged."""
    if passenger_word(part.name) not in _HAIRS:
        return part
    means = root_means(part.mesh.positions, vertex_pieces(part.mesh), skin)
    return _with_shapes(part, {name: means @ offsets for name, offsets in shapes.items()})


def _with_shapes(part: Part, shapes: Mapping[str, FloatArray]) -> Part:
    """A part with offsets (n, 3) of those shapes that move it and that it does not have."""
    least = _MIN_SHIFT * box_diagonal(part.mesh.positions)
    moved = {name: offsets for name, offsets in shapes.items() if np.linalg.norm(offsets, axis=1).max() > least}
    return replace(part, shapes={**part.shapes, **moved, **part.shapes})


def root_means(places: FloatArray, pieces: IndexArray, skin: FloatArray) -> sparse.csr_array:
    """(n, m) means over the skin (m, 3) at the roots of vertices (n, 3): lashes and hairs move as a whole.

    Roots are vertices of the same piece, near the vertex and nearer to the skin. ``pieces``: (n,) of the vertices.
    """
    distances, nearest = cKDTree(skin).query(places)
    heights = np.full(int(pieces.max()) + 1, np.finfo(np.float64).tiny)
    np.maximum.at(heights, pieces, distances)
    apart = 10.0 * (box_diagonal(places) + _ROOT_WEIGHT * float(heights.max())) * pieces
    roots = np.column_stack([places, _ROOT_WEIGHT * distances, apart])
    found = cKDTree(roots).query(roots * [1.0, 1.0, 1.0, 0.0, 1.0], k=np.arange(1, min(_ROOTS, len(places)) + 1))
    away, rows = np.asarray(found[0]), np.asarray(found[1], dtype=np.int64)
    weights = np.exp(-((2.0 * (away - away[:, :1]) / heights[pieces, None]) ** 2)) * (pieces[rows] == pieces[:, None])
    weights /= weights.sum(axis=1, keepdims=True)
    starts = np.arange(0, rows.size + 1, rows.shape[1])
    return sparse.csr_array(
        (weights.ravel(), np.asarray(nearest)[rows].ravel(), starts), shape=(len(places), len(skin))
    )


def vertex_pieces(mesh: ControlMesh) -> IndexArray:
    """(n,) connected piece of every vertex."""
    return label_components(mesh.face_indices, mesh.face_indices[mesh.next_corners], mesh.n_vertices)


def rigid_groups(mesh: ControlMesh, surface: TriangleSurface, config: PieceConfig = PIECES) -> list[IndexArray]:
    """Vertices of each group of pieces that keeps its shape, such as an eyeball; lengths by the body's surface."""
    places = surface.scale * mesh.positions
    # Heights of 0: no part, such as a wide skirt, is rigid because it is far from the body.
    return find_pieces(cage_triangles(mesh)[0], places, np.zeros(len(places)), None, config).rigid_groups()


def average_rows(table: FloatArray, groups: Collection[IndexArray], influences: int | None) -> FloatArray:
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
