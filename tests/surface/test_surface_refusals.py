"""Searches on surfaces that cannot be done: every message says of what, what is wrong, and what to do."""

import numpy as np
import pytest
from examples.shapes import icosahedron
from scipy import sparse

from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface

from refusals import Refusal

POSITIONS, FACES = icosahedron().positions, icosahedron().face_indices.reshape(-1, 3)


def opposite(_: object) -> SurfacePoints:
    """Weights of two vertices without a triangle in common."""
    far = int(np.argmax(np.linalg.norm(POSITIONS - POSITIONS[0], axis=1)))
    rows = sparse.csr_array((np.full(2, 0.5), ([0, 0], [0, far])), shape=(1, len(POSITIONS)))
    return SurfacePoints.from_matrix(TriangleSurface.from_faces(POSITIONS, FACES), rows)


REFUSED = {
    "no triangles": Refusal(
        lambda _: build_tree(POSITIONS, FACES[:0]),
        "triangles: ",
        "expected at least one to search, got none",
        "Give a surface with faces.",
    ),
    "positions that are no numbers": Refusal(
        lambda _: build_tree(np.where(np.arange(12)[:, None] == 3, np.nan, POSITIONS), FACES),
        "positions: expected finite ones",
        "got 1 that are not, first at vertices [3]",
        "Repair the mesh.",
    ),
    "queries without normals": Refusal(
        lambda _: closest_points(build_tree(POSITIONS, FACES), POSITIONS, minimum_cosine=0.5),
        "normals: ",
        "expected those of the queries, got none",
        "normal_weight and minimum_cosine need them",
    ),
    "weights of two triangles": Refusal(
        opposite, "matrix: ", "expected every row to have vertices of one triangle, not so in rows [0]", "Give a"
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_search_that_cannot_be_done_is_refused(name: str) -> None:
    REFUSED[name].check(None)
