"""Check of binary USD layers (crates) before they are opened: USD allocates as much memory as damaged ones state."""

from __future__ import annotations

import struct
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
    """Refuse a crate whose sections state more numbers than their bytes can hold; other files pass."""
    header = read_bytes(file, "a USD file", 11)
    if not header.startswith(_START) or tuple(header[8:]) < _OLDEST:
        return
    content = read_bytes(file, "a USD file")
    try:
        (place,) = struct.unpack_from("<Q", content, 16)
        (count,) = struct.unpack_from("<Q", content, place)
        for number in range(min(count, len(content))):
            name, start, size = struct.unpack_from("<16sQQ", content, place + 8 + 32 * number)
            counts, blocks = _SECTIONS.get(name.rstrip(b"\0"), (0, 0))
            _check_section(content[start : start + size], size, counts, blocks)
    except struct.error:
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
