"""How good a map is, against the true one: between identities of models whose neutral surfaces coincide."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cagemap.geometry.closest import TriangleTree, build_tree, closest_points
from cagemap.geometry.triangles import normalized, triangle_normals, vertex_normals
from cagemap.maps.quality import (
    check_map,
    covered_share,
    dirichlet_energy,
    flipped_share,
    map_positions,
    surface_area,
)
from cagemap.numerics.arrays import FloatArray, IndexArray

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


def true_map(
    target_neutral: FloatArray,
    target_triangles: IndexArray,
    source_neutral: FloatArray,
    source_triangles: IndexArray,
    *,
    source_tree: TriangleTree | None = None,
) -> tuple[IndexArray, FloatArray, NDArray[np.bool_]]:
    """Ground truth between two refined meshes that lie on top of each other (same neutral shape).

    The closest source point among those whose normal makes less than 90 degrees with the target's. Known where the gap
    is at most 0.015 sqrt(area); nothing else is a true match.

    Returns
    -------
    triangle, barycentric : (n1,), (n1, 3)
    known : (n1,) bool
    """
    tree = source_tree or build_tree(source_neutral, source_triangles)
    normals = vertex_normals(target_neutral, target_triangles)
    nearest = _VALID_GAP * np.sqrt(surface_area(source_neutral, source_triangles))
    triangle, barycentric, _ = closest_points(tree, target_neutral, normals, minimum_cosine=0.0, within=nearest)
    known = triangle >= 0
    return np.where(known, triangle, 0), np.where(known[:, None], barycentric, 1 / 3), known


def compare_with_truth(
    target: FloatArray,
    target_triangles: IndexArray,
    source: FloatArray,
    source_triangles: IndexArray,
    triangle: IndexArray,
    barycentric: FloatArray,
    truth: tuple[IndexArray, FloatArray, NDArray[np.bool_]],
    landmarks: IndexArray,
) -> TruthFigures:
    """Compare a map with the true one (from :func:`true_map`); parameters as in :func:`measure_quality`.

    Errors are Euclidean distances between the two image points on the source.
    """
    check_map(len(target), len(source_triangles), triangle, barycentric)
    source = source / np.sqrt(surface_area(source, source_triangles))
    true_triangle, true_barycentric, known = truth
    image = map_positions(source, source_triangles, triangle, barycentric)
    true_image = map_positions(source, source_triangles, true_triangle, true_barycentric)
    normals = normalized(triangle_normals(source, source_triangles))
    errors = np.where(known, np.linalg.norm(image - true_image, axis=1), np.nan)
    judged = target_triangles[known[target_triangles].all(axis=1)]
    return TruthFigures(
        mean=float(np.nanmean(errors)),
        median=float(np.nanmedian(errors)),
        p95=float(np.nanpercentile(errors, 95)),
        maximum=float(np.nanmax(errors)),
        worst_landmark=float(np.linalg.norm(image[landmarks[:, 0]] - source[landmarks[:, 1]], axis=1).max(initial=0)),
        flipped_area=flipped_share(image, target, target_triangles, normals[triangle]),
        true_flipped_area=flipped_share(true_image, target, judged, normals[true_triangle]),
        dirichlet_ratio=dirichlet_energy(target, image, judged) / dirichlet_energy(target, true_image, judged),
        coverage=covered_share(image, target_triangles, source, source_triangles),
        known=float(known.mean()),
        errors=errors,
    )


def round_trip(
    target: FloatArray,
    target_triangles: IndexArray,
    source_triangles: IndexArray,
    forward: tuple[IndexArray, FloatArray],
    backward: tuple[IndexArray, FloatArray],
) -> FloatArray:
    """(n1,) distance between a target vertex and where target -> source -> target takes it, of sqrt(target area).

    The backward map, given per source vertex, is interpolated in space at the forward images.
    """
    unit = target / np.sqrt(surface_area(target, target_triangles))
    back = map_positions(unit, target_triangles, *backward)  # (n2, 3)
    return np.linalg.norm(map_positions(back, source_triangles, *forward) - unit, axis=1)
