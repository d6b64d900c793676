"""Draw the pictures of docs/tutorial.md: python docs/images/tutorial.py DIR.

DIR has what the commands of docs/tutorial.md write. The picture of the report needs Chromium.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from cagemap.files.images.image import Pixels, read_image, write_image
from cagemap.files.meshes.formats import read_mesh
from cagemap.files.result.folder import read_result
from cagemap.maps.pair import locate
from cagemap.maps.result import MatchResult
from cagemap.mesh.cage_points import CagePoints
from cagemap.numerics.arrays import FloatArray
from cagemap.pictures import (
    FRONT,
    Image,
    Model,
    Skin,
    View,
    distinct_colors,
    draw_dots,
    draw_segments,
    frame,
    position_colors,
    render,
    scalar_colors,
)
from cagemap.report.figures import display_image
from cagemap.report.rig_panels import control_edges
from cagemap.spectral.surface import Surface
from cagemap.subdivision import Refinement, refine
from cagemap.transfer.textured_surface import TexturedSurface

WIDTH, HEIGHT = 330, 330
HERE = Path(__file__).parent
BEHIND = replace(FRONT, azimuth=115.0)
WIRE = np.full(3, 0.25)


def model_of(refinement: Refinement) -> Model:
    """The finest surface, in the file's lengths."""
    surface = TexturedSurface.from_level(refinement.finest)
    return Model(surface.positions, surface.triangles)


def draw(model: Model, skin: Skin | None = None, view: View = FRONT) -> Image:
    """One model from one side."""
    camera = frame(model.positions, view, aspect=WIDTH / HEIGHT)
    return render(model, skin or Skin(), camera, width=WIDTH, height=HEIGHT, samples=3)


def draw_wired(refinement: Refinement, skin: Skin | None = None) -> Image:
    """One model with the edges of its control mesh."""
    model = model_of(refinement)
    camera = frame(model.positions, FRONT, aspect=WIDTH / HEIGHT)
    return draw_segments(draw(model, skin), model, camera, control_edges(refinement), WIRE)


def screenshot(page: Path, width: int, height: int, scale: float) -> Image:
    """The top of a page in Chromium, scaled."""
    with TemporaryDirectory() as folder:
        picture = Path(folder) / "page.png"
        size = f"--window-size={width},{height}", f"--force-device-scale-factor={scale}"
        command = ["chromium", "--headless=new", "--no-sandbox", "--hide-scrollbars", *size, f"--screenshot={picture}"]
        command += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--virtual-time-budget=10000"]
        subprocess.run([*command, page.resolve().as_uri()], check=True, capture_output=True)
        return read_image(picture).pixels[..., :3]


def textured(side: Surface, texture: Pixels) -> Skin:
    """The skin of an image over a side's UVs."""
    corners = TexturedSurface.from_level(side.refinement.finest).corner_uvs()
    return Skin(texture=display_image(texture), corner_uvs=corners)


def with_landmarks(side: Surface, model: Model, points: FloatArray) -> Image:
    """Clay with a dot at every landmark, in the same colours on both sides."""
    camera = frame(model.positions, FRONT, aspect=WIDTH / HEIGHT)
    return draw_dots(draw(model), model, camera, points / side.operators.scale, distinct_colors(len(points)), radius=4)


def weights_of(file: Path, side: Surface) -> Skin:
    """The first column of weights at control vertices, as colours of the finest surface."""
    values = np.loadtxt(file, delimiter=",", skiprows=1)[:, 0]
    return Skin(
        vertex_colors=scalar_colors(
            side.refinement.prolong(values[:, None], 0, side.refinement.finest_level)[:, 0], 0.0, 1.0
        )
    )


def save(name: str, *pictures: Image) -> None:
    """Pictures side by side."""
    write_image(HERE / f"{name}.jpg", np.concatenate(pictures, axis=1), force=True)


def main(folder: Path) -> None:
    """All pictures, from the files of the tutorial."""
    result: MatchResult = read_result(folder / "RESULT")
    source, target = result.source, result.target
    pony, deer = model_of(source.refinement), model_of(target.refinement)
    points = [locate(side, of).positions for side, of in _landmarks(result)]
    save("tutorial_landmarks", with_landmarks(source, pony, points[0]), with_landmarks(target, deer, points[1]))
    finest = source.refinement.finest.positions
    images = result.point_map.images.positions / source.operators.scale
    colors = [Skin(vertex_colors=position_colors(places, finest)) for places in (finest, images)]
    save("tutorial_map", draw(pony, colors[0]), draw(deer, colors[1]))
    paint, baked_paint = (read_image(folder / name).pixels for name in ("pony.png", "deer.png"))
    baked = textured(target, baked_paint)
    save(
        "tutorial_texture",
        draw(pony, textured(source, paint)),
        draw(deer, baked),
        draw(deer, baked, BEHIND),
    )
    carried = weights_of(folder / "deer_weights.csv", target)
    save("tutorial_weights", draw(pony, weights_of(folder / "pony_weights.csv", source)), draw(deer, carried))
    wrapped = refine(read_mesh(folder / "deer_as_pony.obj"), 3)
    save("tutorial_wrap", draw_wired(target.refinement), draw_wired(wrapped), draw(pony))
    save("tutorial_report", screenshot(folder / "report.html", 1180, 720, 0.8))


def _landmarks(result: MatchResult) -> tuple[tuple[Surface, CagePoints], ...]:
    """Both sides with their landmarks."""
    return (result.source, result.landmarks.source_points), (result.target, result.landmarks.target_points)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
