"""The command line ``cagemap``: options to requests, tasks, messages."""

from __future__ import annotations

from cagemap.cli.entry import main

__all__ = ["main"]
