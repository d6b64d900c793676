"""Compares the map of a finish with the map on the page, which may differ."""

from __future__ import annotations

import numpy as np

from cagemap.deform.config import SearchConfig
from cagemap.errors import CagemapError
from cagemap.files.result.folder import read_result
from cagemap.studio.finish import MAP_TITLE
from cagemap.studio.scene import Scene
from cagemap.studio.state import Output


def map_difference_notes(scene: Scene | None, outputs: tuple[Output, ...]) -> tuple[str, ...]:
    """Warn if a finish has another map than the page.

    Parameters
    ----------
    scene : Scene or None
        With the map on the page.
    outputs : tuple of Output
        Of the finish.
    """
    result = next((output.path for output in outputs if output.title == MAP_TITLE), None)
    if scene is None or scene.preview_map is None or result is None:
        return ()
    try:
        match = read_result(result)
    except CagemapError:  # reported where the result is used
        return ()
    n = scene.target.n_control
    preview_images = scene.preview_map.pull_back(scene.source.triangles, scene.source.positions)[:n]
    images = match.point_map.images.positions  # at unit area
    if len(images) < n:
        return ()
    difference = np.linalg.norm(images[:n] - match.source.scale * preview_images, axis=1).mean()
    if difference < SearchConfig.min_answer_distance:  # as for two answers of one search
        return ()
    return (
        f"the baked map differs from the map on the page by {100 * difference:.0f} % of the source's size on average. "
        "Match again shows what a match from the start finds; or set a landmark where they differ, then Bake again",
    )
