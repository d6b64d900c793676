"""The command ``cagemap``: words in, calls of the library, words out."""

from __future__ import annotations

from cagemap.cli.entry import main

__all__ = ["main"]
