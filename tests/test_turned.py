"""Limbs whose turn the landmarks leave open are named, and the next landmark is proposed there."""

from __future__ import annotations

import numpy as np
from examples.shapes import creature

from cagemap.basis import Surface
from cagemap.maps.elastic.ends import FineFit
from cagemap.maps.hypotheses.confidence import AS_GIVEN, LOOK
from cagemap.maps.landmarks.turned import turned_limbs
from cagemap.maps.point_map import PointMap
from cagemap.pipeline import prepare_surface


def itself() -> tuple[Surface, PointMap]:
    surface = prepare_surface(creature(), 1)
    mesh = surface.triangles(surface.finest)
    return surface, PointMap.from_vertices(mesh, mesh, np.arange(mesh.n))


def test_an_end_as_good_that_turns_a_limb_is_named_where_it_differs_most() -> None:
    surface, found = itself()
    places = found.target.positions
    turned = places.copy()
    limb = int(np.argmax(places[: surface.control.n_vertices, 2]))
    near = np.linalg.norm(places - places[limb], axis=1) < 0.1
    turned[near] += 0.06 * (0.1 - np.linalg.norm(places[near] - places[limb], axis=1))[:, None] / 0.1 * [1, 0, 0]
    best, cheap, dear = FineFit(1e-4, places), FineFit(1.1e-4, turned), FineFit(1.3e-4, turned)
    doubt = turned_limbs((best, cheap), found, surface)
    assert doubt is not None
    assert (doubt.verdict, doubt.deciding, doubt.readings[0].name) == (LOOK, limb, AS_GIVEN)
    assert f"target vertex {limb}" in doubt.message
    assert "`answer=1`" in doubt.message
    # One end, a dear one, or one that only slides along the surface leave nothing open.
    slid = FineFit(1.01e-4, places + np.array([0.01, 0, 0]))
    assert turned_limbs((best,), found, surface) is None
    assert turned_limbs((best, dear, slid), found, surface) is None
    # What the first end was moved on to says nothing about another end that was not.
    moved = FineFit(1e-4, places, moved=turned)
    assert turned_limbs((moved, slid), found, surface) is None
    known = turned_limbs((moved, cheap), found, surface)
    assert known is not None
    np.testing.assert_array_equal(known.readings[0].positions, turned)
