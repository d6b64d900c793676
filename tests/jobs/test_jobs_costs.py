"""What `--dry-run` says of time, memory and disk, against figures that were measured (benchmarks.library.growth)."""

import json

import pytest

from cagemap.jobs.costs import COSTS, ERROR_FACTOR, result_bytes, surface_bytes, task_seconds, worker_memory

from locations import ROOT

ROWS = json.loads((ROOT / "benchmarks" / "results" / "growth.json").read_text())
STAGES = [(row, stage) for row in ROWS for stage in row["seconds"]]


def near(estimate: float, measured: float) -> bool:
    return measured / ERROR_FACTOR <= estimate <= measured * ERROR_FACTOR


def sizes_of(row: dict) -> list[tuple[int, int]]:
    return list(zip(row["control"], row["finest"], strict=True))


@pytest.mark.parametrize(("row", "stage"), STAGES, ids=[f"{r['target'][:5]}-{r['asked']}-{s}" for r, s in STAGES])
def test_seconds_are_within_the_stated_factor(row: dict, stage: str) -> None:
    kind, _, side = stage.partition(" ")
    texels = int(side) ** 2 if side else 0
    sizes = sizes_of(row)
    if kind == "prepare":
        estimate = sum(task_seconds(kind, [size]) for size in sizes)
    else:
        estimate = task_seconds(kind, sizes, landmarks=bool(row["landmarks"]), texels=texels)
    assert near(estimate, row["seconds"][stage])


@pytest.mark.parametrize("row", ROWS, ids=[f"{row['target'][:5]}-{row['asked']}" for row in ROWS])
def test_memory_and_disk_are_within_the_stated_factor(row: dict) -> None:
    sizes = sizes_of(row)
    assert near(worker_memory(sizes), row["memory_bytes"])
    assert near(result_bytes(sizes), row["result_bytes"])
    stored = sum(surface_bytes(size, count) for size, count in zip(sizes, row["prepared"], strict=True))
    assert near(stored, row["store_bytes"])


def test_more_of_anything_takes_no_less() -> None:
    for kind in COSTS:
        small, large = task_seconds(kind, [(300, 20_000)]), task_seconds(kind, [(3000, 200_000)])
        assert small <= large
    assert task_seconds("match", [(300, 20_000)], landmarks=False) > task_seconds("match", [(300, 20_000)])
    assert task_seconds("transfer", [(300, 20_000)], texels=4096**2) > task_seconds("transfer", [(300, 20_000)])
