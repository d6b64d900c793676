"""A finish that found another map than the one that is shown says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from cagemap.files.result.folder import write_result
from cagemap.maps.result import MatchResult
from cagemap.studio.agreement import led_elsewhere
from cagemap.studio.finish import MAP
from cagemap.studio.scene import Scene
from cagemap.studio.shape import shape_of
from cagemap.studio.skins import Images
from cagemap.studio.state import Output

from example_result import identity_result


def scene_of(shown: MatchResult) -> Scene:
    found = shown.point_map
    images = Images(found.triangle, found.barycentric, shown.quality.trust)
    shapes = shape_of(shown.target.refinement), shape_of(shown.source.refinement)
    return Scene(*shapes, (None, None), (b"", b""), images)


def test_the_map_of_a_finish_is_the_one_that_is_shown_or_it_is_said(tmp_path: Path) -> None:
    outputs = (Output(tmp_path / "RESULT", MAP),)
    write_result(tmp_path / "RESULT", identity_result(level=3))
    scene = scene_of(identity_result(level=2))
    assert led_elsewhere(scene, outputs) == ()
    # Every other vertex of the cube leads across it.
    turned = replace(scene, images=replace(scene.images, triangle=np.roll(scene.images.triangle, 4)))
    (said,) = led_elsewhere(turned, outputs)
    assert "Match again" in said
    assert led_elsewhere(None, outputs) == led_elsewhere(turned, ()) == ()
    assert led_elsewhere(turned, (Output(tmp_path / "gone", MAP),)) == ()
