"""Skinning weights and blend shapes of the target's own parts, such as eyes, lashes and clothes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.character.doubled_pieces import DoubledFaces
from cagemap.character.passenger_pieces import PIECES, PieceConfig, find_pieces
from cagemap.character.values import Part
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.parts import join_meshes, passenger_word
from cagemap.mesh.topology import vertex_pieces
from cagemap.numerics.arrays import FloatArray, IndexArray, box_diagonal, offsets_of
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.transfer.skin import normalise_rows, prune_rows

# A vertex has the values of a counterpart that is nearer than the body, or within this share of the diagonal of the
# part's bounding box (docs/lab/characters.md).
_COUNTERPART_DISTANCE = 0.05
# A part with the same faces whose vertices are farther away on average, in parts of the diagonal, is another one, such
# as the other eye.
_TWIN_DISTANCE = 0.5
# A part has a shape if that moves it by at least this share of the shape's largest offset; less is rounding.
_LEAST_OFFSET = 1e-3
# Rows of weights that are dense at once.
_DENSE_ROWS = 20_000
# Words of parts inside the body, which do not follow the shapes of the skin.
_INSIDE = ("eye", "teeth", "tongue")
# Words of parts that move with their roots in the skin.
HAIRS = ("lash", "brow", "beard")
# The root of a vertex is a vertex close to it and to the skin; its distance from the skin has this weight relative to
# the distance between the two (docs/lab/characters.md).
_ROOT_WEIGHT = 5.0
_ROOTS = 8  # of each vertex: with several, a strip of lashes does not tear


def pairs_of_one_kind(
    candidates: Sequence[Part], own: Sequence[Part], doubled: Sequence[DoubledFaces]
) -> list[DoubledFaces]:
    """Pairs of a candidate and an own part of one kind, such as eyes: by names, or by ``doubled`` faces at one place.

    The `passenger_word` of a name says the kind; faces whose names say different kinds are left out. Candidates are
    parts of the source, placed on the target.
    """
    words, own_words = ([passenger_word(part.name) for part in parts] for parts in (candidates, own))
    pairs = [
        (row, number, np.arange(candidates[row].mesh.n_faces))
        for number, own_word in enumerate(own_words)
        for row, word in enumerate(words)
        if word and word == own_word
    ]
    unlike = {
        (row, number)
        for row, number, _ in doubled
        if words[row] and own_words[number] and words[row] != own_words[number]
    }
    return pairs + [one for one in doubled if one[:2] not in unlike]


def with_nearest_values(
    own: Sequence[Part],
    body: Part,
    counterparts: Sequence[Sequence[Part]],
    surface: TriangleSurface,
    influences: int | None,
) -> list[Part]:
    """Parts of the target with the weights and shapes of the surface nearest to each vertex: the body or a counterpart.

    Lashes, brows and beards have the body's values at their roots. Of a rigid group, such as an eyeball with its iris,
    vertices without a counterpart have the mean of those with one; without any, all have the mean of the group. Eyes,
    teeth, tongues and rigid groups below the skin follow the shapes of counterparts only. Shapes that a part has
    already stay.

    Parameters
    ----------
    own : sequence of Part
    body : Part
        The target's, with the source's weights and shapes.
    counterparts : sequence of sequences of Part
        For each own part, parts of the source of the same kind, at their places on the target; with weights if the body
        has weights.
    surface : TriangleSurface
        The target's; its unit decides which pieces are rigid.
    influences : int or None
        Most joints per vertex; None for all.
    """
    if not own:
        return []
    sources = [body, *dict.fromkeys(chain.from_iterable(counterparts))]
    surfaces = [TriangleSurface(one.mesh.positions, cage_triangles(one.mesh)[0]) for one in sources]
    numbers = [[0, *map(sources.index, parts)] for parts in counterparts]
    found = [_nearest_points(part, sources, surfaces, of_part) for part, of_part in zip(own, numbers, strict=True)]
    matrices, with_counterpart, below_skin = zip(*found, strict=True)
    means, follows_skin = _group_means(own, surface, np.concatenate(with_counterpart), np.concatenate(below_skin))
    sampling = (means @ sparse.vstack(matrices, format="csr")).tocsr()
    shapes, least = dict[str, FloatArray](), dict[str, float]()
    for name in dict.fromkeys(chain.from_iterable(part.shapes for part in sources)):
        offsets = np.concatenate([part.shapes.get(name, np.zeros((part.mesh.n_vertices, 3))) for part in sources])
        shapes[name] = np.where(follows_skin[:, None], sampling @ offsets, 0.0)
        least[name] = _LEAST_OFFSET * np.abs(offsets).max()
    weights = None
    if body.weights is not None:
        of_sources = sparse.vstack([one.weights for one in sources if one.weights is not None], format="csr")
        blocks = np.array_split(np.arange(len(follows_skin)), 1 + len(follows_skin) // _DENSE_ROWS)
        limited = [limit_influences((sampling[block] @ of_sources).toarray(), influences) for block in blocks]
        weights = sparse.vstack([sparse.csr_array(table) for table in limited], format="csr")
    made = []
    for part, (start, end) in zip(own, pairwise(offsets_of([part.mesh.n_vertices for part in own])), strict=True):
        moved = {name: offsets[start:end] for name, offsets in shapes.items() if name not in part.shapes}
        moved = {name: offsets for name, offsets in moved.items() if np.abs(offsets).max() > least[name]}
        of_part = part.weights if weights is None else weights[start:end]
        made.append(replace(part, weights=of_part, shapes=part.shapes | moved))
    return made


def _group_means(
    own: Sequence[Part],
    surface: TriangleSurface,
    with_counterpart: NDArray[np.bool_],
    below_skin: NDArray[np.bool_],
) -> tuple[sparse.csr_array, NDArray[np.bool_]]:
    """Matrix (n, n) to the values of rigid groups; and whether a vertex (n,) follows the shapes that it samples.

    ``with_counterpart`` (n,): vertices with values of a counterpart; ``below_skin`` (n,): below the body's surface.
    """
    count = len(with_counterpart)
    is_inside = np.concatenate([np.full(p.mesh.n_vertices, passenger_word(p.name) in _INSIDE) for p in own])
    follows_skin, rows, members = with_counterpart | ~is_inside, np.arange(count), list[IndexArray]()
    for group in rigid_groups(join_meshes([part.mesh for part in own]), surface):
        known, unknown = group[with_counterpart[group]], group[~with_counterpart[group]]
        follows_skin[unknown] = len(known) > 0 or not (is_inside[group].any() or below_skin[group].mean() > 0.5)
        rows[unknown] = count + len(members)
        members.append(known if len(known) else group)
    # Rows of vertices, then one for each group.
    table = sparse.vstack([sparse.eye_array(count, format="csr"), _means(members, count)], format="csr")
    return table[rows], follows_skin


def _nearest_points(
    part: Part, sources: Sequence[Part], surfaces: Sequence[TriangleSurface], numbers: Sequence[int]
) -> tuple[sparse.csr_array, NDArray[np.bool_], NDArray[np.bool_]]:
    """Matrix from values at all vertices of the sources to those of a part.

    And of each vertex whether it has the values of a counterpart, and whether it is below the body's surface. A
    counterpart with the same faces, at the part's place, gives every vertex the values of the vertex of its number.
    ``numbers``: of the sources to choose from; the first is the body.
    """
    points = part.mesh.positions
    found = [SurfacePoints.nearest(surfaces[number], points) for number in numbers]
    distances = np.array([np.linalg.norm(points - one.positions, axis=1) for one in found])
    is_below = np.einsum("nd,nd->n", points - found[0].positions, found[0].normals) < 0.0
    matrices = [one.matrix() for one in found]
    if passenger_word(part.name) in HAIRS:
        matrices[0] = root_means(points, vertex_pieces(part.mesh), distances[0]) @ matrices[0]
    distances[0] = np.maximum(distances[0], _COUNTERPART_DISTANCE * box_diagonal(points))
    twins = [row for row, number in enumerate(numbers) if row and has_same_faces(part.mesh, sources[number].mesh)]
    away = [float(np.linalg.norm(points - sources[numbers[row]].mesh.positions, axis=1).mean()) for row in twins]
    if twins and min(away) < _TWIN_DISTANCE * box_diagonal(points):
        row = twins[int(np.argmin(away))]
        matrices[row], distances[row] = sparse.eye_array(len(points), format="csr"), 0.0
    chosen, starts = distances.argmin(axis=0), offsets_of([surface.n for surface in surfaces])
    size = len(points), int(starts[-1])
    of_all = [  # each on the columns of its source
        sparse.csr_array((matrix.data, matrix.indices + starts[number], matrix.indptr), shape=size)
        for number, matrix in zip(numbers, matrices, strict=True)
    ]
    rows = sparse.vstack(of_all, format="csr")[chosen * len(points) + np.arange(len(points))]
    return rows, chosen > 0, is_below


def has_same_faces(mesh: ControlMesh, other: ControlMesh) -> bool:
    """Whether two meshes have the same vertices in the same faces, as parts of one modelling program often do."""
    pairs = (mesh.face_offsets, other.face_offsets), (mesh.face_indices, other.face_indices)
    return mesh.n_vertices == other.n_vertices and all(np.array_equal(*pair) for pair in pairs)


def _means(members: Sequence[IndexArray], count: int) -> sparse.csr_array:
    """(g, n) matrix to the mean of each group of vertices."""
    sizes = np.array([len(one) for one in members], dtype=np.int64)
    columns = np.concatenate([np.zeros(0, dtype=np.int64), *members])
    return sparse.csr_array((np.repeat(1.0 / sizes, sizes), columns, offsets_of(sizes)), shape=(len(members), count))


def root_means(places: FloatArray, pieces: IndexArray, distances: FloatArray) -> sparse.csr_array:
    """(n, n) means over the roots of vertices (n, 3), so that lashes and hairs move as a whole.

    Roots are vertices of the same piece, near the vertex and nearer to the skin. ``pieces`` (n,) are the connected
    pieces of the vertices, ``distances`` (n,) theirs from the skin.
    """
    # Farthest distance of each piece; not 0 where a piece lies on the skin.
    heights = np.full(int(pieces.max()) + 1, 1e-9 * box_diagonal(places))
    np.maximum.at(heights, pieces, distances)
    piece_offset = 10.0 * (box_diagonal(places) + _ROOT_WEIGHT * float(heights.max())) * pieces
    points = np.column_stack([places, _ROOT_WEIGHT * distances, piece_offset])
    # The fourth coordinate is the weighted distance from the skin: 0 in the query, so that vertices near the skin are
    # found.
    found = cKDTree(points).query(points * [1.0, 1.0, 1.0, 0.0, 1.0], k=np.arange(1, min(_ROOTS, len(places)) + 1))
    away, rows = np.asarray(found[0]), np.asarray(found[1], dtype=np.int64)
    weights = np.exp(-((2.0 * (away - away[:, :1]) / heights[pieces, None]) ** 2)) * (pieces[rows] == pieces[:, None])
    weights /= weights.sum(axis=1, keepdims=True)
    starts = np.arange(0, rows.size + 1, rows.shape[1])
    return sparse.csr_array((weights.ravel(), rows.ravel(), starts), shape=(len(places), len(places)))


def rigid_groups(mesh: ControlMesh, surface: TriangleSurface, config: PieceConfig = PIECES) -> list[IndexArray]:
    """Vertices of each group of pieces that keeps its shape, such as an eyeball; lengths by the body's surface."""
    places = surface.scale * mesh.positions
    # Heights of 0: no part, such as a wide skirt, is rigid because it is far from the body.
    return find_pieces(cage_triangles(mesh)[0], places, np.zeros(len(places)), None, config).rigid_groups()


def limit_influences(table: FloatArray, influences: int | None) -> FloatArray:
    """Weights (n, j) of at most ``influences`` joints per row, of sum 1."""
    return normalise_rows(prune_rows(table, influences), np.ones(1))


def nearest_rows(places: FloatArray, asked: FloatArray) -> IndexArray:
    """(m,) row of ``places`` (n, 3) nearest to each point of ``asked`` (m, 3)."""
    return np.asarray(cKDTree(places).query(asked)[1], dtype=np.int64)
