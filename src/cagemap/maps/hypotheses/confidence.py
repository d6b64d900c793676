"""Confidence in a map without ground truth: signs of a wrong map, verdict, other answers.

A placement that is offered to the user under a name is an answer; the map is made from the first one. Each sign has a
bound (`SIGN_BOUNDS`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from cagemap.deform.fit import coarse_fit
from cagemap.deform.placement import Placement, distinct_placements, sort_by_cost
from cagemap.deform.problem import Clusters, PreparedPair, Problem
from cagemap.deform.refit import clusters_in_pose
from cagemap.maps.hypotheses.starts import rigid_starts
from cagemap.maps.masks import WHOLE_SHARE, Masks
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import distortion, stretches, weighted_percentiles
from cagemap.mesh.mesh_report import FileVertex, place_text
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads, thread_limit
from cagemap.surface.closest_points import closest_points
from cagemap.surface.polylines import Polyline
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import vertex_normals

# Signs of a wrong map: the largest value for the verdict "sure", and the message to the user above it, in the order of
# messages. How each bound was chosen and judged: docs/lab/judge.md.
SIGNS: dict[str, tuple[float, str]] = {
    # `mirrored_gain`: cost on the source, divided by the cost on its mirror image.
    "mirrored": (
        1.2,
        "it fits the source's mirror image {value:.1f} times as well: a left part on a right one, or "
        "poses with left and right exchanged. If so, mirror one of the files",
    ),
    # Share of the target's area at which the map jumps: distant parts of the target are on one place of the source.
    "jumps": (0.03, "it jumps between parts that only touch, at {percent:.0f} % of the target"),
    # Share of the larger surface without a counterpart, if `stretched` is beyond its bound at equal area only.
    "small_part": (
        1.0 - WHOLE_SHARE,
        "{percent:.0f} % of the larger model has no counterpart, and so small a part may fit in other places too",
    ),
    # Median `distortion`, by the target's area. Both surfaces have unit area, parts too: relative to the shared area,
    # wrong places of small parts were 'sure' (docs/lab/parts.md).
    "stretched": (
        1.55,
        "with both at equal area, it stretches or compresses half of the target {value:.1f} times or more",
    ),
    # The same of coincident surfaces in one unit. Clothes have up to 1.45, a cup inside the wall of a larger one 1.81.
    "squeezed": (1.55, "the closest points stretch or compress half of the target {value:.1f} times or more"),
    # Share of the target's area that another answer of nearly equal cost turns by `TURNED_DEGREES` degrees or more.
    "limb_turned": (0.08, "a map that rotates {percent:.0f} % of the target otherwise fits almost as well"),
    # Cost x 1e4 of an answer that turns the files' axes; 0 for others.
    "turned": (1.0, "files seldom stand in different directions, and the shapes differ"),
    # Cost x 1e4: mean squared distances both ways, and the elastic energy, at unit area.
    "cost": (7.0, "the shapes differ much"),
    # Cost divided by that of the second answer; 0 if there is none.
    "runner_up": (1 / 1.3, "another alignment fits almost as well"),
}
SIGN_BOUNDS = {name: bound for name, (bound, _) in SIGNS.items()}
# Least `runner_up` for the verdict 'two answers'.
TIE = 1 / 1.12
# Least jump, of sqrt(area): a distance along the target, less twice the distance of the images along the source.
JUMP = 0.2
# Number of images that each image is compared with, and the largest distance in mean vertex spacings; opposite
# normals count as twice this distance.
NEIGHBORS, NEAR_SPACINGS = 24, 1.4
# Weight of normals, of sqrt(area): keeps images on their side of a thin part.
NORMAL_WEIGHT = 0.05
# Angle in degrees between the normals of two answers.
TURNED_DEGREES = 60.0
# Beginning of the warning about jumps.
JUMPING = "the map jumps between parts that only touch"

MIRROR_X = np.array([-1.0, 1.0, 1.0])
SURE, LOOK, TWO = "sure", "look at it", "two answers"
# Name of the first answer, where landmarks leave another one open.
AS_GIVEN = "as the landmarks are given"
# Reason shown for a result file without signs.
NOT_JUDGED = "it was matched by an older version of cagemap: match again"


@dataclass(frozen=True, eq=False)
class Confidence:
    """Verdict on a map that its landmarks alone do not determine."""

    verdict: str  #: "sure", "look at it" or "two answers"
    #: different placements of the deformed level's vertices, the best first; in a result, of all vertices of a plain
    #: target
    answers: tuple[Placement, ...]
    signs: Mapping[str, float] = field(default_factory=dict)  #: measured values of `SIGNS`
    deciding: int | None = None  #: control vertex of the target where a landmark would decide
    file_vertex: FileVertex | None = None  #: this vertex in the target's file
    part: str = ""  #: name of the part, if a result has several

    @classmethod
    def of(
        cls,
        answers: tuple[Placement, ...],
        controls: IndexArray,
        signs: Mapping[str, float] | None = None,
        weights: FloatArray | None = None,
    ) -> Confidence:
        """Confidence in the first of distinct answers, best first, by their costs and further signs of the first.

        ``controls`` (n_0,) are the control vertices that the first positions of an answer belong to. Where
        ``weights`` (n,) of the target's vertices are 0, no landmark is asked for: the source may lack the place.
        """
        signs = cost_signs(answers) | dict(signs or {})
        deciding = None
        if len(answers) > 1:
            best, second = (answer.positions[: len(controls)] for answer in answers[:2])
            apart = ((best - second) ** 2).sum(axis=1)
            deciding = int(controls[(apart if weights is None else apart * (weights[controls] > 0)).argmax()])
        verdict = SURE if not describe_signs(signs) else TWO if signs["runner_up"] > TIE else LOOK
        return cls(verdict, answers, signs, deciding)

    @property
    def message(self) -> str:
        """One or two sentences for a user, with vertex numbers of the file."""
        return f"{self.part}: {self._sentences}" if self.part else self._sentences

    @property
    def _sentences(self) -> str:
        best, *others = self.answers
        vertex = self.file_vertex or self.deciding
        if any(answer.exchange for answer in self.answers):
            return (
                "two answers: the landmarks surround each other in the opposite sense on the two surfaces. The map is "
                f"made {best.name}, another one {others[0].name} (`answer=1`)"
            )
        if others and "limb_turned" in self.signs:
            times = others[0].cost / max(best.cost, 1e-12)
            return (
                f"look at it: a map {others[0].name} fits almost as well, at {times:.2f} times the cost (`answer=1`). "
                f"A landmark at target vertex {vertex} decides"
            )
        answer = f"the target is aligned with the source {best.name}"
        if self.verdict == SURE:
            return f"sure: {answer}; no other alignment fits nearly as well"
        hint = f". Add landmarks, first at target vertex {vertex}" if self.deciding is not None else ". Add landmarks"
        if self.verdict == TWO:
            both = f"two answers: {answer}, but the alignment {others[0].name} fits as well (`answer=1`)"
            of_both = {name: value for name, value in self.signs.items() if name not in ("turned", "runner_up")}
            if found := describe_signs(of_both):
                return f"{both}, and both may be wrong: {found[0]}{hint}"
            return f"{both}. A landmark at target vertex {vertex} decides"
        why = next(iter(describe_signs(self.signs)), NOT_JUDGED)
        return f"look at it: {answer}, but {why}{hint}"

    def summary(self) -> dict[str, Any]:
        """Plain values for a manifest."""
        return {
            "verdict": self.verdict,
            "message": self.message,
            "readings": [
                {
                    "name": answer.name,
                    "cost": 1e4 * answer.cost,
                    "exchange": [list(pair) for pair in answer.exchange],
                }
                for answer in self.answers
            ],
            "signs": dict(self.signs),
            "deciding": self.deciding,
            "file_vertex": None if self.file_vertex is None else asdict(self.file_vertex),
            "part": self.part,
        }


def cost_signs(answers: tuple[Placement, ...]) -> dict[str, float]:
    """Signs derived from the costs of answers, best first."""
    best, *different = answers
    cost = 1e4 * best.cost
    runner_up = max((best.cost / max(other.cost, 1e-12) for other in different), default=0.0)
    return {"cost": cost, "turned": cost if best.penalty > 1.0 else 0.0, "runner_up": runner_up}


def describe_signs(signs: Mapping[str, float]) -> list[str]:
    """Messages to the user about the signs above their bounds."""
    beyond = [(text, signs[name]) for name, (bound, text) in SIGNS.items() if signs.get(name, 0.0) > bound]
    return [message.format(value=value, percent=100 * value) for message, value in beyond]


def answer_confidence(
    problem: Problem, point_map: PointMap, answers: tuple[Placement, ...], shared: Masks | None, jumps: FloatArray
) -> Confidence:
    """Confidence in the map of the first of several answers, from the `SIGNS` of a wrong map.

    ``jumps`` are the map's `jump_lengths` (n,). Area that is masked or not shared is ignored.
    """
    prepared, controls = problem.prepared, problem.prepared.control_vertices
    surfaces, masks = (point_map.target, point_map.source), prepared.masks.within(shared)
    weights, max_stretch = masks.of_target(point_map.target.n), SIGN_BOUNDS["stretched"]
    signs = {"jumps": jump_share(prepared, jumps), "stretched": median_distortion(point_map, weights)}
    ratio = masks.length_ratio(*surfaces)
    if shared is not None and median_distortion(point_map, weights, ratio) <= max_stretch < signs["stretched"]:
        signs["small_part"] = 1.0 - min(shared.shares(*surfaces))
    confidence = Confidence.of(answers, controls, signs, weights)
    if confidence.verdict == SURE:  # as slow as all other signs: only where none of them is beyond its bound
        signs["mirrored"] = mirrored_gain(problem, answers[0].positions)
        confidence = Confidence.of(answers, controls, signs, weights)
    if signs["jumps"] > SIGN_BOUNDS["jumps"]:  # a landmark at the jump decides, not where answers differ
        places = prepared.mesh.positions
        nearest = cKDTree(places[: len(controls)]).query(places[jumps.argmax()])[1]
        confidence = replace(confidence, deciding=int(controls[nearest]))
    return confidence


def median_distortion(found: PointMap, weights: FloatArray | None = None, ratio: float = 1.0) -> float:
    """Median `distortion` of a map, weighted by area and ``weights`` (n1,); 1 for an isometry.

    ``ratio``: that of both surfaces' sizes, where they are compared in one unit instead of at equal area.
    """
    target = found.target
    sigma = stretches(ratio * target.positions, found.images.positions, target.triangles)
    areas = target.areas if weights is None else target.areas * weights[target.triangles].mean(axis=1)
    return float(weighted_percentiles(distortion(sigma), areas, [50.0])[0])


def jump_lengths(prepared: PreparedPair, found: PointMap, shared: Masks | None = None) -> FloatArray:
    """(n,) lengths of a map's jumps at the vertices of the deformed level, of sqrt(target area); else 0.

    A map jumps where vertices far apart along the target have images near each other along the source. No cost shows
    this where parts touch. Only unmasked vertices are compared, and only shared area.
    """
    target, source = prepared.graphs
    images = found.images.at(prepared.vertices)
    masks = prepared.masks.within(shared)
    ratio = masks.length_ratio(found.target, found.source)
    pairs = image_pairs(images.positions / ratio, images.normals)
    pairs = pairs[(masks.of_target(found.target.n)[prepared.vertices] > 0)[pairs].all(axis=1)]
    on_target = distances_apart(target.station_distances, pairs)
    pairs, on_target, farthest = pairs[on_target > JUMP], on_target[on_target > JUMP], np.zeros(target.n)
    if not len(pairs):  # as of most maps
        return farthest
    ends, rows = np.unique(pairs, return_inverse=True)
    tree = cKDTree(np.hstack([source.positions, NORMAL_WEIGHT * source.normals]))
    at = tree.query(np.hstack([images.positions, NORMAL_WEIGHT * images.normals])[ends])[1]
    beyond = on_target - 2 / ratio * distances_apart(source.station_distances[:, at], rows.reshape(-1, 2))
    np.maximum.at(farthest, pairs, np.where(beyond > JUMP, beyond, 0.0)[:, None])
    return farthest


def image_pairs(places: FloatArray, normals: FloatArray) -> IndexArray:
    """(m, 2) vertices whose images (n, 3) are near each other and face the same way."""
    radius = NEAR_SPACINGS / np.sqrt(len(places))
    facing = np.hstack([places, radius * normals])
    count = min(NEIGHBORS, len(places))
    distance, neighbours = cKDTree(facing).query(facing, k=count, distance_upper_bound=radius)
    first = np.repeat(np.arange(len(places)), count)
    pairs = np.column_stack([first, np.ravel(neighbours)])
    return pairs[np.isfinite(np.ravel(distance)) & (pairs[:, 0] != pairs[:, 1])]


def distances_apart(distances: FloatArray, pairs: IndexArray) -> FloatArray:
    """(m,) lower bounds of geodesic distances of pairs (m, 2), by distances (s, n) from stations; 0 if unknown."""
    apart = np.zeros(len(pairs))
    for row in np.where(np.isfinite(distances), distances, np.nan):
        apart = np.fmax(apart, np.abs(row[pairs[:, 0]] - row[pairs[:, 1]]))
    return apart


def jump_share(prepared: PreparedPair, jumps: FloatArray) -> float:
    """Share of the target's area at which a map jumps, from `jump_lengths` (n,)."""
    return float(prepared.energy.graph.areas[jumps > 0].sum())


def jump_warnings(prepared: PreparedPair, jumps: FloatArray) -> tuple[str, ...]:
    """A warning if `jump_lengths` (n,) are not 0 on more area than the bound allows."""
    share = jump_share(prepared, jumps)
    if share <= SIGN_BOUNDS["jumps"]:
        return ()
    place = place_text(prepared.mesh.positions[jumps.argmax()] / prepared.mesh.scale)
    return (
        f"{JUMPING}, at {100 * share:.1f} % of the target's area, most at {place} of the target's file. Add "
        "landmarks on these parts",
    )


def mirrored_gain(problem: Problem, positions: FloatArray) -> float:
    """Cost of a placement (n, 3), divided by that of its best fit to the source's mirror image.

    A left shoe on a right one has no folds and costs little more. Costs are those of coarse clusters. The pose of a
    body may resemble the mirrored pose of another one: if the fit to the mirror image costs less, both are fitted again
    with rest shapes in their poses, and the smaller of the two quotients is returned.
    """
    prepared, clusters, small = problem.prepared, problem.coarse_clusters, problem.small_clusters
    source, graph, config = prepared.source_surface, small.energy.graph, prepared.elastic
    mirror_image = TriangleSurface(source.positions * MIRROR_X, source.triangles[:, ::-1])
    mirrored_problem = replace(problem, prepared=replace(prepared, source_surface=mirror_image))
    on_mirror_image, small = mirrored_constraints(clusters), mirrored_constraints(small)

    def squared_distance(start: Placement) -> float:
        return float(graph.areas @ closest_points(mirror_image.tree, start.positions)[2] ** 2)

    def small_fit(start: Placement) -> Placement:
        with thread_limit(1):
            return coarse_fit(mirrored_problem, start.positions, small)

    nearest = sorted(rigid_starts(graph.positions, graph.areas, mirror_image), key=squared_distance)
    tried = distinct_placements(nearest, graph.areas, config.search.min_start_distance)[: config.search.mirrored_starts]
    start = sort_by_cost(in_threads(small_fit, tried))[0].extrapolate_to(clusters.energy.graph, config.graph)
    fits = (
        (problem, clusters, coarse_fit(problem, positions[clusters.vertices], clusters)),
        (mirrored_problem, on_mirror_image, coarse_fit(mirrored_problem, start, on_mirror_image)),
    )
    cost, mirrored_cost = (placed.cost for _, _, placed in fits)
    if cost <= mirrored_cost:
        return cost / mirrored_cost

    def cost_in_pose(onto: Problem, fitted: Clusters, placed: Placement) -> float:
        posed = clusters_in_pose(fitted, placed.positions, config.refit)
        return coarse_fit(onto, posed.energy.graph.positions, posed).cost

    posed_cost, mirrored_posed_cost = (cost_in_pose(*fit) for fit in fits)
    return min(cost / mirrored_cost, posed_cost / mirrored_posed_cost)


def mirrored_constraints(clusters: Clusters) -> Clusters:
    """Clusters with constraints on the source's mirror image."""
    constraints = clusters.constraints
    curves = (
        replace(curve, source=Polyline(curve.source.positions * MIRROR_X, curve.source.closed))
        for curve in constraints.curves
    )
    constraints = replace(constraints, places=constraints.places * MIRROR_X, curves=tuple(curves))
    return replace(clusters, constraints=constraints)


def kept_confidence(before: Confidence | None, problem: Problem) -> Confidence | None:
    """The confidence if all its answers fit all landmarks of a problem, none of which is at its vertex; else None."""
    prepared, places = problem.prepared, problem.landmarks.source.positions
    vertices = problem.landmark_vertices[0]
    if before is None or before.deciding in prepared.vertices[vertices]:
        return None
    if prepared.target.refinement.is_plain:  # whose answers have all vertices
        vertices = prepared.vertices[vertices]
    if vertices.max(initial=-1) >= min(len(answer.positions) for answer in before.answers):
        return None  # answers of a result that was read: at control vertices only
    errors = np.linalg.norm([answer.positions[vertices] - places for answer in before.answers], axis=2)
    return before if errors.max(initial=0.0) < prepared.elastic.landmarks.max_confirmed_miss else None


def turned_limb_answers(ranked: Sequence[Placement], prepared: PreparedPair) -> Confidence | None:
    """Confidence 'look at it' with both placements that differ in a turned limb; None if there is none."""
    best, max_share = ranked[0], SIGN_BOUNDS["limb_turned"]
    for other in ranked[1:]:
        share = turned_share(prepared.mesh, best.positions, other.positions)
        if other.cost <= prepared.elastic.search.max_equal_cost * best.cost and share > max_share:
            answers = best.as_answer(AS_GIVEN), other.as_answer("with a limb turned otherwise about its axis")
            confidence = Confidence.of(answers, prepared.control_vertices, {"limb_turned": share})
            return replace(confidence, verdict=LOOK)
    return None


def turned_share(mesh: TriangleSurface, positions: FloatArray, others: FloatArray) -> float:
    """Share of a mesh's area whose normals differ by `TURNED_DEGREES` or more between two placements (n, 3)."""
    normals, turned = (vertex_normals(places, mesh.triangles) for places in (positions, others))
    areas = mesh.vertex_areas
    return float(areas[(normals * turned).sum(axis=1) <= np.cos(np.radians(TURNED_DEGREES))].sum() / areas.sum())


def prolong_answers(confidence: Confidence, prepared: PreparedPair) -> Confidence:
    """Prolong answers to all vertices of a plain target; describe the deciding vertex."""
    target, deciding = prepared.target, confidence.deciding
    if deciding is not None:
        confidence = replace(confidence, file_vertex=target.control.file_vertex(deciding))
    if not target.refinement.is_plain:
        return confidence

    def prolonged(answer: Placement) -> Placement:
        places = np.array(target.hierarchy.prolong(answer.positions, prepared.levels[0], target.finest_level))
        places[prepared.vertices] = answer.positions  # prolongation would smooth the known positions
        return replace(answer, positions=places)

    return replace(confidence, answers=tuple(prolonged(answer) for answer in confidence.answers))
