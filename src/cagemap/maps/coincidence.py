"""Find whether a target lies on its source, as in retopology, levels of detail and clothes, or is a moved copy of it.

Two cages of one shape differ after subdivision, which shrinks a coarse cage more than a fine one. So the refined
surfaces are compared and the control meshes too, and the pair with the smaller gap is used. A point of a control mesh
corresponds to the point of the refined surface with the same position on its face.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cagemap.deform.config import CoincidenceConfig
from cagemap.deform.data import SurfaceSamples
from cagemap.maps.masks import WHOLE, Masks
from cagemap.mesh.faces import cage_triangles
from cagemap.numerics.arrays import FloatArray
from cagemap.spectral import Surface
from cagemap.spectral.zoomout import evenly_spaced_vertices
from cagemap.subdivision.face_varying import interpolate_linearly
from cagemap.surface.alignment import fit_similarity, principal_frame, rotations_onto
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface, nearest_facing
from cagemap.surface.triangles import row_lengths, triangle_areas, triangle_centres

SAME = 1e-5  # points closer than this times sqrt(source area) are equal: the rounding error of six digits in a file
UNITS = np.array([1e-3, 1e-2, 0.0254, 0.3048, 1.0])  # usual units, in metres: mm, cm, inch, foot, m
FEWEST_POINTS = 3  # fewer pairs of points determine no motion
MOST_SAMPLES = 10_000  # at most this many vertices, and faces, of either surface are sampled


class Motion(NamedTuple):
    """Similarity x -> scale rotation x + shift from the target's file to the source's."""

    rotation: FloatArray = np.eye(3)
    scale: float = 1.0
    shift: FloatArray = np.zeros(3)


@dataclass(frozen=True, eq=False)
class Coincidence:
    """A target that coincides with its source, as their files stand or after a motion."""

    target: TriangleSurface  # after the motion: the finest level, or its vertices on the faces of the control mesh
    source: TriangleSurface
    gap: float  # mean distance of the target's area from the source, in units of sqrt(source area)
    search_radius: float  # of `images`, in the same unit
    motion: Motion

    @classmethod
    def find(
        cls, target: Surface, source: Surface, masks: Masks = WHOLE, config: CoincidenceConfig = CoincidenceConfig()
    ) -> Coincidence | None:
        """Coincidence of two surfaces, None if they do not coincide; the target's mask weights its area.

        Tried in this order: as the files stand, in other units, moved. A moved target must be nearer (``moved_gap``),
        and if it coincides in several rotations, like a box, the answer is None too.
        """
        # Of each shape: the surface that is compared, and the one whose vertices are mapped.
        is_plain = target.refinement.is_plain and source.refinement.is_plain
        compared = [(_finest, _finest)] if is_plain else [(_cage, _unsmoothed), (_finest, _finest)]
        shapes = [(measured(target), measured(source), mapped) for measured, mapped in compared]
        for factor in (*dict.fromkeys((1.0, unit_ratio(target.scale / source.scale))), None):
            found: list[Coincidence] = []
            for own, other, mapped in shapes:
                motions = aligning_motions(own, other, config) if factor is None else [Motion(scale=factor)]
                whole = config if factor is not None else replace(config, min_within_boundary=1.0)  # holes count
                gaps = [_gap(moved(own, motion), other, masks.target, whole) for motion in motions]
                close = [(gap, motion) for gap, motion in zip(gaps, motions, strict=True) if gap is not None]
                if len(close) > 1:
                    return None
                for gap, motion in close:
                    if factor is not None or gap <= config.moved_gap:
                        placed = moved(mapped(target), motion)
                        found.append(cls(placed, mapped(source), gap, config.search_radius, motion))
            if found:
                return min(found, key=lambda one: one.gap)
        return None

    def images(self, source: TriangleSurface, shifts: FloatArray | float = 0.0) -> SurfacePoints:
        """Closest source points that face the same way as the target's vertices, moved by shifts (n1, 3)."""
        places = self.source.scale / self.target.scale * self.target.positions + shifts
        near, _ = nearest_facing(self.source, places, self.target.vertex_normals, self.search_radius)
        corners = self.source.positions[near.corners]  # snapped to vertices and edges nearer than `SAME`
        longest = row_lengths(corners - corners[:, [1, 2, 0]]).max(axis=1, keepdims=True)
        largest = near.barycentric == near.barycentric.max(axis=1, keepdims=True)  # kept, also of a tiny triangle
        kept = np.where((near.barycentric * longest < SAME) & ~largest, 0.0, near.barycentric)
        return SurfacePoints(source, near.triangle, kept / kept.sum(axis=1, keepdims=True))


def unit_ratio(ratio: float) -> float:
    """The ratio of two usual units of length that is nearest to a ratio of sizes."""
    ratios = np.divide.outer(UNITS, UNITS).ravel()
    return float(ratios[np.argmin(np.abs(np.log(ratios / ratio)))])


def aligning_motions(target: TriangleSurface, source: TriangleSurface, config: CoincidenceConfig) -> list[Motion]:
    """Motions of principal frames, then of closest points; none if moments differ or two axes are equally long."""
    frames = (principal_frame(side.positions / side.scale, side.vertex_areas) for side in (target, source))
    (centre, axes, deviations), (source_centre, source_axes, lengths) = frames
    scale = float(np.linalg.norm(lengths) / np.linalg.norm(deviations))
    changes = np.abs(scale * deviations - lengths)
    if (changes > config.max_moment_change * np.maximum(lengths, SAME * lengths[0])).any():  # the last is 0 of a sheet
        return []
    if (lengths[:2] < config.min_axis_ratio * lengths[1:]).any():
        return []
    rotations = rotations_onto(axes, source_axes)
    starts = [Motion(rotation, scale, source_centre - scale * rotation @ centre) for rotation in rotations]
    return [_settled(start, target, source, config) for start in starts]


def _settled(motion: Motion, target: TriangleSurface, source: TriangleSurface, config: CoincidenceConfig) -> Motion:
    """The motion refined by iterative closest points (Besl and McKay 1992), while the mean distance falls."""
    samples, last = _on_faces(target, most=config.settling_samples), np.inf
    for _ in range(config.settling_rounds):
        points = motion.scale * samples.points @ motion.rotation.T + motion.shift
        triangle, barycentric, distance = closest_points(
            source.tree, source.scale * points, samples.normals @ motion.rotation.T, minimum_cosine=0.0
        )
        near = np.flatnonzero(triangle >= 0)  # others face away from all of the source
        if len(near) < FEWEST_POINTS or distance[near].mean() > config.max_distance_ratio * last:
            break
        last = distance[near].mean()
        corners = source.positions[source.triangles[triangle[near]]]
        places = np.einsum("kc,kcd->kd", barycentric[near], corners) / source.scale
        motion = Motion(*fit_similarity(samples.points[near], places))
    return motion


def moved(surface: TriangleSurface, motion: Motion) -> TriangleSurface:
    """The surface as if its file's coordinates were moved, at unit area; keeps what a motion does not change."""
    rotation, scale, shift = motion
    if not (angle_of(rotation) or np.any(shift)):
        return surface if scale == 1.0 else replace(surface, scale=surface.scale / scale)
    positions = surface.positions @ rotation.T + surface.scale / scale * shift
    return TriangleSurface(positions, surface.triangles, surface.scale / scale)


def angle_of(rotation: FloatArray) -> float:
    """Angle in degrees of a rotation (3, 3)."""
    return float(np.degrees(Rotation.from_matrix(rotation).magnitude()))


def _gap(
    target: TriangleSurface, source: TriangleSurface, mask: FloatArray | None, config: CoincidenceConfig
) -> float | None:
    """Mean distance of a target from a coincident source, of sqrt(source area); else None.

    Vertices must coincide; face centres must only be near, since faces of a coarse mesh cut through a fine surface.
    """
    unit, faces, source_faces = source.scale, _on_faces(target, mask), _on_faces(source)
    apart, areas = _distances(faces, source, unit, config)
    if _share(areas, apart < config.max_distance) < config.min_share:
        return None
    gap = float(areas @ apart / areas.sum())
    # A small target is near the source wherever it lies: the gap is small for the target's own size, too.
    if gap * target.scale > config.max_gap_of_target * unit:
        return None
    for samples, other in ((_at_vertices(target, mask), source), (_at_vertices(source), target)):
        distances, areas = _distances(samples, other, unit, config)
        close = areas @ distances <= config.mean_gap * areas.sum()
        if close and _share(areas, distances < config.max_gap) >= config.min_share:
            return gap
    covered = _share(source_faces.areas, _distances(source_faces, target, unit, config)[0] < config.max_distance)
    return gap if covered < config.max_clothes_cover else None


def _share(areas: FloatArray, chosen: NDArray[np.bool_]) -> float:
    """Share of areas (k,) that is chosen; 0 if all areas are 0."""
    return float(areas @ chosen / max(areas.sum(), 1e-300))


def _distances(
    samples: SurfaceSamples, other: TriangleSurface, unit: float, config: CoincidenceConfig
) -> tuple[FloatArray, FloatArray]:
    """(k,) distances to a surface's nearest points with similar normals, times ``unit``, and areas (k,).

    Distances are at most ``max_distance``. Areas are 0 beyond the surface's boundary, as in front of a hole of a scan,
    if that leaves ``min_within_boundary``.
    """
    is_open = other.is_open and config.min_within_boundary < 1.0
    triangle, barycentric, far = closest_points(
        other.tree,
        other.scale * samples.points,
        samples.normals,
        minimum_cosine=0.0,
        within=np.inf if is_open else config.max_distance * other.scale / unit,
    )
    distances = np.minimum(far * unit / other.scale, config.max_distance)
    if is_open:
        beyond = (triangle >= 0) & (distances > config.max_gap) & other.at_boundary(triangle, barycentric)
        if _share(samples.areas, ~beyond) >= config.min_within_boundary:
            return distances, np.where(beyond, 0.0, samples.areas)
    return distances, samples.areas


def _at_vertices(surface: TriangleSurface, mask: FloatArray | None = None) -> SurfaceSamples:
    """Vertices in the file's unit."""
    samples = SurfaceSamples.at_vertices(surface, MOST_SAMPLES, mask)
    return samples._replace(points=samples.points / surface.scale)


def _on_faces(surface: TriangleSurface, mask: FloatArray | None = None, most: int = MOST_SAMPLES) -> SurfaceSamples:
    """Face centres in the file's unit."""
    rows = evenly_spaced_vertices(len(surface.triangles), most)
    corners = surface.triangles[rows]
    areas = (1.0 if mask is None else mask[corners].mean(axis=1)) * triangle_areas(surface.positions, corners)
    return SurfaceSamples(triangle_centres(surface.positions, corners) / surface.scale, surface.normals_of(rows), areas)


def _finest(surface: Surface) -> TriangleSurface:
    return surface.finest_triangles


def _cage(surface: Surface) -> TriangleSurface:
    """The control mesh with polygons as triangle fans; the finest level of a plain mesh."""
    if surface.refinement.is_plain:
        return _finest(surface)
    return TriangleSurface(surface.scale * surface.control.positions, cage_triangles(surface.control)[0], surface.scale)


def _unsmoothed(surface: Surface) -> TriangleSurface:
    """Vertices of the finest level, at their positions on the flat faces of the control mesh."""
    refinement, control = surface.refinement, surface.control
    if refinement.is_plain:
        return _finest(surface)
    matrix, corners = interpolate_linearly(
        control, control.face_indices, control.n_vertices, refinement.finest_level, refinement.scheme
    )
    return TriangleSurface(surface.scale * (matrix @ control.positions), corners, surface.scale)
