"""Where the refined vertices end: limit positions and normals, exact at every vertex of every level.

The local subdivision matrix A maps a vertex and its ring to the vertex and ring one level finer. Its left eigenvectors
give the limit: position from eigenvalue 1, tangents from the two largest that follow [HKD93]_. Interior vertices have
closed formulas (`schemes`); on the boundary the tangent that leads inwards is taken from the eigenvectors of A itself,
because the known formulas belong to modified boundary rules and are degrees off these ones.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from cagemap.errors import ParameterError
from cagemap.mesh import FloatArray
from cagemap.refinement.matrices import RowFiller, put_sharp_rows, put_smooth_rows, vertex_kinds
from cagemap.refinement.refinement import Refinement, topology_of
from cagemap.refinement.schemes import CREASE_LIMIT, CatmullClark, Loop, Scheme
from cagemap.refinement.topology import BoolArray, IntArray, Topology


def limit_matrix(refinement: Refinement, level: int) -> csr_array:
    """Weights of the limit positions of a level's vertices in that level's positions.

    Smooth: the schemes' ``limit_weights``; boundary: 1/6, 2/3, 1/6; corner: itself.

    Parameters
    ----------
    refinement : Refinement
    level : int
        From 0 to L; 0 only where Loop runs or all control faces are quads.

    Returns
    -------
    (n_level, n_level) csr_array
        Rows sum to 1.

    Raises
    ------
    ParameterError
        If there is no such level, or level 0 has faces that are not quads under Catmull-Clark.
    """
    topology = _checked_topology(refinement, level)
    scheme = refinement.scheme
    crease, corner = vertex_kinds(topology, scheme)
    rows = _ring_rows(topology, scheme, corner)
    own, *each = scheme.limit_weights(topology.valences)
    rings = zip(_rings(topology, scheme), each, strict=True)
    put_smooth_rows(rows, topology, ~topology.boundary, own, *rings)
    put_sharp_rows(rows, topology, crease, corner, CREASE_LIMIT)
    # Around an interior vertex of valence 2 a vertex may be in the ring twice.
    return rows.matrix(topology.table.n_vertices, repeats=True)


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

    Exact wherever the surface has one. It has none at interior vertices of valence 2, nor at boundary vertices with so
    many faces (more than 3 under Catmull-Clark, 5 under Loop) that the boundary curve no longer leads their shape;
    there the result is the nearest reasonable direction. It is zero where the surface itself is degenerate.

    Raises
    ------
    ParameterError
        As for `limit_positions`.
    """
    if level == 0 and not _has_limit_rings(refinement, 0) and refinement.n_levels:
        return limit_normals(refinement, 1)[: refinement.levels[0].n_vertices]
    first, second = tangent_matrices(refinement, level)
    positions = refinement.levels[level].positions
    normals = np.cross(first @ positions, second @ positions)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)


def tangent_matrices(refinement: Refinement, level: int) -> tuple[csr_array, csr_array]:
    """Two independent limit tangents of every vertex, as weights of the level's positions.

    Their cross product is outward. Each is (n_level, n_level) and its rows sum to 0; their lengths mean nothing.
    """
    topology = _checked_topology(refinement, level)
    scheme = refinement.scheme
    table = topology.table
    interior_corner = ~topology.boundary[table.vertices]
    weights: tuple[FloatArray, ...] = scheme.tangent_weights(topology.valences[table.vertices], topology.ranks)
    half = len(weights) // 2
    if isinstance(scheme, CatmullClark):
        weights = _with_valence_2_tangents(topology, weights)
    _, corner = vertex_kinds(topology, scheme)
    result = []
    for number, ring_weights in enumerate((weights[:half], weights[half:])):
        entries = [
            (table.vertices[interior_corner], ring[interior_corner], weight[interior_corner])
            for ring, weight in zip(_rings(topology, scheme), ring_weights, strict=True)
        ]
        entries += _boundary_tangents(topology, scheme, corner, number)
        rows, columns, values = (np.concatenate(part) for part in zip(*entries, strict=True))
        shape = (table.n_vertices, table.n_vertices)
        result.append(csr_array((values, (rows, columns)), shape=shape))
    return result[0], result[1]


def _has_limit_rings(refinement: Refinement, level: int) -> bool:
    if level > 0 or isinstance(refinement.scheme, Loop):
        return True
    return bool(np.all(refinement.control.face_sizes == 4))


def _checked_topology(refinement: Refinement, level: int) -> Topology:
    if not 0 <= level <= refinement.n_levels:
        raise ParameterError(f"level: expected 0 to {refinement.n_levels}, got {level}; refine further to have more")
    if not _has_limit_rings(refinement, level):
        raise ParameterError("level: expected quads only, got level 0 of a mesh with other faces; use level 1")
    return topology_of(refinement, level)


def _rings(topology: Topology, scheme: Scheme) -> list[IntArray]:
    """Per corner: the next vertex of its face, and under Catmull-Clark also the opposite one."""
    table = topology.table
    neighbours = table.vertices[table.following]
    return [neighbours] if isinstance(scheme, Loop) else [neighbours, neighbours[table.following]]


def _ring_rows(topology: Topology, scheme: Scheme, corner: BoolArray) -> RowFiller:
    n_rings = 1 if isinstance(scheme, Loop) else 2
    lengths = np.where(topology.boundary, 3, 1 + n_rings * topology.valences)
    lengths[corner] = 1
    return RowFiller(lengths)


def _with_valence_2_tangents(topology: Topology, weights: tuple[FloatArray, ...]) -> tuple[FloatArray, ...]:
    """At valence 2: along the two edges, and between the two opposite vertices.

    The surface has no tangent plane there; this makes the normal that of the ring's polygon.
    """
    here = topology.valences[topology.table.vertices] == 2
    sign = np.where(topology.ranks == 0, 1.0, -1.0)
    replaced = (sign, np.zeros(len(sign)), np.zeros(len(sign)), sign)
    return tuple(np.where(here, new, old) for new, old in zip(replaced, weights, strict=True))


Entries = tuple[IntArray, IntArray, FloatArray]


def _boundary_tangents(topology: Topology, scheme: Scheme, corner: BoolArray, number: int) -> list[Entries]:
    """Entries (row, column, weight) of tangent ``number`` of boundary vertices: along the curve (0), inwards (1)."""
    table = topology.table
    curve = topology.boundary_corners
    # The curve leaves vertex `here` towards `after`, and came from `before`; faces lie on its left.
    here, after = table.vertices[curve], table.vertices[table.following[curve]]
    before = np.empty(table.n_vertices, dtype=np.int32)
    before[after] = here
    before = before[here]
    stays = corner[here].astype(np.float64)
    if number == 0:
        return [(here, after, np.ones(len(here))), (here, before, stays - 1), (here, here, -stays)]
    single = topology.valences[here] == 1
    # A corner's surface is spanned by its two edges; a curve through a single face by its two derivatives.
    entries = [
        (here[single], before[single], np.ones(int(single.sum()))),
        (here[single], here[single], stays[single] - 2),
        (here[single], after[single], 1 - stays[single]),
    ]
    corners_at = np.flatnonzero(topology.boundary[table.vertices])
    for valence in np.unique(topology.valences[here[~single]]):
        centre, edges, faces = inward_tangent(int(valence), scheme)
        chosen = topology.valences[here] == valence
        entries.append((here[chosen], here[chosen], np.full(int(chosen.sum()), centre)))
        entries.append((here[chosen], before[chosen], np.full(int(chosen.sum()), edges[-1])))
        corners = corners_at[topology.valences[table.vertices[corners_at]] == valence]
        ring_weights = (edges[:-1], faces)
        for ring, ring_weight in zip(_rings(topology, scheme), ring_weights, strict=False):
            entries.append((table.vertices[corners], ring[corners], ring_weight[topology.ranks[corners]]))
    return entries


def inward_tangent(valence: int, scheme: Scheme) -> tuple[float, FloatArray, FloatArray]:
    """Tangent that leads from the boundary into the surface at a boundary vertex with ``valence`` >= 2 faces.

    The interior part of the ring (inner edges, and under Catmull-Clark opposite vertices) has a subdivision matrix of
    its own, A_I, fed by the boundary part through C. The wanted left eigenvector (w_B, w_I) of
    ``[[A_B, 0], [C, A_I]]`` has ``w_I A_I = lambda w_I`` for the largest lambda of A_I and
    ``w_B (lambda - A_B) = w_I C``.

    Returns
    -------
    centre : float
        Weight of the vertex.
    edges : (valence + 1,) float64
        Of its neighbours, counter-clockwise; the first and last are on the boundary.
    faces : (valence,) float64
        Of the opposite vertices; empty under Loop.
    """
    local = _boundary_ring_matrix(valence, scheme)
    on_boundary = np.zeros(len(local), dtype=bool)
    on_boundary[[0, 1, valence + 1]] = True
    inner, fed = local[~on_boundary][:, ~on_boundary], local[~on_boundary][:, on_boundary]
    curve = local[on_boundary][:, on_boundary]
    eigenvalues, vectors = np.linalg.eig(inner.T)
    leading = int(np.argmax(eigenvalues.real))
    value, direction = eigenvalues[leading].real, vectors[:, leading].real
    direction = direction / direction.sum()
    # lambda = 1/2 is also an eigenvalue of the curve (regular case): any solution will do, they differ by its tangent.
    along = np.linalg.lstsq((value * np.eye(3) - curve).T, fed.T @ direction, rcond=1e-10)[0]
    weights = np.empty(len(local))
    weights[on_boundary], weights[~on_boundary] = along, direction
    return float(weights[0]), weights[1 : valence + 2], weights[valence + 2 :]


def _boundary_ring_matrix(valence: int, scheme: Scheme) -> FloatArray:
    """Local subdivision matrix at a boundary vertex: the vertex, ``valence + 1`` neighbours, opposite vertices."""
    quads = isinstance(scheme, CatmullClark)
    edge, face = 1 + np.arange(valence + 1), 2 + valence + np.arange(valence)
    local = np.zeros((2 * valence + 2 if quads else valence + 2,) * 2)
    local[0, [0, 1, valence + 1]] = 3 / 4, 1 / 8, 1 / 8
    for k in (0, valence):
        local[edge[k], [0, edge[k]]] = 1 / 2
    end, other = scheme.quad_edge_weights() if isinstance(scheme, CatmullClark) else scheme.edge_weights()
    for k in range(1, valence):
        local[edge[k], [0, edge[k]]] = end
        local[edge[k], [edge[k - 1], edge[k + 1]]] = other
        if quads:
            local[edge[k], [face[k - 1], face[k]]] = other
    for k in range(valence if quads else 0):
        local[face[k], [0, edge[k], edge[k + 1], face[k]]] = 1 / 4
    return local
