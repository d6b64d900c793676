"""Shared by text formats: reading a file as text, and messages that name a line."""

from __future__ import annotations

import stat
from pathlib import Path

from cagemap.errors import FormatError


def require_file(path: Path, what: str) -> None:
    """Refuse a name that is no file's, before a library waits for a pipe to be written to."""
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        raise FormatError(f"{path}: expected {what}, there is no such file. Check the name and the folder.") from None
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from None
    if stat.S_ISDIR(mode):
        raise FormatError(f"{path}: expected {what}, got a folder. Name a file inside it.")
    if not stat.S_ISREG(mode):
        raise FormatError(f"{path}: expected {what}, got a device or a pipe. Save it to a file first.")


def _unreadable(path: Path, error: Exception) -> FormatError:
    return FormatError(f"{path}: cannot be read ({error}). Check its permissions.")


def read_bytes(path: Path, what: str) -> bytes:
    """Read a whole file; a missing, unreadable or empty one is a FormatError that says which."""
    require_file(path, what)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise _unreadable(path, error) from None
    if not content.strip():
        raise FormatError(f"{path}: expected {what}, got an empty file. Export it again.")
    return content


def read_text(path: Path, what: str) -> str:
    r"""Read a text file with line ends made ``\n``.

    UTF-8 is expected; a file that is not (an old exporter's accented material names) is read byte by byte as Latin-1,
    which never fails and leaves the numbers alone.
    """
    return decoded(read_bytes(path, what), path, what)


def decoded(content: bytes, path: Path, what: str) -> str:
    """The text of a file's content, see `read_text`; the path is for messages."""
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
    """A text without halves of characters, which JSON and names of files may hold and nothing can show or write."""
    return text.encode("utf-8", "replace").decode()


def text_name(path: Path) -> str:
    """The whole name of a file for a library that takes text."""
    name = str(path)
    if whole_characters(name) != name:
        raise FormatError(
            f"{path}: expected a name that is text (UTF-8), which images and USD files need, got bytes that are none. "
            "Rename the file or its folder."
        )
    return name


def is_number(word: str | bytes) -> bool:
    """Whether a word is one, also NaN or infinity."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def at_line(path: Path, number: int, expected: str, got: str, remedy: str) -> str:
    """Message about one line of a file; what was found is cut to a readable length."""
    shown = got if len(got) <= 80 else got[:77] + "..."
    return f"{path}, line {number}: expected {expected}, got '{shown}'. {remedy}"


def check_writable_name(name: str) -> None:
    """Refuse a name that cannot stand on one line of a text file."""
    if name != name.strip() or any(character in name for character in "\r\n\0") or name.endswith("\\"):
        raise FormatError(
            f"material name {name!r}: expected no line breaks, no blanks at its ends and no backslash at "
            "its end, which a text file cannot hold. Rename the material."
        )
