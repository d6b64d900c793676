"""Every kind of image through a whole transfer: with and without a mask, at its own size and shrunk."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.cli.progress import Stages
from cagemap.cli.transfer import run_transfer
from cagemap.cli.transfer_request import TransferRequest
from cagemap.files.images import Image, read_image, write_image
from cagemap.files.result import write_result
from cagemap.maps.masks import Masks

from example_result import identity_result

KINDS = [
    (suffix, dtype, channels)
    for suffix, dtype in (
        (".png", "uint8"),
        (".png", "uint16"),
        (".tif", "uint16"),
        (".tif", "float32"),
        (".exr", "float16"),
        (".exr", "float32"),
    )
    for channels in (1, 3, 4)
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cube onto itself, whole and with half of it masked."""
    folder = tmp_path_factory.mktemp("kinds")
    result = identity_result(2)
    write_result(folder / "WHOLE", result)
    mask = (result.target.vertices[:, 0] > 0).astype(np.float64)
    write_result(folder / "MASKED", replace(result, masks=Masks(target=mask)))
    return folder


def _texture(dtype: str, channels: int, seed: int) -> np.ndarray:
    values = np.random.default_rng(seed).random((96, 96, channels))
    if dtype.startswith("uint"):
        return (values * np.iinfo(dtype).max).astype(dtype)
    return (8.0 * values - 1.0).astype(dtype)  # beyond 0 to 1, and negative


def _run(folder: Path, result: str, output: str, **options: object) -> Image:
    request = TransferRequest(folder / result, folder / output, force=True, **options)
    run_transfer(request, Stages())
    return read_image(folder / output)


@pytest.mark.parametrize(("suffix", "dtype", "channels"), KINDS)
def test_a_kind_of_image_stays_what_it_is(folder: Path, suffix: str, dtype: str, channels: int) -> None:
    given, base = _texture(dtype, channels, 1), _texture(dtype, channels, 2)
    texture, own = folder / f"given{suffix}", folder / f"base{suffix}"
    for path, pixels in ((texture, given), (own, base)):
        write_image(path, Image(pixels, (), "Linear"), force=True)
    back = _run(folder, "WHOLE", f"back{suffix}", texture=texture)
    assert (back.pixels.dtype, back.pixels.shape) == (given.dtype, given.shape)
    near = 1 if dtype.startswith("uint") else 0.01
    assert np.median(np.abs(back.pixels.astype(float) - given.astype(float))) <= near
    small = _run(folder, "WHOLE", f"small{suffix}", texture=texture, size=24).pixels
    assert (small.dtype, small.shape) == (given.dtype, (24, 24, channels))
    assert given.min() <= small.min() <= small.max() <= given.max()
    assert small.astype(float).std() < 0.6 * given.astype(float).std()
    over = _run(folder, "MASKED", f"over{suffix}", texture=texture, bases=(("", own),)).pixels
    assert over.dtype == given.dtype
    as_base = np.all(over == base, axis=2).mean()
    assert 0.2 < as_base < 0.8
    faded = _run(folder, "MASKED", f"faded{suffix}", texture=texture).pixels
    assert faded.dtype == given.dtype
    assert faded.shape[2] == (4 if channels == 4 else channels + 1)


@pytest.mark.parametrize("name", ["small.png", "small.exr"])
def test_alpha_is_carried_as_a_channel_of_its_own(folder: Path, name: str) -> None:
    pixels = np.zeros((96, 96, 4), dtype=np.uint8 if name.endswith("png") else np.float32)
    pixels[..., 0] = 200 if name.endswith("png") else 2.0  # colours under no alpha must not be lost
    write_image(folder / name, pixels, force=True)
    back = _run(folder, "WHOLE", f"alpha_{name}", texture=folder / name).pixels
    np.testing.assert_array_equal(back, np.broadcast_to(pixels[0, 0], back.shape))
