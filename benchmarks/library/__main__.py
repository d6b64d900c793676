"""``python -m benchmarks.library``: all ordered pairs of the seven human cages, into benchmarks/results/library.md.

Single matches run one after the other in this process, on stored surfaces and one thread, as a worker does; the job
runs on two workers. Every map of the job is compared with that of the single match.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from itertools import permutations
from pathlib import Path

import numpy as np

from benchmarks.accuracy.data import DATA
from cagemap.files.result.folder import read_result
from cagemap.numerics.threads import thread_limit
from cagemap.tasks.match import MatchRequest, run_match
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.run import RunRequest
from cagemap.tasks.run_job import run_job

HUMANS = DATA / "humans"
RESULTS = Path(__file__).resolve().parents[1] / "results" / "library.md"
CAGES = {
    "base": "base_male_young",
    "soma": "soma18056_female_old_heavy",
    "female": "female1605_male_young",
    "male": "male1591_female_old_heavy",
    "proxy": "proxy741_neutral",
    "anny10": "anny10pc_male_young",
    "anny5": "anny5pc_female_old_heavy",
}


def job_text(vertices: int, names: list[str], spoiled: tuple[str, str, Path] | None = None) -> str:
    """Job file of all ordered pairs of some cages, without landmarks; one pair with a landmark file that misleads."""
    parts = [f'output = "night"\n[options]\nvertices = {vertices}\n']
    parts += [f'[[assets]]\nname = "{name}"\nfile = "{HUMANS / CAGES[name]}.obj"\n' for name in names]
    for pair in permutations(names, 2):
        parts.append(f'[[pairs]]\nsource = "{pair[0]}"\ntarget = "{pair[1]}"\n')
        if spoiled is not None and pair == spoiled[:2]:
            parts.append(f'landmarks = "{spoiled[2]}"\noptions = {{ trust_landmarks = true }}\n')
    return "\n".join(parts)


def exchanged_landmarks(path: Path) -> Path:
    """The landmarks of base and female1605 with left and right exchanged on one side."""
    data = json.loads((HUMANS / "landmarks" / "base__female1605.json").read_text())
    target = {pair["name"]: pair["target"] for pair in data["pairs"]}

    def other(name: str) -> str:
        swapped = name.replace("left", "?").replace("right", "left").replace("?", "right")
        return swapped if swapped in target else name

    for pair in data["pairs"]:
        pair["target"] = target[other(pair["name"])]
    path.write_text(json.dumps(data))
    return path


def run(job: Path) -> tuple[str, float]:
    """Run a job on two workers; what it says, and seconds."""
    start = time.perf_counter()
    text, _ = run_job(RunRequest(job, workers=2), Stages())
    return text, time.perf_counter() - start


def all_pairs(folder: Path, vertices: int) -> list[str]:
    """The job against single matches."""
    job = folder / "job.toml"
    job.write_text(job_text(vertices, list(CAGES)))
    said, wall = run(job)
    _, again = run(job)
    notes = [json.loads(path.read_text()) for path in (folder / "night" / ".cagemap" / "done").glob("*.json")]
    prepared = [note for note in notes if note["name"].startswith("prepare ")]
    matched = [note for note in notes if note["name"].startswith("match ")]
    surfaces = list((folder / "night" / ".cagemap" / "surfaces").glob("*.npz"))
    single, worst = 0.0, 0.0
    with thread_limit(1):
        for source, target in permutations(CAGES, 2):
            files = (HUMANS / f"{CAGES[target]}.obj", HUMANS / f"{CAGES[source]}.obj")
            result = folder / "single" / f"{source}__{target}"
            result.parent.mkdir(exist_ok=True)
            start = time.perf_counter()
            run_match(MatchRequest(*files, result, vertices=vertices, cache=folder / "cache"), Stages())
            single += time.perf_counter() - start
            one, many = read_result(result), read_result(folder / "night" / f"{source}__{target}" / "RESULT")
            worst = max(worst, float(np.abs(one.image() - many.image()).max() / np.ptp(one.image())))
    return [
        "| | |",
        "| --- | --- |",
        f"| pairs, vertices a side | {len(matched)}, about {vertices:,} |",
        f"| surfaces prepared, files stored | {len(prepared)}, {len(surfaces)} |",
        f"| job on two workers, pictures and page included | {wall:.0f} s |",
        f"| single matches on one core, surfaces kept | {single:.0f} s |",
        f"| job over half of that | {wall / (single / 2):.2f} |",
        f"| second run | {again:.1f} s |",
        f"| largest difference of a map from its single match | {worst:.1e} of the size |",
        f"| said | {said.splitlines()[0]} |",
    ]


def spoiled_pair(folder: Path, vertices: int) -> list[str]:
    """One pair of thirty with left and right exchanged."""
    folder.mkdir(exist_ok=True)
    job, names = folder / "job.toml", [name for name in CAGES if name != "anny5"]
    job.write_text(job_text(vertices, names, ("base", "female", exchanged_landmarks(folder / "exchanged.json"))))
    said, _ = run(job)
    return [
        "Six cages, 30 pairs, base -> female with left and right exchanged:",
        "",
        "```",
        *said.splitlines()[:-1],
        "```",
    ]


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vertices", type=int, default=25_000)
    vertices = parser.parse_args().vertices
    with tempfile.TemporaryDirectory() as temporary:
        lines = all_pairs(Path(temporary), vertices)
        lines += ["", *spoiled_pair(Path(temporary) / "spoiled", min(vertices, 6000))]
    text = "\n".join(["# A library of models", "", *lines, ""])
    RESULTS.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
