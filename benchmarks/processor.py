"""Processor time of other processes, as Linux tells it: what a wait costs on a machine that others use too."""

from __future__ import annotations

import os
from pathlib import Path


def children_time() -> float:
    """Processor time of the processes that this one started and theirs, as far as they run."""
    ours = {os.getpid()}
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            parents[int(entry.name)] = (int(fields[1]), int(fields[11]) + int(fields[12]))
    grown = True
    while grown:
        more = {pid for pid, (parent, _) in parents.items() if parent in ours} - ours
        ours |= more
        grown = bool(more)
    ticks = sum(parents[pid][1] for pid in ours - {os.getpid()} if pid in parents)
    return ticks / os.sysconf("SC_CLK_TCK")
