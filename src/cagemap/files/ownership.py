"""Checksum marks in files: whether cagemap wrote a file, and whether it was changed since.

A writer puts `mark` where its format stores text: a comment in OBJ, MTL, PLY and zip archives (NPZ), a key in JSON, the
``generator`` of HTML, the ``Software`` of images. `cagemap.files.atomic` then calls `seal`.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cagemap import __version__

_DIGITS = 64
_BLANK = b"0" * _DIGITS
MARKED = "written by cagemap"
_MARK = re.compile(MARKED.encode() + rb" [^\s,]{1,40}, checksum ([0-9a-f]{64})")
# Bytes at the start and at the end of a file in which a mark is searched; every format has it there.
_SEARCHED = 2**16

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_END = 12  # the empty chunk IEND
_ZIP = b"PK\x03\x04"
_ZIP_END = struct.Struct("<4s4H2LH")  # the record at a zip file's end


def mark() -> str:
    """The mark for a file that is being written, with zeros in place of the checksum."""
    return f"{MARKED} {__version__}, checksum {_BLANK.decode()}"


def seal(path: Path) -> None:
    """Fill in the checksum of a file's mark; a PNG gets the mark in a chunk of its own.

    Files without a mark are not changed.
    """
    if path.stat().st_size == 0:
        return
    with path.open("rb+") as stream:
        if stream.read(len(_PNG)) == _PNG:
            stream.seek(-_PNG_END, os.SEEK_END)
            end = stream.read()
            stream.seek(-_PNG_END, os.SEEK_END)
            body = b"tEXtComment\0" + mark().encode()
            stream.write(struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body)) + end)
            stream.flush()
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            place = _find(data)
            if place is None:
                return
            filled = _checksum(data, place)
            if data[: len(_PNG)] == _PNG:  # the chunk's own checksum follows
                chunk = data[data.rfind(b"tEXtComment\0", 0, place) : place] + filled
                filled += struct.pack(">I", zlib.crc32(chunk))
        # Not through the memory map: on a full disk that ends the process.
        stream.seek(place)
        stream.write(filled)


def stated_checksum(path: Path) -> str | None:
    """The checksum in a file's mark, right or not; None without a mark."""
    with _map_content(path) as data:
        place = _find(data)
        return None if place is None else data[place : place + _DIGITS].decode()


def is_own(path: Path) -> bool:
    """Whether cagemap wrote a file and nobody has changed it since."""
    with _map_content(path) as data:
        place = _find(data)
        return place is not None and data[place : place + _DIGITS] == _checksum(data, place)


@contextmanager
def _map_content(path: Path) -> Iterator[mmap.mmap | bytes]:
    """The content of a file; empty if there is none."""
    if not path.is_file() or path.stat().st_size == 0:
        yield b""
        return
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        yield data


def _find(data: mmap.mmap | bytes) -> int | None:
    """Position in the file of its mark's checksum; None without a mark. Members of a zip archive have their own."""
    head = _zip_directory(data)
    for start in dict.fromkeys((head, max(head, len(data) - _SEARCHED))):
        match = _MARK.search(data[start : start + _SEARCHED])
        if match:
            return start + match.start(1)
    return None


def _checksum(data: mmap.mmap | bytes, place: int) -> bytes:
    """SHA-256 of a file without the checksum itself, in hexadecimal; of a zip archive of its directory alone."""
    view = memoryview(data)
    try:
        # In a PNG the four bytes after the mark depend on it and are left out.
        following = place + _DIGITS + (4 if view[: len(_PNG)] == _PNG else 0)
        digest = hashlib.sha256(view[_zip_directory(data) : place])
        digest.update(view[following:])
    finally:
        view.release()
    return digest.hexdigest().encode()


def _zip_directory(data: mmap.mmap | bytes) -> int:
    """Start of the directory of a zip archive; 0 for other files."""
    if data[: len(_ZIP)] != _ZIP:
        return 0
    end = data.rfind(b"PK\x05\x06")
    if end < 0 or end + _ZIP_END.size > len(data):
        return 0
    return int(max(0, end - _ZIP_END.unpack_from(data, end)[5]))
