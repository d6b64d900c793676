"""Carry blend shapes to another cage by deformation transfer through the map (Sumner and Popovic 2004).

For each target triangle, F is the linear map that moves its three images on the source as the shape moves them, and
the normal to the normal. With Q the rotation of the map's differential, from the target's triangle to its image, the
target's triangle should move by ``Q^T F Q``. The displacement d of the target's *control* vertices solves

    min_d  sum_t a_t |grad (S d) - (Q^T F Q - I)|^2  +  anchor sum_i m_i |(S d)_i - r Q_i^T D(T12(i))|^2,

with S the refinement and D the source's displacement, all at unit area. The second term fixes the translation of every
part, and the shape on large scales: ``anchor`` is inverse to the share of the surface that moves (`moved_share`), so
that a shape of the lids stays at the lids, and one of the whole body keeps its details. r is the median, over
triangles, of a length on the target by that of its image: unlike the ratio of areas, it does not depend on parts that
only one surface has (a mouth bag). Two terms are added: a ridge, and contacts, so that lids closed in the source's
shape close on the target. A zero shape stays zero, and the identity map returns each shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import flipped_triangles, weighted_percentiles
from cagemap.numerics.arrays import FloatArray, IndexArray, nearest_rotations
from cagemap.numerics.sparse_algebra import factor
from cagemap.subdivision import Refinement, level_triangles
from cagemap.surface.triangle_surface import SurfacePoints
from cagemap.surface.triangles import (
    corner_sums,
    normalize_rows,
    triangle_areas,
    triangle_normals,
    vertex_normals,
)
from cagemap.transfer.control_values import control_weights

# A shape is sampled on the coarsest level of the target with at least this many vertices.
_SAMPLES = 25_000
# Weight of displacements against gradients, times the share of the area that moves: gradients determine details smaller
# than about 1.4 times the square root of the moved area.
_ANCHOR = 20.0
# Ridge, relative to the anchor: without it, control vertices that hardly move the surface (of a cube) are undetermined.
_SHAPE_RIDGE = 1e-7
# Weight of contacts of the source's shape against the anchor.
_CONTACT = 100.0
# Contact: a distance below this many edge lengths, and a cosine of the normals below this.
_CONTACT_DISTANCE, _CONTACT_COSINE = 1.0, -0.5


@dataclass(frozen=True, eq=False)
class ShapeCarrier:
    """Linear systems that carry shapes from one source to one target."""

    point_map: PointMap
    source: Refinement
    samples: sparse.csr_array  # (s, c1) sampled target vertices from control vertices
    triangles: IndexArray  # (t, 3) of the samples
    gradient: sparse.csr_array  # (3 t, s) gradients of functions on the samples' triangles
    areas: FloatArray  # (t,)
    masses: FloatArray  # (s,)
    rotations: FloatArray  # (t, 3, 3) Q, from the target to the source
    vertex_rotations: FloatArray  # (s, 3, 3)
    length_ratio: float  # length on the target for a length of 1 on the source, both at unit area
    image_frames: tuple[FloatArray, NDArray[np.bool_]]  # (t, 3, 3) and (t,), see `_inverse_frames`
    control_weights: sparse.csr_array  # (c1, c2) target control vertices from source control vertices
    ridge: sparse.dia_array  # (c1, c1), to be multiplied by the anchor
    mass: sparse.csr_array  # (c1, c1) integrals of products of control displacements
    stiffness: sparse.csr_array  # (c1, c1) and of their gradients


def prepare_shapes(target: Refinement, source: Refinement, point_map: PointMap) -> ShapeCarrier:
    """Linear systems that carry shapes from a source to a target, both refined up to the levels of the map."""
    level = min(max(target.coarsest_level(_SAMPLES), 1), target.finest_level)
    triangles = level_triangles(target, level)
    n_samples = target.levels[level].n_vertices
    positions, images = point_map.target.positions[:n_samples], point_map.images.positions[:n_samples]
    gradient, areas = _gradients(positions, triangles)
    masses = corner_sums(triangles, areas[:, None], n_samples)[:, 0] / 3
    rotations = _rotations(gradient, positions, point_map.images.at(slice(n_samples)), triangles)
    rotation_sums = corner_sums(triangles, (areas[:, None, None] * rotations).reshape(-1, 9), n_samples).reshape(
        -1, 3, 3
    )
    samples = target.rows(slice(n_samples), target.finest_level, 0)
    slopes = gradient @ samples
    return ShapeCarrier(
        point_map,
        source,
        samples,
        triangles,
        gradient,
        areas,
        masses,
        rotations,
        nearest_rotations(rotation_sums),
        _length_ratio(areas, triangle_areas(images, triangles)),
        _inverse_frames(images, triangles),
        control_weights(point_map, target, source),
        sparse.diags_array(_SHAPE_RIDGE * (samples.T @ masses)),
        samples.T @ sparse.diags_array(masses) @ samples,
        slopes.T @ sparse.diags_array(np.repeat(areas, 3)) @ slopes,
    )


def _length_ratio(areas: FloatArray, image_areas: FloatArray) -> float:
    """Median stretch of triangles, weighted by area; triangles whose image is a point are left out."""
    known = image_areas > 0.0
    if not known.any():
        return 1.0
    stretch = np.sqrt(areas[known] / image_areas[known])
    return float(weighted_percentiles(stretch, areas[known], [50.0])[0])


def carry_shape(carrier: ShapeCarrier, displacement: FloatArray) -> FloatArray:
    """Displacement (c1, 3) of the target's control vertices from the source's (c2, 3), each in its file units."""
    expected = (carrier.source.control.n_vertices, 3)
    if np.shape(displacement) != expected or not np.isfinite(displacement).all():
        raise ParameterError(
            f"shape: expected {expected[0]} finite displacements, one a control vertex of the source, got an array of "
            f"shape {np.shape(displacement)}"
        )
    source_surface, point_map = carrier.point_map.source, carrier.point_map
    moves = source_surface.scale * carrier.source.prolong(np.asarray(displacement), 0, carrier.source.finest_level)
    images = point_map.images.at(slice(len(carrier.masses)))
    image_moves = images.interpolate(moves)
    deformation = _deformation(*carrier.image_frames, images.positions + image_moves, carrier.triangles)
    # (t, 3, 3) gradients of the displacement: F - I on the source, Q^T (F - I) Q on the target
    image_gradients = deformation - np.eye(3)
    target_gradients = carrier.rotations.transpose(0, 2, 1) @ image_gradients @ carrier.rotations
    anchor = _ANCHOR / moved_share(image_moves, carrier.masses)
    rotated_moves = carrier.length_ratio * np.einsum("sba,sb->sa", carrier.vertex_rotations, image_moves)
    # (3 t, 3), rows (t, direction)
    weighted_gradients = (carrier.areas[:, None, None] * target_gradients).transpose(0, 2, 1).reshape(-1, 3)
    right_side = carrier.samples.T @ (
        carrier.gradient.T @ weighted_gradients + anchor * carrier.masses[:, None] * rotated_moves
    )
    control_moves = (
        carrier.length_ratio
        * source_surface.scale
        * (carrier.control_weights @ np.asarray(displacement, dtype=np.float64))
    )
    right_side = right_side + anchor * carrier.ridge @ np.einsum(
        "nba,nb->na", carrier.vertex_rotations[: len(control_moves)], control_moves
    )
    matrix = carrier.stiffness + anchor * (carrier.mass + carrier.ridge)
    first, second, relative_moves = contacts(carrier, moves)
    if len(first):
        rows = carrier.samples[first] - carrier.samples[second]
        weights = sparse.diags_array(0.5 * anchor * _CONTACT * (carrier.masses[first] + carrier.masses[second]))
        matrix = matrix + rows.T @ weights @ rows
        right_side = right_side + rows.T @ (weights @ relative_moves)
    return np.asarray(factor(sparse.csc_array(matrix)).solve(np.ascontiguousarray(right_side))) / point_map.target.scale


def moved_share(moves: FloatArray, masses: FloatArray) -> float:
    """Share of the area that displacements (s, 3) move, the participation ratio of their squares; 1 of none."""
    squares = np.square(moves / (np.abs(moves).max() or 1.0)).sum(axis=1)
    fourth = float(masses @ squares**2)
    return float(masses @ squares) ** 2 / (fourth * float(masses.sum())) if fourth else 1.0


def contacts(carrier: ShapeCarrier, moves: FloatArray) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Pairs of samples (k,), (k,) in contact in a source shape, and their relative displacement (k, 3).

    Samples are in contact if their images, displaced by ``moves`` (n, 3) at unit area, are close, face each other and
    are not neighbours: closed lips and eyelids. Samples that come into contact get the gap of the source's shape. The
    gap of samples in contact at rest changes as it does on the source: if the source does not move, the target does not
    either.
    """
    source_surface, n_samples = carrier.point_map.source, len(carrier.masses)
    images = carrier.point_map.images.at(slice(n_samples))
    positions = source_surface.positions + moves
    shaped_images = images.interpolate(positions)
    normals = images.interpolate(vertex_normals(positions, source_surface.triangles))
    edge_lengths = np.sqrt(2 * carrier.masses)
    distance, nearest = cKDTree(shaped_images).query(
        shaped_images, k=16, distance_upper_bound=_CONTACT_DISTANCE * float(edge_lengths.max())
    )
    nearest = np.minimum(nearest, n_samples - 1)
    is_near = np.isfinite(distance) & (distance < _CONTACT_DISTANCE * edge_lengths[:, None])
    is_contact = is_near & (np.einsum("sd,skd->sk", normals, normals[nearest]) < _CONTACT_COSINE)
    # Neighbours across a sharp fold of the target are not in contact: they are close at rest.
    row, column = np.nonzero(is_contact)
    on_target, lengths = carrier.point_map.target.positions, edge_lengths[row]
    target_distance = np.linalg.norm(on_target[nearest[row, column]] - on_target[row], axis=1)
    is_touching = np.asarray(distance)[row, column] < 0.1 * lengths
    is_contact[row, column] = (target_distance > 3 * lengths) | is_touching
    in_contact = is_contact.any(axis=1)
    first = np.flatnonzero(in_contact)
    second = nearest[first, np.argmax(is_contact[first], axis=1)]
    first, second = np.unique(np.sort(np.stack([first, second], axis=1), axis=1), axis=0).T
    rest_gap = images.positions[first] - images.positions[second]
    gap = shaped_images[first] - shaped_images[second]
    was_in_contact = np.linalg.norm(rest_gap, axis=1) < _CONTACT_DISTANCE * np.maximum(
        edge_lengths[first], edge_lengths[second]
    )
    rotations = 0.5 * (carrier.vertex_rotations[first] + carrier.vertex_rotations[second])
    relative_moves = np.einsum("kba,kb->ka", rotations, np.where(was_in_contact[:, None], gap - rest_gap, gap))
    relative_moves *= carrier.length_ratio
    target_gap = carrier.point_map.target.positions[first] - carrier.point_map.target.positions[second]
    return first, second, np.where(was_in_contact[:, None], relative_moves, relative_moves - target_gap)


def _gradients(positions: FloatArray, triangles: IndexArray) -> tuple[sparse.csr_array, FloatArray]:
    """(3 t, n) gradients of functions that are linear on triangles, rows (t, direction); and areas (t,)."""
    normals = triangle_normals(positions, triangles)
    doubled_areas = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    # The gradient of a corner's hat function is normal x opposite edge / (2 area).
    unit = normals / doubled_areas[:, None]
    hat_gradients = [
        np.cross(unit, positions[triangles[:, (k + 2) % 3]] - positions[triangles[:, (k + 1) % 3]])
        / doubled_areas[:, None]
        for k in range(3)
    ]
    t = len(triangles)
    rows = np.repeat(np.arange(3 * t), 3)
    columns = np.repeat(triangles, 3, axis=0).reshape(-1)
    values = np.stack(hat_gradients, axis=2).reshape(-1)  # (t, direction, corner)
    return sparse.csr_array((values, (rows, columns)), shape=(3 * t, len(positions))), 0.5 * doubled_areas


def _rotations(
    gradient: sparse.csr_array, positions: FloatArray, images: SurfacePoints, triangles: IndexArray
) -> FloatArray:
    """(t, 3, 3) rotation of the map's differential, target to source, of every triangle; normals go to normals.

    Where an image has no area, or is flipped and not at vertices alone, its normal is the mean of those at its corners.
    """
    differential = (gradient @ images.positions).reshape(-1, 3, 3).transpose(0, 2, 1)
    normals, image_normals = (
        normalize_rows(triangle_normals(side, triangles)) for side in (positions, images.positions)
    )
    # Normals at sharp vertices mislead.
    is_between_vertices = (images.barycentric.max(axis=1) < 1.0)[triangles].any(axis=1)
    is_uncertain = (flipped_triangles(images, triangles) & is_between_vertices) | ~image_normals.any(axis=1)
    image_normals[is_uncertain] = normalize_rows(images.normals[triangles[is_uncertain]].mean(axis=1))
    stretch = np.sqrt(np.einsum("tab,tab->t", differential, differential) / 2)
    return nearest_rotations(differential + stretch[:, None, None] * image_normals[:, :, None] * normals[:, None, :])


def _frames(positions: FloatArray, triangles: IndexArray) -> FloatArray:
    """(t, 3, 3) two edges and the unit normal of triangles, as columns."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    return np.stack([b - a, c - a, normal], axis=2)


def _inverse_frames(positions: FloatArray, triangles: IndexArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(t, 3, 3) inverse frames, and whether (t,) a triangle has area; others have the unit matrix."""
    frames = _frames(positions, triangles)
    edge_length = np.linalg.norm(frames[:, :, :2], axis=(1, 2))
    is_regular = np.abs(np.linalg.det(frames)) > 1e-9 * edge_length**2
    frames[~is_regular] = np.eye(3)
    return np.asarray(np.linalg.inv(frames)), np.asarray(is_regular)


def _deformation(
    inverses: FloatArray, is_regular: NDArray[np.bool_], after: FloatArray, triangles: IndexArray
) -> FloatArray:
    """(t, 3, 3) linear maps F of triangles: edges go to edges, the unit normal to the unit normal."""
    maps = _frames(after, triangles) @ inverses
    maps[~is_regular] = np.eye(3)
    return maps
