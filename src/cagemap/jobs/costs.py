"""Estimated cost of tasks: processor seconds, memory and disk space.

Fitted by hand to `benchmarks.library.growth` (results in benchmarks/results/growth.json, table in docs/lab/jobs.md); a
test keeps them within `ERROR_FACTOR` of every figure there. Other machines differ by a constant factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

# Estimates are at most this factor above or below measurements.
ERROR_FACTOR = 2.0
# Processor seconds of a new worker for imports and compiled code.
STARTUP_SECONDS = 5.0
# Additional seconds of a match without landmarks: constant, per 1000 control vertices.
SEARCH_SECONDS = (6.0, 0.4)
# Vertices of the level that a surface is prepared on, and stored bytes for each (100 functions).
PREPARED_VERTICES, VERTEX_BYTES = 20_000, 300
# Bytes of a RESULT for every finest vertex of both surfaces, and of a picture.
RESULT_VERTEX_BYTES, PICTURE_BYTES = 105, 14_000
# Bytes of memory of a worker: constant, per finest vertex and per control vertex of both surfaces.
MEMORY_BYTES = (500_000_000, 3_000, 20_000)

Size = tuple[int, int]


@dataclass(frozen=True)
class Cost:
    """Processor seconds of one kind of task."""

    constant: float
    # `control`, `finest`: per 1000 control and per 1000 finest vertices of all surfaces read
    control: float = 0.0
    finest: float = 0.0
    texels: float = 0.0  # per million texels written


COSTS = {
    "prepare": Cost(0.4, 0.03, 0.0008),
    "match": Cost(2.5, 0.12, 0.0025),
    "compose": Cost(0.5, 0.0, 0.004),
    "carry": Cost(0.3, 0.0, 0.0015),
    "picture": Cost(0.3, 0.0, 0.0025),
    "transfer": Cost(0.3, 0.0, 0.004, 0.3),
    "wrap": Cost(0.5, 0.3, 0.003),
    "report": Cost(2.7, 0.0, 0.0038),
}


def task_seconds(kind: str, sizes: Sequence[Size], *, landmarks: bool = True, texels: int = 0) -> float:
    """Processor seconds of a task that reads surfaces of these sizes and writes so many texels."""
    cost = COSTS[kind]
    control, finest = (sum(size[i] for size in sizes) / 1000 for i in (0, 1))
    search_seconds = 0.0 if landmarks or kind != "match" else SEARCH_SECONDS[0] + SEARCH_SECONDS[1] * control
    return cost.constant + cost.control * control + cost.finest * finest + cost.texels * texels / 1e6 + search_seconds


def worker_memory(sizes: Sequence[Size]) -> float:
    """Bytes of memory of a worker that processes two surfaces of these sizes."""
    constant, finest, control = MEMORY_BYTES
    return constant + sum(control * size[0] + finest * size[1] for size in sizes)


def surface_bytes(size: Size, prepared: int) -> float:
    """Stored bytes of a surface whose basis is on a level of ``prepared`` vertices."""
    return VERTEX_BYTES * min(prepared, size[1])


def result_bytes(sizes: Sequence[Size]) -> float:
    """Bytes of a RESULT and its picture."""
    return PICTURE_BYTES + RESULT_VERTEX_BYTES * sum(size[1] for size in sizes)
