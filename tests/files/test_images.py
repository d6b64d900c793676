"""Images: exact round trips in every type, and refusals that say what to do."""

import errno
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.errors import FormatError
from cagemap.files.images.image import Image, pixel_type, read_image, unpremultiply, write_image

from refusals import refuses


def noise(dtype: str, channels: int, shape: tuple[int, int] = (5, 7)) -> np.ndarray:
    rng = np.random.default_rng(2718)
    if dtype.startswith("uint"):
        return rng.integers(0, np.iinfo(dtype).max, (*shape, channels), endpoint=True).astype(dtype)
    return rng.normal(0, 3, (*shape, channels)).astype(dtype)


CASES = [
    (suffix, dtype, channels)
    for suffix, dtypes in {
        ".png": ("uint8", "uint16"),
        ".tif": ("uint8", "uint16", "float32"),
        ".exr": ("float16", "float32"),
    }.items()
    for dtype in dtypes
    for channels in (1, 2, 3, 4)
]


@pytest.mark.parametrize(("suffix", "dtype", "channels"), CASES)
def test_pixels_come_back_exactly(tmp_path: Path, suffix: str, dtype: str, channels: int) -> None:
    pixels = noise(dtype, channels)
    # An EXR holds only colours multiplied by alpha.
    write_image(tmp_path / f"a{suffix}", Image(pixels, associated=suffix == ".exr"))
    image = read_image(tmp_path / f"a{suffix}")
    assert image.pixels.dtype == pixels.dtype
    assert image.pixels.shape == pixels.shape
    np.testing.assert_array_equal(image.pixels, pixels)
    assert len(image.channel_names) == channels


@pytest.mark.parametrize("dtype", ["float16", "float32"])
@pytest.mark.parametrize("channels", [2, 4])
def test_exr_colours_are_multiplied_by_alpha(tmp_path: Path, dtype: str, channels: int) -> None:
    alpha = np.array([[0.0, 0.25, 1.0]])[..., None]
    colors = np.full((1, 3, channels - 1), 0.5)
    plain = np.dstack([colors, alpha]).astype(dtype)
    write_image(tmp_path / "given.exr", plain)
    given = read_image(tmp_path / "given.exr")
    assert given.associated
    np.testing.assert_array_equal(given.pixels, np.dstack([colors * [[[1.0], [0.25], [1.0]]], alpha]))
    np.testing.assert_array_equal(unpremultiply(given).pixels, plain)
    write_image(tmp_path / "again.exr", given)
    np.testing.assert_array_equal(read_image(tmp_path / "again.exr").pixels, given.pixels)
    write_image(tmp_path / "divided.png", replace(given, pixels=np.rint(255 * given.pixels).astype(np.uint8)))
    np.testing.assert_allclose(read_image(tmp_path / "divided.png").pixels / 255.0, plain, atol=0.01)


@pytest.mark.parametrize("channels", [2, 4])
@pytest.mark.parametrize("associated", [True, False])
def test_the_alpha_of_a_tiff_is_stated(tmp_path: Path, channels: int, associated: bool) -> None:
    pixels = noise("uint8", channels)
    write_image(tmp_path / "a.tif", Image(pixels, associated=associated))
    image = read_image(tmp_path / "a.tif")
    np.testing.assert_array_equal(image.pixels, pixels)
    assert image.associated is associated
    assert image.channel_names[-1] == "A"


def test_two_dimensional_16_bit_pixels_are_one_channel(tmp_path: Path) -> None:
    pixels = noise("uint16", 1)[:, :, 0]
    write_image(tmp_path / "a.png", pixels)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png").pixels[:, :, 0], pixels)


def test_jpeg_is_close(tmp_path: Path) -> None:
    ramp = np.repeat(np.linspace(0, 255, 64).astype(np.uint8)[None, :, None], 64, axis=0).repeat(3, axis=2)
    write_image(tmp_path / "a.jpg", ramp)
    # Quality 95: quantisation steps of a few grey values.
    assert np.abs(read_image(tmp_path / "a.jpg").pixels.astype(int) - ramp).max() <= 4


def test_a_file_system_that_reserves_no_room_takes_a_jpeg(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EOPNOTSUPP, "not supported")

    monkeypatch.setattr("os.posix_fallocate", refuse, raising=False)
    write_image(tmp_path / "a.jpg", np.zeros((8, 8, 3), dtype=np.uint8))
    assert (tmp_path / "a.jpg").stat().st_size


def test_channel_names_are_kept(tmp_path: Path) -> None:
    write_image(tmp_path / "a.exr", Image(noise("float32", 2), ("height", "weight")))
    assert read_image(tmp_path / "a.exr").channel_names == ("height", "weight")


@pytest.mark.parametrize(
    ("name", "dtype", "channels", "remedy"),
    [
        ("a.png", "float32", 3, r"Write \.tif"),
        ("a.exr", "uint8", 3, r"Write \.png"),
        ("a.jpg", "uint16", 3, "choose 8 bits"),
        ("a.jpg", "uint8", 4, "JPEG holds no alpha"),
        ("a.bmp", "uint8", 3, "ending in"),
        ("a", "uint8", 3, "no suffix"),
        ("a.png", "int32", 3, "Choose 8 or 16 bits"),
        ("a.tif", "uint8", 5, "1 to 4 channels, got 5"),
    ],
)
def test_what_a_format_cannot_hold_is_refused(tmp_path, name, dtype, channels, remedy):
    refuses(FormatError, remedy, write_image, tmp_path / name, np.zeros((2, 2, channels), dtype=dtype))
    assert list(tmp_path.iterdir()) == []


def test_a_file_without_permission_is_said_to_be_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_image(tmp_path / "closed.png", noise("uint8", 3))
    monkeypatch.setattr("os.access", lambda path, mode: False)
    refuses(FormatError, r"closed\.png: cannot be read .* Check its permissions", read_image, tmp_path / "closed.png")


def test_unreadable_files_are_named(tmp_path: Path) -> None:
    refuses(FormatError, "no such file", read_image, tmp_path / "missing.png")
    (tmp_path / "text.png").write_text("not an image")
    refuses(FormatError, r"text\.png: expected an image", read_image, tmp_path / "text.png")
    whole = noise("uint8", 3, (64, 64))
    for suffix in (".png", ".jpg"):  # the JPEG library fills the rest with grey
        write_image(tmp_path / f"whole{suffix}", whole)
        half = (tmp_path / f"whole{suffix}").read_bytes()[:4000]
        (tmp_path / f"half{suffix}").write_bytes(half)
        with pytest.raises(FormatError, match=rf"half\{suffix}: the image ends early or is damaged"):
            read_image(tmp_path / f"half{suffix}")


@pytest.mark.parametrize("suffix", [".exr", ".tif"])
def test_the_content_says_whether_colours_are_multiplied_by_alpha_not_the_name(suffix: str, tmp_path: Path) -> None:
    write_image(tmp_path / f"a{suffix}", Image(noise("float32", 4), associated=True))
    (tmp_path / f"a{suffix}").rename(tmp_path / "a.png")
    assert read_image(tmp_path / "a.png").associated


def test_bits_choose_the_number_type() -> None:
    assert pixel_type(8, ".png") == np.uint8
    assert pixel_type(16, ".png") == np.uint16
    assert pixel_type(16, ".exr") == np.float16
    assert pixel_type(32, ".exr") == np.float32
    refuses(FormatError, "8, 16 or 32", pixel_type, 12, ".png")
