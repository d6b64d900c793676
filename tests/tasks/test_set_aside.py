"""Pieces that are not matched, laid on the source one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cagemap.character.values import Part
from cagemap.mesh import ControlMesh, Plain
from cagemap.mesh.landmarks import Landmarks
from cagemap.tasks.bodies import Bodies, match_bodies
from cagemap.tasks.progress import Stages
from cagemap.tasks.set_aside import lay_set_aside

from example_once import example_pair

pytestmark = pytest.mark.slow

SCALE, SHIFT = 2.5, np.array([3.0, -1.0, 2.0])


def with_eyes(body: ControlMesh) -> ControlMesh:
    """A mesh with two small copies of itself beside it."""
    eyes = [body.positions] + [0.05 * body.positions + side * body.positions.max(axis=0) for side in (-1.0, 1.0)]
    count, offsets = body.n_vertices, body.face_offsets
    return ControlMesh(
        np.concatenate(eyes),
        np.concatenate([offsets, *(offsets[-1] * piece + offsets[1:] for piece in (1, 2))]),
        np.concatenate([body.face_indices + count * piece for piece in range(3)]),
        scheme=Plain(),
        name="body",
    )


def matched(source: ControlMesh) -> Bodies:
    target = replace(source, positions=SCALE * source.positions + SHIFT)
    return match_bodies(Part("target", target), Part("source", source), Landmarks.none(), Stages())


def test_pieces_go_with_the_surface_around_them() -> None:
    source = with_eyes(example_pair(64).target)
    bodies = matched(source)
    found = lay_set_aside(bodies)
    count = source.n_vertices // 3
    np.testing.assert_array_equal(found.vertices, np.arange(count, 3 * count))
    for own, other in (
        (found.vertices, found.source_vertices),
        (found.corners, found.source_corners),
        (found.faces, found.source_faces),
    ):
        np.testing.assert_array_equal(own, other)
    assert len(found.faces) == 2 * source.n_faces // 3
    np.testing.assert_allclose(found.places, source.positions[count:], atol=1e-9)
    offsets = np.random.default_rng(1).random((2 * count, 3))
    np.testing.assert_allclose(np.einsum("nd,nde->ne", offsets, found.turns), SCALE * offsets, atol=1e-9)


def test_nothing_is_set_aside_of_one_piece() -> None:
    found = lay_set_aside(matched(replace(example_pair(64).target, scheme=Plain())))
    assert all(len(array) == 0 for array in vars(found).values())
