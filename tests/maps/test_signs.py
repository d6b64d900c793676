"""Signs of a wrong map, each on a map that has a known amount of it."""

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import grid, voxels
from scipy.spatial.transform import Rotation

from cagemap import pipeline
from cagemap.deform.placement import Placement
from cagemap.deform.problem import PreparedPair, Problem
from cagemap.files.result.merged_parts import merge_results
from cagemap.maps.hypotheses.confidence import (
    JUMPING,
    LOOK,
    SIGN_BOUNDS,
    SURE,
    TWO,
    Confidence,
    answer_confidence,
    describe_signs,
    image_pairs,
    jump_lengths,
    jump_share,
    jump_warnings,
    median_distortion,
    turned_share,
)
from cagemap.maps.hypotheses.search import ANOTHER_WAY, distinct_answers
from cagemap.maps.landmarks.check import LandmarkCheck
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import NOTHING_SHARED, result_of_fit
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import FloatArray
from cagemap.pipeline import MatchConfig, match, prepare_pair, prepare_surface
from cagemap.spectral import Surface
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface

from example_result import identity_result

LEG, GAP = 7, 0.05


def legs() -> Surface:
    """A hip with two long legs, whose inner sides nearly touch; their feet differ."""
    cells = [(x, LEG, z) for x in range(3) for z in range(2)] + [(x, y, 0) for x in (0, 2) for y in range(LEG)]
    mesh = voxels([*cells, (0, 0, 1), (0, 0, 2), (2, 0, 1)])
    places = mesh.positions.copy()
    places[:, 0] -= np.where(places[:, 0] > places[:, 0].mean(), 1.0 - GAP, 0.0)  # the gap of one cell closes
    return prepare_surface(mesh.with_positions(places), 2)


@pytest.fixture(scope="module")
def surface() -> Surface:
    return legs()


@pytest.fixture(scope="module")
def prepared(surface: Surface) -> PreparedPair:
    return prepare_pair(surface, surface)


def map_to(surface: Surface, places: FloatArray) -> PointMap:
    mesh = surface.triangles(surface.finest_level)
    found = SurfacePoints.nearest(mesh, places, mesh.vertex_normals, normal_weight=0.05)
    return PointMap(mesh, found)


def across(surface: Surface) -> tuple[PointMap, FloatArray]:
    """The lower half of one leg on the other leg, as if both were one; and which vertices that is."""
    mesh = surface.triangles(surface.finest_level)
    places = mesh.positions.copy()
    middle, knee = places[:, 0].mean(), np.quantile(places[:, 1], 0.4)
    lower = (places[:, 0] > middle) & (places[:, 1] < knee)
    places[lower, 0] -= 1.02 * mesh.scale
    return map_to(surface, places), lower


@pytest.mark.parametrize("name", SIGN_BOUNDS)
def test_each_sign_alone_is_a_doubt_beyond_its_bound(name: str) -> None:
    answers = (Placement(np.zeros((4, 3)), 0.0, name="as the files stand"),)
    assert Confidence.of(answers, np.arange(3), {name: SIGN_BOUNDS[name]}).verdict == SURE
    doubt = Confidence.of(answers, np.arange(3), {name: 1.1 * SIGN_BOUNDS[name]})
    assert doubt.verdict == LOOK
    assert describe_signs(doubt.signs)[0] in doubt.message


def test_an_answer_of_the_same_rotation_is_told_apart_in_words() -> None:
    places, name = np.zeros((4, 3)), "as the files stand"
    answers = Placement(places, 0.0, name=name), Placement(places, 0.0, name=name + ANOTHER_WAY)
    said = "but the alignment as the files stand (limbs assigned differently) fits as well"
    assert said in Confidence(TWO, answers, deciding=0).message


def test_two_answers_of_a_poor_map_may_both_be_wrong() -> None:
    """What only chooses between both does not say that both are wrong."""
    answers = tuple(Placement(np.full((4, 3), k), 5e-4, name=f"number {k}", penalty=1.0 + k) for k in (1.0, 2.0))
    decided = Confidence.of(answers, np.arange(3), {"stretched": 1.0})
    assert (decided.verdict, decided.signs["turned"]) == (TWO, pytest.approx(5.0))
    assert decided.message.endswith("fits as well (`answer=1`). A landmark at target vertex 0 decides")
    poor = Confidence.of(answers, np.arange(3), {"stretched": 2.0})
    assert poor.verdict == TWO
    assert ", and both may be wrong: with both at equal area, it stretches" in poor.message
    assert poor.message.endswith("2.0 times or more. Add landmarks, first at target vertex 0")


def test_a_small_part_is_doubted_as_such() -> None:
    """The end of a strip, 4 % of it, on its place: nothing is stretched, but at equal area all is compressed."""
    strip, end = prepare_surface(grid(80, 4), 1), prepare_surface(grid(16, 1), 1)
    mesh, whole = end.triangles(end.finest_level), strip.triangles(strip.finest_level)
    shared = Masks(np.ones(mesh.n), ((strip.vertices[:, 0] < 16) & (strip.vertices[:, 1] < 1)).astype(np.float64))
    problem = Problem.of_landmarks(prepare_pair(end, strip), Landmarks.none())

    def message(width: float) -> str:
        places = mesh.positions / mesh.scale * whole.scale * [1.0, width, 1.0]
        found = PointMap(mesh, SurfacePoints.nearest(whole, places))
        answers = (Placement(problem.prepared.mesh.positions, 1.0),)
        return answer_confidence(problem, found, answers, shared, np.zeros(problem.prepared.mesh.n)).message

    assert "96 % of the larger model has no counterpart, and so small a part may fit in other places too" in message(1)
    assert "it stretches or compresses half of the target" in message(0.5)


def test_further_answers_of_the_same_rotation_are_numbered(prepared: PreparedPair) -> None:
    graph = prepared.energy.graph
    placements = [Placement(graph.positions + 0.5 * k, 1.0 + k, name="as the files stand") for k in range(4)]
    named = [answer.name for answer in distinct_answers(prepared, placements)]
    way = "as the files stand (limbs assigned differently)"
    assert named == ["as the files stand", way, f"{way} 2", f"{way} 3"]


def test_the_distortion_of_a_stretched_grid_is_that_of_most_columns() -> None:
    """Seven of ten columns keep their height, which is less by the root of how much the area grew."""
    plane = grid(10, 10)
    moved, x = plane.positions.copy(), plane.positions[:, 0]
    moved[:, 0] = np.where(x < 7, 1.25 * x, 8.75 + 5.0 * (x - 7))
    faces = plane.face_indices.reshape(-1, 4)
    target, source = (TriangleSurface.from_faces(places, faces) for places in (plane.positions, moved))
    found = PointMap.from_vertices(target, source, np.arange(target.n))
    assert median_distortion(found) == pytest.approx(np.sqrt((7 * 1.25 + 3 * 5.0) / 10))


def test_masked_area_does_not_count_as_stretched() -> None:
    """All but the first third of a strip is compressed by 3 and masked."""
    strip = prepare_surface(grid(30, 10), 1)
    mesh = strip.triangles(strip.finest_level)
    places, x = mesh.positions.copy(), mesh.positions[:, 0]
    third = x.min() + np.ptp(x) / 3
    places[:, 0] = np.where(x < third, x, third + (x - third) / 3)
    masks = Masks((x < third).astype(float), None)
    problem = Problem.of_landmarks(prepare_pair(strip, strip, MatchConfig(masks=masks)), Landmarks.none())
    found = PointMap(mesh, SurfacePoints.nearest(mesh, places))
    answers = (Placement(problem.prepared.mesh.positions, 1.0),)  # too costly to be sure: nothing is fitted
    confidence = answer_confidence(problem, found, answers, None, np.zeros(problem.prepared.mesh.n))
    assert confidence.signs["stretched"] == pytest.approx(1.0)


def test_a_strip_s_last_third_on_its_first_jumps_on_both() -> None:
    strip = prepare_surface(grid(30, 10), 1)
    mesh, pair = strip.triangles(strip.finest_level), prepare_pair(strip, strip)
    places = mesh.positions.copy()
    x = places[:, 0] - places[:, 0].min()
    third = x.max() / 3
    places[x > 2 * third + 1e-9, 0] -= 2 * third
    found = PointMap(mesh, SurfacePoints.nearest(mesh, places))
    column = third / 20
    # Both thirds, and the column beside them: images compare within 1.4 mean distances of vertices.
    assert jump_share(pair, jump_lengths(pair, found)) == pytest.approx((2 * third + column) / (3 * third), abs=0.04)
    little = mesh.positions.copy()
    little[x > 2 * third + 1e-9, 0] -= 2 * column  # slides by less than `JUMP`
    assert not jump_lengths(pair, PointMap(mesh, SurfacePoints.nearest(mesh, little))).any()


def test_a_small_part_on_its_own_place_does_not_jump() -> None:
    """The end of a strip, 5 % of it: along the part it is far, along the whole it is not."""
    strip, end = prepare_surface(grid(80, 4), 1), prepare_surface(grid(16, 1), 1)
    mesh, whole = end.triangles(end.finest_level), strip.triangles(strip.finest_level)
    found = PointMap(mesh, SurfacePoints.nearest(whole, mesh.positions / mesh.scale * whole.scale))
    shared = Masks(np.ones(mesh.n), ((strip.vertices[:, 0] < 16) & (strip.vertices[:, 1] < 1)).astype(np.float64))
    pair = prepare_pair(end, strip)
    assert not jump_lengths(pair, found, shared).any()
    assert jump_share(pair, jump_lengths(pair, found)) > 0.3  # as a whole it is compressed


def test_half_a_bar_turned_about_its_axis_is_its_sides() -> None:
    """Twelve cells of a square bar; the sides of the last half have 24 of all 50 faces, the end has one."""
    bar = voxels([(0, 0, z) for z in range(12)])
    mesh = TriangleSurface.from_faces(bar.positions, bar.face_indices.reshape(-1, 4))
    middle = 0.5 * (mesh.positions.min(axis=0) + mesh.positions.max(axis=0))
    last = mesh.positions[:, 2] > middle[2] + 1e-9

    def share(degrees: float) -> float:
        turn = Rotation.from_euler("z", degrees, degrees=True)
        turned = np.where(last[:, None], turn.apply(mesh.positions - middle) + middle, mesh.positions)
        return turned_share(mesh, mesh.positions, turned)

    assert share(90.0) == pytest.approx(24 / 50, abs=4 / 50)  # one ring
    assert share(45.0) == 0.0


def test_the_identity_has_no_jumps(surface: Surface, prepared: PreparedPair) -> None:
    mesh = surface.triangles(surface.finest_level)
    same = PointMap.from_vertices(mesh, mesh, np.arange(mesh.n))
    assert not jump_lengths(prepared, same).any()
    assert jump_warnings(prepared, jump_lengths(prepared, same)) == ()


def test_a_leg_on_the_other_leg_is_told_and_said_where(surface: Surface, prepared: PreparedPair) -> None:
    mesh = surface.triangles(surface.finest_level)
    wrong, lower = across(surface)
    farthest = jump_lengths(prepared, wrong)
    share = jump_share(prepared, farthest)
    assert share > 0.05
    (sentence,) = jump_warnings(prepared, farthest)
    place = np.array([float(x) for x in sentence.split("(")[1].split(")")[0].split(",")])
    assert np.linalg.norm(mesh.positions / mesh.scale - place, axis=1).min() < 0.01
    low = mesh.positions[:, 1] < mesh.positions[lower, 1].max()
    assert low[farthest.argmax()]
    # Not sure, whatever else speaks for it.
    best = Placement(mesh.positions, 1e-4, name="as the files stand")
    problem = Problem.of_landmarks(prepared, Landmarks.none())
    deciding = answer_confidence(problem, wrong, (best,), None, farthest).deciding
    controls = prepared.mesh.positions[: len(prepared.control_vertices)]
    from_jump = np.linalg.norm(controls - prepared.mesh.positions[farthest.argmax()], axis=1)
    row = prepared.control_vertices.tolist().index(deciding)
    assert from_jump[row] == pytest.approx(from_jump.min())  # of vertices as near, any
    assert Confidence.of((best,), np.arange(3)).verdict == SURE
    doubt = Confidence.of((best,), np.arange(3), {"jumps": share})
    assert doubt.verdict == LOOK
    assert "jumps between parts that only touch" in doubt.message


def test_maps_that_landmarks_decide_are_asked_too(surface: Surface, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong, _ = across(surface)
    monkeypatch.setattr(pipeline, "search_placements", lambda problem, progress: [Placement(wrong.images.positions)])
    monkeypatch.setattr(pipeline, "map_of_places", lambda *given: wrong)
    given = Landmarks(("a", "b", "c"), np.array([0, 10, 20]), np.array([1, 10, 20]))  # not the identity
    result = match(surface, surface, given, MatchConfig(check_landmarks=False))
    assert result.quality.warnings[0].startswith(JUMPING)
    assert result.quality.match_warnings == result.quality.warnings[:1]


def test_parts_of_one_result_keep_what_was_said_of_them() -> None:
    part = identity_result()
    said = "jumps at 5.0 % of the target's area"
    jumping = replace(part, quality=replace(part.quality, warnings=("little", said), match_warnings=(said,)))
    merged = merge_results([part, jumping], {}).quality
    assert merged.warnings[0] == said
    assert merged.match_warnings == (said,)
    assert "little" not in merged.warnings


def test_parts_of_one_result_keep_their_shared_area() -> None:
    part = identity_result()
    n, m = len(part.target.vertices), len(part.source.vertices)
    lower = part.target.vertices[:, 2] < 0
    half = replace(part, shared=Masks(lower.astype(np.float64), np.ones(m)))
    merged = merge_results([part, half], {})
    # The part that was not asked weights whole, the other one as far as it did.
    assert merged.shared_shares[0] == pytest.approx((1 + half.shared_shares[0]) / 2)
    assert merged.shared.target.sum() == n + lower.sum()
    assert merged.shared_shares[1] == pytest.approx(1.0)
    lacking = f"{50 * (1 - half.shared_shares[0]):.1f} % of the target has no counterpart on the source"
    assert any(text.startswith(lacking) for text in merged.quality.warnings)
    assert merge_results([part, part], {}).shared is None
    for mask in (lower, ~lower):
        masked = replace(half, masks=Masks(mask.astype(np.float64)))
        warnings = merge_results([masked, masked], {}).quality.warnings
        assert (NOTHING_SHARED in warnings) == (mask is not lower)


def test_what_has_no_counterpart_says_nothing_about_a_map(surface: Surface, prepared: PreparedPair) -> None:
    wrong, lower = across(surface)
    weights = np.where(wrong.target.positions[:, 1] <= wrong.target.positions[lower, 1].max() + 0.05, 0.0, 1.0)
    assert not jump_lengths(prepared, wrong, Masks(weights, np.ones(wrong.source.n))).any()
    assert median_distortion(wrong, weights) == pytest.approx(1.0, abs=1e-6)
    nothing = Masks(np.zeros(wrong.target.n), np.ones(wrong.source.n))
    assert not WHOLE.within(nothing).any  # a map that shares nothing is judged as a whole


def test_unmasked_area_without_a_counterpart_is_judged_as_if_it_had_one(surface: Surface) -> None:
    same, n = map_to(surface, surface.finest_triangles.positions), len(surface.vertices)
    upper = (surface.vertices[:, 1] > surface.vertices[:, 1].mean()).astype(np.float64)
    masks, lower = Masks(upper), Masks(1.0 - upper, np.ones(n))
    np.testing.assert_array_equal(masks.within(lower).of_target(n), upper)
    problem = Problem.of_landmarks(prepare_pair(surface, surface, MatchConfig(masks=masks)), Landmarks.none())
    for shared in (lower, Masks(np.ones(n), np.ones(n))):
        found = result_of_fit(problem, same, Landmarks.none(), LandmarkCheck(), {}, shared)
        quality = found.quality
        assert np.isfinite([quality.flipped_area, quality.coverage, quality.trusted_area]).all()
        assert (NOTHING_SHARED in quality.warnings) == (shared is lower)


def test_what_is_masked_does_not_jump(surface: Surface) -> None:
    wrong, lower = across(surface)
    weights = np.where(wrong.target.positions[:, 1] <= wrong.target.positions[lower, 1].max() + 0.05, 0.0, 1.0)
    assert not jump_lengths(prepare_pair(surface, surface, MatchConfig(masks=Masks(target=weights))), wrong).any()


def test_a_map_of_one_point_stays_within_its_memory() -> None:
    places = np.zeros((4000, 3))
    assert len(image_pairs(places, np.tile([0.0, 0.0, 1.0], (4000, 1)))) < 25 * 4000
