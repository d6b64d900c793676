"""Bodies posed by a simple skeleton, and the sets written of them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, triangulated

from cagemap.files.meshes.formats import read_mesh
from cagemap.subdivision import level_triangles, refine
from cagemap.surface.triangles import triangle_areas

from locations import ROOT

sys.path.insert(0, str(ROOT))
from benchmarks.public.harder import detail, write_shuffled
from benchmarks.public.lookalikes import TRIANGLES as TRIANGLES_WRITTEN
from benchmarks.public.lookalikes import write_shape
from benchmarks.skeleton import Bone, shares, skinned

MESH = triangulated(creature())
TRIANGLES = MESH.face_indices.reshape(-1, 3)
LOW, HIGH = MESH.positions.min(axis=0), MESH.positions.max(axis=0)
BONES = {
    "back": Bone(LOW, 0.5 * (LOW + HIGH), "", 1.0),
    "front": Bone(0.5 * (LOW + HIGH), HIGH, "back", 1.0),
}


@pytest.fixture(scope="module")
def weights() -> np.ndarray:
    return shares(MESH.positions, TRIANGLES, BONES, 0.05)


def test_shares_are_shares(weights: np.ndarray) -> None:
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    assert weights.min() >= 0
    assert weights[MESH.positions[:, 2].argmin(), 0] > 0.9
    assert weights[MESH.positions[:, 2].argmax(), 1] > 0.9


def test_bones_at_rest_move_nothing_and_the_root_turns_all(weights: np.ndarray) -> None:
    np.testing.assert_allclose(skinned(MESH.positions, weights, BONES, {}), MESH.positions, atol=1e-12)
    turned = skinned(MESH.positions, weights, BONES, {"back": (0.0, 0.0, 90.0)}) - LOW
    rest = MESH.positions - LOW
    np.testing.assert_allclose(turned, np.column_stack([-rest[:, 1], rest[:, 0], rest[:, 2]]), atol=1e-10)


def test_a_longer_bone_carries_the_next_one(weights: np.ndarray) -> None:
    """Twice the length of the root moves what hangs on it by that length, and nothing is thicker."""
    whole = np.array([[0.0, 1.0]] * MESH.n_vertices)
    moved = skinned(MESH.positions, whole, BONES, {}, {"back": (2.0, 1.0)})
    np.testing.assert_allclose(moved - MESH.positions, np.tile(0.5 * (HIGH - LOW), (MESH.n_vertices, 1)), atol=1e-10)


@pytest.mark.slow
def test_a_written_shape_knows_its_points(tmp_path: Path) -> None:
    """Another connectivity at unit area; each point at its nearest vertex, no more than the vertices' spacing away."""
    fine = refine(MESH, 4)
    triangles, positions = level_triangles(fine, 4), fine.finest.positions
    write_shape(tmp_path, "one", positions, triangles, np.arange(0, len(positions), 97))
    found, vertices = read_mesh(tmp_path / "shapes" / "one.off"), np.loadtxt(tmp_path / "corres" / "one.vts", dtype=int)
    scale = np.sqrt(triangle_areas(positions, triangles).sum())
    assert found.n_faces == TRIANGLES_WRITTEN < len(triangles)
    away = np.linalg.norm(found.positions[vertices - 1] - positions[::97] / scale, axis=1)
    assert 0 < away.mean() < np.sqrt(1 / found.n_vertices)


def test_detail_is_as_large_and_as_smooth_as_asked(tmp_path: Path) -> None:
    fine = refine(MESH, 2)
    triangles, positions = level_triangles(fine, 2), fine.finest.positions
    scale = np.sqrt(triangle_areas(positions, triangles).sum())
    for length in (0.05, 0.2):
        shifts = detail(positions, triangles, length, 0.01, 3)
        assert np.sqrt((shifts**2).mean()) == pytest.approx(0.01 * scale)
        along = np.linalg.norm(shifts[triangles[:, 0]] - shifts[triangles[:, 1]], axis=1).mean()
        edges = np.linalg.norm(positions[triangles[:, 0]] - positions[triangles[:, 1]], axis=1).mean()
        assert along / edges < 1.5 * 0.01 / length  # of a wave of that length and size


@pytest.mark.slow
def test_shuffled_shapes_have_their_points_where_they_were(tmp_path: Path) -> None:
    fine = refine(MESH, 4)
    triangles, positions, known = (
        level_triangles(fine, 4),
        fine.finest.positions,
        np.arange(0, fine.finest.n_vertices, 97),
    )
    found = []
    for seed in (1, 2):
        write_shuffled(tmp_path, f"body_{seed}", positions, triangles, known, seed)
        mesh = read_mesh(tmp_path / "shapes" / f"body_{seed}.off")
        found.append(mesh.positions[np.loadtxt(tmp_path / "corres" / f"body_{seed}.vts", dtype=int) - 1])
        scale = np.sqrt(triangle_areas(positions, triangles).sum())
        away = np.linalg.norm(found[-1] - positions[known] / scale, axis=1)
        assert away.mean() < np.sqrt(1 / mesh.n_vertices)
    assert (found[0] != found[1]).any()
