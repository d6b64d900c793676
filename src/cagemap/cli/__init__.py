"""The command ``cagemap``: options in, tasks called, messages out."""

from __future__ import annotations

from cagemap.cli.entry import main

__all__ = ["main"]
