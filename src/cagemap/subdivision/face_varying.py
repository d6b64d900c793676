"""Refine face-varying values: UVs by subdivision of the mesh cut along its seams, other values linearly.

A vertex of the UV layout is a pair of a mesh vertex and one of its UVs. Seams are boundaries of the layout; the six
modes differ in which boundary values are fixed (``corner``). Sharpness is taken from the mesh (`_with_sharpness`).

Values painted on a cage are interpolated linearly over its faces: subdivision would smooth a weight of 1 at one control
vertex to 0.45. Vertices keep their value, edges get the midpoint, faces the mean.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeAlias

import numpy as np
from scipy import sparse

from cagemap.mesh import ControlMesh
from cagemap.mesh.schemes import INFINITE_SHARPNESS, Bilinear, Loop, Scheme
from cagemap.mesh.topology import BoolArray, Topology, layout_topology
from cagemap.numerics.arrays import FloatArray, IndexArray, mask_of
from cagemap.subdivision.matrices import linear_matrix, subdivision_matrix
from cagemap.subdivision.topology import MeshState, children, control_state, next_state, split_topology
from cagemap.surface.triangles import fan_triangles, triangles

Layout: TypeAlias = tuple[FloatArray, IndexArray]  # UVs (p, 2) of a level, UV of every corner of its faces

_DEPENDENT = ("corners_plus1", "corners_plus2")


def refined_layout(control: ControlMesh, levels: int, scheme: Scheme) -> Layout:
    """UVs (p, 2) of level 1 or higher, and the UV of every corner of its faces (m, 4) or (m, 3)."""
    state = control_state(control, scheme)
    layout, uvs = control_layout(control, state, scheme)
    for step in range(levels):
        if step:
            state = state if _is_linear(scheme) else next_state(state, scheme)
            layout = _next_layout(layout, scheme)
        uvs = _layout_matrix(layout, state, scheme) @ uvs
    return uvs, children(layout.topology, scheme).astype(np.int64)


def control_layout(control: ControlMesh, state: MeshState, scheme: Scheme) -> tuple[MeshState, FloatArray]:
    """UV layout of a control mesh, and values (p, 2) of every pair of vertex and UV."""
    assert control.uvs is not None
    assert control.uv_indices is not None
    pairs = control.uv_indices * control.n_vertices + control.face_indices
    unique, numbers = np.unique(pairs, return_inverse=True)
    values, owners = np.divmod(unique, control.n_vertices)
    cut = layout_topology(control, numbers.astype(np.int64), len(unique))
    layout = MeshState(cut, np.zeros(len(unique), dtype=bool))
    if not _is_linear(scheme):
        sharp_layout = _with_sharpness(layout, state)
        fixed, follows = _fixed_values(sharp_layout, state.topology, owners, scheme.uv_interpolation)
        fixed = cut.boundary & (fixed | (sharp_layout.vertices >= INFINITE_SHARPNESS))
        layout = MeshState(cut, fixed, follows=follows)
    return layout, control.uvs[values]


def _fixed_values(
    layout: MeshState, topology: Topology, owners: IndexArray, mode: str
) -> tuple[BoolArray, IndexArray | None]:
    """Fixed UVs of a mode, and `MeshState.follows`; UVs belong to mesh vertices ``owners`` (p,)."""
    cut = layout.topology
    if mode == "boundaries":
        return cut.boundary, None
    single = cut.boundary & (cut.valences == 1)
    inside = ~cut.outer_edges
    fixed = mask_of(cut.edge_ends[inside & (layout.edges >= INFINITE_SHARPNESS)], cut.n_vertices)
    fixed[cut.vertices[cut.ranks < 0]] = True  # separate fans
    if mode == "none":
        return fixed, None
    follows = None
    if mode in _DEPENDENT:
        n_values = np.bincount(owners, minlength=topology.n_vertices)[owners]
        twin = np.arange(len(owners))  # the other UV of a vertex with two
        twins = np.flatnonzero(n_values == 2)
        both = twins[np.argsort(owners[twins], kind="stable")].reshape(-1, 2)
        twin[both] = both[:, ::-1]
        causes = fixed | single if mode == "corners_plus2" else fixed
        fixed = fixed | (n_values > 2) | ((n_values == 2) & (causes | causes[twin]))
        semi_sharp = inside & (layout.edges > 0) & (layout.edges < INFINITE_SHARPNESS)
        semi = mask_of(cut.edge_ends[semi_sharp], cut.n_vertices)
        smooth_one = (n_values == 2) & ~semi & semi[twin] & ~(layout.vertices > 0) & ~(fixed | single)
        if smooth_one.any():
            follows = np.where(smooth_one, twin, np.arange(len(owners)))
        if mode == "corners_plus2":
            seam_end = cut.boundary & (n_values == 1) & ~topology.boundary[owners]
            fixed = fixed | seam_end
    return fixed | single, follows


def _with_sharpness(layout: MeshState, state: MeshState) -> MeshState:
    """The layout with the sharpness of the mesh; seams and fixed values are infinitely sharp."""
    cut, topology = layout.topology, state.topology
    forward = cut.edge_corners[:, 0]
    outer = cut.outer_edges
    owners = np.empty(cut.n_vertices, dtype=np.int64)
    owners[cut.vertices] = topology.vertices
    edges, halves = np.zeros(len(outer)), np.zeros((len(outer), 2))
    vertices = np.where(state.corner, INFINITE_SHARPNESS, 0.0)
    after = vertices
    if state.is_sharp:
        of_mesh, is_forward = topology.edges[forward], topology.forward[forward]
        edges, halves = state.edges[of_mesh], state.halves[of_mesh]
        halves = np.where(is_forward[:, None], halves, halves[:, ::-1])
        vertices, after = state.vertices, state.after
    edges[outer], halves[outer] = INFINITE_SHARPNESS, INFINITE_SHARPNESS
    vertices = np.where(layout.corner, INFINITE_SHARPNESS, vertices[owners])
    after = np.where(layout.corner, INFINITE_SHARPNESS, after[owners])
    return replace(layout, edges=edges, halves=halves, vertices=vertices, after=after)


def _next_layout(layout: MeshState, scheme: Scheme) -> MeshState:
    """Layout of the next level; new values on seams are fixed in mode ``boundaries`` only."""
    child, follows = split_topology(layout.topology, scheme), layout.follows
    fixed = child.boundary
    if scheme.uv_interpolation != "boundaries":
        fixed = np.concatenate([layout.corner, np.zeros(child.n_vertices - len(layout.corner), dtype=bool)])
    if follows is not None:
        follows = np.concatenate([follows, np.arange(len(follows), child.n_vertices)])
    return replace(layout, topology=child, corner=fixed, follows=follows)


def _layout_matrix(layout: MeshState, state: MeshState, scheme: Scheme) -> sparse.csr_array:
    """Matrix from UVs to those of the next level: linear if `_is_linear`, else of a subdivision step on the layout."""
    if _is_linear(scheme):
        return linear_matrix(layout.topology, not isinstance(scheme, Loop))
    if state.is_sharp:
        layout = _with_sharpness(layout, state)
        layout = replace(layout, corner=layout.topology.boundary & (layout.vertices >= INFINITE_SHARPNESS))
    return subdivision_matrix(layout, scheme)


def _is_linear(scheme: Scheme) -> bool:
    """Whether UVs are refined linearly everywhere: mode ``all``, or `Bilinear`."""
    return scheme.uv_interpolation == "all" or isinstance(scheme, Bilinear)


def interpolate_linearly(
    control: ControlMesh, nodes: IndexArray, count: int, level: int, scheme: Scheme
) -> tuple[sparse.csr_array, IndexArray]:
    """Linear interpolation at a level: weights (p, count) of its nodes, and the nodes of its triangles (t, 3).

    ``nodes`` (c,), below ``count``, are the vertex of every face corner, or a node of `merged_corners`: corners of one
    node share its value. All corners of a node must belong to one vertex.
    """
    if level == 0:
        identity = sparse.csr_array(sparse.eye_array(count, format="csr"))
        return identity, fan_triangles(control.face_offsets, nodes)[0]
    with_faces = not isinstance(scheme, Loop)
    topology = layout_topology(control, nodes, count)
    matrix = linear_matrix(topology, with_faces)
    for _ in range(level - 1):
        topology = split_topology(topology, scheme)
        matrix = sparse.csr_array(linear_matrix(topology, with_faces) @ matrix)
    return matrix, triangles(children(topology, scheme).astype(np.int64))


def corner_triangles(control: ControlMesh, level: int, scheme: Scheme) -> IndexArray:
    """(c,) triangle of a level at every control face corner, its first vertex from level 1 on."""
    corners = np.arange(len(control.face_indices))
    if level == 0:
        # In a face's fan the last two corners share the last triangle, the first two the first one.
        faces, sizes = control.corner_faces, control.face_sizes
        within = corners - control.face_offsets[faces]
        return np.asarray((np.cumsum(sizes - 2) - (sizes - 2))[faces] + np.clip(within - 1, 0, sizes[faces] - 3))
    # A child's first corner is its parent's corner (subdivision.topology).
    if not isinstance(scheme, Loop):
        return 2 * 4 ** (level - 1) * corners
    return 4 ** (level - 1) * (4 * (corners // 3) + corners % 3)
