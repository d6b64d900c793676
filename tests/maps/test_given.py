"""Maps in every form that users have, and the same maps in other bases."""

from __future__ import annotations

import numpy as np
import pytest
from examples import shapes

from cagemap import research
from cagemap.errors import ParameterError
from cagemap.maps.functional_maps import check_map, functional_map_from, image_positions
from cagemap.maps.point_map import PointMap
from cagemap.pipeline import prepare_pair
from cagemap.spectral import BasisConfig

from quick_match import QUICK
from refusals import refuses


@pytest.fixture(scope="module")
def pair():
    """The creature, and the same one wider: vertex i is vertex i."""
    mesh = shapes.creature()
    sides = [
        research.prepare(mesh.with_positions(mesh.positions * by), 1, BasisConfig(count=40))
        for by in (1, [1.2, 1, 0.9])
    ]
    chosen = np.arange(0, mesh.n_vertices, 9)
    return research.make_pair(*sides, (chosen, chosen))


def forms(pair):
    """The true map as a point map, vertices of both levels, and a matrix."""
    n = len(pair.target.vertices)
    true = PointMap.from_vertices(pair.target.finest_triangles, pair.source.finest_triangles, np.arange(n))
    return true, np.arange(n), np.arange(pair.target.control.n_vertices), functional_map_from(pair, true)


def test_every_form_gives_the_same_places_and_matrix(pair):
    true, *others = forms(pair)
    vertices = np.arange(0, len(pair.target.vertices), 5)
    wanted = true.images.at(vertices).positions
    np.testing.assert_array_equal(image_positions(pair, true, vertices), wanted)
    for given, most in zip(others, (0.0, 0.05, 0.05), strict=True):
        away = np.linalg.norm(image_positions(pair, given, vertices) - wanted, axis=1)
        assert away.mean() <= most
        np.testing.assert_allclose(functional_map_from(pair, given)[:10, :10], others[2][:10, :10], atol=0.05)
    np.testing.assert_array_equal(
        image_positions(pair, others[1], np.arange(9)), true.images.at(np.arange(9)).positions
    )


def test_what_is_no_map_of_the_pair_is_refused(pair):
    n = len(pair.target.vertices)
    wrong = (3, np.zeros((0, 0)), np.eye(41), np.arange(n - 1), np.full(n, n), np.full(n, -1))
    for given in wrong:
        refuses(ParameterError, "map: expected a PointMap, a functional map of at most", check_map, pair, given)
    refuses(ParameterError, "finite numbers", check_map, pair, np.full((4, 4), np.nan))
    coarse = pair.target.triangles(0)
    with pytest.raises(ParameterError, match="may be exchanged"):
        check_map(pair, PointMap.from_vertices(coarse, coarse, np.arange(coarse.n)))


def test_bases_of_others_may_be_flipped_and_mixed(pair):
    """C there and back where the others' functions are a rotation of ours; pyFM's signs are another."""
    rng = np.random.default_rng(2)
    ours = [side.basis.at(1) for side in (pair.target, pair.source)]
    turns = [np.linalg.qr(rng.standard_normal((40, 40)))[0] for _ in ours]
    psi1, psi2 = (functions @ turn for functions, turn in zip(ours, turns, strict=True))
    matrix = forms(pair)[-1]
    theirs = research.to_bases(pair, matrix, psi1, psi2)
    np.testing.assert_allclose(theirs, turns[0].T @ matrix @ turns[1], atol=1e-5)
    np.testing.assert_allclose(research.from_bases(pair, theirs, psi1, psi2), matrix, atol=1e-5)
    assert research.from_bases(pair, np.eye(7, 5), psi1, psi2).shape == (7, 5)
    with pytest.raises(ParameterError, match=r"target functions: expected .* the vertices of level 1"):
        research.from_bases(pair, theirs, psi1[:-1], psi2)
    refuses(ParameterError, "source functions: expected", research.from_bases, pair, theirs, psi1, psi2[:, :39])


@pytest.mark.slow
def test_the_steps_follow_each_other_from_any_form(pair):
    true, vertices, coarse, matrix = forms(pair)
    prepared = prepare_pair(pair.target, pair.source, QUICK)
    for given in (vertices, coarse, matrix):
        found = research.elastic(pair, given, prepared)
        assert np.linalg.norm(found.images.positions - true.images.positions, axis=1).mean() < 0.02
    free = research.make_pair(pair.target, pair.source)
    found = research.unfold(free, research.project(free, research.elastic(free, matrix, prepared), prepared))
    assert np.linalg.norm(found.images.positions - true.images.positions, axis=1).mean() < 0.03
    assert research.judge(free, found).flipped_area < 0.02
    assert research.zoomout(free, found, research.ZoomOutSchedule(10, 30)).shape == (30, 30)
    again = research.project(pair, true.images.positions[prepared.vertices], prepared)
    np.testing.assert_allclose(again.images.positions, true.images.positions, atol=0.05)
    from_landmarks = research.elastic(pair, prepared=prepared)
    assert np.linalg.norm(from_landmarks.images.positions - true.images.positions, axis=1).mean() < 0.02
