"""Every kind of image through a whole transfer: with and without a mask, at its own size and shrunk."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import OpenImageIO as oiio
import pytest
from hypothesis import given as given_by
from hypothesis import settings
from hypothesis import strategies as st
from PIL import Image as PillowImage
from PIL import ImageCms

from cagemap.errors import FormatError
from cagemap.files.images.image import Image, read_image, read_image_form, write_image
from cagemap.files.result.folder import write_result
from cagemap.maps.masks import Masks
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer

from example_result import identity_result
from refusals import refuses

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


@pytest.mark.slow
@pytest.mark.parametrize(("suffix", "dtype", "channels"), KINDS)
def test_a_kind_of_image_stays_what_it_is(folder: Path, suffix: str, dtype: str, channels: int) -> None:
    given, base = _texture(dtype, channels, 1), _texture(dtype, channels, 2)
    texture, own = folder / f"given{suffix}", folder / f"base{suffix}"
    for path, pixels in ((texture, given), (own, base)):
        write_image(path, Image(pixels, (), "Linear", associated=suffix == ".exr"), force=True)
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


def _exr(path: Path, pixels: np.ndarray, origin: tuple[int, int], window: tuple[int, int, int, int]) -> None:
    """An EXR whose data lie at an origin (x, y), in a display window (x, y, width, height)."""
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], oiio.HALF)
    spec.x, spec.y = origin
    spec.full_x, spec.full_y, spec.full_width, spec.full_height = window
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(np.ascontiguousarray(pixels))
    output.close()


@settings(max_examples=40)
@given_by(x=st.integers(-9, 9), y=st.integers(-9, 9), width=st.integers(1, 12), height=st.integers(1, 12))
def test_the_display_window_of_an_exr_is_the_image(x: int, y: int, width: int, height: int) -> None:
    pixels = np.random.default_rng(1).random((6, 7, 3)).astype(np.float16)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "cut.exr"
        _exr(path, pixels, (x + 3, y + 2), (3, 2, width, height))
        read, form = read_image(path).pixels, read_image_form(path)
    assert read.shape == (*form[2], form[1]) == (height, width, 3)
    for row, column in np.ndindex(height, width):
        inside = 0 <= row - y < 6 and 0 <= column - x < 7
        np.testing.assert_array_equal(read[row, column], pixels[row - y, column - x] if inside else 0)


def test_an_exr_of_several_parts_is_refused(tmp_path: Path) -> None:
    path, specs = str(tmp_path / "parts.exr"), []
    for name in ("beauty", "depth"):
        specs.append(oiio.ImageSpec(8, 8, 3, oiio.HALF))
        specs[-1].attribute("name", name)
    output = oiio.ImageOutput.create(path)
    assert output.open(path, tuple(specs))
    for number, spec in enumerate(specs):
        assert number == 0 or output.open(path, spec, "AppendSubimage")
        assert output.write_image(np.zeros((8, 8, 3), np.float32))
    output.close()
    refuses(FormatError, "several parts", read_image, path)


@pytest.mark.parametrize(("other", "read"), [((8, 6), False), ((8, 3), False), ((4, 3), True), (None, True)])
def test_a_tiff_of_several_pages_is_refused_but_for_smaller_ones(tmp_path, other, read):
    """Layers are other pictures, thumbnails are none."""
    pixels = np.arange(8 * 6 * 3, dtype=np.uint8).reshape(6, 8, 3)
    more = [] if other is None else [PillowImage.new("RGB", other)]
    PillowImage.fromarray(pixels).save(tmp_path / "a.tif", save_all=True, append_images=more)
    if read:
        np.testing.assert_array_equal(read_image(tmp_path / "a.tif").pixels, pixels)
    else:
        refuses(FormatError, "a TIFF of several pages", read_image, tmp_path / "a.tif")


def test_a_tiff_of_lab_colours_is_refused(tmp_path: Path) -> None:
    """The library that reads it turns them into RGB some 14 levels off."""
    PillowImage.new("LAB", (4, 4), (100, 20, 20)).save(tmp_path / "lab.tif")
    refuses(FormatError, "LAB colours", read_image, tmp_path / "lab.tif")


def test_colours_multiplied_by_alpha_stay_so_or_are_divided(tmp_path: Path) -> None:
    alpha = np.tile(np.array([0, 51, 255], dtype=np.uint8), (4, 1))[..., None]
    plain = np.full((4, 3, 3), 100, dtype=np.uint8)
    multiplied = np.dstack([np.rint(plain * (alpha / 255)).astype(np.uint8), alpha])
    spec = oiio.ImageSpec(3, 4, 4, oiio.UINT8)
    output = oiio.ImageOutput.create(str(tmp_path / "given.tif"))
    assert output.open(str(tmp_path / "given.tif"), spec)
    assert output.write_image(multiplied)
    output.close()
    given = read_image(tmp_path / "given.tif")
    assert given.associated
    write_image(tmp_path / "same.tif", given)
    same = read_image(tmp_path / "same.tif")
    assert same.associated
    np.testing.assert_array_equal(same.pixels, multiplied)
    write_image(tmp_path / "divided.png", given)
    divided = read_image(tmp_path / "divided.png")
    assert not divided.associated
    np.testing.assert_array_equal(divided.pixels[..., 3:], alpha)
    np.testing.assert_array_equal(divided.pixels[:, 1:, :3], plain[:, 1:])
    # Directions of a normal map, without the alpha that its image had.
    write_image(tmp_path / "turned.png", replace(given, pixels=multiplied[..., :3]))
    np.testing.assert_array_equal(read_image(tmp_path / "turned.png").pixels, multiplied[..., :3])


@pytest.mark.parametrize(("given", "bits", "output"), [("c.png", 16, "c2.exr"), ("c.exr", 8, "c2.png")])
def test_a_colour_written_in_a_type_of_another_encoding_is_said(folder, given, bits, output):
    write_image(
        folder / given, np.full((8, 8, 3), 0.5 if given == "c.exr" else 128, "f4" if given == "c.exr" else "u1")
    )
    for name, said in (("color", True), ("roughness", False)):
        maps = ((name, folder / given),)
        request = TransferRequest(folder / "WHOLE", folder / output, maps=maps, bits=bits, size=8, force=True)
        _, warnings = run_transfer(request, Stages())
        assert any(f"choose the colour space of {given}" in warning for warning in warnings) == said


def test_heights_are_not_multiplied_by_alpha(folder: Path) -> None:
    write_image(folder / "heights.exr", np.tile(np.float32([2.0, 0.5]), (32, 32, 1)))
    request = TransferRequest(folder / "WHOLE", folder / "carried.exr", displacement=folder / "heights.exr")
    assert "\n  height = (value - 0) * 1 in the target's units" in run_transfer(request, Stages())[0]
    np.testing.assert_allclose(read_image(folder / "carried.exr").pixels, 4.0, rtol=1e-3)  # twice as large a target


@pytest.mark.parametrize("suffix", [".jpg", ".tif", ".png"])
def test_an_icc_profile_is_kept_if_it_is_of_the_same_channels(folder: Path, suffix: str) -> None:
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    PillowImage.new("RGB", (8, 8), (200, 30, 60)).save(folder / f"color{suffix}", icc_profile=profile)
    _run(folder, "WHOLE", f"baked{suffix}", texture=folder / f"color{suffix}")
    assert PillowImage.open(folder / f"baked{suffix}").info.get("icc_profile") == profile
    _run(folder, "MASKED", "faded.png", texture=folder / f"color{suffix}")
    assert PillowImage.open(folder / "faded.png").info.get("icc_profile") == profile
    colors = read_image(folder / f"color{suffix}")
    write_image(folder / f"grey{suffix}", replace(colors, pixels=colors.pixels[..., :1]), force=True)
    assert "icc_profile" not in PillowImage.open(folder / f"grey{suffix}").info


@pytest.mark.parametrize("suffix", [".jpg", ".tif", ".png"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_an_image_is_turned_as_its_file_says(tmp_path: Path, suffix: str, orientation: int) -> None:
    """Cameras store rows as they lie on the sensor; what is expected is OpenImageIO's own turning."""
    stored = np.zeros((16, 32, 3), dtype=np.uint8)
    stored[:8, :8], stored[:8, 8:], stored[8:, :8] = (200, 0, 0), (0, 200, 0), (0, 0, 200)
    spec = oiio.ImageSpec(32, 16, 3, "uint8")
    spec.attribute("Orientation", orientation)
    spec.attribute("CompressionQuality", 100)
    spec.attribute("jpeg:subsampling", "4:4:4")
    file = str(tmp_path / f"photo{suffix}")
    opened = oiio.ImageOutput.create(file)
    assert opened.open(file, spec)
    assert opened.write_image(stored)
    assert opened.close()
    source = oiio.ImageBuf(stored)
    source.specmod().attribute("Orientation", orientation)
    expected = oiio.ImageBufAlgo.reorient(source).get_pixels(oiio.UINT8)
    found = read_image(file).pixels
    assert found.shape == expected.shape
    assert read_image_form(file) == (np.dtype(np.uint8), 3, found.shape[:2])
    np.testing.assert_allclose(found.astype(int), expected, atol=4)  # JPEG
