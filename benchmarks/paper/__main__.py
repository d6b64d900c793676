"""``python -m benchmarks.paper [NAME ...]``: redraw the paper's figures and tables into docs/paper/."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from itertools import chain

from benchmarks.paper.data import DATA, folder
from benchmarks.paper.drawing import FIGURES, TABLES, made, write_page
from benchmarks.speed.measure import machine


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.paper", description="Protocol C: figures and tables.")
    parser.add_argument("names", nargs="*", choices=[*FIGURES, *TABLES, []], help="which; all by default")
    parser.add_argument("--processes", type=int, default=2, help="figures drawn at the same time")
    arguments = parser.parse_args()
    if not DATA.is_dir():
        parser.error("the meshes are not beside this checkout (../shared/data)")
    wanted = arguments.names or [*FIGURES, *TABLES]
    place = folder() / "paper.json"
    seen = json.loads(place.read_text()) if place.is_file() else {}
    used = machine()
    code = f"{used['commit']}, {used['date']}"
    begin = time.perf_counter()
    # Tables come last and one by one, for they are of seconds.
    figures, tables_of_seconds = ([name for name in wanted if (name in FIGURES) == is_figure] for is_figure in (1, 0))
    with ProcessPoolExecutor(arguments.processes, multiprocessing.get_context("spawn")) as processes:
        for name, said, seconds in chain(processes.map(made, figures), map(made, tables_of_seconds)):
            seen[name] = said
            seen.setdefault("code", {})[name] = code
            print(f"{name}: {seconds:.0f} s", flush=True)
            place.write_text(json.dumps(seen, indent=1) + "\n")
            write_page(seen)
    print(f"all: {time.perf_counter() - begin:.0f} s", flush=True)


if __name__ == "__main__":
    main()
