"""Helpers for text formats: reading files as text, and messages that name a line."""

from __future__ import annotations

import errno
import os
import stat
import tomllib
import unicodedata
from collections.abc import Collection, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from cagemap.errors import FormatError, MissingFileError


def require_file(path: Path, what: str) -> None:
    """Refuse a path that is not a regular file, since a library would wait for data from a pipe."""
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        raise MissingFileError(
            f"{path}: expected {what}, there is no such file. Check the name and the folder."
        ) from None
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from None
    if stat.S_ISDIR(mode):
        raise FormatError(f"{path}: expected {what}, got a folder. Name a file inside it.")
    if not stat.S_ISREG(mode):
        raise FormatError(f"{path}: expected {what}, got a device or a pipe. Save it to a file first.")
    if not os.access(path, os.R_OK):
        raise _unreadable(path, PermissionError(errno.EACCES, os.strerror(errno.EACCES)))


def require_suffix(
    path: Path, suffixes: Collection[str], what: str = "a name", remedy: str = "Give another name."
) -> None:
    """Refuse the name of a file that ends in none of the suffixes."""
    if path.suffix.lower() not in suffixes:
        got = "a folder" if os.path.isdir(path) else path.suffix.lower() or "no suffix"
        endings = " or ".join(", ".join(suffixes).rsplit(", ", 1))
        raise FormatError(f"{path}: expected {what} ending in {endings}, got {got}. {remedy}")


def _unreadable(path: Path, error: Exception) -> FormatError:
    return FormatError(f"{path}: cannot be read ({error}). Check its permissions.")


def read_bytes(path: Path, what: str, size: int = -1) -> bytes:
    """Read a file, or its first bytes; if it is missing, unreadable or empty, the FormatError says so."""
    require_file(path, what)
    try:
        with path.open("rb") as file:
            content = file.read(size)
    except OSError as error:
        raise _unreadable(path, error) from None
    if not content.strip():
        raise FormatError(f"{path}: expected {what}, got an empty file. Export it again.")
    return content


def read_text(path: Path, what: str) -> str:
    r"""Read a text file, with ``\n`` as line ends.

    A file that is not UTF-8 (old exporters' accented material names) is read as Latin-1, which never fails and keeps
    the numbers.
    """
    return decode_text(read_bytes(path, what), path, what)


def decode_text(content: bytes, path: Path, what: str) -> str:
    """Decode a file's content as `read_text` does; ``path`` is used in messages."""
    if b"\0" in content:
        raise FormatError(
            f"{path}: expected {what}, which is plain text, got binary data or UTF-16. Export it again as text (UTF-8)."
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def whole_characters(text: str) -> str:
    """A text without lone surrogates, which JSON and file names may have but nothing can write."""
    return text.encode("utf-8", "replace").decode()


def read_toml(path: Path, what: str) -> tuple[str, dict[str, Any]]:
    """Text and table of a TOML file; errors name the file."""
    require_file(path, what)
    try:
        text = path.read_bytes().decode("utf-8-sig")
        return text, tomllib.loads(text)
    except RecursionError:
        raise FormatError(
            f"{path}: expected a TOML file, got brackets within brackets without end. Write it again."
        ) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise FormatError(f"{path}: expected a TOML file, got a mistake in it: {error}. Correct it.") from None


def make_distinct(names: Sequence[str]) -> tuple[str, ...]:
    """Unique names: repeated ones get a number appended, which gives none of the other names."""
    given, used, counts = set(names), set[str](), dict[str, int]()
    unique = []
    for name in names:
        word = name
        while word in used or (word != name and word in given):
            counts[name] = counts.get(name, 1) + 1
            word = f"{name}_{counts[name]}"
        used.add(word)
        unique.append(word)
    return tuple(unique)


def file_in(folder: Path, name: str) -> Path:
    """The path of a name in a folder; its accents as the disk has them, composed or decomposed."""
    forms = (name, unicodedata.normalize("NFC", name), unicodedata.normalize("NFD", name))
    # Unlike `Path.is_file`, false for names that are too long.
    return next((folder / form for form in forms if os.path.isfile(folder / form)), folder / name)


def find_image(path: Path, stated: str) -> Path | None:
    """The image that a file names, searched in the file's folder and below; None if missing. Links are followed."""
    name = PurePosixPath(stated.replace("\\", "/").replace("\0", ""))
    folder = Path(os.path.abspath(path.parent))
    for place in (name, name.name, f"textures/{name.name}", f"{path.stem}.fbm/{name.name}"):
        full = Path(os.path.normpath(folder / place))
        for parent in (folder, folder.resolve()):
            file = file_in(parent, str(full.relative_to(parent))) if full.is_relative_to(parent) else parent
            if name.name and os.path.isfile(file):
                return file
    return None


def text_name(path: Path) -> str:
    """The name of a file for a library that needs UTF-8 text."""
    name = str(path)
    if whole_characters(name) != name:
        raise FormatError(
            f"{path}: expected a name that is text (UTF-8), which images and USD files need, got bytes that are none. "
            "Rename the file or its folder."
        )
    return name


def is_number(word: str | bytes) -> bool:
    """Whether a word is a number, NaN or infinity."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def at_line(path: Path, number: int, expected: str, got: str, remedy: str) -> str:
    """Message about one line of a file, which is cut to 80 characters."""
    shown = got if len(got) <= 80 else got[:77] + "..."
    return f"{path}, line {number}: expected {expected}, got '{shown}'. {remedy}"


def check_writable_name(name: str) -> None:
    """Refuse a name that cannot be written on one line of a text file."""
    if name != name.strip() or any(character in name for character in "\r\n\t\0") or name.endswith("\\"):
        raise FormatError(
            f"the name {name!r}: expected no line breaks, no tabs, no blanks at its ends and no backslash at its end, "
            "which a text file cannot hold. Rename this material, object or group."
        )


def flatten_entries(prefix: str, value: Any) -> dict[str, Any]:
    """Nested dicts as one dict; names are joined by dots."""
    if not isinstance(value, dict):
        return {prefix: value}
    entries: dict[str, Any] = {}
    for name, entry in value.items():
        entries |= flatten_entries(f"{prefix}.{name}" if prefix else name, entry)
    return entries
