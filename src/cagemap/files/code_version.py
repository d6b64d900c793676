"""Version of the code, so that results stored by other code are not reused."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable

from cagemap import __version__


@cache  # the code that runs is that of the start
def code_version() -> str:
    """Version of the package and 16 hexadecimal digits that change with any of its Python files."""
    digest = hashlib.sha256()
    for name, content in _sources(resources.files("cagemap"), ""):
        digest.update(f"{name}:{len(content)};".encode())
        digest.update(content)
    return f"{__version__}+{digest.hexdigest()[:16]}"


def _sources(folder: Traversable, prefix: str) -> list[tuple[str, bytes]]:
    """Name and content of the Python files below a folder, in the order of their names."""
    found: list[tuple[str, bytes]] = []
    for entry in sorted(folder.iterdir(), key=lambda item: item.name):
        if entry.is_dir():
            found += _sources(entry, f"{prefix}{entry.name}/")
        elif entry.name.endswith(".py"):
            found.append((prefix + entry.name, entry.read_bytes()))
    return found
