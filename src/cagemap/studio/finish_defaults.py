"""Default options of a finish."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.errors import ParameterError
from cagemap.studio.finish import FinishOptions
from cagemap.studio.models import NO_SCHEME
from cagemap.studio.scene import Scene
from cagemap.studio.state import Files


def with_defaults(options: FinishOptions, files: Files, scene: Scene, vertices: int) -> FinishOptions:
    """Options with defaults for the open pair.

    Without an image the source's material or vertex colours are baked, or else its ambient occlusion, and a cage is
    wrapped.

    ``vertices``: of the map shown, for a finish that asks for no other number and no level.
    ParameterError if the target cannot be wrapped.
    """
    is_plain, values = files.schemes[0] == NO_SCHEME, options.option_values
    has_level, number = values.get(("match", "level")) is not None, values.get(("match", "vertices"))
    options = options.with_values(
        {
            ("transfer", "unwrap"): not scene.target.control.has_layout,
            ("match", "vertices"): None if has_level else vertices if number is None else number,
        }
    )
    if options.texture and files.texture is None and scene.has_colors:
        options = options.with_values({("transfer", "material_colors"): True})
    elif options.texture and files.texture is None:
        colors = None if values.get(("transfer", "detail")) else scene.source.control.vertex_colors
        default = ("ao",) if colors is None or np.isnan(colors).all() else ("colors",)
        kinds = values.get(("transfer", "bake")) or default
        wrap = options.wrap or not (is_plain or kinds == ("colors",))
        options = replace(options, wrap=wrap).with_values({("transfer", "bake"): kinds})
    if is_plain and options.wrap:
        raise ParameterError(
            f"{files.target.name} is open as a plain mesh, which cannot be wrapped. Press Open… and choose how the "
            "target is subdivided (Options). Or choose something else to make below."
        )
    return options
