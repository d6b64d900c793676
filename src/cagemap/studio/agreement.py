"""Whether a finish has found the map that the page shows: a match from the start may find another one."""

from __future__ import annotations

import numpy as np

from cagemap.deform.config import SearchConfig
from cagemap.errors import CagemapError
from cagemap.files.result.folder import read_result
from cagemap.studio.finish import MAP
from cagemap.studio.scene import Scene
from cagemap.studio.state import Output


def led_elsewhere(scene: Scene | None, outputs: tuple[Output, ...]) -> tuple[str, ...]:
    """What to say where the map of a finish is another answer than the one that is shown; nothing where it is not.

    Two answers of a search differ by as much on average (`SearchConfig.different`).

    Parameters
    ----------
    scene : Scene or None
        With the map that is shown.
    outputs : tuple of Output
        Of the finish.
    """
    result = next((output.path for output in outputs if output.what == MAP), None)
    if scene is None or scene.images is None or result is None:
        return ()
    try:
        match = read_result(result)
    except CagemapError:  # said by whoever uses it
        return ()
    n = scene.target.n_control
    shown = scene.images.on(scene.source.triangles, scene.source.positions)[:n]
    found = match.point_map.images.positions  # at unit area
    if len(found) < n:
        return ()
    apart = np.linalg.norm(found[:n] - match.source.scale * shown, axis=1).mean()
    if apart < SearchConfig.different:
        return ()
    return (
        f"the full map is another one than the map that is shown: it leads {100 * apart:.0f} % of the source's size "
        "elsewhere, on average. Match again shows what a match from the start finds; a landmark where they differ "
        "decides, then Bake again",
    )
