"""Exact limit positions and normals at the vertices of every level.

Left eigenvectors of the local subdivision matrix of a vertex and its ring give the limit: position from eigenvalue 1,
tangents from the next two [HKD93]_. They have closed formulas, except at darts (ends of an infinite crease), where they
are computed numerically. Around semi-sharp vertices the mesh is refined locally until nothing is semi-sharp.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from scipy.sparse import csr_array, diags_array, eye_array

from cagemap.errors import ParameterError
from cagemap.mesh.schemes import CREASE_LIMIT, INFINITE_SHARPNESS, Bilinear, CatmullClark, Loop
from cagemap.mesh.topology import BoolArray, Topology, topology_of
from cagemap.numerics.arrays import FloatArray, IndexArray, grouped_sums, label_components, mask_of, places_of
from cagemap.subdivision.matrices import (
    Entries,
    boundary_entries,
    inner_entries,
    matrix_of,
    rings_of,
    subdivision_matrix,
)
from cagemap.subdivision.refinement import Refinement, state_of
from cagemap.subdivision.topology import MeshState, Sharpness, corner_neighbours, next_state
from cagemap.surface.triangles import normalize_rows

SmoothScheme: TypeAlias = CatmullClark | Loop


def limit_matrix(refinement: Refinement, level: int) -> csr_array:
    """(n_level, n_level) matrix from positions to limit positions of a level; rows sum to 1."""
    state = _state_with_rings(refinement, level)
    if isinstance(refinement.scheme, Bilinear):
        return csr_array(eye_array(state.topology.n_vertices, format="csr"))
    return _limits(state, refinement.scheme, np.ones(state.topology.n_vertices, dtype=bool))


def limit_positions(refinement: Refinement, level: int) -> FloatArray:
    """(n_level, 3) limit positions of a level's vertices; they do not depend on the level."""
    used = _level_with_rings(refinement, level)
    limits: FloatArray = limit_matrix(refinement, used) @ refinement.levels[used].positions
    return limits[: refinement.levels[level].n_vertices]


def limit_normals(refinement: Refinement, level: int) -> FloatArray:
    """(n_level, 3) outward unit normals of the limit surface at a level's vertices.

    On creases and corners the mean over all sides; zero on degenerate surfaces. Approximate where the surface has no
    normal: at interior vertices of valence 2, at boundary vertices of more than 3 faces (Catmull-Clark) or 5 (Loop),
    at sharp boundary vertices of several faces, and on bilinear surfaces. Errors as of `limit_positions`.
    """
    used = _level_with_rings(refinement, level)
    return normalize_rows(np.cross(*limit_tangents(refinement, used)))[: refinement.levels[level].n_vertices]


def limit_tangents(refinement: Refinement, level: int) -> tuple[FloatArray, FloatArray]:
    """Two tangents (n_level, 3) with outward cross product; at the boundary the first one is along it."""
    state = _state_with_rings(refinement, level)
    positions, scheme = refinement.levels[level].positions, refinement.scheme
    if isinstance(scheme, Bilinear):
        # Approximate by Loop's tangents: a bilinear surface has none, as it has edges there.
        return ring_tangents(state.topology, Loop(), state.topology.boundary, positions)
    return _tangents(state, scheme, positions, np.ones(len(positions), dtype=bool))


def _level_with_rings(refinement: Refinement, level: int) -> int:
    """The level, but level 1, whose faces are all quads, for level 0 of a mesh with others under Catmull-Clark."""
    if level or not isinstance(refinement.scheme, CatmullClark) or np.all(refinement.control.face_sizes == 4):
        return level
    if refinement.finest_level == 0:
        raise ParameterError("level: limits of a control mesh with n-gons need one refinement step; refine once")
    return 1


def _state_with_rings(refinement: Refinement, level: int) -> MeshState:
    if not 0 <= level <= refinement.finest_level:
        raise ParameterError(f"level: expected 0 to {refinement.finest_level}, got {level}; refine to have more")
    if _level_with_rings(refinement, level) != level:
        raise ParameterError("level: expected quads only, got level 0 of a mesh with other faces; use level 1")
    return state_of(refinement, level)


def _features(topology: Topology, sharpness: Sharpness) -> tuple[BoolArray, BoolArray, BoolArray, BoolArray]:
    """Four masks (n,) of vertices with sharpness inside: semi-sharp, darts, creases, corners."""
    ends, n = topology.edge_ends, topology.n_vertices
    inside = ~topology.outer_edges
    infinite = sharpness.edges >= INFINITE_SHARPNESS
    semi = (sharpness.vertices > 0) & (sharpness.vertices < INFINITE_SHARPNESS)
    semi[ends[(sharpness.edges > 0) & ~infinite]] = True
    count = np.bincount(ends[infinite].ravel(), minlength=n)
    inner = np.bincount(ends[infinite & inside].ravel(), minlength=n) > 0
    corner = (sharpness.vertices >= INFINITE_SHARPNESS) | (inner & (count > 2))
    infinite_only = ~semi & ~corner & inner
    return semi, infinite_only & (count == 1), infinite_only & (count == 2), corner & ~semi


def _limits(state: MeshState, scheme: SmoothScheme, wanted: BoolArray) -> csr_array:
    """(n, n) weights of limit positions; rows that are not wanted are undefined."""
    topology, sharpness = state.topology, state.sharpness
    shape = topology.n_vertices, topology.n_vertices
    own_weights, *each = scheme.limit_weights(topology.valences)
    inner = inner_entries(topology, own_weights, *zip(rings_of(topology, scheme), each, strict=True))
    smooth_limits = matrix_of([*inner, *boundary_entries(topology, state.corner, CREASE_LIMIT)], shape)
    if sharpness is None:
        return smooth_limits
    semi, dart, crease, corner = _features(topology, sharpness)
    ends, fixed = topology.edge_ends[sharpness.edges >= INFINITE_SHARPNESS], np.flatnonzero(corner | crease)
    own_weight, neighbour_weight = CREASE_LIMIT
    along = np.where(crease[ends], neighbour_weight, 0.0)
    entries: list[Entries] = [
        (fixed, fixed, np.where(corner[fixed], 1.0, own_weight)),
        (ends[:, 0], ends[:, 1], along[:, 0]),
        (ends[:, 1], ends[:, 0], along[:, 1]),
    ]
    if np.any(semi & wanted):
        matrix, numbers, child, chosen = _refined_around(state, scheme, semi & wanted)
        finer = (_limits(child, scheme, chosen)[np.flatnonzero(chosen)] @ matrix).tocoo()
        entries.append((np.flatnonzero(semi & wanted)[finer.coords[0]], numbers[finer.coords[1]], finer.data))
    smooth = ~(semi | dart | crease | corner)
    result = diags_array(smooth.astype(np.float64)) @ smooth_limits + matrix_of(entries, shape)
    result = csr_array(result + _dart_rows(topology, sharpness, scheme, dart & wanted)[0])
    result.eliminate_zeros()
    result.sort_indices()
    return result


def _tangents(
    state: MeshState, scheme: SmoothScheme, positions: FloatArray, wanted: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Two tangents of every vertex; rows that are not wanted are undefined."""
    if state.sharpness is None:
        return ring_tangents(state.topology, scheme, state.corner, positions)
    semi, dart, _, corner = _features(state.topology, state.sharpness)
    tangents = _tangents_of_sides(state, scheme, positions, corner)
    dart_rows = _dart_rows(state.topology, state.sharpness, scheme, dart)
    for tangent, rows in zip(tangents, dart_rows[1:], strict=True):
        tangent[dart] = (rows @ positions)[dart]
    if np.any(semi & wanted):
        matrix, numbers, child, chosen = _refined_around(state, scheme, semi & wanted)
        finer = _tangents(child, scheme, matrix @ positions[numbers], chosen)
        for tangent, values in zip(tangents, finer, strict=True):
            tangent[semi & wanted] = values[chosen]
    return tangents


def _tangents_of_sides(
    state: MeshState, scheme: SmoothScheme, positions: FloatArray, corner: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Tangents from the mean normal of all sides, with the surface cut along infinite creases."""
    assert state.sharpness is not None
    topology, n = state.topology, state.topology.n_vertices
    cut = state.sharpness.edges >= INFINITE_SHARPNESS
    forward, backward = topology.edge_corners[~cut].T
    heads = np.concatenate([forward, topology.following[forward]])
    tails = np.concatenate([topology.following[backward], backward])
    labels, vertices = np.unique(label_components(heads, tails, topology.n_corners), return_inverse=True)
    cut_apart = topology_of(vertices, len(labels), topology.faces, topology.following, topology.previous)
    owners = np.empty(len(labels), dtype=np.int64)
    owners[cut_apart.vertices] = topology.vertices
    sides = ring_tangents(cut_apart, scheme, (corner | state.corner)[owners], positions[owners])
    normals = normalize_rows(grouped_sums(owners, normalize_rows(np.cross(*sides)), n))
    tangents = np.empty((2, n, 3))
    tangents[:, owners] = sides
    several = np.bincount(owners, minlength=n) > 1
    along = tangents[0] - np.einsum("nx,nx->n", tangents[0], normals)[:, None] * normals
    tangents[0, several] = along[several]
    tangents[1, several] = np.cross(normals, along)[several]
    return tangents[0], tangents[1]


def _refined_around(
    state: MeshState, scheme: SmoothScheme, chosen: BoolArray
) -> tuple[csr_array, IndexArray, MeshState, BoolArray]:
    """S of two rings of faces around chosen vertices, its columns' vertices, the next state, chosen vertices there."""
    assert state.sharpness is not None
    topology, near = state.topology, chosen
    for _ in range(2):
        faces = mask_of(topology.faces[near[topology.vertices]], topology.n_faces)
        near = mask_of(topology.vertices[faces[topology.faces]], topology.n_vertices)
    corners = np.flatnonzero(faces[topology.faces])
    new = places_of(corners, topology.n_corners).astype(np.int32)
    numbers, indices = np.unique(topology.vertices[corners], return_inverse=True)
    face_numbers = (np.cumsum(faces) - 1).astype(np.int32)[topology.faces[corners]]
    around = new[topology.following[corners]], new[topology.previous[corners]]
    part = topology_of(indices, len(numbers), face_numbers, *around)
    edges, halves = state.sharpness.of_corners(topology, corners[part.edge_corners[:, 0]])
    sharpness = Sharpness(edges, halves, state.sharpness.vertices[numbers], state.sharpness.after[numbers])
    part_state = MeshState(part, state.corner[numbers], sharpness)
    child = next_state(part_state, scheme)
    followed = np.zeros(child.topology.n_vertices, dtype=bool)
    followed[: len(numbers)] = chosen[numbers]
    return subdivision_matrix(part_state, scheme), numbers.astype(np.int64), child, followed


def _dart_rows(
    topology: Topology, sharpness: Sharpness, scheme: SmoothScheme, dart: BoolArray
) -> tuple[csr_array, csr_array, csr_array]:
    """(n, n) weights of limit position and of two tangents at darts (ends of an infinite crease)."""
    infinite, shape = (sharpness.edges >= INFINITE_SHARPNESS)[topology.edges], (topology.n_vertices,) * 2
    first = np.zeros(topology.n_vertices, dtype=np.int32)
    leading = infinite & dart[topology.vertices]
    first[topology.vertices[leading]] = topology.ranks[leading]
    around = np.flatnonzero(dart[topology.vertices])
    centres = topology.vertices[around]
    valences = topology.valences[centres]
    ranks = (topology.ranks[around] - first[centres]) % valences
    order, rings = np.lexsort([ranks, centres]), rings_of(topology, scheme)
    none = np.zeros(0, dtype=np.int64)
    entries: list[list[Entries]] = [[(none, none, np.zeros(0))] for _ in range(3)]
    for valence in np.unique(valences).tolist():
        corners = around[order[valences[order] == valence]].reshape(-1, valence)  # of one dart in every row
        darts = topology.vertices[corners[:, :1]]
        columns = np.hstack([darts, *(ring[corners] for ring in rings)])
        for kind, weights in zip(entries, _dart_weights(scheme, valence), strict=True):
            kind.append((np.repeat(darts, columns.shape[1]), columns.ravel(), np.tile(weights, len(darts))))
    position, first_tangent, second = (matrix_of(kind, shape) for kind in entries)
    return position, first_tangent, second


def _dart_weights(scheme: SmoothScheme, valence: int) -> FloatArray:
    """(3, ring) weights of limit position and tangents at a dart; the ring begins at the crease's other end."""
    ranks = np.arange(valence)
    following = (ranks + 1) % valence
    quads = not isinstance(scheme, Loop)
    faces = np.column_stack([np.zeros_like(ranks), 1 + ranks, *([1 + valence + ranks] if quads else []), 1 + following])
    n = 1 + (2 if quads else 1) * valence
    topology = topology_of(faces.ravel(), n, *corner_neighbours(*faces.shape))
    edges = np.where(topology.outer_edges, INFINITE_SHARPNESS, 0.0)
    spokes = topology.edges[:: faces.shape[1]]
    edges[spokes[0]] = INFINITE_SHARPNESS
    smooth = np.zeros(n)
    sharpness = Sharpness(edges, np.column_stack([edges, edges]), smooth, smooth)
    matrix = subdivision_matrix(MeshState(topology, smooth.astype(bool), sharpness), scheme)
    ring = np.concatenate([[0], n + spokes, *([n + topology.n_edges + ranks] if quads else [])])
    local = matrix[ring].toarray()
    # The ring is symmetric about the crease: one tangent is even, one odd, each with a simple eigenvalue.
    mirror = np.concatenate([[0], 1 + (-ranks) % valence, *([1 + valence + (-1 - ranks) % valence] if quads else [])])
    sides = []
    for sign in (1, -1):
        values, vectors = np.linalg.eig((0.5 * (local + sign * local[:, mirror])).T)
        sides.append(vectors[:, np.argsort(-values.real)].real.T)
    even, odd = sides
    weights = np.stack([even[0] / even[0].sum(), even[1], odd[0]])
    # Orient the second tangent to the left of the first on a flat counter-clockwise ring.
    angles = 2 * np.pi * np.concatenate([ranks, ranks + 0.5]) / valence
    flat = np.column_stack([np.cos(angles), np.sin(angles)])[: n - 1]
    if np.linalg.det(weights[1:, 1:] @ flat) < 0:
        weights[2] *= -1
    return weights


# Boundary formulas below are derived for the rules used here: published formulas (also OpenSubdiv's) belong to other
# boundary rules and are up to 10 degrees off.
def ring_tangents(
    topology: Topology, scheme: SmoothScheme, corner: BoolArray, positions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Two tangents (n, 3) of every vertex without creases; at the boundary the first one is along it."""
    sides = zip(_inner_tangents(topology, scheme), _boundary_tangents(topology, scheme, corner), strict=True)
    shape = topology.n_vertices, topology.n_vertices
    first, second = (matrix_of([*inner, *boundary], shape) @ positions for inner, boundary in sides)
    return first, second


def _inner_tangents(topology: Topology, scheme: SmoothScheme) -> tuple[list[Entries], list[Entries]]:
    """Entries of the two tangents of interior vertices."""
    rings = rings_of(topology, scheme)
    inside = np.flatnonzero(~topology.boundary[topology.vertices])
    centres = topology.vertices[inside]
    valences, ranks = topology.valences[centres], topology.ranks[inside]
    masks: tuple[FloatArray, ...] = scheme.tangent_weights(valences, ranks)
    if isinstance(scheme, CatmullClark):  # valence 2 has no tangent plane: use the polygon of the ring
        sign, none = np.where(ranks == 0, 1.0, -1.0), np.zeros(len(ranks))
        polygon = sign, none, none, sign
        masks = tuple(np.where(valences == 2, new, old) for new, old in zip(polygon, masks, strict=True))
    entries: list[Entries] = [
        (centres, ring[inside], weights) for ring, weights in zip((*rings, *rings), masks, strict=True)
    ]
    return entries[: len(rings)], entries[len(rings) :]


def _boundary_tangents(
    topology: Topology, scheme: SmoothScheme, corner: BoolArray
) -> tuple[list[Entries], list[Entries]]:
    """Entries of the tangents along the boundary curve and inwards."""
    curve = topology.boundary_corners
    # The boundary goes from vertex `before` over `vertex` to `after`, with faces on its left.
    vertex, after = topology.vertices[curve], topology.vertices[topology.following[curve]]
    before = np.empty(topology.n_vertices, dtype=np.int32)
    before[after] = vertex
    before = before[vertex]
    fixed = corner[vertex].astype(np.float64)
    along: list[Entries] = [
        (vertex, after, np.ones(len(vertex))),
        (vertex, before, fixed - 1),
        (vertex, vertex, -fixed),
    ]
    single = topology.valences[vertex] == 1
    # Single face: a corner's tangents are along its two edges, else the curve's first and second derivatives.
    inwards: list[Entries] = [
        (vertex, before, single.astype(np.float64)),
        (vertex, vertex, single * (fixed - 2)),
        (vertex, after, single * (1 - fixed)),
    ]
    corners_at = np.flatnonzero(topology.boundary[topology.vertices])
    for valence in np.unique(topology.valences[vertex[~single]]):
        centre, edges, faces = scheme.inward_tangent(int(valence))
        chosen = (topology.valences[vertex] == valence).astype(np.float64)
        inwards += [(vertex, vertex, centre * chosen), (vertex, before, edges[-1] * chosen)]
        corners = corners_at[topology.valences[topology.vertices[corners_at]] == valence]
        for ring, weights in zip(rings_of(topology, scheme), (edges[:-1], faces), strict=False):
            inwards.append((topology.vertices[corners], ring[corners], weights[topology.ranks[corners]]))
    return along, inwards
