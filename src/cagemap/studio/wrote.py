"""The line by which a command tells the studio that runs it what it wrote."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

_BEFORE = "cagemap wrote: "


def wrote_line(files: Iterable[Path]) -> str:
    """Files as a line."""
    return f"{_BEFORE}{json.dumps([str(file.resolve()) for file in files])}"


def files_wrote(line: str) -> tuple[Path, ...] | None:
    """Files of such a line; None if it is another."""
    head, told, listed = line.partition(_BEFORE)
    return tuple(map(Path, json.loads(listed))) if told and not head else None
