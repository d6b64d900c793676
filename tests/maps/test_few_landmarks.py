"""Left stays left and right stays right, with six landmarks on nearly mirror-symmetric shapes."""

from __future__ import annotations

import numpy as np
import pytest

from cagemap import BasisConfig, Landmarks, match, prepare_surface

from example_once import example_pair
from quick_match import SEARCHED


def only(landmarks: Landmarks, names: list[str]) -> Landmarks:
    return landmarks.without([i for i, name in enumerate(landmarks.names) if name not in names])


@pytest.mark.slow
def test_a_single_hoof_tells_left_from_right():
    """The other landmarks are along the middle."""
    pair, basis = example_pair(texture_size=64), BasisConfig(count=40)
    target, source = prepare_surface(pair.target, 1, basis), prepare_surface(pair.source, 1, basis)
    names = ["nose_tip", "tail_tip", "chest", "poll", "belly", "hoof_front_L"]
    found = match(target, source, only(pair.landmarks, names), SEARCHED)
    own = target.refinement.finest.positions
    image = found.point_map.pull_back(source.refinement.finest.positions)
    # Both creatures are mirror-symmetric in x; near the middle the side says nothing.
    sideways = np.abs(own[:, 0]) > 0.2 * np.abs(own[:, 0]).max()
    crossed = sideways & (own[:, 0] * image[:, 0] < 0)
    assert sideways.mean() > 0.3
    assert crossed.sum() <= 0.005 * sideways.sum()
    assert found.suspects == ()
