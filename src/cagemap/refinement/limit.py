"""Where the refined vertices end: limit positions and normals, exact at every vertex of every level.

The local subdivision matrix A maps a vertex and its ring to the vertex and ring one level finer. Its left eigenvectors
give the limit: position from eigenvalue 1, tangents from the two largest that follow [HKD93]_. Where nothing is
semi-sharp they are closed formulas (`limit_rings`), or, where one infinite crease ends, eigenvectors of a small matrix.
A vertex with semi-sharp features is followed to the level at which none is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array, eye_array

from cagemap.errors import ParameterError
from cagemap.mesh.schemes import CREASE_LIMIT, INFINITE_SHARPNESS, Bilinear, Loop
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.graphs import components
from cagemap.refinement.limit_rings import SmoothScheme, ring_limits, ring_tangents, rings_of
from cagemap.refinement.matrices import subdivision_matrix
from cagemap.refinement.refinement import Refinement, state_of
from cagemap.refinement.sharpness import Sharpness, edge_ends
from cagemap.refinement.state import MeshState, next_state, state_matrix
from cagemap.refinement.topology import BoolArray, Topology, cut_table, table_of, topology_of_table


def limit_matrix(refinement: Refinement, level: int) -> csr_array:
    """Weights of the limit positions of a level's vertices in that level's positions.

    Parameters
    ----------
    refinement : Refinement
    level : int
        From 0 to L; 0 only where Loop or bilinear runs or all control faces are quads.

    Returns
    -------
    (n_level, n_level) csr_array
        Rows sum to 1.

    Raises
    ------
    ParameterError
        If there is no such level, or level 0 has faces that are not quads under Catmull-Clark.
    """
    state = _checked_state(refinement, level)
    scheme = refinement.scheme
    if isinstance(scheme, Bilinear):
        return csr_array(eye_array(state.topology.table.n_vertices, format="csr"))
    return _limits(state, scheme, np.ones(state.topology.table.n_vertices, dtype=bool))


def limit_positions(refinement: Refinement, level: int) -> FloatArray:
    """Limit positions of a level's vertices, (n_level, 3): the same point at every level that has the vertex.

    Raises
    ------
    ParameterError
        If there is no such level.
    """
    if level == 0 and not _has_limit_rings(refinement, 0):
        if refinement.n_levels == 0:
            raise ParameterError("level: limits of a control mesh with n-gons need one refinement step; refine once")
        # Vertex i is vertex i one level further, where all faces are quads.
        return limit_positions(refinement, 1)[: refinement.levels[0].n_vertices]
    limits: FloatArray = limit_matrix(refinement, level) @ refinement.levels[level].positions
    return limits


def limit_normals(refinement: Refinement, level: int) -> FloatArray:
    """Unit normals of the limit surface at a level's vertices, (n_level, 3), outwards.

    Exact wherever the surface has one. On creases and corners, where every side has its own, the mean of all sides. It
    has none at interior vertices of valence 2, nor at boundary vertices with so many faces (more than 3 under
    Catmull-Clark, 5 under Loop) that the boundary curve no longer leads their shape, nor at sharp boundary vertices of
    several faces, nor on bilinear surfaces; there the result is the nearest reasonable direction. It is zero where
    the surface itself is degenerate.

    Raises
    ------
    ParameterError
        As for `limit_positions`.
    """
    if level == 0 and not _has_limit_rings(refinement, 0) and refinement.n_levels:
        return limit_normals(refinement, 1)[: refinement.levels[0].n_vertices]
    return _unit(np.cross(*limit_tangents(refinement, level)))


def limit_tangents(refinement: Refinement, level: int) -> tuple[FloatArray, FloatArray]:
    """Two directions that span the limit surface's tangent plane at every vertex, each (n_level, 3).

    Their cross product is outward; their lengths mean nothing. On the boundary the first follows the curve.

    Raises
    ------
    ParameterError
        As for `limit_matrix`.
    """
    state = _checked_state(refinement, level)
    positions, scheme = refinement.levels[level].positions, refinement.scheme
    if isinstance(scheme, Bilinear):
        # Its ring of edges, as if Loop's: the surface itself has an edge there.
        return ring_tangents(state.topology, Loop(), state.topology.boundary, positions)
    return _tangents(state, scheme, positions, np.ones(len(positions), dtype=bool))


def _has_limit_rings(refinement: Refinement, level: int) -> bool:
    if level > 0 or isinstance(refinement.scheme, Loop | Bilinear):
        return True
    return bool(np.all(refinement.control.face_sizes == 4))


def _checked_state(refinement: Refinement, level: int) -> MeshState:
    if not 0 <= level <= refinement.n_levels:
        raise ParameterError(f"level: expected 0 to {refinement.n_levels}, got {level}; refine further to have more")
    if not _has_limit_rings(refinement, level):
        raise ParameterError("level: expected quads only, got level 0 of a mesh with other faces; use level 1")
    return state_of(refinement, level)


def _unit(vectors: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)


@dataclass(frozen=True, eq=False)
class _Features:
    """Vertices whose limit needs more than the boundary's rules, (n,) bool each."""

    semi: BoolArray
    dart: BoolArray
    crease: BoolArray
    corner: BoolArray


def _features(topology: Topology, sharpness: Sharpness) -> _Features:
    ends, n = edge_ends(topology), topology.table.n_vertices
    inside = topology.edge_corners[:, 1] >= 0
    infinite = sharpness.edges >= INFINITE_SHARPNESS
    semi = (sharpness.vertices > 0) & (sharpness.vertices < INFINITE_SHARPNESS)
    semi[ends[(sharpness.edges > 0) & ~infinite]] = True
    count = np.bincount(ends[infinite].ravel(), minlength=n)
    inner = np.bincount(ends[infinite & inside].ravel(), minlength=n) > 0
    corner = (sharpness.vertices >= INFINITE_SHARPNESS) | (inner & (count > 2))
    settled = ~semi & ~corner & inner
    return _Features(semi, settled & (count == 1), settled & (count == 2), corner & ~semi)


def _limits(state: MeshState, scheme: SmoothScheme, wanted: BoolArray) -> csr_array:
    """Weights of limit positions, (n, n); rows that are not wanted mean nothing."""
    topology, sharpness = state.topology, state.sharpness
    rows = ring_limits(topology, scheme, state.corner)
    if sharpness is None:
        return rows
    features, ends, n = _features(topology, sharpness), edge_ends(topology), topology.table.n_vertices
    kept = ~(features.semi | features.dart | features.crease | features.corner)
    own, other = CREASE_LIMIT
    along = (sharpness.edges[:, None] >= INFINITE_SHARPNESS) & features.crease[ends]
    fixed, crease = np.flatnonzero(features.corner), np.flatnonzero(features.crease)
    parts = [
        (fixed, fixed, np.ones(len(fixed))),
        (crease, crease, np.full(len(crease), own)),
        (ends[along[:, 0], 0], ends[along[:, 0], 1], np.full(along[:, 0].sum(), other)),
        (ends[along[:, 1], 1], ends[along[:, 1], 0], np.full(along[:, 1].sum(), other)),
    ]
    row, column, weight = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    result = diags_array(kept.astype(np.float64)) @ rows + csr_array((weight, (row, column)), shape=(n, n))
    result = result + _dart_rows(topology, sharpness, scheme, features.dart & wanted)[0]
    if np.any(features.semi & wanted):
        part, vertices, child, followed = _one_step_on(state, scheme, features.semi & wanted)
        chosen = followed[: len(vertices)]
        finer = _limits(child, scheme, followed)[np.flatnonzero(chosen)] @ state_matrix(part, scheme)
        finer = finer.tocoo()
        row, column = vertices[chosen][finer.coords[0]], vertices[finer.coords[1]]
        result = result + csr_array((finer.data, (row, column)), shape=(n, n))
    result = csr_array(result)
    result.eliminate_zeros()
    result.sort_indices()
    return result


def _one_step_on(
    state: MeshState, scheme: SmoothScheme, chosen: BoolArray
) -> tuple[MeshState, IndexArray, MeshState, BoolArray]:
    """What is around some vertices, with its vertices' numbers, and the same a level on, where they come first."""
    part, vertices = _neighbourhood(state, chosen)
    child = next_state(part, scheme)
    followed = np.zeros(child.topology.table.n_vertices, dtype=bool)
    followed[: len(vertices)] = chosen[vertices]
    return part, vertices, child, followed


def _tangents(
    state: MeshState, scheme: SmoothScheme, positions: FloatArray, wanted: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Two tangents of every vertex; rows that are not wanted mean nothing."""
    if state.sharpness is None:
        return ring_tangents(state.topology, scheme, state.corner, positions)
    features = _features(state.topology, state.sharpness)
    tangents = _tangents_of_sides(state, scheme, positions, features.corner)
    for tangent, rows in zip(
        tangents, _dart_rows(state.topology, state.sharpness, scheme, features.dart)[1:], strict=True
    ):
        tangent[features.dart] = (rows @ positions)[features.dart]
    if np.any(features.semi & wanted):
        part, vertices, child, followed = _one_step_on(state, scheme, features.semi & wanted)
        chosen = followed[: len(vertices)]
        finer = _tangents(child, scheme, state_matrix(part, scheme) @ positions[vertices], followed)
        for tangent, values in zip(tangents, finer, strict=True):
            tangent[vertices[chosen]] = values[: len(vertices)][chosen]
    return tangents


def _tangents_of_sides(
    state: MeshState, scheme: SmoothScheme, positions: FloatArray, corner: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Cut the surface along infinite creases, so that each side has its own boundary; then take the mean normal."""
    assert state.sharpness is not None
    topology, table = state.topology, state.topology.table
    cut = state.sharpness.edges >= INFINITE_SHARPNESS
    forward, backward = topology.edge_corners[~cut].T
    pairs = (np.concatenate([forward, table.following[forward]]), np.concatenate([table.following[backward], backward]))
    cut_apart, labels = cut_table(table, components(*pairs, table.n_corners))
    owners = np.empty(len(labels), dtype=np.int64)
    owners[cut_apart.vertices] = table.vertices
    sides = ring_tangents(topology_of_table(cut_apart), scheme, (corner | state.corner)[owners], positions[owners])
    n = table.n_vertices
    normals = np.zeros((n, 3))
    np.add.at(normals, owners, _unit(np.cross(*sides)))
    normals = _unit(normals)
    tangents = np.empty((2, n, 3))
    tangents[:, owners] = sides
    several = np.bincount(owners, minlength=n) > 1
    along = tangents[0] - np.einsum("nx,nx->n", tangents[0], normals)[:, None] * normals
    tangents[0, several] = along[several]
    tangents[1, several] = np.cross(normals, along)[several]
    return tangents[0], tangents[1]


def _neighbourhood(state: MeshState, vertices: BoolArray) -> tuple[MeshState, IndexArray]:
    """Two rings of faces around some vertices as a mesh of their own, and the number of each of its vertices."""
    assert state.sharpness is not None
    table = state.topology.table
    near = vertices
    for _ in range(2):
        faces = np.zeros(table.n_faces, dtype=bool)
        faces[table.faces[near[table.vertices]]] = True
        near = np.zeros(table.n_vertices, dtype=bool)
        near[table.vertices[faces[table.faces]]] = True
    corners = np.flatnonzero(faces[table.faces])
    new = np.zeros(table.n_corners, dtype=np.int32)
    new[corners] = np.arange(len(corners))
    numbers, indices = np.unique(table.vertices[corners], return_inverse=True)
    face_numbers = (np.cumsum(faces) - 1).astype(np.int32)[table.faces[corners]]
    part = topology_of_table(
        table_of(indices, len(numbers), face_numbers, new[table.following[corners]], new[table.previous[corners]])
    )
    start = corners[part.edge_corners[:, 0]]
    edges = table.edges[start]
    halves = np.where(
        table.forward[start][:, None], state.sharpness.halves[edges], state.sharpness.halves[edges][:, ::-1]
    )
    sharpness = Sharpness(
        state.sharpness.edges[edges], halves, state.sharpness.vertices[numbers], state.sharpness.after[numbers]
    )
    return MeshState(part, state.corner[numbers], sharpness), numbers.astype(np.int64)


def _dart_rows(
    topology: Topology, sharpness: Sharpness, scheme: SmoothScheme, dart: BoolArray
) -> tuple[csr_array, csr_array, csr_array]:
    """Weights of limit position and tangents, (n, n) each, at vertices where one infinite crease ends."""
    table = topology.table
    infinite = (sharpness.edges >= INFINITE_SHARPNESS)[table.edges]
    first = np.zeros(table.n_vertices, dtype=np.int32)
    leading = infinite & dart[table.vertices]
    first[table.vertices[leading]] = topology.ranks[leading]
    around = np.flatnonzero(dart[table.vertices])
    centres = table.vertices[around]
    valences = topology.valences[centres]
    ranks = (topology.ranks[around] - first[centres]) % valences
    rings = rings_of(topology, scheme)
    parts: list[tuple[IndexArray, IndexArray, FloatArray]] = [(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)))]
    for valence in np.unique(valences).tolist():
        weights = _dart_weights(scheme, valence)
        alike = valences == valence
        alone = np.unique(centres[alike])
        parts.append((alone, alone, np.repeat(weights[:, :1].T, len(alone), axis=0)))
        for number, ring in enumerate(rings):
            places = 1 + number * valence + ranks[alike]
            parts.append((centres[alike], ring[around[alike]], weights[:, places].T))
    rows, columns, weights = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    shape = (table.n_vertices, table.n_vertices)
    position, first_tangent, second = (csr_array((weights[:, k], (rows, columns)), shape=shape) for k in range(3))
    return position, first_tangent, second


def _dart_weights(scheme: SmoothScheme, valence: int) -> FloatArray:
    """Limit position and tangents at a dart of an infinite crease, from the eigenvectors of its ring's matrix.

    Returns
    -------
    (3, 1 + valence) or (3, 1 + 2 valence) float64
        Weights of the vertex, its neighbours from the crease's other end on, and, among quads, the opposite vertices.
    """
    here = np.arange(valence)
    following = (here + 1) % valence
    quads = not isinstance(scheme, Loop)
    columns = [np.zeros_like(here), 1 + here, *([1 + valence + here] if quads else []), 1 + following]
    faces = np.column_stack(columns)
    size, n = faces.shape[1], 1 + (2 if quads else 1) * valence
    corners = np.arange(faces.size, dtype=np.int32).reshape(faces.shape)
    table = table_of(
        faces.ravel(),
        n,
        np.repeat(here, size).astype(np.int32),
        np.roll(corners, -1, axis=1).ravel(),
        np.roll(corners, 1, axis=1).ravel(),
    )
    topology = topology_of_table(table)
    edges = np.where(topology.edge_corners[:, 1] < 0, INFINITE_SHARPNESS, 0.0)
    spokes = table.edges[corners[:, 0]]
    edges[spokes[0]] = INFINITE_SHARPNESS
    smooth = np.zeros(n)
    sharpness = Sharpness(edges, np.column_stack([edges, edges]), smooth, smooth)
    matrix = subdivision_matrix(topology, scheme, smooth.astype(bool), sharpness)
    ring = np.concatenate([[0], n + spokes, *([n + table.n_edges + here] if quads else [])])
    local = matrix[ring].toarray()
    # The ring is its own mirror image about the crease. One tangent is even, the other odd: apart, neither is repeated.
    mirror = np.concatenate([[0], 1 + (-here) % valence, *([1 + valence + (-1 - here) % valence] if quads else [])])
    even, odd = (_left_eigenvectors(0.5 * (local + sign * local[:, mirror])) for sign in (1, -1))
    weights = np.stack([even[0] / even[0].sum(), even[1], odd[0]])
    # Seen on a flat ring, counter-clockwise, the second tangent has to be on the left of the first.
    angles = 2 * np.pi * np.concatenate([here, here + 0.5]) / valence
    flat = np.column_stack([np.cos(angles), np.sin(angles)])[: n - 1]
    if np.linalg.det(weights[1:, 1:] @ flat) < 0:
        weights[2] *= -1
    return weights


def _left_eigenvectors(matrix: FloatArray) -> FloatArray:
    """Left eigenvectors in rows, that of the largest eigenvalue first."""
    values, vectors = np.linalg.eig(matrix.T)
    return np.asarray(vectors[:, np.argsort(-values.real)].real.T)
