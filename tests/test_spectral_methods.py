"""The spectral methods on real pairs: what each stage is worth, and that maps get better from level to level."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.accuracy.data import HUMANS
from examples import shapes

from cagemap.basis import BasisConfig
from cagemap.errors import ParameterError
from cagemap.functional_map import MapWeights, extend_functional_map, solve_functional_map
from cagemap.geometry.points import SurfacePoints
from cagemap.maps.pair import Pair, PointPairs, near_vertices
from cagemap.maps.spectral import hierarchical
from cagemap.maps.spectral.hierarchical import Growth, HierarchyConfig, hierarchical_map
from cagemap.maps.spectral.joining import joined_match
from cagemap.maps.spectral.levels import search_levels
from cagemap.maps.spectral.paper import PaperConfig, orthonormal, paper_map
from cagemap.maps.spectral.samples import fit_functional_map
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import MatchConfig, default_basis, match, prepare_surface
from judged_pairs import THREE, Judged


@pytest.fixture(scope="module")
def judged(shared_data):
    return Judged(HUMANS["female1605__male1591"], BasisConfig(schedule=(100, 50)), 14)


def noise_beside(coarse, constraints, weights, *, match=None):
    """The extension with its new blocks replaced by noise of the same size."""
    extended = extend_functional_map(coarse, constraints, weights, match=match)
    new = np.ones(extended.shape, dtype=bool)
    new[: coarse.shape[0], : coarse.shape[1]] = False
    values = extended[new]
    extended[new] = np.random.default_rng(7).standard_normal(new.sum()) * np.sqrt(np.mean(values**2))
    return extended


@pytest.mark.slow
def test_the_paper_method_gets_better_from_level_to_level(judged):
    """Fig. 10's claim, and the bar of 6 (x100 of sqrt(area)) with 14 landmarks."""
    errors = judged.errors(*paper_map(judged.pair))
    assert errors[0] > errors[1]
    assert errors[-1] < 5.0


@pytest.mark.slow
def test_decay_and_alternation_help_the_paper_method(judged):
    """Both stages stay because the map is worse without them."""
    usual = judged.errors(*paper_map(judged.pair))[-1]
    literal = PaperConfig(weights=replace(MapWeights(), decay=0.0), rounds=0)
    assert judged.errors(*paper_map(judged.pair, literal))[-1] > 1.3 * usual


@pytest.mark.slow
def test_every_stage_of_the_paper_method_helps_in_the_mean(shared_data):
    """Eight runs (two pairs, both directions, 14 and 30 landmarks), each stage left out in turn.

    Measured: 2.80; 2.89 without symmetry (5.2), 2.88 without signatures (5.1), 4.08 without decay, 3.11 without rounds.
    """
    usual = PaperConfig()
    weights, descriptors = usual.weights, usual.descriptors
    without = {
        "nothing": usual,
        "symmetry": replace(usual, weights=replace(weights, operators=0.0)),
        "signatures": replace(usual, descriptors=replace(descriptors, signature_weight=0.0)),
        "decay": replace(usual, weights=replace(weights, decay=0.0)),
        "rounds": replace(usual, rounds=0),
    }
    errors = {name: [] for name in without}
    for key in ("female1605__male1591", "anny10pc__anny5pc"):
        for landmarks in (14, 30):
            for back in (False, True):
                judged = Judged(HUMANS[key], BasisConfig(schedule=(100, 50)), landmarks, back=back)
                for name, config in without.items():
                    errors[name].append(judged.errors(*paper_map(judged.pair, config))[-1])
    means = {name: np.mean(found) / np.mean(errors["nothing"]) for name, found in errors.items()}
    assert means["symmetry"] > 1.01
    assert means["signatures"] > 1.01
    assert means["decay"] > 1.3
    assert means["rounds"] > 1.05


def kept_extension(monkeypatch):
    """Leave out the last solve of a growth: C stays as eqs. 14-16 have extended it."""
    mine = threading.local()  # growths run in threads

    def extend(coarse, constraints, weights, *, match=None):
        mine.found = extend_functional_map(coarse, constraints, weights, match=match)
        return mine.found

    def solve(constraints, weights, *, known=None, match=None):
        found = getattr(mine, "found", None)
        if match is not None and found is not None and found.shape == match.shape:
            return found
        return solve_functional_map(constraints, weights, known=known, match=match)

    monkeypatch.setattr(hierarchical, "extend_functional_map", extend)
    monkeypatch.setattr(hierarchical, "solve_functional_map", solve)


@pytest.mark.slow
def test_the_last_solve_and_going_on_to_more_functions_help(shared_data, monkeypatch):
    """Each left out of a map with all 300 functions; medians, which one hand or the other does not decide."""
    judged = Judged(HUMANS["female1605__male1591"], BasisConfig(), 14)
    config = HierarchyConfig(growths=THREE)

    def median(**changes):
        places = hierarchical_map(judged.pair, replace(config, **changes))[1].images.positions
        return np.median(np.linalg.norm(places - judged.images, axis=1)[judged.known])

    usual = median()
    assert median(further_functions=150) > 1.02 * usual
    kept_extension(monkeypatch)
    assert median() > 1.02 * usual


@pytest.mark.slow
def test_a_level_more_does_not_make_the_hierarchical_map_worse(shared_data):
    """Level 3, whose operators end at level 2: 0.63, as level 2 has; 0.89 with operators of the finest level."""
    judged = Judged(HUMANS["female1605__male1591"], default_basis("hfm"), 30, back=True, level=3)
    assert judged.errors(*hierarchical_map(judged.pair))[-1] < 0.75


@pytest.mark.slow
def test_signatures_heat_and_symmetry_help_the_hierarchical_map_on_a_held_out_pair(shared_data):
    """Three growths: 2.03 with all; without heat 2.10, signatures 2.17, symmetry 2.19, heat and signatures 2.44.

    Picked after six such runs: it guards the stages and proves no gain; `base -> proxy741` goes the other way
    (docs/accuracy.md).
    """
    judged = Judged(HUMANS["base__proxy741"], BasisConfig(), 14, back=True)
    usual = HierarchyConfig(growths=THREE)
    descriptors, weights = usual.descriptors, usual.weights

    def error(**changes):
        return judged.errors(*hierarchical_map(judged.pair, replace(usual, **changes)))[-1]

    best = error()
    assert error(descriptors=replace(descriptors, heat=0)) > 1.01 * best
    assert error(descriptors=replace(descriptors, signature_weight=0.0)) > 1.03 * best
    assert error(weights=replace(weights, operators=0.0)) > 1.03 * best
    assert error(descriptors=replace(descriptors, heat=0, signature_weight=0.0)) > 1.1 * best


def one_way(target, source, matches, sizes):
    """C of the target's matches alone, Phi1^+ P12 Phi2, in place of both ways'."""
    return fit_functional_map(target, source.rows[matches[0]][:, : sizes[1]], sizes[0])


@pytest.mark.slow
def test_extended_blocks_matter_to_the_hierarchical_map(shared_data, monkeypatch):
    """Noise in what eqs. 14-16 find makes the whole method's map worse by half at least: before, it changed nothing.

    With the bases that the method asks for, 300 functions: 0.75 and 1.50 measured.
    """
    judged = Judged(HUMANS["female1605__male1591"], BasisConfig(), 14)
    usual = judged.errors(*hierarchical_map(judged.pair))[-1]
    assert usual < 1.3
    monkeypatch.setattr(hierarchical, "extend_functional_map", noise_beside)
    assert judged.errors(*hierarchical_map(judged.pair))[-1] > 1.5 * usual


@pytest.mark.slow
def test_descriptors_and_matches_both_ways_help_every_band(judged, monkeypatch):
    """Without descriptors beside the map it is plain upsampling, and worse; so it is without the source's matches."""
    config = HierarchyConfig()
    map_alone = replace(config, weights=replace(config.weights, match=1e9))
    usual = judged.errors(*hierarchical_map(judged.pair, config))[-1]
    assert judged.errors(*hierarchical_map(judged.pair, map_alone))[-1] > 1.02 * usual
    config = replace(config, growths=THREE)
    usual = judged.errors(*hierarchical_map(judged.pair, config))[-1]
    monkeypatch.setattr(hierarchical, "fit_both_ways", one_way)
    assert judged.errors(*hierarchical_map(judged.pair, config))[-1] > 1.1 * usual


@pytest.mark.slow
def test_joining_takes_each_hand_from_the_map_that_has_it_right(shared_data, monkeypatch):
    """Two maps of which each has one side of the better growth, the other side of the worse one."""
    judged = Judged(HUMANS["base__male1591"], BasisConfig(), 30)
    errors = {}

    def halves(matches, places, triangles, merit):
        good, bad = sorted(matches, key=merit, reverse=True)
        left = judged.pair.target.triangles(1).positions[:, 0] > 0
        mixed = [np.where(left, good, bad), np.where(left, bad, good)]
        joined = joined_match(mixed, places, triangles, merit)
        errors.update(mixed=min(judged.error(places[m]) for m in mixed), joined=judged.error(places[joined]))
        return joined

    monkeypatch.setattr(hierarchical, "joined_match", halves)
    growths = Growth(12, 1.55, 0.33, 0.1), Growth(12, 1.55, 0.1, 0.3)
    hierarchical_map(judged.pair, HierarchyConfig(growths=growths, further_functions=150))
    assert errors["mixed"] > 1.1 * errors["joined"]


@pytest.mark.slow
def test_the_final_map_is_worse_without_joining(shared_data, monkeypatch):
    """The best growth goes on alone, on a pair that joining was chosen with: 1.21 times the error measured."""
    judged = Judged(HUMANS["base__male1591"], BasisConfig(), 30, back=True)
    usual = judged.errors(*hierarchical_map(judged.pair))[-1]
    monkeypatch.setattr(hierarchical, "joined_match", lambda matches, *known: max(matches, key=known[-1]))
    assert judged.errors(*hierarchical_map(judged.pair))[-1] > 1.1 * usual


@pytest.mark.slow
def test_coordinates_beside_the_functions_help_below_the_searched_level(judged, monkeypatch):
    """Left out of the candidates' search and of the step from vertices to points."""
    config = HierarchyConfig(growths=THREE)
    usual = judged.errors(*hierarchical_map(judged.pair, config))[-1]
    monkeypatch.setattr(hierarchical, "shared_coordinates", lambda *known: None)
    assert judged.errors(*hierarchical_map(judged.pair, config))[-1] > 1.01 * usual


@pytest.mark.slow
def test_normals_turn_hands_the_right_way(shared_data):
    """Both hands of this pair come out half a turn off without them."""
    judged = Judged(HUMANS["base__male1591"], BasisConfig(), 30)
    errors = []
    for weight in (0.0, 0.6):
        config = HierarchyConfig(growths=(Growth(20, 1.5, 0.33, weight),), further_functions=150)
        errors.append(judged.errors(*hierarchical_map(judged.pair, config))[-1])
    assert errors[0] > 1.2 * errors[1]


def creature_pair(level=1, schedule=(20, 10)):
    surface = prepare_surface(shapes.creature(), level, BasisConfig(schedule=schedule))
    chosen = np.arange(0, surface.control.n_vertices, 7)
    return Pair.of_vertices(surface, surface, chosen, chosen)


def test_on_the_only_level_the_functional_map_has_all_functions():
    """Growths ended at 20 of 30 functions and no level below adds the others: RESULT could not be read."""
    pair = creature_pair(schedule=(20, 10))
    config = HierarchyConfig(search_vertices=300, searched_functions=20, further_functions=20)
    assert search_levels(pair.target, pair.source, 300) == (pair.target.finest, pair.source.finest)
    maps, _ = hierarchical_map(pair, config)
    assert len(maps) == 1
    assert maps[0].functional_map.shape == (30, 30)
    np.testing.assert_allclose(np.abs(maps[0].functional_map), np.eye(30), atol=0.2)


def test_landmarks_between_vertices_have_vertices_of_the_searched_level():
    """Those of the level where functions end are more than the searched level has: an internal error."""
    surface = creature_pair(2, (40, 15, 5)).target
    mesh = surface.triangles(2)
    rng = np.random.default_rng(0)
    points = SurfacePoints(mesh, rng.integers(0, len(mesh.triangles), 8), rng.dirichlet([3.0, 3.0, 3.0], 8))
    config = HierarchyConfig(search_vertices=300, searched_functions=20, growths=(Growth(),))
    assert search_levels(surface, surface, 300) == (1, 1)
    assert near_vertices(points, surface).max() >= surface.triangles(1).n > near_vertices(points, surface, 1).max()
    maps, found = hierarchical_map(Pair(surface, surface, PointPairs(points, points)), config)
    assert [level.functional_map.shape for level in maps] == [(55, 55), (60, 60)]
    assert np.median(np.linalg.norm(found.images.positions - mesh.positions, axis=1)) < 0.01


def test_finer_levels_start_from_the_same_map():
    """Operators end at the searched level: its matches are the same whichever level is the finest."""
    found, config = [], HierarchyConfig(search_vertices=300, searched_functions=20, growths=(Growth(),))
    for levels in ((1, 1), (2, 1), (3, 2)):
        one, two = (prepare_surface(shapes.creature(), level, BasisConfig(count=30, vertices=300)) for level in levels)
        chosen = np.arange(0, one.control.n_vertices, 7)
        landmarks = Landmarks(tuple(map(str, chosen)), chosen, chosen, one.control.name, two.control.name)
        found.append(match(one, two, landmarks, MatchConfig(method="hfm", hierarchy=config)))
        assert found[-1].level_maps[-1].levels == levels
        away = found[-1].point_map.images.positions - one.triangles(one.finest).positions
        assert np.median(np.linalg.norm(away, axis=1)) < 0.03  # a wrong part of the body is 0.3 away
    for other in found[1:]:
        assert np.mean(other.level_maps[0].match == found[0].level_maps[0].match) > 0.95
    with pytest.raises(ParameterError, match=r"hfm needs operators up to level 3, got .* end at level 1"):
        match(one, one, landmarks, MatchConfig(method="hfm", hierarchy=replace(config, search_vertices=5000)))


def test_maps_of_all_levels_are_returned_and_are_the_identity():
    """A surface and itself: C = I and every vertex its own match, level by level."""
    pair = creature_pair()
    maps, points = paper_map(pair, PaperConfig(weights=MapWeights(decay=0.0)))
    assert [found.levels for found in maps] == [(0, 0), (1, 1)]
    for found, size in zip(maps, (20, 30), strict=True):
        np.testing.assert_allclose(found.functional_map, np.eye(size), atol=1e-6)
        np.testing.assert_array_equal(found.match, np.arange(len(found.match)))
    away = np.linalg.norm(points.images.positions - pair.source.triangles(1).positions, axis=1)
    assert away.max() < 1e-3


def test_sides_may_have_their_own_levels_and_schedules():
    """Table 1: the finer side waits, and C has as many rows and columns as the sides have functions."""
    one = prepare_surface(shapes.creature(), 2, BasisConfig(schedule=(12, 6, 4)))
    two = prepare_surface(shapes.creature(), 1, BasisConfig(schedule=(10, 8)))
    chosen = np.arange(0, one.control.n_vertices, 9)
    maps, points = paper_map(Pair.of_vertices(one, two, chosen, chosen))
    assert maps[-1].levels == (2, 1)
    assert maps[-1].functional_map.shape == (22, 18)
    assert points.source.n == two.refinement.finest.n_vertices


def test_orthonormal_is_the_nearest_isometry():
    """Singular values become 1, singular vectors stay (2.1.4)."""
    rng = np.random.default_rng(3)
    c = rng.standard_normal((6, 4))
    q = orthonormal(c)
    np.testing.assert_allclose(q.T @ q, np.eye(4), atol=1e-12)
    other, _ = np.linalg.qr(rng.standard_normal((6, 4)))
    assert np.linalg.norm(c - q) < np.linalg.norm(c - other)


def test_match_keeps_the_maps_of_all_levels():
    surface = creature_pair().target
    chosen = np.arange(0, surface.control.n_vertices, 7)
    landmarks = Landmarks(tuple(map(str, chosen)), chosen, chosen, surface.control.name, surface.control.name)
    found = match(surface, surface, landmarks, MatchConfig(method="paper"))
    assert [one.levels for one in found.level_maps] == [(0, 0), (1, 1)]
    np.testing.assert_array_equal(found.functional_map, found.level_maps[-1].functional_map)


def test_wrong_parameters_are_refused():
    with pytest.raises(ParameterError, match="rounds: expected 0 or more alternations, got -1"):
        PaperConfig(rounds=-1)
    with pytest.raises(ParameterError, match="first functions"):
        Growth(factor=1.0)
    with pytest.raises(ParameterError, match="one growth"):
        HierarchyConfig(growths=())
    with pytest.raises(ParameterError, match="start: expected a functional map of level 0"):
        paper_map(creature_pair(), start=np.eye(3))
