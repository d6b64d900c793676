"""Meshes and names that cannot be used: every message names the mesh, what is wrong, and what to do."""

from __future__ import annotations

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import NamedPoints, pair_by_name
from cagemap.mesh.plain import plain_mesh

from refusals import Refusal

REPAIR = "Repair it in a modelling program."


def points(*names: str) -> NamedPoints:
    return NamedPoints(names, np.arange(len(names)), np.full((len(names), 3), np.nan))


def triangles(count: int, faces: list[tuple[int, ...]]) -> ControlMesh:
    """A mesh of vertices at random places."""
    return ControlMesh.from_faces(np.random.default_rng(1).normal(size=(count, 3)), faces, name="scan.obj")


def of_a_line(_: object) -> None:
    plain_mesh(triangles(4, [(0, 1, 2), (2, 1, 3)]).with_positions(np.arange(4.0)[:, None] * [1.0, 0.0, 0.0]))


REFUSED = {
    "a name twice": Refusal(
        lambda _: pair_by_name(points("nose", "nose"), points("nose"), cube(), cube()),
        "target points: ",
        "expected every name once, got these again: nose",
        "Rename them.",
    ),
    "a surface on a line": Refusal(of_a_line, "scan.obj: ", "expected a surface with an area, got 2 faces", REPAIR),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_mesh_that_cannot_be_used_is_refused(name: str) -> None:
    REFUSED[name].check(None)
