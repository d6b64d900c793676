"""Draw wrap.jpg: python docs/images/wrap.py RESULT WRAPPED [RESULT WRAPPED ...].

A row for each RESULT: target, source, distance of the wrapped surface to the source, and the wrapped edges. WRAPPED is
what `cagemap wrap RESULT -o WRAPPED` wrote.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from cagemap.files.images.image import write_image
from cagemap.files.meshes.formats import read_mesh
from cagemap.files.result.folder import read_result
from cagemap.numerics.arrays import FloatArray
from cagemap.pictures import FRONT, Image, Model, Skin, draw_segments, frame, render, scalar_colors
from cagemap.report.rig_panels import control_edges
from cagemap.subdivision import Refinement, level_triangles, refine
from cagemap.surface.closest_points import closest_points

WIDTH, HEIGHT = 390, 520
WIRE = np.full(3, 0.25)
YELLOW = 2e-3  # of sqrt(area)


def draw(refinement: Refinement, skin: Skin | None = None, edges: FloatArray | None = None) -> Image:
    """The finest surface from the front."""
    model = Model(refinement.finest.positions, level_triangles(refinement, refinement.finest_level))
    camera = frame(model.positions, FRONT, aspect=WIDTH / HEIGHT)
    image = render(model, skin or Skin(), camera, width=WIDTH, height=HEIGHT, samples=3)
    return image if edges is None else draw_segments(image, model, camera, edges, WIRE)


def row(folder: Path, wrapped: Path) -> Image:
    """Four pictures of one result."""
    result = read_result(folder)
    target, surface = result.target.refinement, result.point_map.source
    fine = refine(read_mesh(wrapped), target.finest_level, target.scheme)
    _, _, distance = closest_points(surface.tree, surface.scale * fine.finest.positions)
    colors = Skin(vertex_colors=scalar_colors(distance, 0.0, YELLOW))
    pictures = [draw(target), draw(result.source.refinement), draw(fine, colors)]
    return np.concatenate([*pictures, draw(fine, edges=control_edges(fine))], axis=1)


def main(files: list[Path]) -> None:
    """A row for each result."""
    rows = [row(folder, wrapped) for folder, wrapped in zip(files[::2], files[1::2], strict=True)]
    write_image(Path(__file__).with_name("wrap.jpg"), np.concatenate(rows), force=True)


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
