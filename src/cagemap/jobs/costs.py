"""Cost of tasks: processor seconds, memory and disk space, from measured growth.

Fitted by hand to `benchmarks.library.growth` (results in benchmarks/results/growth.json, table in docs/lab/jobs.md); a
test keeps them within `FACTOR` of every figure there. Other machines differ by their speed as a whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

# Estimates are within this factor of what was measured, either way.
FACTOR = 2.0
# Processor seconds that a new worker takes to import, and to read its compiled code.
STARTUP = 5.0
# What a match without landmarks takes in addition: constant, per 1000 control vertices.
SEARCH = (6.0, 0.4)
# Vertices of the level that a surface is prepared on, and bytes that each of them has in the store (100 functions).
PREPARED, STORED = 20_000, 400
# Bytes of a RESULT for every finest vertex of both surfaces, and of a picture on the page.
RESULT, PICTURE = 105, 14_000
# Bytes of memory of a worker: constant, per finest vertex and per control vertex of both surfaces.
MEMORY = (500_000_000, 3_000, 20_000)

Size = tuple[int, int]


@dataclass(frozen=True)
class Cost:
    """Processor seconds of one kind of task.

    Attributes
    ----------
    constant : float
    control, finest : float
        Per 1000 control and per 1000 finest vertices of all surfaces that it reads.
    texels : float
        Per million texels that it writes.
    """

    constant: float
    control: float = 0.0
    finest: float = 0.0
    texels: float = 0.0


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
    """Processor seconds of a task.

    Parameters
    ----------
    kind : str
        Of the task.
    sizes : sequence of (int, int)
        Control and finest vertices of the surfaces that it reads.
    landmarks : bool
        Whether a match has them.
    texels : int
        That it writes.
    """
    cost = COSTS[kind]
    control, finest = (sum(size[i] for size in sizes) / 1000 for i in (0, 1))
    search = 0.0 if landmarks or kind != "match" else SEARCH[0] + SEARCH[1] * control
    return cost.constant + cost.control * control + cost.finest * finest + cost.texels * texels / 1e6 + search


def worker_memory(sizes: Sequence[Size]) -> float:
    """Bytes of memory of a worker that has two surfaces of these sizes before it."""
    constant, finest, control = MEMORY
    return constant + sum(control * size[0] + finest * size[1] for size in sizes)


def stored_surface(size: Size, prepared: int) -> float:
    """Bytes of a prepared surface in the store; ``prepared`` vertices at the level that its basis ends on."""
    return STORED * min(prepared, size[1])


def stored_result(sizes: Sequence[Size]) -> float:
    """Bytes of a RESULT and its picture."""
    return PICTURE + RESULT * sum(size[1] for size in sizes)
