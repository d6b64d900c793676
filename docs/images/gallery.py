"""Draw the pictures of docs/gallery.md: python docs/images/gallery.py.

It runs the scripts of examples/ in a temporary folder. The picture of 07 needs Chromium.
"""

from __future__ import annotations

import os
import runpy
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from tutorial import draw, draw_wired, model_of, save, screenshot, textured

from cagemap.files.result.folder import read_result
from cagemap.maps.pair import locate
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray
from cagemap.pictures import FRONT, Image, Skin, draw_dots, frame, position_colors, scalar_colors
from cagemap.spectral.surface import Surface
from cagemap.subdivision import refine

EXAMPLES = Path(__file__).parents[2] / "examples"
Names = Mapping[str, Any]


def colored(side: Surface, values: FloatArray, low: float, high: float) -> Image:
    """One model with values at its finest vertices as colours."""
    return draw(model_of(side.refinement), Skin(vertex_colors=scalar_colors(values, low, high)))


def places(point_map: PointMap, target: Surface, source: Surface) -> tuple[Image, Image]:
    """Source and target of a map; equal colours are equal places."""
    finest = source.refinement.finest.positions
    images = point_map.images.positions / source.operators.scale
    looks = [(source, finest), (target, images)]
    first, second = (
        draw(model_of(side.refinement), Skin(vertex_colors=position_colors(at, finest, cells=0))) for side, at in looks
    )
    return first, second


def matrix_image(matrix: FloatArray, size: int) -> Image:
    """The size of a matrix's entries as grey squares, large ones dark."""
    shades = 1.0 - np.abs(matrix) / np.abs(matrix).max()
    rows, columns = (np.arange(size - 40) * count // (size - 40) for count in matrix.shape)
    grey = np.pad(255 * shades[rows][:, columns], 20, constant_values=255)
    return np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)


def bake(names: Names) -> tuple[Image, ...]:
    """01: the pony, and the deer with its texture."""
    skins = textured(names["source"], names["pair"].texture), textured(names["target"], names["texture"])
    pony, deer = (model_of(names[side].refinement) for side in ("source", "target"))
    return draw(pony, skins[0]), draw(deer, skins[1])


def weights(names: Names) -> tuple[Image, ...]:
    """02: weights of the front joint on both."""
    return tuple(
        colored(side, side.refinement.prolong(values[:, :1], 0, side.refinement.finest_level)[:, 0], 0.0, 1.0)
        for side, values in ((names["source"], names["weights"]), (names["target"], names["carried"]))
    )


def wrap(names: Names) -> tuple[Image, ...]:
    """03: the deer's cage before and after."""
    return draw_wired(names["target"].refinement), draw_wired(refine(names["wrapped"].mesh, 3))


def heights(names: Names) -> tuple[Image, ...]:
    """04: heights of the pony on both."""
    values, carried = names["heights"], names["carried"]
    result = names["result"]
    return tuple(
        colored(side, of, values.min(), values.max())
        for side, of in ((result.source, values), (result.target, carried))
    )


def functional_map(names: Names) -> tuple[Image, ...]:
    """05: the matrix, and the map that it says."""
    deer = places(names["found"], names["target"], names["source"])[1]
    return matrix_image(names["matrix"], len(deer)), deer


def moved(names: Names) -> tuple[Image, ...]:
    """06: the landmark on the pony, before and after, and how far the deer's vertices moved."""
    source, result = names["source"], names["result"]
    model = model_of(source.refinement)
    landmarks = [of.landmarks.source_points for of in (result, names["updated"])]
    points = [locate(source, of).positions[names["eye"]] for of in landmarks]
    camera = frame(model.positions, FRONT, aspect=1.0)
    colors = np.array([[0.55, 0.55, 0.6], [0.9, 0.25, 0.2]])
    dots = draw_dots(draw(model), model, camera, np.array(points) / source.operators.scale, colors, radius=4)
    return dots, colored(names["target"], names["lengths"], 0.0, names["lengths"].max())


def report(names: Names) -> tuple[Image, ...]:
    """07: the top of the page."""
    return (screenshot(Path("report.html"), 1100, 550, 0.6),)


def both_ways(names: Names) -> tuple[Image, ...]:
    """08: the places of each model on the other."""
    results: list[MatchResult] = [read_result(Path(name)) for name in ("pony__deer", "deer__pony")]
    return tuple(places(one.point_map, one.target, one.source)[1] for one in results)


PICTURES = (bake, weights, wrap, heights, functional_map, moved, report, both_ways)


def main() -> None:
    """A picture for each script."""
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        for number, picture in enumerate(PICTURES, 1):
            (script,) = EXAMPLES.glob(f"{number:02}_*.py")
            save(f"gallery_{number:02}", *picture(runpy.run_path(str(script))))


if __name__ == "__main__":
    main()
