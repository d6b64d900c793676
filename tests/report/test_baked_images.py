"""Baked images of floats on a report's page: colours are linear and are encoded once, data is shown unchanged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cagemap.files.images.image import write_image
from cagemap.tasks.report import _baked_image

from example_result import identity_result


@pytest.mark.parametrize(
    ("kind", "shown"),
    [
        ("bake-colors", [0.0, 0.5, 1.0]),
        ("bake-ao", [0.0, 0.5, 1.0]),
        ("normal-map", [0.0, 0.21404, 1.0]),
        ("displacement", [0.0, 0.21404, 1.0]),
    ],
)
def test_floats_are_encoded_once_if_they_are_colours(tmp_path: Path, kind: str, shown: list[float]) -> None:
    values = np.array([0.0, 0.21404, 1.0], np.float32)
    write_image(tmp_path / "a.exr", np.tile(values[:, None], (2, 1, 3)))
    entry = {"kind": kind, "output": "a.exr", "tiles": [0]}
    (pixels,) = _baked_image(tmp_path, identity_result(1), entry).tiles.values()
    np.testing.assert_allclose(pixels[0, :, 0], shown, atol=1e-4)


@pytest.mark.parametrize("names", ["skin.{}.png", "skin_{}_v2.png", "1001_{}.png"])
def test_tiles_are_found_wherever_their_number_stands(tmp_path: Path, names: str) -> None:
    tiles = [1001, 1002]
    for tile in tiles:
        write_image(tmp_path / names.format(tile), np.full((4, 4, 3), tile - 1000, dtype=np.uint8))
    entry = {"kind": "texture", "output": names.format(1001), "tiles": tiles}
    image = _baked_image(tmp_path, identity_result(1), entry)
    assert image.name.endswith(names.format("<UDIM>"))
    assert {tile: round(float(pixels.max() * 255)) for tile, pixels in image.tiles.items()} == {1001: 1, 1002: 2}
