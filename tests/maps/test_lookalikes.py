"""Bodies posed by a simple skeleton, and the sets written of them."""

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
from benchmarks.public.harder import write_shuffled
from benchmarks.skeleton import Bone, shares, skinned

MESH = triangulated(creature())
TRIANGLES = MESH.face_indices.reshape(-1, 3)
LOW, HIGH = MESH.positions.min(axis=0), MESH.positions.max(axis=0)
BONES = {
    "back": Bone(LOW, 0.5 * (LOW + HIGH), "", 1.0),
    "front": Bone(0.5 * (LOW + HIGH), HIGH, "back", 1.0),
}


def test_bones_at_rest_move_nothing_and_the_root_turns_all() -> None:
    weights = shares(MESH.positions, TRIANGLES, BONES, 0.05)
    np.testing.assert_allclose(skinned(MESH.positions, weights, BONES, {}), MESH.positions, atol=1e-12)
    turned = skinned(MESH.positions, weights, BONES, {"back": (0.0, 0.0, 90.0)}) - LOW
    rest = MESH.positions - LOW
    np.testing.assert_allclose(turned, np.column_stack([-rest[:, 1], rest[:, 0], rest[:, 2]]), atol=1e-10)


@pytest.mark.slow
def test_shuffled_shapes_have_their_points_where_they_were(tmp_path: Path) -> None:
    fine = refine(MESH, 4)
    triangles, positions = level_triangles(fine, 4), fine.finest.positions
    known = np.arange(0, len(positions), 97)
    write_shuffled(tmp_path, "body", positions, triangles, known, 1)
    mesh = read_mesh(tmp_path / "shapes" / "body.off")
    found = mesh.positions[np.loadtxt(tmp_path / "corres" / "body.vts", dtype=int) - 1]
    scale = np.sqrt(triangle_areas(positions, triangles).sum())
    assert np.linalg.norm(found - positions[known] / scale, axis=1).mean() < np.sqrt(1 / mesh.n_vertices)
