"""Draw bakes.jpg: a rough skin sculpted on one body, baked for another: python docs/images/bakes.py RESULT."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from cagemap.files.images.image import write_image
from cagemap.files.result.folder import read_result
from cagemap.pictures import FRONT, Model, Skin, frame, render
from cagemap.subdivision import level_triangles, refine
from cagemap.surface.triangles import vertex_normals
from cagemap.transfer import transfer_of
from cagemap.transfer.detail import bake_detail_heights, bake_detail_normals, bake_detail_values, detail_over
from cagemap.transfer.rays import ambient_occlusion

WIDTH, HEIGHT, TEXELS = 400, 480, 1024


def main(folder: Path) -> None:
    """The sculpt, and its normals, occlusion and heights on the target."""
    result = read_result(folder)
    transfer = transfer_of(result)
    fine = refine(result.source.control, 4)
    places, triangles = fine.finest.positions, level_triangles(fine, 4)
    rng = np.random.default_rng(0)
    size = np.ptp(places, axis=0).max()
    waves = rng.normal(size=(3, 24)) * 240 / size
    relief = 1.2e-3 * size * np.sin(places @ waves + rng.uniform(0, 6, 24)).mean(axis=1, keepdims=True) * 5
    sculpt = places + relief * vertex_normals(places, triangles)
    detail = detail_over(transfer.point_map.source, sculpt, triangles)
    normals = bake_detail_normals(transfer, detail, size=TEXELS, dtype=np.float32)
    openness = bake_detail_values(
        transfer, detail, ambient_occlusion(detail.surface, 64), size=TEXELS, dtype=np.float32
    )
    heights = bake_detail_heights(transfer, detail, size=TEXELS).pixels
    low, high = np.quantile(heights, [0.01, 0.99])
    surface = transfer.target
    body = Model(surface.positions, surface.triangles)
    looks = [normals, np.repeat(openness, 3, axis=2), np.repeat((heights - low) / (high - low), 3, axis=2).clip(0, 1)]
    shown = [(Model(sculpt, triangles), Skin())]
    shown += [(body, Skin(texture=look.astype(np.float64), corner_uvs=surface.corner_uvs())) for look in looks]
    pictures = [
        render(model, skin, frame(model.positions, FRONT, aspect=WIDTH / HEIGHT), width=WIDTH, height=HEIGHT)
        for model, skin in shown
    ]
    write_image(Path(__file__).with_name("bakes.jpg"), np.concatenate(pictures, axis=1), force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
