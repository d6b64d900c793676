"""Masks and landmarks that a map cannot use: every message says which, what is wrong, and what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import cube, icosahedron, pyramid

from cagemap import BasisConfig, Landmarks, MatchConfig, Surface, face_mask, prepare_surface, refine
from cagemap.maps.pair import near_vertices
from cagemap.mesh import Plain
from cagemap.pipeline import pair_of
from cagemap.surface.surface_points import SurfacePoints

from refusals import Refusal


def crowded(_: object) -> None:
    """More points between vertices than a level has vertices."""
    surface = prepare_surface(cube(), 1, BasisConfig(count=5))
    count = 4 * len(surface.vertices)
    weights = np.random.default_rng(2).dirichlet(np.ones(3), count)
    finest = surface.triangles(surface.finest_level)
    near_vertices(SurfacePoints(finest, np.arange(count) % len(finest.triangles), weights), surface)


def plain() -> Surface:
    return prepare_surface(replace(icosahedron(), scheme=Plain()), 0, BasisConfig(count=5))


REFUSED = {
    "a mask of faces that are not refined": Refusal(
        lambda _: face_mask(refine(pyramid(), 0), np.ones(pyramid().n_faces)),
        "face mask: ",
        "expected a mesh refined at least once, got its control mesh",
        "Refine it once.",
    ),
    "landmarks that leave no vertex free": Refusal(
        crowded, "landmarks: expected at most ", "on a level of as many vertices, got 104", "Give fewer, or refine once"
    ),
    "symmetries of a plain mesh": Refusal(
        lambda _: pair_of(
            plain(),
            plain(),
            Landmarks.none(),
            MatchConfig(method="paper", symmetries=((np.arange(12), np.arange(12)),)),
        ),
        "symmetries: ",
        "a plain mesh (scheme none) takes no symmetries",
        "Leave them out.",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_a_map_cannot_use_is_refused(name: str) -> None:
    REFUSED[name].check(None)
