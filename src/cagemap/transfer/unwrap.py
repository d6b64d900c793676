"""Unwrap a control mesh into UV islands of whole polygons, so that refined UVs stay inside.

xatlas cuts the triangulated mesh into charts and flattens them. Refinement works on polygons: a polygon whose triangles
lie in different charts, or whose flat outline is not convex, would fold when its UVs are refined. Such a *loose*
polygon is attached to a chart that holds a part of it, if it does not overlap the chart. Otherwise it becomes an
island. Islands are then packed again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from cagemap.errors import InvalidMeshError
from cagemap.mesh import ControlMesh, Plain
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.inputs import MeshLike, arrays_accepted
from cagemap.numerics.arrays import FloatArray, IndexArray, label_components
from cagemap.numerics.process import import_library
from cagemap.subdivision import refine
from cagemap.transfer.packing import pack_islands

# Rounding of the cross product at straight corners, relative to the product of the edges.
_STRAIGHT = -1e-9
# Levels of refinement after which control vertices are near the surface.
_SMOOTHING = 2
# Least area of a polygon, relative to its squared perimeter; below it counts as folded.
_FLAT = 1e-6
# Pairs of polygons compared per block.
_PAIRS = 2**18


@arrays_accepted
def unwrap(control: MeshLike, *, padding: float = 1 / 256) -> ControlMesh:
    """Give a control mesh texture coordinates.

    Parameters
    ----------
    control : mesh, see `cagemap.mesh.inputs.control_mesh`
        Any polygon mesh; texture coordinates it already has are replaced.
    padding : float
        Distance between islands, as a part of the image's side; half of it to the border.

    Returns
    -------
    ControlMesh
        With UVs in the unit square, of one density: the area of an island is proportional to that of its polygons.
        Islands do not overlap, nor do the linearly refined UVs; none is mirrored. The same mesh gives the same UVs.

    Raises
    ------
    InvalidMeshError
        If the mesh has no extent.
    ParameterError
        If the padding is negative, or leaves no room for the islands.
    """
    low, high = control.positions.min(axis=0, initial=np.inf), control.positions.max(axis=0, initial=-np.inf)
    size = float((high - low).max())
    if control.n_faces == 0 or not (np.isfinite(size) and size > 0):
        raise InvalidMeshError(f"{control.name}: expected a mesh with faces and an extent to unwrap, got none")
    positions = (control.positions - low) / size
    if not isinstance(control.scheme, Plain):  # the surface is less bent than its cage and needs fewer cuts
        smooth = refine(control.with_positions(positions).with_uvs(None, None), _SMOOTHING).finest
        positions = smooth.positions[: control.n_vertices]
    flat, corner_uvs = _attach_loose(control, positions, _charts(positions, cage_triangles(control)[0]))
    # Islands are connected components of polygons.
    islands = label_components(corner_uvs, corner_uvs[control.next_corners], len(flat))
    uvs = _equalize(control, positions, flat, corner_uvs, islands)
    edges = np.column_stack([corner_uvs, corner_uvs[control.next_corners]])
    return control.with_uvs(pack_islands(uvs, edges, islands, padding), corner_uvs)


@dataclass(frozen=True, eq=False)
class _Charts:
    """Charts of xatlas: UVs and their vertices, UV triangles, and the chart of every triangle (-1: none)."""

    uvs: FloatArray
    vertices: IndexArray
    triangles: IndexArray
    chart: IndexArray


def _charts(positions: FloatArray, triangles: IndexArray) -> _Charts:
    """Cut a triangle mesh into flat charts, in the mesh's own length unit, none mirrored."""
    xatlas = import_library("xatlas", "UV layouts (`unwrap`)")
    atlas = xatlas.Atlas()
    atlas.add_mesh(positions.astype(np.float32), triangles.astype(np.uint32))
    charting, packing = xatlas.ChartOptions(), xatlas.PackOptions()
    charting.max_cost, charting.normal_deviation_weight = 8.0, 1.0  # larger charts: stretch is cheaper than seams
    packing.resolution = 1024
    atlas.generate(charting, packing)
    vertices, uv_triangles, uvs = (np.asarray(array) for array in atlas[0])
    corners = uv_triangles.astype(np.int64)
    chart = np.full(len(triangles), -1, dtype=np.int64)
    for number in range(atlas.get_mesh_chart_count(0)):
        chart[np.asarray(atlas.get_mesh_chart(0, number).faces, dtype=np.int64)] = number
    scaled = uvs.astype(np.float64) * (atlas.width, atlas.height) / max(atlas.texels_per_unit, 1e-30)
    first_edge, second_edge = scaled[corners[:, 1:]].transpose(1, 0, 2) - scaled[corners[:, 0]]
    turning = np.bincount(chart + 1, _cross(first_edge, second_edge))[1:]
    mirrored = (chart >= 0) & (np.append(turning, 0.0)[chart] < 0)
    scaled[np.unique(corners[mirrored]), 0] *= -1
    return _Charts(scaled, vertices.astype(np.int64), corners, chart)


def _attach_loose(control: ControlMesh, positions: FloatArray, charts: _Charts) -> tuple[FloatArray, IndexArray]:
    """UVs (p, 2) and the UV of every corner (c,), with loose polygons attached or placed on their own."""
    corner_uvs, chart = _whole_polygons(control, charts)
    _loosen_overlaps(control, charts.uvs, corner_uvs, chart)
    uvs = [charts.uvs]
    n_uvs = len(charts.uvs)
    per_face = control.face_sizes - 2
    first_triangle = np.cumsum(per_face) - per_face
    for face in np.flatnonzero(chart < 0):
        corners = slice(control.face_offsets[face], control.face_offsets[face + 1])
        vertices = control.face_indices[corners]
        outline = _outline(positions[vertices])
        face_triangles = np.arange(first_triangle[face], first_triangle[face] + per_face[face])
        placed = None
        for candidate in np.unique(charts.chart[face_triangles[charts.chart[face_triangles] >= 0]]):
            known = _known_corners(charts, face_triangles[charts.chart[face_triangles] == candidate], vertices)
            neighbors = np.flatnonzero(chart == candidate)
            placed = _lay_against(outline, known, np.concatenate(uvs), control, corner_uvs, neighbors)
            if placed is not None:
                chart[face] = candidate
                break
        if placed is None:
            known, placed = np.full(len(vertices), -1), outline
        new_corners = np.flatnonzero(known < 0)
        corner_uvs[corners] = known
        corner_uvs[control.face_offsets[face] + new_corners] = n_uvs + np.arange(len(new_corners))
        uvs.append(placed[new_corners])
        n_uvs += len(new_corners)
    used, renumbered = np.unique(corner_uvs, return_inverse=True)
    return np.concatenate(uvs)[used], renumbered


def _whole_polygons(control: ControlMesh, charts: _Charts) -> tuple[IndexArray, IndexArray]:
    """UV of every corner (c,), and chart of every face (m,); -1 if the polygon is cut, missing or not convex."""
    per_face = control.face_sizes - 2
    face = np.repeat(np.arange(control.n_faces), per_face)
    first_triangle = np.cumsum(per_face) - per_face
    step = np.arange(len(face)) - first_triangle[face]
    begin = control.face_offsets[:-1]
    corner_uvs = np.empty(len(control.face_indices), dtype=np.int64)
    corner_uvs[begin] = charts.triangles[first_triangle, 0]
    corner_uvs[begin + 1] = charts.triangles[first_triangle, 1]
    corner_uvs[begin[face] + step + 2] = charts.triangles[:, 2]
    agree = (
        (charts.triangles[:, 0] == corner_uvs[begin[face]])
        & (charts.triangles[:, 1] == corner_uvs[begin[face] + step + 1])
        & (charts.chart >= 0)
    )
    whole = np.bincount(face, agree, minlength=control.n_faces) == per_face
    whole &= _convex_faces(control, charts.uvs[corner_uvs])
    chart = np.where(whole, charts.chart[first_triangle], -1)
    corner_uvs[~np.repeat(whole, control.face_sizes)] = -1
    return corner_uvs, chart


def _loosen_overlaps(control: ControlMesh, uvs: FloatArray, corner_uvs: IndexArray, chart: IndexArray) -> None:
    """Remove polygons from charts, in place, until none overlap: charts of xatlas may overlap themselves."""
    pairs = _overlapping_pairs(control, uvs, corner_uvs, chart)
    while len(pairs):
        members, counts = np.unique(pairs, return_counts=True)
        worst = int(members[counts.argmax()])
        corner_uvs[control.face_offsets[worst] : control.face_offsets[worst + 1]] = -1
        chart[worst] = -1
        pairs = pairs[(pairs != worst).all(axis=1)]


def _overlapping_pairs(control: ControlMesh, uvs: FloatArray, corner_uvs: IndexArray, chart: IndexArray) -> IndexArray:
    """(q, 2) overlapping pairs of polygons of one chart, found by a sweep from left to right."""
    corners, begin = uvs[corner_uvs], control.face_offsets[:-1]
    low, high = np.minimum.reduceat(corners, begin), np.maximum.reduceat(corners, begin)
    # Charts are shifted apart, so that none overlaps another one in the sweep.
    shift = 2 * np.ptp(corners[:, 0]) * chart
    faces = np.flatnonzero(chart >= 0)
    faces = faces[np.argsort((low[:, 0] + shift)[faces], kind="stable")]
    starts, ends = (low[:, 0] + shift)[faces], (high[:, 0] + shift)[faces]
    counts = np.maximum(np.searchsorted(starts, ends, side="right") - np.arange(len(faces)) - 1, 0)
    before = np.cumsum(counts) - counts
    used = csr_array((np.ones(len(corner_uvs)), np.maximum(corner_uvs, 0), control.face_offsets))
    overlaps = [np.zeros((0, 2), np.int64)]
    for rows in np.split(np.arange(len(faces)), np.searchsorted(before, np.arange(_PAIRS, counts.sum(), _PAIRS))):
        first = np.repeat(rows, counts[rows])
        second = first + 1 + np.arange(len(first)) - np.repeat(before[rows] - before[rows[:1]], counts[rows])
        a, b = faces[first], faces[second]
        near = ((low[a] < high[b]) & (low[b] < high[a])).all(axis=1)
        a, b = a[near], b[near]
        # Convex polygons on either side of a common edge cannot overlap.
        apart = used[a].multiply(used[b]).sum(axis=1) < 2
        a, b = a[apart], b[apart]
        overlapping = _overlap(*(_polygons(control, uvs, corner_uvs, side) for side in (a, b)))
        overlaps.append(np.column_stack([a, b])[overlapping])
    return np.concatenate(overlaps)


def _polygons(control: ControlMesh, uvs: FloatArray, corner_uvs: IndexArray, faces: IndexArray) -> FloatArray:
    """(q, k, 2) corners of some polygons; smaller polygons repeat their last corner."""
    size = control.face_sizes[faces]
    step = np.minimum(np.arange(size.max(initial=1)), size[:, None] - 1)
    return np.asarray(uvs[corner_uvs[control.face_offsets[faces][:, None] + step]])


def _convex_faces(control: ControlMesh, points: FloatArray) -> np.ndarray:
    """(m,) whether the flat polygons with the given (c, 2) corners are convex and turn left."""
    following = control.next_corners
    edges = points[following] - points
    cross = _cross(edges, edges[following])
    lengths = np.linalg.norm(edges, axis=1)
    begin = control.face_offsets[:-1]
    straight = np.minimum.reduceat(cross - _STRAIGHT * lengths * lengths[following], begin) >= 0
    area2 = np.add.reduceat(_cross(points, points[following]), begin)
    turns = np.add.reduceat(np.arctan2(cross, np.einsum("ij,ij->i", edges, edges[following])), begin)
    solid = area2 > _FLAT * np.add.reduceat(lengths, begin) ** 2
    return straight & solid & (np.abs(turns - 2 * np.pi) < 1.0)  # a star turns left too, but twice around


def _outline(points: FloatArray) -> FloatArray:
    """(k, 2) convex outline of a polygon in space: its unfolded fan, or else a regular polygon of its area."""
    sides = points - points[0]
    lengths = np.linalg.norm(sides, axis=1)
    cosines = np.einsum("ij,ij->i", sides[1:-1], sides[2:]) / np.maximum(lengths[1:-1] * lengths[2:], 1e-300)
    angles = np.concatenate([[0.0, 0.0], np.cumsum(np.arccos(np.clip(cosines, -1, 1)))])
    unfolded = lengths[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    if _is_convex(unfolded):
        return unfolded
    normals = np.cross(sides[1:-1], sides[2:])
    area = 0.5 * float(np.linalg.norm(normals, axis=1).sum())
    k = len(points)
    radius = np.sqrt(2 * max(area, 1e-12) / (k * np.sin(2 * np.pi / k)))
    around = 2 * np.pi * np.arange(k) / k
    return radius * np.column_stack([np.cos(around), np.sin(around)])


def _is_convex(outline: FloatArray) -> bool:
    loop = ControlMesh.from_faces(np.zeros((len(outline), 3)), [list(range(len(outline)))])
    return bool(_convex_faces(loop, outline)[0])


def _known_corners(charts: _Charts, triangles: IndexArray, vertices: IndexArray) -> IndexArray:
    """(k,) UVs of a polygon's corners in a chart, from some of its triangles; -1 for other corners."""
    uv = np.unique(charts.triangles[triangles])
    matches = charts.vertices[uv][None, :] == vertices[:, None]
    return np.where(matches.sum(axis=1) == 1, uv[matches.argmax(axis=1)], -1)


def _lay_against(
    outline: FloatArray,
    known: IndexArray,
    uvs: FloatArray,
    control: ControlMesh,
    corner_uvs: IndexArray,
    neighbors: IndexArray,
) -> FloatArray | None:
    """(k, 2) corners of a polygon attached to a chart, or None if it would fold or overlap the chart."""
    have = known >= 0
    if have.sum() < 2 or len(neighbors) == 0:
        return None
    z, w = outline @ (1, 1j), uvs[known] @ (1, 1j)
    z_mean, w_mean = z[have].mean(), w[have].mean()
    similarity = np.vdot(z[have] - z_mean, w[have] - w_mean) / np.vdot(z[have] - z_mean, z[have] - z_mean)
    fitted = w_mean + similarity * (z - z_mean)
    placed = np.where(have, w, fitted)
    points = np.column_stack([placed.real, placed.imag])
    if not _is_convex(points):
        return None
    begin, size = control.face_offsets[neighbors], control.face_sizes[neighbors]
    first = np.cumsum(size) - size
    taken_uvs = uvs[corner_uvs[np.repeat(begin - first, size) + np.arange(size.sum())]]
    apart = np.any(np.minimum.reduceat(taken_uvs, first) >= points.max(axis=0), axis=1)
    apart |= np.any(np.maximum.reduceat(taken_uvs, first) <= points.min(axis=0), axis=1)
    near = _polygons(control, uvs, corner_uvs, neighbors[~apart])
    if _overlap(np.broadcast_to(points, (len(near), *points.shape)), near).any():
        return None
    return points


def _overlap(first: FloatArray, second: FloatArray) -> np.ndarray:
    """(q,) whether pairs of convex polygons (q, k, 2) overlap (separating axis theorem); they turn left."""
    scale = 0.5 * np.ptp(first, axis=1).max(axis=1)
    apart = np.zeros(len(first), dtype=bool)
    for polygon, other in ((first, second), (second, first)):
        edges = np.roll(polygon, -1, axis=1) - polygon
        lengths = np.linalg.norm(edges, axis=2)
        outward = np.stack([edges[..., 1], -edges[..., 0]], axis=2) / np.maximum(lengths, 1e-300)[..., None]
        distance = np.einsum("qed,qeod->qeo", outward, other[:, None] - polygon[:, :, None])
        apart |= ((distance.min(axis=2) >= -1e-6 * scale[:, None]) & (lengths > 0)).any(axis=1)
    return ~apart


def _equalize(
    control: ControlMesh, positions: FloatArray, uvs: FloatArray, corner_uvs: IndexArray, islands: IndexArray
) -> FloatArray:
    """UVs with each island scaled to the area of its polygons in space."""
    triangles = cage_triangles(control)[0]
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    solid = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    solid_of_face = np.bincount(np.repeat(np.arange(control.n_faces), control.face_sizes - 2), solid)
    corners = uvs[corner_uvs]
    flat_of_face = np.add.reduceat(_cross(corners, corners[control.next_corners]), control.face_offsets[:-1])
    island_of_face = islands[corner_uvs[control.face_offsets[:-1]]]
    ratio = np.bincount(island_of_face, solid_of_face) / np.bincount(island_of_face, flat_of_face)
    # The bound keeps islands of degenerate polygons from shrinking to a point.
    return uvs * np.sqrt(np.maximum(ratio, 1e-6))[islands][:, None]


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
