"""Tasks by number, with templates that farms accept; a full disk; a scheduler and workers as processes."""

import json
import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cagemap.cli.app import app
from cagemap.errors import ParameterError
from cagemap.example import ExamplePair
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.result.folder import read_result
from cagemap.jobs.farm import farm_steps, openjd_template, parse_task_range, slurm_script
from cagemap.jobs.plan import Plan, Task

from forked import dask_command, forking
from job_text import job_text


def plan(root: Path, pairs: int = 2) -> Plan:
    """Two surfaces; a map, a picture and a texture of each pair, in the order of `plan_job`."""
    tasks = []
    for i in range(pairs):
        pair = (f"a{i}", "b")
        match, log = f"match {i}", {"log": str(root / "log"), "root": str(root)}
        tasks += [Task("prepare", f"prepare {i}", "k", (), log, (f"surfaces/{i}",))] if i < 2 else []
        tasks += [Task("match", match, "k", (f"prepare {min(i, 1)}",), log, (f"{i}/map",), pair)]
        tasks += [Task("picture", f"picture {i}", "k", (match,), log, (f"{i}/picture",), pair)]
        tasks += [Task("transfer", f"transfer {i}", "k", (match,), log, (f"{i}/texture",), pair)]
    return Plan(root, tuple(tasks), tuple((f"a{i}", "b") for i in range(pairs)))


def test_outputs_of_a_pair_share_a_number_and_come_after_all_maps(tmp_path: Path) -> None:
    steps = farm_steps(plan(tmp_path))
    assert [(step.name, step.first, step.last) for step in steps] == [
        ("prepare", 1, 2),
        ("match", 3, 4),
        ("outputs", 5, 6),
        ("page", 7, 7),
    ]
    assert [task.name for task in steps[2].tasks[1]] == ["picture 1", "transfer 1"]


def test_numbers_and_ranges() -> None:
    assert list(parse_task_range("3", 7)) == [3]
    assert list(parse_task_range("2-4", 7)) == [2, 3, 4]
    for wrong in ("0", "8", "4-2", "2-8", "two", "-1", "1-", ""):
        with pytest.raises(ParameterError, match="--task: expected a number or a range such as 2-5, of tasks 1 to 7"):
            parse_task_range(wrong, 7)


def test_open_job_description_accepts_the_template(tmp_path: Path) -> None:
    model = pytest.importorskip("openjd.model", reason="needs openjd-model")
    odd = tmp_path / ("{{night}} 'of' " + "x" * 80 + ".toml")
    template = json.loads(json.dumps(openjd_template(odd, farm_steps(plan(tmp_path)))))
    decoded = model.decode_job_template(template=template)
    assert (decoded.name, len(decoded.steps)) == (("--night-- -of- " + "x" * 80)[:64], 4)
    values = model.preprocess_job_parameters(
        job_template=decoded,
        job_parameter_values={},
        job_template_dir=tmp_path,
        current_working_dir=tmp_path,
    )
    assert Path(values["JobFile"].value) == odd
    job = model.create_job(job_template=decoded, job_parameter_values=values)
    numbers = [
        int(one["Number"].value)
        for step in job.steps
        for one in model.StepParameterSpaceIterator(space=step.parameterSpace)
    ]
    assert numbers == [1, 2, 3, 4, 5, 6, 7]
    assert [[one.dependsOn for one in step.dependencies or ()] for step in job.steps] == [
        [],
        ["prepare"],
        ["match"],
        ["outputs"],
    ]


def test_the_slurm_script_runs_every_number_once_after_the_step_before(tmp_path, monkeypatch):
    """A stand-in for sbatch runs each array at once, as Slurm would when all before has ended."""
    monkeypatch.setattr("cagemap.jobs.farm.MAX_SLURM_ARRAY_SIZE", 4)
    programs = tmp_path / "bin"
    programs.mkdir()
    (programs / "cagemap").write_text(f'#!/bin/bash\necho "$@" >> "{tmp_path}/ran"\n')
    (programs / "sbatch").write_text(
        f"""#!/bin/bash
echo "$@" >> "{tmp_path}/submitted"
id=$(wc -l < "{tmp_path}/submitted")
while [[ $1 == -* ]]; do [[ $1 == --array=* ]] && span=${{1#--array=}}; shift; done
for i in $(seq ${{span%-*}} ${{span#*-}}); do SLURM_ARRAY_TASK_ID=$i bash "$@"; done
echo "$id;cluster"
"""
    )
    for program in programs.iterdir():
        program.chmod(0o755)
    job, script = tmp_path / "it's a job.toml", tmp_path / "submit.sh"
    script.write_text(slurm_script(job, farm_steps(plan(tmp_path, pairs=6))))
    done = subprocess.run(
        ["bash", str(script), "--mem=8G"],
        env={**os.environ, "PATH": f"{programs}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    total = 2 + 2 * 6 + 1
    assert (tmp_path / "ran").read_text().splitlines() == [f"run {job} --task {n}" for n in range(1, total + 1)]
    submitted = (tmp_path / "submitted").read_text().splitlines()
    assert all("--mem=8G" in line for line in submitted)
    after = [line.partition("afterany:")[2].partition(" ")[0] for line in submitted]
    assert after == ["", "1", "1", "2:3", "2:3", "4:5"]


def test_the_slurm_script_ends_where_a_step_is_not_accepted(tmp_path: Path) -> None:
    sbatch, script = tmp_path / "sbatch", tmp_path / "submit.sh"
    sbatch.write_text(f'#!/bin/bash\necho "$@" >> "{tmp_path}/submitted"\n[[ "$*" != *cagemap-match* ]] && echo 1\n')
    sbatch.chmod(0o755)
    script.write_text(slurm_script(tmp_path / "job.toml", farm_steps(plan(tmp_path))))
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(["bash", str(script)], env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, "submitted" in done.stdout) == (1, False)
    assert len((tmp_path / "submitted").read_text().splitlines()) == 2


LANDMARKS = {("pony", "deer"): "landmarks.json", ("deer", "pony"): "back.json"}  # of source and target


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


@pytest.mark.slow
@pytest.mark.usefixtures("quick_fit")
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
