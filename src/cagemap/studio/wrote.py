"""What passes between the studio and the process that runs its commands: a line a command, and one at its end."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

_BEFORE = "cagemap ended: "


def command_line(words: Iterable[str]) -> str:
    """A command as a line."""
    return json.dumps(list(words))


def words_of(line: str) -> list[str]:
    """The command of such a line."""
    return list(map(str, json.loads(line)))


def ended_line(code: int, files: Iterable[Path]) -> str:
    """A command's exit code, and the files that it wrote, as a line."""
    return f"{_BEFORE}{json.dumps([code, *(str(file.resolve()) for file in files)])}"


def ended(line: str) -> tuple[int, tuple[Path, ...]] | None:
    """Exit code and files of such a line; None if it is another."""
    head, told, listed = line.partition(_BEFORE)
    if not told or head:
        return None
    code, *files = json.loads(listed)
    return int(code), tuple(map(Path, files))
