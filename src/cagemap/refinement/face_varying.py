"""Face-varying values (UVs), refined by the surface's own rules on their own topology, so that seams stay seams.

The UV layout is the mesh cut along its seams: a vertex of the layout is a mesh vertex together with one of its UVs.
Seams are boundaries there and follow the rules of boundaries; the six modes only say which values on them are corners.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from cagemap.mesh import ControlMesh
from cagemap.mesh.schemes import INFINITE_SHARPNESS, Bilinear, Loop, Scheme
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.refinement.matrices import subdivision_matrix
from cagemap.refinement.sharpness import Sharpness
from cagemap.refinement.state import MeshState, children, control_state, next_state, split_topology
from cagemap.refinement.topology import BoolArray, CornerTable, Topology, control_table, topology_of_table

# UVs (p, 2) of a level, and the UV of every corner of its faces.
Layout: TypeAlias = tuple[FloatArray, IndexArray]

_DEPENDENT = ("corners_plus1", "corners_plus2")


@dataclass(frozen=True, eq=False)
class UvLayout:
    """Topology of the UVs of one level, with what the mode decided.

    Attributes
    ----------
    topology : Topology
        Its vertices are the UVs.
    kept : (p,) bool
        UVs on a seam or on the boundary that stay what they are.
    follows : (p,) int64 or None
        The UV whose sharpness counts for each; itself, but for the smooth one of two where the other is semi-sharp.
    """

    topology: Topology
    kept: BoolArray
    follows: IndexArray | None = None


def is_linear(scheme: Scheme) -> bool:
    """Whether UVs are refined linearly everywhere; positions under `Bilinear` are too."""
    return scheme.uv_interpolation == "all" or isinstance(scheme, Bilinear)


def control_layout(control: ControlMesh, state: MeshState, scheme: Scheme) -> tuple[UvLayout, FloatArray]:
    """UV layout of a control mesh, and the value of each of its vertices.

    Parameters
    ----------
    control : ControlMesh
        With UVs.
    state : MeshState
        Of the mesh itself.
    scheme : Scheme

    Returns
    -------
    layout : UvLayout
    values : (p, 2) float64
        As in ``control.uvs``, but once per mesh vertex that has the value.
    """
    assert control.uvs is not None
    assert control.uv_indices is not None
    pairs = control.uv_indices * control.n_vertices + control.face_indices
    unique, numbers = np.unique(pairs, return_inverse=True)
    values, owners = np.divmod(unique, control.n_vertices)
    cut = topology_of_table(control_table(control, numbers.astype(np.int64), len(unique)))
    kept = np.zeros(len(unique), dtype=bool)
    layout = UvLayout(cut, kept)
    if not is_linear(scheme):
        around = layout_sharpness(layout, state)
        kept, follows = _kept_values(cut, state.topology, owners, around, scheme.uv_interpolation)
        layout = UvLayout(cut, cut.boundary & (kept | (around.vertices >= INFINITE_SHARPNESS)), follows)
    return layout, control.uvs[values]


def _kept_values(
    cut: Topology, topology: Topology, owners: IndexArray, around: Sharpness, mode: str
) -> tuple[BoolArray, IndexArray | None]:
    """Which UVs on seams and boundaries stay, and whose sharpness each follows.

    Parameters
    ----------
    owners : (p,) int64
        Mesh vertex of every UV.
    around : Sharpness
        In the layout.
    """
    if mode == "boundaries":
        return cut.boundary, None
    n = topology.table.n_vertices
    single = cut.boundary & (cut.valences == 1)
    inside = cut.edge_corners[:, 1] >= 0
    infinite = _touched(cut, inside & (around.edges >= INFINITE_SHARPNESS))
    separate = np.zeros(len(owners), dtype=bool)
    separate[cut.table.vertices[cut.ranks < 0]] = True
    kept = separate | infinite
    if mode == "none":
        return kept, None
    follows = None
    if mode in _DEPENDENT:
        n_values = np.bincount(owners, minlength=n)[owners]
        other = _other_of_two(owners, n_values)
        causes = kept | single if mode == "corners_plus2" else kept
        kept = kept | (n_values > 2) | ((n_values == 2) & (causes | causes[other]))
        semi = _touched(cut, inside & (around.edges > 0) & (around.edges < INFINITE_SHARPNESS))
        smooth_one = (n_values == 2) & ~semi & semi[other] & ~(around.vertices > 0) & ~(kept | single)
        if smooth_one.any():
            follows = np.where(smooth_one, other, np.arange(len(owners)))
        if mode == "corners_plus2":
            seam_end = cut.boundary & (n_values == 1) & ~topology.boundary[owners]
            kept = kept | seam_end
    return kept | single, follows


def _touched(cut: Topology, edges: BoolArray) -> BoolArray:
    """(p,) vertices at some of the edges."""
    table = cut.table
    corners = edges[table.edges]
    result = np.zeros(table.n_vertices, dtype=bool)
    result[table.vertices[corners]] = True
    result[table.vertices[table.following[corners]]] = True
    return result


def _other_of_two(owners: IndexArray, n_values: IndexArray) -> IndexArray:
    """The other UV of the same vertex, where a vertex has two; else the UV itself."""
    other = np.arange(len(owners))
    twins = np.flatnonzero(n_values == 2)
    pairs = twins[np.argsort(owners[twins], kind="stable")].reshape(-1, 2)
    other[pairs] = pairs[:, ::-1]
    return other


def layout_sharpness(layout: UvLayout, state: MeshState) -> Sharpness:
    """The mesh's sharpness as the UVs see it: seams are infinitely sharp, and so are values that are kept."""
    cut, table, sharpness = layout.topology, state.topology.table, state.sharpness
    forward = cut.edge_corners[:, 0]
    outer = cut.edge_corners[:, 1] < 0
    owners = np.empty(cut.table.n_vertices, dtype=np.int64)
    owners[cut.table.vertices] = table.vertices
    edges, halves = np.zeros(len(outer)), np.zeros((len(outer), 2))
    vertices = np.where(state.corner, INFINITE_SHARPNESS, 0.0)
    after = vertices
    if sharpness is not None:
        numbers = table.edges[forward]
        edges = sharpness.edges[numbers]
        halves = sharpness.halves[numbers]
        halves = np.where(table.forward[forward][:, None], halves, halves[:, ::-1])
        vertices, after = sharpness.vertices, sharpness.after
    edges[outer], halves[outer] = INFINITE_SHARPNESS, INFINITE_SHARPNESS
    vertices = np.where(layout.kept, INFINITE_SHARPNESS, vertices[owners])
    after = np.where(layout.kept, INFINITE_SHARPNESS, after[owners])
    return Sharpness(edges, halves, vertices, after)


def next_layout(layout: UvLayout, child: Topology, scheme: Scheme) -> UvLayout:
    """Layout of the next level: values keep their rule, and new ones on seams are kept in mode ``boundaries`` only."""
    new = child.table.n_vertices - len(layout.kept)
    kept = np.concatenate([layout.kept, np.zeros(new, dtype=bool)])
    if scheme.uv_interpolation == "boundaries":
        kept = child.boundary
    follows = layout.follows
    if follows is not None:
        follows = np.concatenate([follows, np.arange(len(follows), child.table.n_vertices)])
    return replace(layout, topology=child, kept=kept, follows=follows)


def refined_layout(control: ControlMesh, levels: int, scheme: Scheme) -> Layout:
    """UVs (p, 2) of a level from 1 on, and the UV of every corner of its faces (m, 4) or (m, 3)."""
    state = control_state(control, scheme)
    layout, uvs = control_layout(control, state, scheme)
    for step in range(levels):
        if step:
            state = state if is_linear(scheme) else next_state(state, scheme)
            layout = next_layout(layout, split_topology(layout.topology, scheme), scheme)
        uvs = refine_uvs(layout, uvs, state, scheme)
    return uvs, children(layout.topology.table, scheme).astype(np.int64)


def refine_uvs(layout: UvLayout, uvs: FloatArray, state: MeshState, scheme: Scheme) -> FloatArray:
    """One step: linear, or in any mode but ``all`` the step of the surface, taken on the layout.

    Parameters
    ----------
    layout : UvLayout
    uvs : (p, 2) float64
    state : MeshState
        Of the mesh at the same level.
    scheme : Scheme

    Returns
    -------
    (p + e, 2) or (p + e + m, 2) float64
    """
    if is_linear(scheme):
        return refine_linearly(layout.topology.table, uvs, with_face_points=not isinstance(scheme, Loop))
    around = None if state.sharpness is None else layout_sharpness(layout, state)
    fixed = layout.kept
    if around is not None:
        fixed = layout.topology.boundary & (around.vertices >= INFINITE_SHARPNESS)
    refined: FloatArray = subdivision_matrix(layout.topology, scheme, fixed, around, layout.follows) @ uvs
    return refined


def refine_linearly(table: CornerTable, uvs: FloatArray, *, with_face_points: bool) -> FloatArray:
    """One linear step: values stay, edges get midpoints, faces (not under Loop) the mean of their corners.

    OpenSubdiv calls it ``FVAR_LINEAR_ALL``.

    Parameters
    ----------
    table : CornerTable
        Corner table of the UV layout.
    uvs : (p, 2) float64

    Returns
    -------
    (p + e, 2) or (p + e + m, 2) float64
    """
    # One corner of every edge is enough: the others would write the same value.
    chosen = np.flatnonzero(table.forward)
    midpoints = np.empty((table.n_edges, uvs.shape[1]))
    midpoints[table.edges[chosen]] = 0.5 * (uvs[table.vertices[chosen]] + uvs[table.vertices[table.following[chosen]]])
    if not with_face_points:
        return np.concatenate([uvs, midpoints])
    if table.has_only(4):
        a, b, c, d = (uvs[table.vertices[k::4]] for k in range(4))
        return np.concatenate([uvs, midpoints, 0.25 * ((a + c) + (b + d))])
    starts = np.flatnonzero(np.diff(table.faces, prepend=-1))
    sizes = np.diff(starts, append=table.n_corners)
    centroids = np.add.reduceat(uvs[table.vertices], starts, axis=0) / sizes[:, None]
    return np.concatenate([uvs, midpoints, centroids])
