"""``python -m benchmarks.speed [--part NAME ...] [--quick] [--pyfm PYTHON]``: measure, write JSON and Markdown."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from benchmarks.speed.data import DATA
from benchmarks.speed.measure import REPOSITORY, machine, run_task
from benchmarks.speed.parts import PARTS, Options, default_pyfm, has_pyfm
from benchmarks.speed.tables import markdown

RESULTS = REPOSITORY / "benchmarks" / "results"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description="Protocol A: speed.")
    parser.add_argument(
        "--part", nargs="+", choices=list(PARTS), default=list(PARTS), help="parts to measure; all by default"
    )
    parser.add_argument("--quick", action="store_true", help="small meshes: try the benchmark itself")
    parser.add_argument(
        "--pyfm", metavar="PYTHON", help="interpreter with pyfmaps 1.3.1; this one by default, if it has it"
    )
    parser.add_argument(
        "--peer-seconds", type=float, default=600.0, help="of ZoomOut measured, the rest is extrapolated"
    )
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder of speed.json and speed.md")
    arguments = parser.parse_args()
    if not DATA.is_dir():
        parser.error(f"the meshes are not beside this checkout ({DATA.name} in ../shared)")
    if arguments.pyfm and not has_pyfm(arguments.pyfm):
        parser.error(f"--pyfm: {arguments.pyfm} cannot import pyFM; install pyfmaps==1.3.1 for it")
    commit = machine()["commit"]  # before results are written, which are files of the repository
    if commit.endswith("-dirty") and not arguments.quick and arguments.output == RESULTS:
        parser.error("tables of the repository are those of a commit: commit first, or give another --output")
    name = "speed-quick" if arguments.quick else "speed"
    place = arguments.output / f"{name}.json"
    arguments.output.mkdir(parents=True, exist_ok=True)
    # Parts that are not measured now keep their figures, each with the machine it was measured on.
    figures = json.loads(place.read_text()) if place.is_file() else {}
    with tempfile.TemporaryDirectory() as folder:
        options = Options(arguments.quick, arguments.pyfm or default_pyfm(), arguments.peer_seconds, folder)
        run_task("warm_up", {})
        for part in arguments.part:
            print(f"{part}: {PARTS[part].__doc__}", flush=True)
            on = machine() | {"commit": commit}
            figures[part] = PARTS[part](options) | {"machine": on}
            place.write_text(json.dumps(figures, indent=1) + "\n")
            (arguments.output / f"{name}.md").write_text(markdown(figures))
    print(markdown(figures))


main()
