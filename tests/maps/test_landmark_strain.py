"""The strain of landmark pairs: a reduced elastic energy and which pair strains most."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scipy import sparse

from cagemap import Surface
from cagemap.deform.energy import energy_matrix
from cagemap.deform.graph import ElasticGraph, cluster_graph
from cagemap.deform.problem import level_graph
from cagemap.maps.landmarks.strain import ReducedEnergy, reduced_energy, strained_pair
from cagemap.subdivision import refine

from example_once import example_pair


@pytest.fixture(scope="module")
def graph() -> ElasticGraph:
    return level_graph(Surface(refine(example_pair(64).target, 1)), 1)


def strained(energy: ReducedEnergy, places: np.ndarray) -> int | None:
    return strained_pair(energy, places, np.linalg.norm(energy.released(places, np.arange(len(places))), axis=1))


def test_the_quadratic_form_is_the_elastic_energy(graph):
    coarse, _ = cluster_graph(graph, 100, np.array([4, 9]))
    rng = np.random.default_rng(31)
    positions, maps = rng.standard_normal((coarse.n, 3)), rng.standard_normal((coarse.n, 3, 3))
    form = energy_matrix(coarse, 1e-2)
    energy = 0.0
    for c in range(3):
        unknowns = np.concatenate([positions[:, c : c + 1], maps[:, c]], axis=1).ravel()
        energy += unknowns @ (form @ unknowns)
    # E counts directed edges by half; the form's ridge of 1e-9 is all that is left.
    assert energy == pytest.approx(coarse.energies(positions, maps, 1e-2).sum(), rel=1e-6)


def test_released_is_the_minimum_with_the_others_held():
    rng = np.random.default_rng(32)
    root, right = rng.standard_normal((40, 40)), rng.standard_normal(40)
    matrix, landmarks = root.T @ root, rng.permutation(40)[:15]
    energy = ReducedEnergy.of(sparse.csc_array(matrix), right, landmarks)
    places, held = rng.standard_normal((5, 3)), np.array([0, 2, 3])
    moved = energy.released(places, held)
    for i in held:
        fixed = np.concatenate([np.arange(3 * j, 3 * j + 3) for j in held if j != i])
        free = np.setdiff1d(np.arange(40), landmarks[fixed])
        load = right[free] - matrix[np.ix_(free, landmarks[fixed])] @ places.ravel()[fixed]
        best = np.zeros(40)
        best[free] = np.linalg.solve(matrix[np.ix_(free, free)], load)
        np.testing.assert_allclose(moved[i], best[landmarks[3 * i : 3 * i + 3]] - places[i], atol=1e-9)
    assert not moved[[1, 4]].any()


@pytest.mark.slow
def test_the_strain_of_many_landmarks_needs_little_memory(graph):
    """H of 600 landmarks by the columns of an inverse takes more than those columns; blocks of it take little."""
    landmarks = np.linspace(0, graph.n - 1, 600).astype(np.int64)
    coarse, _ = cluster_graph(graph, 300, landmarks)
    columns = 8 * 12 * coarse.n * 3 * len(landmarks)
    tracemalloc.start()
    energy = reduced_energy(graph, graph.positions, graph.normals, landmarks)
    strained(energy, graph.positions[landmarks])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < columns / 4


def test_the_strained_pair_is_the_displaced_one(graph):
    """On a surface mapped to itself with one landmark slid along it, that one wants to go back."""
    landmarks = np.linspace(0, 150, 12).astype(np.int64)
    energy = reduced_energy(graph, graph.positions, graph.normals, landmarks)
    places = graph.positions[landmarks]
    assert strained(energy, places) is None
    near = np.argsort(np.linalg.norm(graph.positions - places[4], axis=1))
    slid = places.copy()
    slid[4] = next(graph.positions[v] for v in near if np.linalg.norm(graph.positions[v] - places[4]) > 0.08)
    assert strained(energy, slid) == 4
    assert strained(reduced_energy(graph, graph.positions, graph.normals, landmarks[:9]), slid[:9]) is None
