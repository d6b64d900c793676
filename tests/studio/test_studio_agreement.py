"""A finish that found another map than the one that is shown says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from cagemap.files.result.folder import write_result
from cagemap.maps.result import MatchResult
from cagemap.studio.agreement import map_difference_notes
from cagemap.studio.finish import MAP_TITLE
from cagemap.studio.scene import Scene
from cagemap.studio.shape import refined_shape
from cagemap.studio.skins import PreviewMap
from cagemap.studio.state import Output

from example_result import identity_result


def scene_of(shown: MatchResult) -> Scene:
    found = shown.point_map
    images = PreviewMap(found.triangle, found.barycentric, shown.quality.trust)
    shapes = refined_shape(shown.target.refinement), refined_shape(shown.source.refinement)
    return Scene(*shapes, (None, None), (b"", b""), images)


def test_the_map_of_a_finish_is_the_one_that_is_shown_or_it_is_said(tmp_path: Path) -> None:
    outputs = (Output(tmp_path / "RESULT", MAP_TITLE),)
    write_result(tmp_path / "RESULT", identity_result(level=3))
    scene = scene_of(identity_result(level=2))
    assert map_difference_notes(scene, outputs) == ()
    # Every other vertex of the cube leads across it.
    turned = replace(scene, preview_map=replace(scene.preview_map, triangle=np.roll(scene.preview_map.triangle, 4)))
    (said,) = map_difference_notes(turned, outputs)
    assert "Match again" in said
    assert map_difference_notes(None, outputs) == map_difference_notes(turned, ()) == ()
    assert map_difference_notes(turned, (Output(tmp_path / "gone", MAP_TITLE),)) == ()
