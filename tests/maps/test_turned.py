"""Limbs whose turn the landmarks leave open are named, and the next landmark is proposed there."""

from __future__ import annotations

import numpy as np
from examples.shapes import creature

from cagemap.deform.placement import Placement
from cagemap.deform.prepared import PreparedPair
from cagemap.maps.hypotheses.confidence import AS_GIVEN, LOOK
from cagemap.maps.landmarks.turned import turned_limbs
from cagemap.pipeline import prepare_pair, prepare_surface


def itself() -> PreparedPair:
    surface = prepare_surface(creature(), 1)
    return prepare_pair(surface, surface)


def test_an_end_as_good_that_turns_a_limb_is_named_where_it_differs_most() -> None:
    prepared = itself()
    places = prepared.mesh.positions
    limb = int(np.argmax(places[: prepared.target.control.n_vertices, 2]))

    def moved_within(reach: float) -> np.ndarray:
        """Vertices so near to the limb's tip farther away, most of all the tip."""
        near = np.clip(1.2 - np.linalg.norm(places - places[limb], axis=1) / reach, 0.0, 1.0)
        return np.asarray(places + 0.06 * near[:, None] * [1, 0, 0] + 0.01 * (np.arange(len(places)) == limb)[:, None])

    turned = moved_within(0.35)
    share = prepared.mesh.vertex_areas @ (np.linalg.norm(turned - places, axis=1) >= 0.05)
    assert 0.025 < share < 0.1
    best, cheap, dear = Placement(places, 1e-4), Placement(turned, 1.1e-4), Placement(turned, 1.3e-4)
    doubt = turned_limbs((best, cheap), prepared)
    assert doubt is not None
    assert (doubt.verdict, doubt.deciding, doubt.readings[0].name) == (LOOK, limb, AS_GIVEN)
    assert f"target vertex {limb}" in doubt.message
    assert "`answer=1`" in doubt.message
    # A fingertip that lies elsewhere turns no limb: half of such doubts were about right maps.
    assert np.linalg.norm(moved_within(0.06) - places, axis=1).max() > 0.05
    assert turned_limbs((best, Placement(moved_within(0.06), 1.01e-4)), prepared) is None
    # One end, a dear one, or one that only slides along the surface leave nothing open.
    slid = Placement(places + np.array([0.01, 0, 0]), 1.01e-4)
    assert turned_limbs((best,), prepared) is None
    assert turned_limbs((best, dear, slid), prepared) is None
    # What the first end was moved on to says nothing about another end that was not.
    moved = Placement(places, 1e-4, final=turned)
    assert turned_limbs((moved, slid), prepared) is None
    known = turned_limbs((moved, cheap), prepared)
    assert known is not None
    np.testing.assert_array_equal(known.readings[0].positions, turned)
