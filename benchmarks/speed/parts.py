"""The six parts of protocol A, and what a newcomer waits for: the first run."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.speed.data import PAIRS
from benchmarks.speed.measure import Figures, cagemap, run, run_task

# What `cagemap match` prepares.
FUNCTIONS = 150


@dataclass(frozen=True)
class Options:
    """What the command line asked for.

    Attributes
    ----------
    quick : bool
        Small meshes: whether the benchmark works, not how fast cagemap is.
    pyfm : str or None
        Interpreter that has pyFM.
    peer_budget : float
        Seconds of ZoomOut after which its remaining steps are extrapolated.
    folder : str
        Scratch folder, for results and prepared surfaces that several parts use.
    """

    quick: bool
    pyfm: str | None
    peer_budget: float
    folder: str

    @property
    def level(self) -> int:
        """Level of the main pair: 395k vertices a side, or 25k."""
        return 2 if self.quick else 4

    @property
    def result(self) -> str:
        """RESULT of the main pair."""
        return str(Path(self.folder) / f"RESULT{self.level}")

    @property
    def cache(self) -> str:
        """Prepared surfaces."""
        return str(Path(self.folder) / "prepared")


def basis(options: Options) -> Figures:
    """Our basis against SciPy's exact one at the finest level."""
    level, count = (3, 100) if options.quick else (5, 300)
    return run_task("basis", {"level": level, "count": count, "exact": True})


def match(options: Options) -> Figures:
    """From two OBJ files to a written RESULT, and again with both surfaces prepared."""
    figures = _match("proxies", options.level, options.result)
    figures["accuracy"] = run_task("check_map", {"pair": "proxies", "result": options.result})["mean error"]
    figures["prepared"] = run_task(
        "prepared_match",
        {
            "pair": "proxies",
            "level": options.level,
            "count": FUNCTIONS,
            "cache": options.cache,
            "output": str(Path(options.folder) / "RESULT-prepared"),
        },
    )
    return figures


def peers(options: Options) -> Figures:
    """Compare with pyFM's fit, ZoomOut to 150 and point map on the same refined meshes and landmarks."""
    if options.pyfm is None:
        return {"skipped": "no interpreter with pyFM was given; see --pyfm"}
    sizes = [("proxies", 1), ("bodies", 1), ("bodies", 2)]
    rows = []
    for pair, level in sizes[:1] if options.quick else sizes:
        result = str(Path(options.folder) / f"RESULT-{pair}{level}")
        ours = _match(pair, level, result)
        error = run_task("check_map", {"pair": pair, "result": result})["mean error"]
        arguments = {"pair": pair, "level": level, "python": options.pyfm, "budget": options.peer_budget}
        theirs = run_task("peer", arguments | {"folder": options.folder})
        rows.append({"ours": ours, "ours error": error, "pyFM": theirs, "ratio": theirs["total"] / ours["wall"]})
        if not error < theirs["mean error"]:
            raise AssertionError(
                f"{pair}, level {level}: pyFM's error {theirs['mean error']:.2f} is below ours {error:.2f}"
            )
    return {"rows": rows}


def growth(options: Options) -> Figures:
    """Time and memory of a match from 60k to a million vertices a side, and their log-log slopes."""
    rows = []
    for level in (1, 2) if options.quick else (1, 2, 3):
        result = str(Path(options.folder) / f"RESULT-bodies{level}")
        rows.append(_match("bodies", level, result))
    sizes = np.log([np.mean(row["vertices"]) for row in rows])
    slopes = {
        name: float(np.polyfit(sizes, np.log([row[name] for row in rows]), 1)[0]) for name in ("wall", "cpu", "peak")
    }
    return {"rows": rows, "slopes": slopes}


def bake(options: Options) -> Figures:
    """Bake a texture at 2k, 4k and 8k through the main pair's map."""
    if not Path(options.result).is_dir():
        _match("proxies", options.level, options.result)
    return run_task("bake", {"result": options.result, "sizes": [512, 1024] if options.quick else [2048, 4096, 8192]})


def landmark(options: Options) -> Figures:
    """One landmark added: time to the new map at 25k vertices a side."""
    return run_task("landmark_added", {"pair": "proxies", "level": 2, "count": FUNCTIONS, "cache": options.cache})


def stages(options: Options) -> Figures:
    """Every stage beside the bytes it must move or the operations it must do."""
    return run_task("stages", {"pair": "proxies", "level": options.level, "count": FUNCTIONS, "cache": options.cache})


def start(options: Options) -> Figures:
    """What the first run costs: imports of --help, and compilation of all that a match and a bake run."""
    figures: Figures = {"help": min((cagemap("--help") for _ in range(5)), key=lambda run: run["wall"])}
    with tempfile.TemporaryDirectory() as cache:
        answer = run_task("warm_up", {}, environment={"NUMBA_CACHE_DIR": cache})
        cold, figures["kernels"] = answer["process"], answer["kernels"]
        warm = run_task("warm_up", {}, environment={"NUMBA_CACHE_DIR": cache})["process"]
    figures |= {"first": cold, "second": warm, "compilation": {k: cold[k] - warm[k] for k in ("wall", "cpu")}}
    figures["help"].pop("output")
    return figures


PARTS: dict[str, Callable[[Options], Figures]] = {
    part.__name__: part for part in (start, stages, basis, match, growth, bake, landmark, peers)
}


def _match(pair: str, level: int, result: str, *more: str | float) -> Figures:
    """Run `cagemap match` in a process of its own, as a user does; with more options of the command line."""
    import json

    chosen = PAIRS[pair]
    process = cagemap(
        *("match", "--target", chosen.target_file, "--source", chosen.source_file, "--landmarks", chosen.landmarks),
        *("--level", level, "-o", result, *more),
    )
    process.pop("output")
    manifest = json.loads((Path(result) / "manifest.json").read_text())
    vertices = [manifest[side]["vertices"] for side in ("target", "source")]
    return process | {"vertices": vertices, "stages": manifest["timings"]}


def has_pyfm(python: str) -> bool:
    """Whether an interpreter can import pyFM."""
    try:
        run([python, "-c", "import pyFM"])
    except (RuntimeError, OSError):
        return False
    return True


def default_pyfm() -> str | None:
    """This interpreter, if it has pyFM."""
    return sys.executable if has_pyfm(sys.executable) else None
