"""Starts that landmarks do not give: rigid alignments of the files, and limbs assigned to limbs by their tips.

A start is a rough position on the source for every vertex of the target's coarse graph. Rigid ones align bounding boxes
or principal axes, or keep the files' positions; none is mirrored: the elastic fit cannot undo that. Limbs assigned by
intrinsic measures give starts that do not depend on the pose.

Between species a fit can leave an ear or a hoof beside its counterpart, or a short leg inside a long one. So tips near
each other are constraints of a refit, whose coarse stage has source-to-target data terms too.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from cagemap.deform.config import SearchConfig
from cagemap.deform.fit import coarse_fit, evaluate_placement, fine_fit
from cagemap.deform.graph import ElasticGraph
from cagemap.deform.placement import Placement, distinct_placements
from cagemap.deform.problem import PreparedPair, Problem, Tips
from cagemap.deform.refit import common_rotation
from cagemap.maps.masks import WHOLE_SHARE
from cagemap.numerics.arrays import FloatArray, IndexArray, nearest_rotations
from cagemap.numerics.threads import in_threads, thread_limit
from cagemap.surface.alignment import Y_UP, axis_rotations, nearest_axis_rotation, principal_frame, rotations_onto
from cagemap.surface.triangle_surface import TriangleSurface

AS_FILED, BY_FILE_AXES = "as the files stand", "by the axes that the files state"
# Starts of `rigid_starts` for each rotation: boxes with one scale and with three.
STARTS_PER_ROTATION = 2
# Least extent of a box; a box that is flat along an axis is not stretched along it.
LEAST_EXTENT = 1e-6
# Least length of a limb, of sqrt(area).
LEAST_LENGTH = 0.01
# Measures of e limbs and p landmarks, in sqrt(area): geodesic distances (p + e, p + e) between the roots of limbs,
# landmarks first (they count as limbs); and girths (e,), area divided by length.
LimbMeasures = tuple[FloatArray, FloatArray]


def assigned_limbs(problem: Problem) -> list[Tips]:
    """Corresponding tips (k,) of limbs of target and source, most likely first; none if a surface has too few."""
    ratio, config = file_ratio(problem.prepared) or 1.0, problem.prepared.elastic.search
    units = min(ratio, 1.0), min(1.0 / ratio, 1.0)  # of both sides, as multiples of the larger surface's unit
    landmarks, tips = problem.landmark_vertices, find_tips(problem, config.limb_height, units)
    ends = tips[0][: config.max_limbs], tips[1][: config.max_limbs]
    fewest = min(map(len, ends))
    needed = config.fewest_points if units == (1.0, 1.0) else config.fewest_of_part
    if fewest < 1 or len(landmarks[0]) + fewest < needed:
        return []
    sides = zip(problem.prepared.graphs, landmarks, ends, units, strict=True)
    target, source = (limb_measures(*side, config.girth_part) for side in sides)
    return [(ends[0][i], ends[1][j]) for i, j in rank_assignments(target, source, config)]


def limb_measures(
    graph: ElasticGraph,
    landmarks: IndexArray,
    tips: IndexArray,
    unit: float = 1.0,
    girth_part: float = SearchConfig.girth_part,
) -> LimbMeasures:
    """Measure the limbs of tips (e,) and landmarks (p,), in a unit; at least three, connected.

    The length of a limb is that of its leaf in the tree of all ends, the Gromov product
    ``min_jk (d_ij + d_ik - d_jk) / 2``.
    """
    ends = np.concatenate([landmarks, tips])
    distances = graph.distances(ends)
    apart = distances[:, ends]
    products = 0.5 * (apart[:, :, None] + apart[:, None, :] - apart)
    every = np.arange(len(ends))
    products[every, every, :] = products[every, :, every] = products[:, every, every] = np.inf
    lengths = np.maximum(products.min(axis=(1, 2)), LEAST_LENGTH)
    between = apart - lengths[:, None] - lengths
    between[every, every] = 0.0
    part, limbs = girth_part * lengths[len(landmarks) :], distances[len(landmarks) :]
    return unit * between, unit * ((limbs < part[:, None]) @ graph.areas / part)


def rank_assignments(
    target: LimbMeasures, source: LimbMeasures, config: SearchConfig = SearchConfig()
) -> list[tuple[IndexArray, IndexArray]]:
    """Assignments of limbs, most likely first: their numbers (k,) on target and on source.

    Ranked by distances between roots of limbs and by girths. Lengths do not count: a hippo has short legs and a cougar
    a long tail.
    """
    (between, girths), (source_between, source_girths) = target, source
    if len(girths) > len(source_girths):
        return [(i, j) for j, i in rank_assignments(source, target, config)]
    count, landmarks = len(girths), len(between) - len(girths)
    to = np.array(list(permutations(range(len(source_girths)), count)))
    ends = np.hstack([np.tile(np.arange(landmarks), (len(to), 1)), landmarks + to])
    apart = np.abs(source_between[ends[:, :, None], ends[:, None, :]] - between).sum(axis=(1, 2))
    ratios = np.log(source_girths[to] / girths)
    ratios -= np.median(ratios, axis=1, keepdims=True)
    ranked = np.argsort(apart + config.girth_weight * np.abs(ratios).sum(axis=1), kind="stable")
    return [(np.arange(count), to[row]) for row in ranked[: config.max_assignments]]


def file_ratio(prepared: PreparedPair) -> float | None:
    """Factor from the target's unit, sqrt(area), to the source's, in file lengths.

    None for closed surfaces, whose units need no file, and for files whose units seem to be unrelated.
    """
    target, source = prepared.target.finest_triangles, prepared.source.finest_triangles
    ratio, most = source.scale / target.scale, prepared.elastic.search.max_unit_ratio
    is_related = (target.is_open or source.is_open) and 1.0 / most <= ratio <= most
    return ratio if is_related else None


def find_tips(problem: Problem, least: float | None = None, units: tuple[float, float] = (1.0, 1.0)) -> Tips:
    """Tips of limbs (e,), (e2,) of a least height in ``units``, highest first: vertices of both searched levels.

    None is masked, at a landmark or at a boundary.
    """
    prepared, landmarks = problem.prepared, problem.landmarks
    config, (target, source) = prepared.elastic.search, prepared.graphs
    least, tips = config.tip_height if least is None else least, []
    searched = prepared.source.hierarchy.on_finest(prepared.levels[1])
    masks = prepared.masks.at(prepared.vertices, searched)
    meshes = prepared.mesh, prepared.source.triangles(prepared.levels[1])
    for graph, mesh, weights, given, unit in (
        (target, meshes[0], masks.of_target(target.n), landmarks.target.positions, units[0]),
        (source, meshes[1], masks.of_source(source.n), landmarks.source.positions, units[1]),
    ):
        vertices = tip_vertices(graph, least / unit)
        away = np.linalg.norm(graph.positions[vertices, None] - given, axis=2).min(axis=1, initial=np.inf)
        kept = (weights[vertices] > 0) & (away > config.min_landmark_distance) & ~mesh.boundary_vertices[vertices]
        tips.append(vertices[kept])
    return tips[0], tips[1]


def tip_vertices(graph: ElasticGraph, least: float = SearchConfig.tip_height) -> IndexArray:
    """(e,) local maxima of the mean geodesic distance, most prominent first.

    Mean geodesic distance: Hilaga et al. 2001. Prominence: Edelsbrunner et al. 2002, see `prominences`.
    """
    heights = mean_distances(graph)
    peaks, above = prominences(heights, graph.heads, graph.tails)
    kept = above >= least
    return peaks[kept][np.argsort(-above[kept], kind="stable")]


def mean_distances(graph: ElasticGraph) -> FloatArray:
    """(n,) mean geodesic distance of every vertex to its connected piece; 0 on small pieces."""
    distances = graph.station_distances
    reached = np.isfinite(distances)
    large = reached.any(axis=0)
    shares = np.bincount(distances.argmin(axis=0), graph.areas * large, len(distances))
    return np.asarray((shares @ np.where(reached, distances, 0.0)) / np.where(large, shares @ reached, 1.0))


def prominences(heights: FloatArray, heads: IndexArray, tails: IndexArray) -> tuple[IndexArray, FloatArray]:
    """Local maxima (q,) of heights (n,), and their persistence: the height above the pass to a higher maximum."""
    order = np.argsort(heights, kind="stable")
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    best = rank.copy()
    np.maximum.at(best, heads, rank[tails])
    up = order[best]
    while not np.array_equal(up[up], up):  # every vertex climbs to its peak
        up = up[up]
    peaks, basin = np.unique(up, return_inverse=True)
    across = basin[heads] < basin[tails]
    basins, passes = np.column_stack([basin[heads], basin[tails]])[across], np.minimum(rank[heads], rank[tails])[across]
    descending = np.argsort(-passes, kind="stable")
    _, highest = np.unique(basins[descending], axis=0, return_index=True)  # the highest pass between any two basins
    above, joined = np.full(len(peaks), np.inf), np.arange(len(peaks))
    for edge in descending[np.sort(highest)].tolist():
        a, b = joined[basins[edge]].tolist()
        if a != b:
            lower, higher = (a, b) if rank[peaks[a]] < rank[peaks[b]] else (b, a)
            above[lower] = heights[peaks[lower]] - heights[order[passes[edge]]]
            joined[joined == lower] = higher
    lowest, highest_ones = np.full(len(peaks), np.inf), np.isinf(above)
    np.minimum.at(lowest, joined[basin], heights)
    above[highest_ones] = (heights[peaks] - lowest)[highest_ones]
    return peaks, above


def refit_distinct_to_tips(problem: Problem, ranked: Sequence[Placement]) -> list[Placement]:
    """Placements, those that are cheap and different from all better ones refitted by `refit_to_tips`."""
    tips, config = find_tips(problem), problem.prepared.elastic.search
    distinct = distinct_placements(ranked, problem.prepared.energy.graph.areas, config.min_answer_distance)
    max_cost = config.max_cost * min(placed.cost for placed in ranked)

    def refit(placed: Placement) -> Placement:
        return refit_to_tips(problem, tips, placed) if placed in distinct and placed.cost <= max_cost else placed

    return in_threads(refit, ranked)


def refit_to_tips(problem: Problem, tips: Tips, placed: Placement) -> Placement:
    """Refit a placement with mutually nearest tips as constraints of the coarse stage; unchanged if much costlier.

    Only landmarks are constraints of the fine stage, so that tips that do not correspond can separate.
    """
    prepared, config = problem.prepared, problem.prepared.elastic.search
    pairs = pair_tips(placed.positions[tips[0]], prepared.graphs[1].positions[tips[1]], config)
    if not len(pairs):
        return placed
    clusters = problem.clusters_with((tips[0][pairs[:, 0]], tips[1][pairs[:, 1]]), prepared.elastic.stiff_coarse)
    with thread_limit(1):
        coarse = coarse_fit(problem, placed.positions[clusters.vertices], clusters, prepared.source_samples)
    refitted = evaluate_placement(prepared, fine_fit(problem, coarse)).with_start_of(placed)
    return refitted if refitted.cost <= config.max_equal_cost * placed.cost else placed


def pair_tips(images: FloatArray, places: FloatArray, config: SearchConfig) -> IndexArray:
    """(q, 2) tips that are mutually nearest, the target's by their images (e, 3), the source's by places (e2, 3)."""
    pairs, distances = mutually_nearest(images, places, config.max_tip_distance)
    return pairs if np.any(distances > config.min_tip_miss) else pairs[:0]


def mutually_nearest(points: FloatArray, others: FloatArray, within: float) -> tuple[IndexArray, FloatArray]:
    """(q, 2) points (n, 3) and others (m, 3) that are mutually nearest and nearer than a distance; distances (q,)."""
    if not len(points) or not len(others):
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0)
    distance, nearest = (np.asarray(column) for column in cKDTree(others).query(points))
    back = np.asarray(cKDTree(points).query(others)[1])
    rows = np.flatnonzero((distance < within) & (back[nearest] == np.arange(len(points))))
    return np.column_stack([rows, nearest[rows]]).astype(np.int64), distance[rows]


def unmoved_start(prepared: PreparedPair, points: FloatArray) -> list[Placement]:
    """Start of points (k, 3) at their position in the files; none for closed surfaces or unrelated units."""
    ratio = file_ratio(prepared)
    return [] if ratio is None else [Placement(np.asarray(ratio * points))]


def part_starts(prepared: PreparedPair, points: FloatArray, areas: FloatArray) -> list[Placement]:
    """Starts of a part's points (k, 3) on patches of the whole, or of a whole's on a part; none for two wholes.

    A patch has the part's area in file units. Part and patch have one centre, and no rotation or one of the four that
    align their principal frames.
    """
    ratio, source = file_ratio(prepared), prepared.source_surface
    share = 1.0 if ratio is None else min(ratio, 1.0 / ratio) ** 2
    if ratio is None or share >= WHOLE_SHARE:
        return []
    own = principal_frame(points, areas), principal_frame(source.positions, source.vertex_areas)
    larger, starts = prepared.graphs[int(ratio < 1.0)], list[Placement]()
    for distances in larger.station_distances[: prepared.elastic.search.part_patches]:
        order = np.argsort(distances, kind="stable")
        patch = order[: np.searchsorted(np.cumsum(larger.areas[order]), share) + 1]
        frame = principal_frame(larger.positions[patch], larger.areas[patch])
        (centre, axes, _), (source_centre, source_axes, _) = (own[0], frame) if ratio < 1.0 else (frame, own[1])
        for rotation in (np.eye(3), *rotations_onto(axes, source_axes)):
            starts.append(Placement(ratio * (points - centre) @ rotation.T + source_centre))
    return starts


def rigid_starts(
    points: FloatArray, areas: FloatArray, source: TriangleSurface, usual: Sequence[FloatArray] = ()
) -> list[Placement]:
    """Placements of points (k, 3) with areas (k,) that align bounding boxes or principal frames with the source's.

    Boxes in all 24 axis rotations, the ``usual`` ones first, with equal diagonals (one scale) or equal extents (three
    scales). Principal frames in four rotations, not scaled.
    """
    starts = []
    for matrix in sorted(axis_rotations(), key=lambda one: not _is_among(one, usual)):
        turned = points @ matrix.T
        starts += [Placement(_fit_to_box(turned, source.positions, stretched)) for stretched in (False, True)]
    centre, axes, _ = principal_frame(points, areas)
    source_centre, source_axes, _ = principal_frame(source.positions, source.vertex_areas)
    for rotation in rotations_onto(axes, source_axes):
        starts.append(Placement((points - centre) @ rotation.T + source_centre))
    return starts


def _fit_to_box(points: FloatArray, source_points: FloatArray, stretched: bool) -> FloatArray:
    """Points moved and scaled so that their bounding box agrees with the source's."""
    low, high = points.min(axis=0), points.max(axis=0)
    source_low, source_high = source_points.min(axis=0), source_points.max(axis=0)
    extent, wanted = np.maximum(high - low, LEAST_EXTENT), np.maximum(source_high - source_low, LEAST_EXTENT)
    scale = wanted / extent if stretched else np.linalg.norm(wanted) / np.linalg.norm(extent)
    return np.asarray((points - (low + high) / 2) * scale + (source_low + source_high) / 2)


def usual_rotations(prepared: PreparedPair) -> list[FloatArray]:
    """Rotations (3, 3) that have no penalty: the identity, and that from the target's up axis to the source's."""
    target, source = up_rotations(prepared)
    onto_source = source @ target.T
    return [np.eye(3)] if np.array_equal(onto_source, np.eye(3)) else [np.eye(3), onto_source]


def up_rotations(prepared: PreparedPair) -> tuple[FloatArray, FloatArray]:
    """Rotations (3, 3) of target and source to +Y up, about axes; the identity if the up axis is unknown."""
    given = (side.control.upright for side in (prepared.target, prepared.source))
    target, source = (Y_UP if upright is None else nearest_axis_rotation(upright) for upright in given)
    return target, source


def axis_rotation(areas: FloatArray, maps: FloatArray) -> FloatArray:
    """The one of `axis_rotations` nearest to the differentials (n, 3, 3) of a placement with areas (n,)."""
    return nearest_axis_rotation(common_rotation(areas, nearest_rotations(maps)))


def rotation_name(matrix: FloatArray, usual: Sequence[FloatArray] = ()) -> str:
    """Description for a user of a rotation (3, 3), which may be one of the `usual_rotations`."""
    vector = Rotation.from_matrix(matrix).as_rotvec(degrees=True)
    angle = round(float(np.linalg.norm(vector)))
    if angle == 0:
        return AS_FILED
    if _is_among(matrix, usual):
        return BY_FILE_AXES
    axis = np.round(vector / np.abs(vector).max()).astype(int)
    if np.count_nonzero(axis) == 1:
        sign = "-" if axis.sum() < 0 and angle != 180 else ""
        return f"turned {angle} degrees about {sign}{'xyz'[int(np.flatnonzero(axis)[0])]}"
    return f"turned {angle} degrees about ({', '.join(map(str, axis))})"


def rotation_penalty(matrix: FloatArray, prepared: PreparedPair) -> float:
    """Factor on the cost of a placement that is rotated by one of `axis_rotations`; 1 for `usual_rotations`.

    A rotation about the up axis has the factor ``turned_penalty``, others ``tilted_penalty``. If the files' up axes
    differ, one of the files may be wrong: the smaller factor counts, with these axes and with +Y up in both.
    """
    config, (target, source) = prepared.elastic.search, up_rotations(prepared)
    between_upright = source.T @ matrix @ target

    def penalty(rotation: FloatArray) -> float:  # +Y up; entries are -1, 0 or 1
        if rotation[1, 1] < 0.5:
            return config.tilted_penalty
        return 1.0 if rotation[0, 0] > 0.5 else config.turned_penalty

    penalties = penalty(between_upright), penalty(matrix)
    return penalties[0] if np.array_equal(target, source) else min(penalties)


def _is_among(matrix: FloatArray, others: Sequence[FloatArray]) -> bool:
    return any(np.array_equal(matrix, other) for other in others)
