"""Processor time of other processes, as Linux tells it: what a wait costs on a machine that others use too."""

from __future__ import annotations

import os
from pathlib import Path


def children_time() -> float:
    """Processor time of the processes that this one started and theirs."""
    return tree_time(os.getpid()) - sum(os.times()[:2])


def tree_time(root: int) -> float:
    """Processor time of a process and its descendants, with those that have ended and were waited for."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            parents[int(entry.name)] = (int(fields[1]), sum(map(int, fields[11:15])))
    tree, grown = {root}, True
    while grown:
        more = {pid for pid, (parent, _) in parents.items() if parent in tree} - tree
        tree |= more
        grown = bool(more)
    return sum(parents[pid][1] for pid in tree if pid in parents) / os.sysconf("SC_CLK_TCK")
