"""Limbs whose rotation the landmarks leave open are named, and the next landmark is proposed there."""

from __future__ import annotations

import numpy as np
from examples.shapes import creature
from scipy.spatial.transform import Rotation

from cagemap.deform.placement import Placement
from cagemap.maps.hypotheses.confidence import LOOK, WARNING_SIGNS, turned_limb_answers, turned_share
from cagemap.pipeline import prepare_pair, prepare_surface


def test_another_map_as_good_that_turns_a_limb_is_named_where_it_differs_most() -> None:
    surface = prepare_surface(creature(), 1)
    prepared = prepare_pair(surface, surface)
    places = prepared.mesh.positions

    def rotated(share: float, degrees: float) -> np.ndarray:
        """The foremost share of the vertices rotated about the body's long axis, their tip moved most."""
        front = places[:, 2] >= np.quantile(places[:, 2], 1 - share)
        axis = places[front].mean(axis=0)
        turn = Rotation.from_euler("z", degrees, degrees=True)
        return np.where(front[:, None], turn.apply(places - axis) + axis, places)

    turned = rotated(0.2, 90.0)
    bound = WARNING_SIGNS["limb_turned"].bound
    assert turned_share(prepared.mesh, places, turned) > bound
    best, cheap, dear = Placement(places, 1e-4), Placement(turned, 1.1e-4), Placement(turned, 1.3e-4)
    doubt = turned_limb_answers((best, cheap), prepared)
    assert doubt.verdict == LOOK
    assert "a map with a limb turned otherwise about its axis fits almost as well, at 1.10 times" in doubt.message
    control = slice(prepared.target.control.n_vertices)
    assert doubt.deciding == np.linalg.norm(turned - places, axis=1)[control].argmax()
    assert f"target vertex {doubt.deciding}" in doubt.message
    assert "`answer=1`" in doubt.message
    # A fingertip that is turned is no limb, and a limb that is turned a little is in the same place.
    for little in (rotated(0.01, 90.0), rotated(0.2, 10.0)):
        assert turned_limb_answers((best, Placement(little, 1.01e-4)), prepared) is None
    # One placement, a dear one, or one that only slides along the surface leave nothing open.
    slid = Placement(places + np.array([0.06, 0, 0]), 1.01e-4)
    assert turned_limb_answers((best,), prepared) is None
    assert turned_limb_answers((best, dear, slid), prepared) is None
    # What the first placement was moved on to says nothing about another one that was not.
    moved = Placement(places, 1e-4, finished_positions=turned)
    assert turned_limb_answers((moved, slid), prepared) is None
    known = turned_limb_answers((moved, cheap), prepared)
    np.testing.assert_array_equal(known.answers[0].positions, turned)
