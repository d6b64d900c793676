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
from job_text import job_text

LANDMARKS = {("pony", "deer"): "landmarks.json", ("deer", "pony"): "back.json"}  # of source and target

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("quick_fit")]


@pytest.fixture
def folder(pair_files: Path, built_in_pair: ExamplePair) -> Path:
    write_landmarks(pair_files / "back.json", built_in_pair.landmarks.reversed())
    return pair_files


def single(folder: Path, target: str, source: str, landmarks: str) -> np.ndarray:
    """Images of a match by its own command."""
    given = ["match", "--vertices", "300", "-o", str(folder / "alone")]
    files = {"-t": f"{target}.obj", "-s": f"{source}.obj", "--landmarks": landmarks}
    given += [word for option, name in files.items() for word in (option, str(folder / name))]
    said = CliRunner().invoke(app, given)
    assert said.exit_code == 0, said.output
    return read_result(folder / "alone").image()


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
    pairs = [{"source": of[0], "target": of[1], "landmarks": file} for of, file in LANDMARKS.items()]
    (folder / "job.toml").write_text(job_text("vertices = 300", {"pony": {}, "deer": {}}, pairs))
    with cluster(folder, 2) as address:
        said = CliRunner().invoke(app, ["run", str(folder / "job.toml"), "--scheduler", address])
    assert said.exit_code == 0, said.output
    assert "2 pairs, tasks: 6 done" in said.output
    for (source, target), landmarks in LANDMARKS.items():
        found = read_result(folder / "night" / f"{source}__{target}" / "RESULT").image()
        np.testing.assert_allclose(found, single(folder, target, source, landmarks), atol=1e-12)
