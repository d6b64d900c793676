"""One map from several: parts on which they disagree, each from the one that fits it best."""

from __future__ import annotations

import numpy as np
from examples import shapes

from cagemap.geometry.triangles import triangle_areas
from cagemap.maps.quality import dirichlet_energy
from cagemap.maps.spectral import joining
from cagemap.maps.spectral.joining import joined_match, parts_apart
from cagemap.refinement import level_triangles, refine


def surface():
    refinement = refine(shapes.creature(), 1)
    positions, triangles = refinement.finest.positions, level_triangles(refinement, 1)
    return positions / np.sqrt(triangle_areas(positions, triangles).sum()), triangles


def spoilt(positions, centre, rng):
    """The identity but for the vertices around a place, which are mixed among each other; and these vertices."""
    near = np.argsort(np.linalg.norm(positions - positions[centre], axis=1))[:40]
    match = np.arange(len(positions))
    match[near] = rng.permutation(near)
    return match, np.sort(near)


def test_each_part_comes_from_the_map_that_has_it_right(monkeypatch):
    """Two maps, each wrong at another end of the creature: together they are the identity."""
    positions, triangles = surface()
    rng = np.random.default_rng(0)
    front, back = int(np.argmax(positions[:, 2])), int(np.argmin(positions[:, 2]))
    one, of_one = spoilt(positions, front, rng)
    two, of_two = spoilt(positions, back, rng)

    def merit(match):
        return len(np.unique(match)) / dirichlet_energy(positions, positions[match], triangles)

    monkeypatch.setattr(joining, "APART", 0.0)
    found = joined_match([one, two], positions, triangles, merit)
    assert merit(found) > 1.5 * max(merit(one), merit(two))
    np.testing.assert_array_equal(found, np.arange(len(positions)))
    assert len(np.intersect1d(of_one, of_two)) == 0


def test_parts_are_connected_apart_and_large_enough(monkeypatch):
    positions, triangles = surface()
    rng = np.random.default_rng(1)
    front, back = int(np.argmax(positions[:, 2])), int(np.argmin(positions[:, 2]))
    one, of_one = spoilt(positions, front, rng)
    two, of_two = spoilt(positions, back, rng)
    monkeypatch.setattr(joining, "SMALLEST", 1)
    monkeypatch.setattr(joining, "APART", 0.0)
    parts = parts_apart(one, two, positions, triangles)
    moved = np.flatnonzero(one != two)
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), moved)
    assert not any(np.isin(part, of_one).any() and np.isin(part, of_two).any() for part in parts)
    monkeypatch.setattr(joining, "SMALLEST", 1 + max(map(len, parts)))
    assert not parts_apart(one, two, positions, triangles)
    monkeypatch.setattr(joining, "SMALLEST", 1)
    monkeypatch.setattr(joining, "APART", 10.0)
    assert not parts_apart(one, two, positions, triangles)


def test_nothing_is_taken_that_does_not_help():
    positions, triangles = surface()
    right = np.arange(len(positions))
    wrong, _ = spoilt(positions, 0, np.random.default_rng(2))

    def merit(match):
        return -float(np.linalg.norm(positions[match] - positions, axis=1).sum())

    np.testing.assert_array_equal(joined_match([wrong, right], positions, triangles, merit), right)
