"""Images through OpenImageIO: pixels in the number type of the file, rows from the top.

OpenImageIO multiplies the colours of a PNG by alpha (switched off here), misreads 2-dimensional uint16 arrays (here
always (h, w, c)), and converts pixels that a format cannot store (refused here).
"""

from __future__ import annotations

import errno
import os
import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.atomic import atomic_path
from cagemap.files.images.parts import apply_orientation, fit_to_display_window, require_one_picture, shown_size
from cagemap.files.ownership import mark
from cagemap.files.text import require_file, require_suffix, text_name
from cagemap.mesh.udim import FIRST_TILE
from cagemap.numerics.arrays import array_of
from cagemap.numerics.kinds import kinds_checked

Pixels = NDArray[Any]

UDIM_MARK = "<UDIM>"
# Other spellings: Arnold's and Houdini's.
_UDIM_MARKS = re.compile(r"<udim>|%\(udim\)d", re.IGNORECASE)
_FIRST_NUMBER = re.compile(rf"(?<=[._]){FIRST_TILE}(?=\.\w+\Z)")
# Pixel types that each format stores exactly.
_FORMATS: dict[str, tuple[str, ...]] = {
    ".png": ("uint8", "uint16"),
    ".jpg": ("uint8",),
    ".jpeg": ("uint8",),
    ".tif": ("uint8", "uint16", "float32"),  # OpenImageIO widens half to float here
    ".tiff": ("uint8", "uint16", "float32"),
    ".exr": ("float16", "float32"),
}
_CHANNELS = {1: ("Y",), 2: ("Y", "A"), 3: ("R", "G", "B"), 4: ("R", "G", "B", "A")}
_LARGEST_CHANNELS = 4
# Number types by OpenImageIO's names.
_KINDS = {"uint8": "uint8", "uint16": "uint16", "half": "float16", "float": "float32"}
_READ_AS = {dtype: name for name, dtype in _KINDS.items()}
_TIFF, _JPEG = (".tif", ".tiff"), (".jpg", ".jpeg")
_ASSOCIATED_SUFFIXES = (*_TIFF, ".exr")  # formats that can hold colours multiplied by alpha; EXR holds no others
# Texels of a written image that are read back at a time.
_VERIFIED_TEXELS = 1 << 22
_HEADER = 1 << 16  # most bytes of a file besides its texels
# Error numbers of `posix_fallocate` on file systems that do not support it.
_NO_RESERVING = (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP)


@dataclass(frozen=True, eq=False)
class Image:
    """Pixels of an image, with its channel names and colour encoding."""

    pixels: Pixels  # (h, w, c) uint8, uint16, float16 or float32; row 0 at the top
    channel_names: tuple[str, ...] = ()  # one for each channel
    color_space: str = ""  # the file's name for the encoding of colours ("sRGB", "Linear", ...), empty without one
    icc_profile: bytes = b""  # of the colours, empty without one
    associated: bool = False  # colours are multiplied by alpha: always in an EXR with alpha, and if a TIFF states it

    def __repr__(self) -> str:
        encoding = f", {self.color_space}" if self.color_space else ""
        return f"Image({' x '.join(map(str, self.pixels.shape))} {self.pixels.dtype}{encoding})"

    @property
    def size(self) -> tuple[int, int]:
        """Height and width."""
        return self.pixels.shape[0], self.pixels.shape[1]


@kinds_checked
def read_image(path: str | Path) -> Image:
    """Read an image with 1 to 4 channels.

    Raises
    ------
    FormatError
        If the file cannot be read as an image, or has more channels, other pixel types or more than two dimensions.
    """
    file = Path(path)
    try:
        return _read(file)
    except UnicodeDecodeError as error:  # text in the file that OpenImageIO cannot decode
        raise FormatError(f"{file}: the image is damaged: {error}. Export it again.") from error


def image_of_bytes(data: bytes, suffix: str, name: str) -> Image:
    """An image from the content of a file; ``name`` is used in messages."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"image{suffix}"
        file.write_bytes(data)
        try:
            return read_image(file)
        except FormatError as error:
            raise FormatError(str(error).replace(str(file), name)) from None


def png_bytes(image: Image) -> bytes:
    """An image as a PNG file."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "image.png"
        write_image(file, image)
        return file.read_bytes()


def _read(file: Path) -> Image:
    opened, kind = _open(file)
    spec = opened.spec()
    try:
        pixels = opened.read_image(0, 0, 0, spec.nchannels, _READ_AS[kind])
        error = opened.geterror()
        if pixels is None or error:  # of a JPEG that ends early, the library fills the rest with grey
            raise FormatError(f"{file}: the image ends early or is damaged: {_reason(error)} Export it again.")
    finally:
        opened.close()
    array = np.asarray(pixels).reshape(spec.height, spec.width, spec.nchannels).astype(kind, copy=False)
    form = opened.format_name()
    may_be_associated = form in ("tiff", "openexr")
    associated = may_be_associated and spec.alpha_channel >= 0 and not spec.getattribute("oiio:UnassociatedAlpha")
    array = fit_to_display_window(array, spec) if form == "openexr" else array
    array = apply_orientation(array, int(spec.getattribute("Orientation") or 1))
    profile = spec.getattribute("ICCProfile")
    return Image(
        array,
        tuple(spec.channelnames),
        str(spec.getattribute("oiio:ColorSpace") or ""),
        b"" if profile is None else profile.tobytes(),
        associated,
    )


def _open(file: Path) -> tuple[Any, str]:
    """The reader of an image with a checked header, and the number type of its pixels."""
    import OpenImageIO as oiio  # here, since a match reads no image

    hints = oiio.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", 1)
    require_file(file, "an image")
    opened = oiio.ImageInput.open(text_name(file), hints)
    if opened is None:
        raise FormatError(
            f"{file}: expected an image (PNG, TIFF, EXR, JPEG, ...), could not open it: {_reason(oiio.geterror())} "
            "Export it again in one of these formats."
        )
    spec = opened.spec()
    kind = str(spec.format)
    if spec.channelformats:
        kind = "float"  # channels of several types: the widest type, without loss
    if kind not in _KINDS or not 1 <= spec.nchannels <= _LARGEST_CHANNELS or spec.depth > 1:
        opened.close()
        raise FormatError(
            f"{file}: expected a flat image of 1 to {_LARGEST_CHANNELS} channels of uint8, uint16, half or float, "
            f"found {spec.nchannels} of {kind}" + (" in depth" if spec.depth > 1 else "") + ". Convert it first."
        )
    try:
        require_one_picture(file, opened)
        opened.geterror()  # forgets that there is no further page
    except FormatError:
        opened.close()
        raise
    return opened, _KINDS[kind]


def read_image_form(path: str | Path) -> tuple[np.dtype[Any], int, tuple[int, int]]:
    """Number type, number of channels and (height, width) of an image, or of a set's first tile, from its header."""
    opened, kind = _open(next(iter(tile_files(path).values())))
    channels, size = int(opened.spec().nchannels), shown_size(opened.spec(), opened.format_name())
    opened.close()
    return np.dtype(kind), channels, size


@kinds_checked
def write_image(path: str | Path, image: Image | Pixels, *, force: bool = False) -> None:
    """Write an image by `atomic_path`; the suffix gives the format.

    An image that cagemap did not write is replaced only with ``force``.

    Raises
    ------
    FormatError
        If the format is unknown, does not hold the pixels' type exactly, or the file cannot be written.
    """
    import OpenImageIO as oiio  # here, since a match writes no image

    file = Path(path)
    given = image if isinstance(image, Image) else Image(array_of(image), ())
    pixels = given.pixels[:, :, None] if given.pixels.ndim == 2 else given.pixels
    check_writable(file, pixels.dtype, pixels.shape[2] if pixels.ndim == 3 else 0)
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, _READ_AS[str(pixels.dtype)])
    spec.channelnames = given.channel_names if len(given.channel_names) == channels else _CHANNELS[channels]
    spec.alpha_channel = channels - 1 if channels in (2, 4) else -1  # OpenImageIO sets it for four channels alone
    if file.suffix.lower() not in _ASSOCIATED_SUFFIXES:
        given = unpremultiply(replace(given, pixels=pixels))
        pixels = given.pixels
    elif file.suffix.lower() not in _TIFF and not given.associated and spec.channelnames[-1] == "A":
        alpha = pixels[..., -1:]  # colours are multiplied by it, except where it is 0
        colors = pixels[..., :-1] * np.where(alpha > 0, alpha, 1)
        pixels = np.concatenate([colors.astype(pixels.dtype), alpha], axis=2)
    spec.attribute("oiio:UnassociatedAlpha", 0 if given.associated else 1)
    spec.attribute("png:compressionLevel", 4)  # a quarter of the time of 9, a few per cent larger
    if given.color_space:
        spec.attribute("oiio:ColorSpace", given.color_space)
    # A profile of other channels stays out: that of a CMYK image, which was read as RGB, or of colours in a grey image.
    if given.icc_profile[16:20] == (b"RGB " if channels > 2 else b"GRAY"):
        profile = np.frombuffer(given.icc_profile, dtype=np.uint8)
        spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(profile)}]"), profile)
    if file.suffix.lower() != ".png":  # in a PNG the mark is added as a chunk to the finished file
        spec.attribute("Software", mark())
    if file.suffix.lower() in _JPEG:
        spec.attribute("CompressionQuality", 95)
    with atomic_path(file, force=force, verify=partial(_holds, pixels)) as temporary:
        if file.suffix.lower() in _JPEG:
            _reserve(temporary, pixels.nbytes + len(given.icc_profile) + _HEADER)
        output = oiio.ImageOutput.create(str(temporary))
        if output is None:
            raise FormatError(f"{file}: cannot write this format: {_reason(oiio.geterror())} Choose another suffix.")
        written = output.open(str(temporary), spec) and output.write_image(np.ascontiguousarray(pixels))
        error = output.geterror()
        if not (output.close() and written):
            raise FormatError(f"{file}: could not write the image: {_reason(error or output.geterror())}")


def _holds(pixels: Pixels, path: Path) -> bool:
    """Whether an image can be read completely and has these pixels; for a JPEG only their number is compared."""
    try:
        opened, kind = _open(path)
    except FormatError:
        return False
    spec = opened.spec()
    same = (spec.height, spec.width, spec.nchannels) == pixels.shape and kind == str(pixels.dtype)
    rows = max(1, _VERIFIED_TEXELS // spec.width)
    for top in range(0, len(pixels) if same else 0, rows):
        expected = pixels[top : top + rows]
        part = opened.read_scanlines(top, top + len(expected), 0, 0, spec.nchannels, _READ_AS[kind])
        same = part is not None and (
            path.suffix.lower() in _JPEG
            or np.array_equal(np.reshape(part, expected.shape), expected, equal_nan=kind.startswith("float"))
        )
        if not same:
            break
    opened.close()
    return same


def _reserve(path: Path, size: int) -> None:
    """Reserve disk space for a file, where possible: on a full disk, the JPEG library ends the whole process."""
    if hasattr(os, "posix_fallocate"):
        with path.open("rb+") as stream:
            try:
                os.posix_fallocate(stream.fileno(), 0, size)
            except OSError as error:
                if error.errno not in _NO_RESERVING:
                    raise


def unpremultiply(image: Image) -> Image:
    """An image with colours not multiplied by alpha, the last channel."""
    pixels = image.pixels
    if image.associated and pixels.ndim == 3 and pixels.shape[2] in (2, 4):
        full = float(np.iinfo(pixels.dtype).max) if pixels.dtype.kind == "u" else 1.0
        share = pixels[..., -1:].astype(np.float64) / full
        colors = np.divide(pixels[..., :-1], share, out=pixels[..., :-1].astype(np.float64), where=share > 0)
        if pixels.dtype.kind == "u":
            colors = np.rint(np.minimum(colors, full))
        pixels = np.concatenate([colors.astype(pixels.dtype), pixels[..., -1:]], axis=2)
    return replace(image, pixels=pixels, associated=False)


def check_image_name(file: Path) -> None:
    """Refuse a name without a suffix of an image format, or one that is not UTF-8."""
    text_name(file.absolute())
    require_suffix(file, _FORMATS, "an image name")


def check_writable(path: str | Path, dtype: np.dtype[Any], channels: int) -> None:
    """Refuse, before any work is done, an image that its format cannot store."""
    file = Path(path)
    check_image_name(file)
    suffix = file.suffix.lower()
    if channels not in _CHANNELS:
        raise FormatError(f"{file}: expected 1 to {_LARGEST_CHANNELS} channels, got {channels}")
    if suffix in _JPEG and channels in (2, 4):
        raise FormatError(f"{file}: JPEG holds no alpha, got {channels} channels. Write a PNG.")
    if str(dtype) not in _FORMATS[suffix]:
        others = [other for other, types in _FORMATS.items() if str(dtype) in types]
        bits = " or ".join(str(bits) for bits in (8, 16, 32) if str(pixel_type(bits, suffix)) in _FORMATS[suffix])
        remedy = f"Write {' or '.join(others)}, or choose {bits} bits" if others else f"Choose {bits} bits"
        raise FormatError(f"{file}: {suffix} holds {' or '.join(_FORMATS[suffix])}, got {dtype} pixels. {remedy}.")


def read_texture(path: str | Path) -> Image | dict[int, Image]:
    """Read a texture: an image, or all tiles by UDIM number if the name has ``<UDIM>``."""
    files = tile_files(path)
    if UDIM_MARK not in with_udim_mark(Path(path)).name:
        return read_image(files[FIRST_TILE])
    return {number: read_image(tile) for number, tile in files.items()}


def with_udim_mark(path: Path) -> Path:
    """A path with ``<udim>`` or ``%(UDIM)d`` (the forms of some programs) replaced by ``<UDIM>``."""
    return path.with_name(_UDIM_MARKS.sub(UDIM_MARK, path.name)) if path.name else path


def tile_files(path: str | Path) -> dict[int, Path]:
    """Files of a texture by UDIM number; a single image is the first tile."""
    tiles = _tiles(path)
    if not tiles:
        first = udim_path(path, FIRST_TILE)
        raise FormatError(f"{path}: expected tiles such as {first}, found none. Check the name.")
    return tiles


def texture_files(path: str | Path) -> list[Path]:
    """Files that `read_texture` reads."""
    return list(_tiles(path).values())


def _tiles(path: str | Path) -> dict[int, Path]:
    file = with_udim_mark(Path(path))
    if UDIM_MARK not in file.name:
        return {FIRST_TILE: file}
    before, after = file.name.split(UDIM_MARK, 1)
    pattern = re.compile(re.escape(before) + r"(1\d{3})" + re.escape(after) + r"\Z")
    names = sorted(entry.name for entry in file.parent.iterdir()) if file.parent.is_dir() else []
    return {int(match[1]): file.parent / entry for entry in names if (match := pattern.match(entry))}


def udim_path(path: str | Path, tile: int) -> Path:
    """File of a tile: its number in place of ``<UDIM>`` or 1001, or before the suffix; no change for tile 0.

    Examples
    --------
    >>> [udim_path(name, 1002).name for name in ("skin.<UDIM>.png", "skin.1001.png", "skin.png")]
    ['skin.1002.png', 'skin.1002.png', 'skin.1002.png']
    >>> udim_path("skin.png", 0).name
    'skin.png'
    """
    file = as_tile_set(path)
    if UDIM_MARK in file.name:
        return file.with_name(file.name.replace(UDIM_MARK, str(tile or FIRST_TILE)))
    return file if tile == 0 else file.with_name(f"{file.stem}.{tile}{file.suffix}")


def tile_pattern(path: str | Path) -> Path:
    """The pattern of all files of `udim_path`, with ``<UDIM>`` in place of the tile's number."""
    file = as_tile_set(path)
    return file if UDIM_MARK in file.name else file.with_name(f"{file.stem}.{UDIM_MARK}{file.suffix}")


def as_tile_set(path: str | Path) -> Path:
    """A path with ``<UDIM>`` in place of the first tile's number, 1001, or of other programs' marks."""
    file = with_udim_mark(Path(path))
    return file if UDIM_MARK in file.name or not file.name else file.with_name(_FIRST_NUMBER.sub(UDIM_MARK, file.name))


def set_of_tile(path: Path) -> Path:
    """The pattern of the set that a tile such as ``skin.1001.png`` belongs to; the path itself without such a name."""
    return path.with_name(re.sub(r"(?<!\d)1\d{3}(?=\.\w+\Z)", UDIM_MARK, path.name))


def first_image(texture: Image | Mapping[int, Image]) -> Image:
    """The image, or that of the first tile; all tiles have the same pixel type and channels."""
    return texture if isinstance(texture, Image) else next(iter(texture.values()))


def texture_pixels(texture: Image | Mapping[int, Image]) -> Pixels | dict[int, Pixels]:
    """The pixels of an image or of tiles, as the bakes of `cagemap.transfer` take them."""
    if isinstance(texture, Image):
        return texture.pixels
    return {tile: image.pixels for tile, image in texture.items()}


def pixel_type(bits: int, suffix: str) -> np.dtype[Any]:
    """Number type for bits of a channel: 8 and 16 are integers (16 in EXR: half float), 32 is float."""
    names = {8: "uint8", 16: "float16" if suffix.lower() == ".exr" else "uint16", 32: "float32"}
    if bits not in names:
        raise FormatError(f"bits: expected 8, 16 or 32 a channel, got {bits}. Choose one of them.")
    return np.dtype(names[bits])


def _reason(message: str) -> str:
    """A library's error message as one line with a full stop."""
    text = " ".join(str(message).split())
    if "could not find a format reader" in text:  # the library then asks whether it knows the format
        text = "it has another format"
    return (text or "no reason given").rstrip(".") + "."
