"""Join pairs of triangles into quads: undo an exporter's triangulation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.faces import with_corners_of
from cagemap.mesh.inputs import MeshLike, arrays_accepted
from cagemap.mesh.structure_checks import require_structure
from cagemap.mesh.topology import adjacent_corners, mesh_topology
from cagemap.numerics.arrays import FloatArray, IndexArray, joined_runs, pair_keys, places_of

_MOST_FOLDED, _MOST_SKEWED = 90.0, 75.0  # degrees: fold of a pair, difference of its corners from 90
_IN_ORDER = 60.0  # degrees off the cost of consecutive faces, as exporters write both triangles in a row
# Share of triangles in consecutive pairs that begin at even faces, from which the whole file consists of such pairs.
_MOST_EVEN = 0.9


@arrays_accepted
def join_quads(mesh: MeshLike) -> tuple[ControlMesh, int]:
    """Join triangles in pairs; also the number of quads.

    A pair shares an edge that is no crease, no border of a hole and no seam of UVs, materials or objects. Of several
    possible quads, consecutive faces and corners near 90 degrees are preferred. Vertices keep their numbers.

    Examples
    --------
    >>> from cagemap import ControlMesh
    >>> square = ControlMesh.from_faces([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3)])
    >>> join_quads(square)[0].face_sizes
    array([4])
    """
    require_structure(mesh)
    quads = _candidates(mesh)
    first, second = mesh.corner_faces[quads[:, 0]], mesh.corner_faces[quads[:, 2]]
    places = mesh.positions[mesh.face_indices[quads]]
    to_next, to_previous = np.roll(places, -1, axis=1) - places, np.roll(places, 1, axis=1) - places
    cost = np.abs(_angle(to_next, to_previous) - 90.0).max(axis=1, initial=0.0)
    a, b, c, d = places.transpose(1, 0, 2)
    fold = _angle(np.cross(b - a, c - a), np.cross(c - a, d - a))
    sound = (fold < _MOST_FOLDED) & (cost < _MOST_SKEWED)
    in_order, even = np.abs(first - second) == 1, np.minimum(first, second) % 2 == 0
    cost -= np.where(in_order, _IN_ORDER, 0.0)
    if 2 * np.sum(in_order & even & sound) >= _MOST_EVEN * mesh.n_faces:
        cost -= np.where(in_order & even, 180.0, 0.0)
        sound |= in_order & even
    chosen = quads[sound][_matched(first[sound], second[sound], cost[sound], mesh.n_faces)]
    if not len(chosen):
        return mesh, 0
    pairs = np.sort(mesh.corner_faces[chosen[:, [0, 2]]], axis=1)
    sizes = mesh.face_sizes.copy()
    sizes[pairs[:, 0]] = 4
    kept = np.ones(mesh.n_faces, dtype=bool)
    kept[pairs[:, 1]] = False
    faces = np.flatnonzero(kept)
    offsets, corners = joined_runs(mesh.face_offsets[faces], sizes[faces])
    place = np.empty(mesh.n_faces, dtype=np.int64)
    place[faces] = offsets[:-1]
    corners[place[pairs[:, 0]][:, None] + np.arange(4)] = chosen
    return with_corners_of(mesh, faces, offsets, corners), len(chosen)


def _candidates(mesh: ControlMesh) -> IndexArray:
    """(q, 4) face corners of all quads that two triangles can form."""
    topology, following, faces = mesh_topology(mesh), mesh.next_corners, mesh.corner_faces
    first, second = adjacent_corners(topology)
    heads = mesh.face_indices[following]
    fits = (topology.face_counts[topology.edges[first]] == 2) & (mesh.face_indices[first] == heads[second])
    fits &= (mesh.face_sizes[faces[first]] == 3) & (mesh.face_sizes[faces[second]] == 3)
    for _, labels, _ in mesh.partitions:
        if labels is not None:
            fits &= labels[faces[first]] == labels[faces[second]]
    if mesh.hole_faces is not None:
        is_hole = np.isin(np.arange(mesh.n_faces), mesh.hole_faces)
        fits &= is_hole[faces[first]] == is_hole[faces[second]]
    for uvs in (uv_set.uv_indices for uv_set in mesh.all_uv_sets):
        fits &= (uvs[first] == uvs[following[second]]) & (uvs[following[first]] == uvs[second])
    if mesh.crease_edges is not None and len(mesh.crease_edges):
        edge_keys = pair_keys(np.column_stack([mesh.face_indices[first], heads[first]]), mesh.n_vertices)
        fits &= ~np.isin(edge_keys, pair_keys(mesh.crease_edges, mesh.n_vertices))
    first, second = first[fits], second[fits]
    return np.column_stack([first, following[following[second]], second, following[following[first]]])


def _angle(one: FloatArray, other: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(one, axis=-1) * np.linalg.norm(other, axis=-1)
    cosine = np.einsum("...x,...x->...", one, other) / np.where(lengths > 0.0, lengths, 1.0)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _matched(first: IndexArray, second: IndexArray, cost: FloatArray, n_faces: int) -> NDArray[np.bool_]:
    """(q,) which pairs of faces to join: in rounds, pairs of least cost for both faces."""
    rank = places_of(np.argsort(cost, kind="stable"), len(cost))
    chosen = np.zeros(len(cost), dtype=bool)
    open_pairs = np.arange(len(cost))
    while len(open_pairs):  # ends, as the pair of least cost is always joined
        best = np.full(n_faces, len(cost), dtype=np.int64)
        for side in (first, second):
            np.minimum.at(best, side[open_pairs], rank[open_pairs])
        ranks = rank[open_pairs]
        won = open_pairs[(best[first[open_pairs]] == ranks) & (best[second[open_pairs]] == ranks)]
        chosen[won] = True
        taken = np.zeros(n_faces, dtype=bool)
        taken[first[won]] = taken[second[won]] = True
        open_pairs = open_pairs[~taken[first[open_pairs]] & ~taken[second[open_pairs]]]
    return chosen
