"""How good a map is, against the true one: between identities of models whose neutral surfaces coincide."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cagemap.maps.pair import PointPairs
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import covered_share, flipped_triangles, landmark_errors, stretches
from cagemap.numerics.arrays import FloatArray
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import triangle_areas

_VALID_GAP = 0.015  # of sqrt(area): a larger gap between the neutral surfaces is no match


@dataclass(frozen=True)
class TruthFigures:
    """A map against the true one; errors are distances on the source divided by sqrt(source area).

    Attributes
    ----------
    mean, median, p95, maximum : float
        Over the target vertices whose true image is known.
    worst_landmark : float
    flipped_area, true_flipped_area : float
        Shares of the target's area folded by the map and by the true map.
    dirichlet_ratio : float
        Dirichlet energy of the map over that of the true map, both over the triangles whose truth is known.
    coverage : float
    known : float
        Share of target vertices with a known true image.
    errors : (n1,) float64
        NaN where the truth is not known.
    """

    mean: float
    median: float
    p95: float
    maximum: float
    worst_landmark: float
    flipped_area: float
    true_flipped_area: float
    dirichlet_ratio: float
    coverage: float
    known: float
    errors: FloatArray = field(repr=False)


@dataclass(frozen=True, eq=False)
class Truth:
    """Where target vertices truly go.

    Attributes
    ----------
    images : SurfacePoints
        Of the source's neutral surface; arbitrary where not known.
    known : (n1,) bool
    """

    images: SurfacePoints
    known: NDArray[np.bool_]

    def on(self, source: TriangleSurface) -> SurfacePoints:
        """The same points of another identity of the source."""
        return SurfacePoints(source, self.images.triangle, self.images.barycentric)


def true_map(target: TriangleSurface, source: TriangleSurface) -> Truth:
    """Ground truth between two refined meshes that lie on top of each other in their files (same neutral shape).

    The closest source point among those whose normal makes less than 90 degrees with the target's. Known where the gap
    is at most 0.015 sqrt(area); nothing else is a true match.
    """
    points = target.positions * (source.scale / target.scale)
    triangle, barycentric, _ = closest_points(
        source.tree, points, target.vertex_normals, minimum_cosine=0.0, within=_VALID_GAP
    )
    known = triangle >= 0
    images = SurfacePoints(source, np.where(known, triangle, 0), np.where(known[:, None], barycentric, 1 / 3))
    return Truth(images, known)


def dirichlet_energy(target: np.ndarray, image: np.ndarray, triangles: np.ndarray) -> float:
    """``1/2 sum_t area_t (sigma_1^2 + sigma_2^2)`` of a map; at least the image's area, equal for conformal maps."""
    largest, smallest = stretches(target, image, triangles)
    return float(0.5 * (triangle_areas(target, triangles) * (largest**2 + smallest**2)).sum())


def compare_with_truth(found: PointMap, truth: Truth, landmarks: PointPairs | None = None) -> TruthFigures:
    """Compare a map with the true one; errors are Euclidean distances between the two images on the source."""
    target, source, known = found.target, found.source, truth.known
    true_images = truth.on(source)
    image, true_image = found.images.positions, true_images.positions
    errors = np.where(known, np.linalg.norm(image - true_image, axis=1), np.nan)
    judged = known[target.triangles].all(axis=1)
    areas, flipped = target.areas, flipped_triangles(found.images, target.triangles)
    truly = flipped_triangles(true_images, target.triangles[judged])
    energies = [dirichlet_energy(target.positions, to, target.triangles[judged]) for to in (image, true_image)]
    return TruthFigures(
        mean=float(np.nanmean(errors)),
        median=float(np.nanmedian(errors)),
        p95=float(np.nanpercentile(errors, 95)),
        maximum=float(np.nanmax(errors)),
        worst_landmark=0.0 if landmarks is None else float(landmark_errors(found, landmarks).max(initial=0)),
        flipped_area=float(areas[flipped].sum() / areas.sum()),
        true_flipped_area=float(areas[judged][truly].sum() / areas[judged].sum()),
        dirichlet_ratio=energies[0] / energies[1],
        coverage=covered_share(target.positions, image, target.triangles, source),
        known=float(known.mean()),
        errors=errors,
    )


def round_trip(forward: PointMap, backward: PointMap) -> FloatArray:
    """(n1,) distance between a target vertex and where target -> source -> target takes it, of sqrt(target area).

    The backward map, given per source vertex, is interpolated in space at the forward images.
    """
    back = forward.images.interpolate(backward.images.positions)
    return np.linalg.norm(back - forward.target.positions, axis=1)
