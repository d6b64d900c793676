"""Left stays left and right stays right, with six landmarks on nearly mirror-symmetric shapes."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.truth import compare_with_truth, true_map

from cagemap import BasisConfig, Landmarks, match, prepare_surface, read_mesh, refine
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.surface.triangle_surface import TriangleSurface

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


@pytest.mark.slow
def test_six_landmarks_on_humans(shared_data):
    humans = shared_data / "humans"
    names = "male1591_female_old_heavy", "female1605_male_young"
    target, source = (prepare_surface(read_mesh(humans / f"{name}.obj"), 1, BasisConfig(count=300)) for name in names)
    file = humans / "landmarks" / "female1605__male1591_fps30.json"
    landmarks, _ = read_landmarks(file, "male1591", "female1605")
    six = landmarks.without(range(6, len(landmarks)))
    found = match(target, source, six, SEARCHED)
    neutral = (refine(read_mesh(humans / f"{name}_neutral.obj"), 1).finest for name in ("male1591", "female1605"))
    truth = true_map(*(TriangleSurface.from_faces(side.positions, side.faces) for side in neutral))
    figures = compare_with_truth(found.point_map, truth)
    assert figures.mean < 0.01
    assert figures.p95 < 0.03
