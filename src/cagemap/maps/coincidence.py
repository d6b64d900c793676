"""Surfaces that lie on each other: retopology, levels of detail, clothes.

Subdivision shrinks a coarse cage more than a fine one, so that either the refined surfaces lie on each other or the
control meshes do: the nearer ones decide. Points of control meshes are those of the refined surfaces with the same
place on their face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.deform.config import CoincidenceConfig
from cagemap.maps.masks import WHOLE, Masks
from cagemap.mesh.faces import cage_triangles
from cagemap.numerics.arrays import FloatArray
from cagemap.spectral import Surface
from cagemap.spectral.zoomout import evenly_spaced
from cagemap.subdivision.face_varying import interpolate_linearly
from cagemap.surface.closest_points import closest_points
from cagemap.surface.surface_points import SurfacePoints, nearest_facing
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import row_lengths, triangle_centres

# Points closer than this, of sqrt(source area), are equal: the rounding error of six digits in a file.
SAME = 1e-5
# Vertices, and faces, of either surface that are asked where they are.
_SAMPLES = 10_000


@dataclass(frozen=True, eq=False)
class Coincidence:
    """A target that lies on its source, in the places that their files give them.

    Attributes
    ----------
    target, source : TriangleSurface
        What lies on each other: the finest levels, or their vertices on the faces of the control meshes.
    gap : float
        Mean distance of the target's area from the source, in units of sqrt(source area).
    reach : float
        How far `images` looks, in the same.
    """

    target: TriangleSurface
    source: TriangleSurface
    gap: float
    reach: float

    @classmethod
    def find(
        cls,
        target: Surface,
        source: Surface,
        masks: Masks = WHOLE,
        config: CoincidenceConfig = CoincidenceConfig(),
    ) -> Coincidence | None:
        """The shapes of two surfaces that lie on each other, None of others; a mask says what of the target counts."""
        found = []
        for asked, shape in ((_cage, _unsmoothed), (_finest, _finest)):
            gap = _gap(asked(target), asked(source), masks.target, config)
            if gap is not None:
                found.append((gap, shape))
        if not found:
            return None
        gap, shape = min(found, key=lambda one: one[0])
        return cls(shape(target), shape(source), gap, config.reach)

    def images(self, source: TriangleSurface, shifts: FloatArray | float = 0.0) -> SurfacePoints:
        """Closest points that face the same way, of the target's finest vertices.

        Parameters
        ----------
        source : TriangleSurface
            The finest level, which they are points of.
        shifts : (n1, 3) float64
            What target vertices are moved by before, in the source's unit.
        """
        places = self.source.scale / self.target.scale * self.target.positions + shifts
        near, _ = nearest_facing(self.source, places, self.target.vertex_normals, self.reach)
        return SurfacePoints(source, near.triangle, _snapped(near))


def _snapped(points: SurfacePoints) -> FloatArray:
    """(m, 3) barycentric coordinates of points, on vertices and edges that are nearer than `SAME`."""
    corners = points.surface.positions[points.corners]
    longest = row_lengths(corners - corners[:, [1, 2, 0]]).max(axis=1, keepdims=True)
    kept = np.where(points.barycentric * longest < SAME, 0.0, points.barycentric)
    return np.asarray(kept / kept.sum(axis=1, keepdims=True))


def _finest(surface: Surface) -> TriangleSurface:
    return surface.finest_triangles


def _cage(surface: Surface) -> TriangleSurface:
    """The control mesh, polygons in fans; a plain mesh as it is."""
    if surface.refinement.is_plain:
        return _finest(surface)
    return TriangleSurface(surface.scale * surface.control.positions, cage_triangles(surface.control)[0], surface.scale)


def _unsmoothed(surface: Surface) -> TriangleSurface:
    """The finest level on the faces of the control mesh: vertices at the same places of their faces."""
    refinement, control = surface.refinement, surface.control
    if refinement.is_plain:
        return _finest(surface)
    linear = interpolate_linearly(
        control, control.face_indices, control.n_vertices, refinement.n_levels, refinement.scheme
    )
    return TriangleSurface(surface.scale * (linear.matrix @ control.positions), linear.corners, surface.scale)


@dataclass(frozen=True, eq=False)
class _Samples:
    """Points of a surface in the file's lengths, with normals (k, 3) and the area (k,) that each stands for."""

    points: FloatArray
    normals: FloatArray
    areas: FloatArray

    @classmethod
    def of_vertices(cls, surface: TriangleSurface, mask: FloatArray | None = None) -> _Samples:
        rows = evenly_spaced(surface.n, _SAMPLES)
        counts = 1.0 if mask is None else mask[rows]
        areas = counts * surface.vertex_areas[rows]
        return cls(surface.positions[rows] / surface.scale, surface.vertex_normals[rows], areas)

    @classmethod
    def of_faces(cls, surface: TriangleSurface, mask: FloatArray | None = None) -> _Samples:
        rows = evenly_spaced(len(surface.triangles), _SAMPLES)
        corners = surface.triangles[rows]
        counts = 1.0 if mask is None else mask[corners].mean(axis=1)
        centres = triangle_centres(surface.positions, corners) / surface.scale
        return cls(centres, surface.normals[rows], counts * surface.areas[rows])

    def distances(self, other: TriangleSurface, unit: float, most: float) -> FloatArray:
        """(k,) distances to the nearest points of a surface with similar normals, times ``unit``; at most ``most``."""
        within = most * other.scale / unit
        points = other.scale * self.points
        far = closest_points(other.tree, points, self.normals, minimum_cosine=0.0, within=within)[2]
        return np.minimum(far * unit / other.scale, most)

    def share(self, chosen: NDArray[np.bool_]) -> float:
        """Share of the area that some points stand for, 0 where nothing counts."""
        return float(self.areas @ chosen / max(self.areas.sum(), 1e-300))


def _gap(
    target: TriangleSurface, source: TriangleSurface, mask: FloatArray | None, config: CoincidenceConfig
) -> float | None:
    """Mean distance of a target from a source that it lies on, in units of sqrt(source area); None where it does not.

    A coarse mesh is made with its vertices on a fine surface, and its faces cut through it: vertices are asked, and of
    faces only that they are near.
    """
    unit, faces = source.scale, _Samples.of_faces(target, mask)
    apart = faces.distances(source, unit, config.near)
    if faces.share(apart < config.near) < config.share:
        return None
    gap = float(faces.areas @ apart / faces.areas.sum())
    for samples, other in ((_Samples.of_vertices(target, mask), source), (_Samples.of_vertices(source), target)):
        between = samples.distances(other, unit, config.near)
        close = samples.areas @ between <= config.mean_gap * samples.areas.sum()
        if close and samples.share(between < config.max_gap) >= config.share:
            return gap
    clothed = _Samples.of_faces(source)
    covered = clothed.share(clothed.distances(target, unit, config.near) < config.near)
    return gap if covered < config.clothed else None
