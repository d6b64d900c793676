"""Jobs where machines end: a disk that fills, and a scheduler and workers that are processes of their own."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cagemap.cli.app import app
from cagemap.example import ExamplePair
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.result.folder import read_result

from forked import dask_command, forking

JOB = """output = "{output}"
[options]
vertices = 300
[[assets]]
name = "pony"
file = "pony.obj"
[[assets]]
name = "deer"
file = "deer.obj"
[[pairs]]
source = "pony"
target = "deer"
landmarks = "landmarks.json"
[[pairs]]
source = "deer"
target = "pony"
landmarks = "back.json"
"""

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("quick_fit")]


@pytest.fixture
def folder(pair_files: Path, built_in_pair: ExamplePair) -> Path:
    write_landmarks(pair_files / "back.json", built_in_pair.landmarks.reversed())
    return pair_files


ALONE: dict[str, np.ndarray] = {}


def single(folder: Path, target: str, source: str, landmarks: str) -> np.ndarray:
    """Images of a match by its own command, which is done once for all tests."""
    if target in ALONE:
        return ALONE[target]
    result = folder / f"alone-{target}"
    given = ["match", "--vertices", "300", "-o", str(result)]
    files = {"-t": f"{target}.obj", "-s": f"{source}.obj", "--landmarks": landmarks}
    given += [word for option, name in files.items() for word in (option, str(folder / name))]
    said = CliRunner().invoke(app, given)
    assert said.exit_code == 0, said.output
    return ALONE.setdefault(target, read_result(result).image())


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[str]:
    """Address of a Dask scheduler with workers, each a process that runs Dask's own command, with quick fits."""
    file = folder / "scheduler.json"
    commands = [["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]]
    commands += [["worker", "--scheduler-file", str(file), "--nthreads", "1", "--no-nanny", "--no-dashboard"]] * workers
    with ExitStack() as stack:
        for command in commands:
            process = forking().Process(target=dask_command, args=(command, folder))
            process.start()
            stack.callback(process.join)
            stack.callback(process.terminate)
            deadline = time.monotonic() + 60
            while not file.is_file() and time.monotonic() < deadline:
                time.sleep(0.1)
        yield str(json.loads(file.read_text())["address"])


def test_a_scheduler_and_two_workers_of_their_own_give_the_same_results(folder: Path) -> None:
    (folder / "job.toml").write_text(JOB.format(output="night"))
    with cluster(folder, 2) as address:
        said = CliRunner().invoke(app, ["run", str(folder / "job.toml"), "--scheduler", address])
    assert said.exit_code == 0, said.output
    assert "2 pairs, tasks: 6 done" in said.output
    for target, source, landmarks in (("deer", "pony", "landmarks.json"), ("pony", "deer", "back.json")):
        found = read_result(folder / "night" / f"{source}__{target}" / "RESULT").image()
        np.testing.assert_allclose(found, single(folder, target, source, landmarks), atol=1e-12)
