"""Draw docs/images/demo.png from the folder that `cagemap demo` wrote: python docs/images/draw.py DIR."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from cagemap.files.images.image import read_image, write_image
from cagemap.files.result.folder import read_result
from cagemap.pictures import FRONT, Image, Model, Skin, View, frame, render
from cagemap.report.figures import display_image
from cagemap.spectral.surface import Surface
from cagemap.transfer.textured_surface import TexturedSurface

WIDTH, HEIGHT = 460, 420


def draw(side: Surface, texture: Path, view: View) -> Image:
    """One side of the result in its texture."""
    surface = TexturedSurface.from_level(side.refinement.finest)
    model = Model(surface.positions, surface.triangles)
    skin = Skin(texture=display_image(read_image(texture).pixels), corner_uvs=surface.corner_uvs())
    camera = frame(model.positions, view, aspect=WIDTH / HEIGHT)
    return render(model, skin, camera, width=WIDTH, height=HEIGHT, samples=3)


def main(folder: Path) -> None:
    """Source and target side by side, the target from both sides."""
    result = read_result(folder / "RESULT")
    pictures = [
        draw(result.source, folder / "pony.png", FRONT),
        draw(result.target, folder / "deer.png", FRONT),
        draw(result.target, folder / "deer.png", replace(FRONT, azimuth=115.0)),
    ]
    write_image(Path(__file__).with_name("demo.png"), np.concatenate(pictures, axis=1), force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
