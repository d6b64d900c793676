"""From fitted points to the map of the finest level: interpolated, projected, unfolded."""

from __future__ import annotations

import numpy as np
import pytest
from examples.shapes import creature
from scipy import sparse

from cagemap.deform.config import ElasticConfig, ProjectionConfig
from cagemap.maps.pair import Pair
from cagemap.maps.projection import relax as folds
from cagemap.maps.projection.project import control_points, project
from cagemap.maps.projection.relax import relax_folds
from cagemap.maps.quality import flipped_triangles
from cagemap.subdivision import Refinement, level_triangles, refine
from cagemap.surface.surface_points import SurfacePoints
from cagemap.surface.triangles import normalize_rows

from elastic_shapes import mesh_of, prepared_at, surface_of


def test_control_points_interpolate(creature_at_3: tuple[Refinement, float]) -> None:
    refinement, scale = creature_at_3
    n = refinement.levels[1].n_vertices
    sampling = sparse.csr_array(refinement.product(3, 1)[:n])
    points = scale * refinement.finest.positions[:n]
    control = control_points(sampling, points)
    spacing = np.sqrt(1 / n)
    assert abs(sampling @ control - points).max() < 0.02 * spacing
    assert abs(sampling @ points - points).max() > 0.05 * spacing  # what not solving would leave


@pytest.mark.parametrize("rings", [0, 1, 3])
def test_rings_around_triangles_are_those_of_their_neighbours(rings):
    faces = level_triangles(refine(creature(), 1), 1)
    flipped = np.zeros(len(faces), dtype=bool)
    flipped[[3, 400]] = True
    expected = set(faces[flipped].ravel().tolist())
    for _ in range(rings):
        expected |= {vertex for face in faces.tolist() if expected & set(face) for vertex in face}
    assert set(np.flatnonzero(folds.flipped_rings(faces, flipped, rings, faces.max() + 1)).tolist()) == expected


def test_unfolding_repairs_folds_and_leaves_the_rest_alone(creature_at_3: tuple[Refinement, float]) -> None:
    refinement, scale = creature_at_3
    surface = mesh_of(refinement, scale, 3)
    positions, faces = surface.positions, surface.triangles
    rng = np.random.default_rng(15)
    pulled = rng.choice(len(positions), 12, replace=False)
    held = np.setdiff1d(np.arange(0, len(positions), 50), pulled)
    wanted = positions.copy()
    spacing = np.sqrt(1 / len(positions))
    wanted[pulled] += 3 * spacing * normalize_rows(rng.standard_normal((12, 3)))
    images = SurfacePoints.nearest(surface, wanted)
    before = flipped_triangles(images, faces).sum()
    assert before > 10
    again, still = relax_folds(images, faces, held, normal_weight=0.02)
    assert flipped_triangles(again, faces).sum() == still.sum() <= before // 5
    moved = np.linalg.norm(again.positions - images.positions, axis=1)
    assert (moved[held] == 0).all()
    assert (moved > 0).mean() < 0.05


@pytest.mark.parametrize("seed", [3, 4])
def test_unfolding_knows_what_still_folds_however_far_folds_spread(creature_at_3, seed, monkeypatch):
    refinement, scale = creature_at_3
    surface = mesh_of(refinement, scale, 3)
    positions, faces = surface.positions, surface.triangles
    # A patch sent to another, upside down, cannot be unfolded; where every sweep is kept, folds spread to its border.
    centre, other = positions[np.random.default_rng(seed).choice(len(positions), 2, replace=False)]
    near = np.linalg.norm(positions - centre, axis=1) < 0.12
    wanted = np.where(near[:, None], other - (positions - centre), positions)
    images = SurfacePoints.nearest(surface, wanted)
    monkeypatch.setattr(folds, "_improved_patches", lambda near, inside, before, after: inside)
    again, still = relax_folds(
        images, faces, np.zeros(0, dtype=np.int64), normal_weight=0.02, config=ProjectionConfig(rings=(1, 2))
    )
    assert still.sum() > 100
    np.testing.assert_array_equal(still, flipped_triangles(again, faces))


@pytest.mark.slow
def test_projection_meets_landmarks_wherever_the_fit_left_them(creature_at_3: tuple[Refinement, float]) -> None:
    surface = surface_of(creature_at_3[0])
    prepared = prepared_at(surface, surface, surface.finest_level, ElasticConfig())
    pair = Pair.of_vertices(surface, surface, landmarks := np.array([3, 40, 90]), landmarks)
    positions = prepared.source.finest_triangles.positions
    fitted = positions.copy()
    fitted[landmarks] = positions[np.array([500, 700, 900])]  # far off: the closest triangle does not hold the landmark
    found = project(prepared, fitted, pair.landmarks)
    np.testing.assert_allclose(found.images.positions[landmarks], positions[landmarks], atol=1e-12)
    np.testing.assert_allclose(found.barycentric.sum(axis=1), 1, atol=1e-12)
