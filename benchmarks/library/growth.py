"""``python -m benchmarks.library.growth``: processor seconds, memory and bytes of every stage of a job, by size.

Each pair in a process of its own, on one thread, its compiled code already read. `cagemap.jobs.costs` is fitted to
the figures, and a test compares them. Rows that are there are not measured again.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.data import DATA
from cagemap.example import example_pair
from cagemap.files.images.image import write_image
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.files.meshes.formats import read_mesh
from cagemap.files.result.folder import read_result, write_result
from cagemap.files.result.surface_store import load_or_prepare
from cagemap.numerics.threads import thread_limit
from cagemap.pipeline import MAP_BASIS, choose_level, match
from cagemap.report import draw_thumbnail, write_report
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer
from cagemap.tasks.wrap import WrapRequest, run_wrap

RESULTS = Path(__file__).resolve().parents[1] / "results" / "growth.json"
HUMANS = DATA / "humans"
FIRST = ("male1591_female_old_heavy", "female1605_male_young", "female1605__male1591_fps14")
HEAVY = ("soma18056_female_old_heavy", "base_male_young", "base__soma18056_fps14")
CASES = [
    (*FIRST, 25_000),
    (*FIRST, 100_000),
    (*FIRST, 400_000),
    (*FIRST[:2], "", 25_000),
    (*HEAVY, 100_000),
    ("base_female_old_heavy", "female1605_male_young", "", 100_000),
]


def measured(target: str, source: str, landmarks: str, vertices: int) -> dict[str, Any]:
    """Seconds by stage, sizes and bytes of one pair."""
    row: dict[str, Any] = {"target": target, "source": source, "landmarks": landmarks, "asked": vertices}
    seconds: dict[str, float] = {}

    def timed(stage: str, call: Callable[[], Any]) -> Any:
        start = time.process_time()
        made = call()
        seconds[stage] = seconds.get(stage, 0.0) + time.process_time() - start
        return made

    with tempfile.TemporaryDirectory() as place, thread_limit(1):
        folder = Path(place)
        _warm_up(folder)
        meshes = [read_mesh(HUMANS / f"{name}.obj") for name in (target, source)]
        levels = [choose_level(mesh, vertices) for mesh in meshes]
        surfaces = [
            timed("prepare", lambda m=mesh, at=level: load_or_prepare(folder / "store", m, at, MAP_BASIS))
            for mesh, level in zip(meshes, levels, strict=True)
        ]
        row["control"] = [mesh.n_vertices for mesh in meshes]
        row["finest"] = [surface.triangles(surface.finest_level).n for surface in surfaces]
        row["prepared"] = [surface.refinement.levels[surface.operators.finest_level].n_vertices for surface in surfaces]
        row["store_bytes"] = sum(file.stat().st_size for file in (folder / "store").iterdir())
        given = None
        if landmarks:
            path = HUMANS / "landmarks" / f"{landmarks}.json"
            given = read_landmarks(path, f"{target}.obj", f"{source}.obj")[0]
        found = timed("match", lambda: match(*surfaces, given))
        timed("match", lambda: write_result(folder / "RESULT", found))
        row["result_bytes"] = sum(file.stat().st_size for file in (folder / "RESULT").iterdir())
        timed("picture", lambda: write_image(folder / "p.png", draw_thumbnail(read_result(folder / "RESULT"))))
        timed("report", lambda: write_report(folder / "r.html", read_result(folder / "RESULT")))
        noise = np.random.default_rng(0).random((1024, 1024, 3))
        write_image(folder / "t.png", (255 * noise).astype(np.uint8))
        for size in (1024, 4096):
            request = TransferRequest(folder / "RESULT", folder / f"{size}.png", folder / "t.png", size=size)
            timed(f"transfer {size}", lambda request=request: run_transfer(request, Stages()))
        timed("wrap", lambda: run_wrap(WrapRequest((folder / "RESULT",), folder / "w.obj"), Stages()))
    row["memory_bytes"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return row | {"seconds": seconds}


def _warm_up(folder: Path) -> None:
    """Read compiled code: a worker does that once."""
    pair = example_pair(16)
    surfaces = [load_or_prepare(folder / "warm", mesh, 1, MAP_BASIS) for mesh in (pair.target, pair.source)]
    write_result(folder / "warm-RESULT", match(*surfaces, pair.landmarks))
    draw_thumbnail(read_result(folder / "warm-RESULT"))
    write_image(folder / "warm.png", pair.texture)
    request = TransferRequest(folder / "warm-RESULT", folder / "warm-out.png", folder / "warm.png", size=64)
    run_transfer(request, Stages())


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.library.growth", description=__doc__)
    parser.add_argument("--case", type=int, help="measure one in this process and print it")
    arguments = parser.parse_args()
    if arguments.case is not None:
        print(json.dumps(measured(*CASES[arguments.case])))
        return
    rows = json.loads(RESULTS.read_text()) if RESULTS.is_file() else []
    known = [[row[name] for name in ("target", "source", "landmarks", "asked")] for row in rows]
    for number, case in enumerate(CASES):
        if list(case) not in known:
            command = [sys.executable, "-m", "benchmarks.library.growth", "--case", str(number)]
            said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            rows.append(json.loads(said.splitlines()[-1]))
            RESULTS.write_text(json.dumps(rows, indent=1) + "\n")
            print(rows[-1], flush=True)


if __name__ == "__main__":
    main()
