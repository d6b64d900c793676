"""Quality of a map, measured without ground truth.

Lengths are divided by sqrt(area) of their surface, and shares are shares of area, so that figures of different models
and meshes compare.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.pair import PointPairs
from cagemap.maps.point_map import PointMap
from cagemap.mesh.mesh_report import place_text
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import ThreadPool, in_threads, row_slices
from cagemap.spectral import Surface
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import CACHED, corner_sums, normalize_rows, row_lengths, triangle_normals

LANDMARK_TOLERANCE = 5e-4  # of sqrt(area): landmarks with a larger error are named
FLIPPED_TOLERANCE = 5e-3  # of the target's area
COVERAGE_TOLERANCE = 0.98  # of the source's area
TRUSTED_STRETCH = 2.0  # up to this stretch or compression (relative to isometry) a map is fully trusted
PERCENTILE_BINS = 4096
COVERAGE_SAMPLES = 50_000
ON_SURFACE = 1e-6  # of sqrt(area): closer points are on the surface
MASK_ADVICE = ". Mask it, if it is to keep its own"
# Warning about masks that leave no part of the map.
NOTHING_JOINED = (
    "the map leads from no unmasked part of the target to an unmasked part of the source: look at the masks of both "
    "sides. The figures are those of the target's mask"
)
# Figures of one number, and percentiles (by target area) of figures with a distribution.
FIGURES = ("flipped_area", "coverage", "dirichlet", "trusted_area")
PERCENTILES = {"area_ratio": ("1", "5", "50", "95", "99"), "aspect_ratio": ("50", "95", "99")}


@dataclass(frozen=True, eq=False)
class QualityFigures:
    """Quality of a map, measured without ground truth."""

    #: (p,) distance from a landmark's image to its source point, in sqrt(source area)
    landmark_errors: FloatArray = field(repr=False)
    flipped_area: float  #: share of the target's area whose image is folded over (its orientation is reversed)
    #: share of the source's area that the image of the target covers. If a surface is open, only the area that has a
    #: counterpart on the other surface counts.
    coverage: float
    dirichlet: float  #: Dirichlet energy, corresponding parts scaled to equal area; 1 for an isometry
    #: (5,) percentiles 1, 5, 50, 95, 99 (by target area) of the area stretch; 1 is the mean of the shared area
    area_ratios: FloatArray = field(repr=False)
    #: (3,) percentiles 50, 95, 99 (by target area) of ratios of singular values; 1 is conformal
    aspect_ratios: FloatArray = field(repr=False)
    trust: FloatArray = field(repr=False)  #: (n1,) 1 where locally unfolded and little stretched, 0 at folds
    trusted_area: float  #: mean of ``trust`` by area
    warnings: tuple[str, ...] = ()  #: problems that a user should know, worst first; empty for a good map
    match_warnings: tuple[str, ...] = ()  #: those of ``warnings`` that only the match can give; not kept in files

    def summary(self) -> dict[str, object]:
        """Return the figures as plain numbers and lists for a manifest (the per-vertex trust field left out)."""
        errors = self.landmark_errors
        return {
            "landmark_error_mean": float(errors.mean()) if len(errors) else None,
            "landmark_error_worst": float(errors.max()) if len(errors) else None,
            **{name: _known(getattr(self, name)) for name in FIGURES},
            **{
                f"{name}_percentiles": dict(zip(percents, map(_known, getattr(self, f"{name}s").tolist()), strict=True))
                for name, percents in PERCENTILES.items()
            },
            "warnings": list(self.warnings),
        }

    @classmethod
    def of_summary(cls, summary: Mapping[str, Any], landmark_errors: FloatArray, trust: FloatArray) -> QualityFigures:
        """Figures from a `summary`; NaN for missing values."""
        figures: dict[str, Any] = {name: _number(summary.get(name)) for name in FIGURES}
        for name, percents in PERCENTILES.items():
            known = summary.get(f"{name}_percentiles") or {}
            figures[f"{name}s"] = np.array([_number(known.get(percent)) for percent in percents])
        figures["warnings"] = tuple(summary.get("warnings") or ())
        return cls(landmark_errors=landmark_errors, trust=trust, **figures)


@kinds_checked
def judge(
    target: Surface, point_map: PointMap, landmarks: PointPairs | None = None, masks: Masks = WHOLE
) -> QualityFigures:
    """Quality figures of any point map of the target's finest level, without ground truth; else ParameterError.

    ``masks`` weight both surfaces' vertices in the figures.
    """
    if point_map.target.n != len(target.vertices):
        raise ParameterError(
            f"judge: expected a map of the {len(target.vertices)} finest vertices of {target.control.name}, got one of "
            f"{point_map.target.n}: target and source may be exchanged, or the map belongs to another level"
        )
    if masks.shared is None:  # masks within shared area may be 0 nearly everywhere
        masks.require_fit(point_map.target.n, point_map.source.n)
    level = target.hierarchy.coarsest_level(COVERAGE_SAMPLES)
    asked = target.hierarchy.on_finest(level)[target.triangles(level).triangles]
    return measure_quality(point_map, landmarks, coarse_triangles=asked, masks=masks)


def measure_quality(
    point_map: PointMap,
    landmarks: PointPairs | None = None,
    *,
    coarse_triangles: IndexArray | None = None,
    masks: Masks = WHOLE,
) -> QualityFigures:
    """Measure a map, shares weighted by masks; on dense targets coverage is that of ``coarse_triangles`` (t, 3)."""
    target, images = point_map.target, point_map.images
    image, counted = images.positions, masks.joint(point_map)
    is_joined = bool(counted.any())
    counted = counted if is_joined else masks.of_target(target.n)
    ratio = masks.length_ratio(target, point_map.source)
    sized = target.positions if ratio == 1.0 else ratio * target.positions  # the shared area at the source's size

    whole = bool((counted == 1.0).all())
    areas = target.areas if whole else target.areas * counted[target.triangles].mean(axis=1)
    largest, smallest = stretch = np.empty((2, len(areas)))

    def fill(part: slice) -> None:
        chosen = target.triangles[part]
        stretch[:, part] = stretches(sized, image, chosen)

    with ThreadPool(1) as pool:
        asked = target.triangles if coarse_triangles is None else coarse_triangles
        covered = pool.submit(covered_share, target.positions, image, asked, point_map.source, masks=masks)
        flipped = inverted_triangles(image, _source_normals(images), target.triangles)
        in_threads(fill, row_slices(len(areas), CACHED))
        trust = trust_field(target, (largest, smallest), flipped)
        coverage = covered.result()
    dirichlet = float(0.5 * (areas * (largest**2 + smallest**2)).sum() / areas.sum())
    aspect = largest / np.maximum(smallest, 1e-9)
    largest *= smallest  # now ratios of areas: in place, as dense targets have many triangles
    distributions = [
        (values, areas, [float(p) for p in PERCENTILES[name]])
        for name, values in (("area_ratio", largest), ("aspect_ratio", aspect))
    ]
    area_ratios, aspect_ratios = in_threads(lambda asked: weighted_percentiles(*asked), distributions)
    vertex_areas = target.vertex_areas * counted / (target.vertex_areas @ counted)
    figures = QualityFigures(
        landmark_errors=np.zeros(0) if landmarks is None else landmark_errors(point_map, landmarks),
        flipped_area=float(areas[flipped].sum() / areas.sum()),
        coverage=coverage,
        dirichlet=dirichlet,
        area_ratios=area_ratios,
        aspect_ratios=aspect_ratios,
        trust=trust,
        trusted_area=float(vertex_areas @ trust),
        warnings=() if is_joined else (NOTHING_JOINED,),
    )
    found = _warnings(figures, landmarks, target, vertex_areas, "area" if masks.shared is None else "shared area")
    return replace(figures, warnings=(*figures.warnings, *found))


def covered_share(
    target: FloatArray, image: FloatArray, triangles: IndexArray, source: TriangleSurface, masks: Masks = WHOLE
) -> float:
    """Share of the source's area, weighted by masks, that the images (n1, 3) of the target cover.

    A point of the source is covered by an image triangle that faces the same way, is less than 60 degrees from the
    point's normal, and is no farther than half its longest edge, on the target and in the image. So flat triangles of a
    coarse target cover the curved surface under them, and triangles stretched over a gap do not.
    """
    points = SurfacePoints.evenly_spread(source, COVERAGE_SAMPLES)
    normals = normalize_rows(points.interpolate(source.vertex_normals))
    reach = 0.5 * np.minimum(longest_edges(target, triangles), longest_edges(image, triangles))
    nearest, barycentric, distance = closest_points(
        build_tree(image, triangles), points.positions, normals, minimum_cosine=0.0, within=reach.max() + ON_SURFACE
    )
    offsets = points.positions - np.einsum("mk,mkd->md", barycentric, image[triangles[nearest]])
    above = np.abs(np.einsum("md,md->m", offsets, normals)) >= 0.5 * distance
    covered = (nearest >= 0) & (distance <= reach[nearest] + ON_SURFACE) & (above | (distance <= ON_SURFACE))
    counts = masks.at_source(points)
    return float(counts[covered].sum() / counts.sum())


def longest_edges(positions: FloatArray, triangles: IndexArray) -> FloatArray:
    """(t,) length of the longest edge of every triangle (t, 3)."""
    first, second, third = (positions.take(triangles[:, k], axis=0) for k in range(3))
    return np.maximum(np.maximum(row_lengths(second - first), row_lengths(third - second)), row_lengths(first - third))


def stretches(target: FloatArray, image: FloatArray, triangles: IndexArray) -> tuple[FloatArray, FloatArray]:
    """(t,) largest and smallest singular value of the map's differential on every target triangle.

    From the first fundamental forms G of the target's and H of the image's triangle: squared singular values are the
    eigenvalues of ``G^{-1} H``. Degenerate target triangles count as unstretched.
    """
    g11, g12, g22 = _first_form(target, triangles)
    h11, h12, h22 = _first_form(image, triangles)
    determinant = g11 * g22 - g12**2
    usable = determinant > 1e-12 * (g11 + g22) ** 2
    safe = np.where(usable, determinant, 1.0)
    half_trace = np.where(usable, (g22 * h11 - 2 * g12 * h12 + g11 * h22) / (2 * safe), 1.0)
    product = np.where(usable, np.maximum(h11 * h22 - h12**2, 0) / safe, 1.0)
    spread = np.sqrt(np.maximum(half_trace**2 - product, 0))
    return np.sqrt(half_trace + spread), np.sqrt(np.maximum(half_trace - spread, 0))


def _first_form(positions: FloatArray, triangles: IndexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(t,) inner products e1.e1, e1.e2, e2.e2 of the two edges leaving a triangle's first corner."""
    first, second, third = (positions.take(triangles[:, k], axis=0) for k in range(3))
    e1, e2 = second - first, third - first
    return np.einsum("td,td->t", e1, e1), np.einsum("td,td->t", e1, e2), np.einsum("td,td->t", e2, e2)


def distortion(sigma: tuple[FloatArray, FloatArray]) -> FloatArray:
    """(t,) ``max(sigma_1, 1 / sigma_2)`` of `stretches`: 1 for an isometry."""
    return np.maximum(sigma[0], 1 / np.maximum(sigma[1], 1e-6))


def trust_field(
    target: TriangleSurface, sigma: tuple[FloatArray, FloatArray], flipped: NDArray[np.bool_]
) -> FloatArray:
    """(n1,) means of triangles' ``min(1, (TRUSTED_STRETCH / d)^2)``, d their `distortion`, or 0 where flipped."""
    trusted, areas = np.empty((len(flipped), 1)), target.areas

    def fill(part: slice) -> None:
        shares = np.minimum(1.0, (TRUSTED_STRETCH / distortion((sigma[0][part], sigma[1][part]))) ** 2)
        trusted[part, 0] = areas[part] * np.where(flipped[part], 0.0, shares)

    in_threads(fill, row_slices(len(flipped), CACHED))
    weighted = corner_sums(target.triangles, trusted, target.n)[:, 0]
    total = 3.0 * areas.sum() * target.vertex_areas
    means = np.divide(weighted, total, out=np.zeros(target.n), where=total > 0)
    return np.minimum(means, 1.0, out=means)


def landmark_errors(point_map: PointMap, landmarks: PointPairs) -> FloatArray:
    """(p,) distances between landmarks' images, projected to the source, and their source points, of sqrt(area)."""
    if not len(landmarks):
        return np.zeros(0)
    means = landmarks.target.interpolate(point_map.images.positions)
    images = SurfacePoints.nearest(point_map.source, means, guess=landmarks.source.triangle).positions
    return np.linalg.norm(images - landmarks.source.positions, axis=1)


def flipped_triangles(images: SurfacePoints, triangles: IndexArray) -> NDArray[np.bool_]:
    """(t1,) target triangles whose image faces against the sum of the source's normals at its corners."""
    return inverted_triangles(images.positions, images.normals, triangles)


def inverted_triangles(positions: FloatArray, normals: FloatArray, triangles: IndexArray) -> NDArray[np.bool_]:
    """(t,) which triangles (t, 3) face against the sum of the normals (n, 3) at their corners (n, 3)."""
    flipped = np.empty(len(triangles), dtype=np.bool_)

    def fill(part: slice) -> None:
        corners = triangles[part]
        expected = sum(normals.take(corners[:, k], axis=0) for k in range(3))
        flipped[part] = np.einsum("td,td->t", triangle_normals(positions, corners), expected) < 0

    in_threads(fill, row_slices(len(triangles), CACHED))
    return flipped


def _source_normals(images: SurfacePoints) -> FloatArray:
    """(m, 3) normals at images; vertex normals at vertices, since triangles at sharp vertices mislead."""
    at_vertex = np.flatnonzero(images.barycentric.max(axis=1) == 1.0)
    if not len(at_vertex):
        return images.normals
    of_vertices = images.surface.vertex_normals[images.at(at_vertex).heaviest_corners]
    normals = images.normals.copy()
    normals[at_vertex] = of_vertices
    return normals


def weighted_percentiles(values: FloatArray, weights: FloatArray, percents: Sequence[float]) -> FloatArray:
    """Percentiles of values, weighted. Only bins between values of a sample that contain a percentile are sorted."""
    ends = np.sort(values[:: len(values) // PERCENTILE_BINS + 1])
    weight_of_bins = np.zeros(len(ends) + 1)
    for part in row_slices(len(values), CACHED):
        weight_of_bins += np.bincount(np.searchsorted(ends, values[part]), weights[part], len(ends) + 1)
    cumulative = np.cumsum(weight_of_bins)
    found = []
    for goal in np.asarray(percents) / 100 * cumulative[-1]:
        k = min(int(np.searchsorted(cumulative, goal)), len(ends))
        low, high = ends[k - 1] if k else -np.inf, ends[k] if k < len(ends) else np.inf
        inside = np.flatnonzero((values > low) & (values <= high))
        inside = inside[np.argsort(values[inside])]
        reached = np.searchsorted(np.cumsum(weights[inside]), goal - (cumulative[k - 1] if k else 0.0))
        found.append(values[inside[min(int(reached), len(inside) - 1)]])
    return np.array(found)


def _warnings(
    figures: QualityFigures, landmarks: PointPairs | None, target: TriangleSurface, vertex_areas: FloatArray, area: str
) -> list[str]:
    """Warnings for a user: what is wrong, how much of the ``area``, where."""
    messages, trust, errors = [], figures.trust, figures.landmark_errors
    names = () if landmarks is None else landmarks.names
    flipped_area, coverage = figures.flipped_area, figures.coverage
    worst = int(np.argmin(np.where(vertex_areas > 0, trust, np.inf)))
    where = f"worst at {place_text(target.positions[worst] / target.scale)} of the target's file"
    if landmarks is not None and len(landmarks):
        nearest = row_lengths(landmarks.target.positions - target.positions[worst]).argmin()
        where += f" (nearest landmark: '{names[nearest]}')"
    if flipped_area > 0.5:
        messages.append(
            f"the map turns the surface inside out ({100 * flipped_area:.0f} % of the area is flipped): left and right "
            "landmarks may be exchanged, or one mesh is mirrored"
        )
    elif flipped_area > FLIPPED_TOLERANCE:
        messages.append(f"{100 * flipped_area:.1f} % of the target's {area} is folded over, {where}")
    off = np.flatnonzero(errors > LANDMARK_TOLERANCE)
    if len(off):
        listed = ", ".join(f"{names[i]} ({100 * errors[i]:.1f} %)" for i in off[np.argsort(-errors[off])][:5])
        messages.append(f"{len(off)} landmarks are not met exactly (miss, of the model's size): {listed}")
    if coverage < COVERAGE_TOLERANCE:
        messages.append(f"{100 * (1 - coverage):.1f} % of the source's {area} is not reached by the map")
    untrusted = float(vertex_areas[trust < 0.5].sum())
    if untrusted > 0.1:
        messages.append(f"the map stretches strongly over {100 * untrusted:.0f} % of the target's {area}, {where}")
    return messages


def unshared_warnings(target_share: float, source_share: float) -> tuple[str, ...]:
    """Warnings about area without a counterpart on the other surface, from the shares with one."""
    messages = []
    if target_share < COVERAGE_TOLERANCE:
        messages.append(
            f"{100 * (1 - target_share):.1f} % of the target has no counterpart on the source: it receives what the "
            f"nearest places that have one receive{MASK_ADVICE}"
        )
    if source_share < COVERAGE_TOLERANCE:
        messages.append(f"{100 * (1 - source_share):.1f} % of the source has no counterpart on the target")
    return tuple(messages)


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _number(value: float | None) -> float:
    return np.nan if value is None else float(value)
