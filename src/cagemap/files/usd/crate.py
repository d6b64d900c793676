"""Check of binary USD layers (crates) before they are opened: USD allocates as much memory as damaged ones state."""

from __future__ import annotations

import struct
import zipfile
from contextlib import suppress
from pathlib import Path

from cagemap.errors import FormatError
from cagemap.files.text import read_bytes

_START, _OLDEST = b"PXR-USDC", (0, 4, 0)  # earlier versions do not compress
# Whole numbers that a section begins with, and compressed blocks behind, each after its length.
_SECTIONS = {
    b"TOKENS": (2, 1),
    b"STRINGS": (1, 0),
    b"FIELDS": (1, 2),
    b"FIELDSETS": (1, 1),
    b"PATHS": (2, 3),
    b"SPECS": (1, 3),
}
_MAX_NUMBERS_PER_BYTE = 16 * 255  # of a compressed block: 2 bits for a number, then LZ4


def check_crate(file: Path) -> None:
    """Refuse a crate whose sections or arrays state more numbers than they hold.

    The crates of a package (.usdz) are checked too; other files pass.
    """
    header = read_bytes(file, "a USD file", 11)
    if header.startswith(_START):
        _check(file, read_bytes(file, "a USD file"))
    elif header.startswith(b"PK"):
        with suppress(zipfile.BadZipFile), zipfile.ZipFile(file) as package:
            for entry in package.infolist():
                if entry.flag_bits & 1:
                    raise FormatError(f"{file}: expected a package without encryption, got one. Export it again.")
                if entry.compress_type == zipfile.ZIP_STORED and entry.filename.lower().endswith((".usd", ".usdc")):
                    _check(file, package.read(entry))


def _check(file: Path, content: bytes) -> None:
    if not content.startswith(_START) or tuple(content[8:11]) < _OLDEST:
        return
    try:
        (place,) = struct.unpack_from("<Q", content, 16)
        (count,) = struct.unpack_from("<Q", content, place)
        for number in range(min(count, len(content))):
            name, start, size = struct.unpack_from("<16sQQ", content, place + 8 + 32 * number)
            counts, blocks = _SECTIONS.get(name.rstrip(b"\0"), (0, 0))
            section = content[start : start + size]
            _check_section(section, size, counts, blocks)
            if name.startswith(b"FIELDS\0"):
                _check_arrays(content, _field_values(section))
    except (struct.error, IndexError):
        raise FormatError(f"{file}: cannot be read as USD (its sections are damaged). Export it again.") from None


def _check_section(section: bytes, size: int, counts: int, blocks: int) -> None:
    """Raise `struct.error` for a section that is shorter than its ``size``, or than its numbers need."""
    stated = struct.unpack_from(f"<{counts}Q", section)
    if len(section) < size or any(number > _MAX_NUMBERS_PER_BYTE * size for number in stated):
        raise struct.error
    end = 8 * counts
    for _ in range(blocks):
        (length,) = struct.unpack_from("<Q", section, end)
        end += 8 + length
        if end > size:
            raise struct.error


# Of the 64 bits that describe a value: an array, a compressed one; the others are its type, and its place in the file.
_ARRAY, _INLINED, _COMPRESSED, _TYPE_SHIFT, _PLACE = 1 << 63, 1 << 62, 1 << 61, 48, (1 << 48) - 1
_FLOATS = {7: 2, 8: 4, 9: 8}  # bytes of half, float and double
_TIME_SAMPLES = 46
_LISTS = (31, 40, 41, 45, 48, 49, 50)  # dictionaries and lists, which begin with their length
_EDITS = (*range(32, 40), 55)  # edits of lists: a byte of flags, the first of them without a list, then lists
_LEAST_COMPRESSED = 16  # shorter arrays are written as they are


def _field_values(section: bytes) -> list[int]:
    """Descriptions of all values, from the second compressed block of the section FIELDS."""
    (count, first) = struct.unpack_from("<QQ", section)
    (length,) = struct.unpack_from("<Q", section, 16 + first)
    block = section[24 + first :][:length]
    if not count or block[0]:  # several chunks, from 2 GB on
        return []
    return list(struct.unpack_from(f"<{count}Q", _decompress_lz4(block[1:], 8 * count)))


def _decompress_lz4(block: bytes, size: int) -> bytes:
    """The first ``size`` bytes, or a few more, of a block of LZ4."""
    content, place = bytearray(), 0

    def length(short: int) -> int:
        nonlocal place
        total, more = short, 255 if short == 15 else 0
        while more == 255:
            more = block[place]
            total, place = total + more, place + 1
        return total

    while place < len(block) and len(content) < size:
        token = block[place]
        place += 1
        literals = length(token >> 4)
        content += block[place : place + literals]
        place += literals
        if place < len(block):
            (back,) = struct.unpack_from("<H", block, place)
            place += 2
            copied = min(length(token & 15) + 4, size - len(content))
            if not 0 < back <= len(content):
                raise struct.error
            content += (content[-back:] * (copied // back + 1))[: max(copied, 0)]
    return bytes(content)


def _check_arrays(content: bytes, values: list[int]) -> None:
    """Raise `struct.error` for arrays, also in time samples, and lists that state too many elements."""
    version, end = tuple(content[8:11]), len(content)
    for value in values:
        place, kind = value & _PLACE, value >> _TYPE_SHIFT & 0xFF
        if kind == _TIME_SAMPLES:
            place += struct.unpack_from("<q", content, place)[0]
            (times,) = struct.unpack_from("<Q", content, place)
            place += 8 + struct.unpack_from("<q", content, place + 8)[0]
            (count,) = struct.unpack_from("<Q", content, place)
            samples = struct.unpack_from(f"<{min(count, end)}Q", content, place + 8)
            _check_arrays(content, [one for one in (times, *samples) if one >> _TYPE_SHIFT & 0xFF != _TIME_SAMPLES])
        if not place:  # nothing is stored elsewhere, as of empty arrays
            continue
        if not value & _INLINED and (kind in _LISTS or kind in _EDITS):
            after = kind in _EDITS
            (count,) = struct.unpack_from("<Q", content, place + after)
            if count > end and not (after and content[place] <= 1):
                raise struct.error
        if not value & _ARRAY:
            continue
        place += 0 if version >= (0, 5, 0) else 4  # the rank
        (count,) = struct.unpack_from("<Q" if version >= (0, 7, 0) else "<I", content, place)
        place += 8 if version >= (0, 7, 0) else 4
        most = end - place
        if value & _COMPRESSED and count >= _LEAST_COMPRESSED:
            if kind in _FLOATS:
                code, place = content[place : place + 1], place + 1
                if code == b"t":  # a table of the different values
                    place += 4 + _FLOATS[kind] * struct.unpack_from("<I", content, place)[0]
            (size,) = struct.unpack_from("<Q", content, place)
            most = _MAX_NUMBERS_PER_BYTE * min(size, most)
        if count > most:
            raise struct.error
