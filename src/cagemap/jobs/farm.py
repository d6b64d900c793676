"""Numbered tasks of a plan, and scripts for render farms and clusters."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from cagemap.errors import ParameterError
from cagemap.jobs.plan import Plan, Task

PAGE_STEP = "page"
# Step of a kind of task; all other kinds belong to "outputs".
STEP_OF_KIND = {"prepare": "prepare", "match": "match", "carry": "carry"}
STEP_NAMES = ("prepare", "match", "outputs", "carry")
# Slurm's default `MaxArraySize` is 1001.
MAX_SLURM_ARRAY_SIZE = 1000
# Characters of a job's name in Open Job Description 2023-09.
MAX_NAME_LENGTH = 64


@dataclass(frozen=True)
class Step:
    """Numbered tasks that may run in parallel, after all earlier steps."""

    name: str  # "prepare", "match", "outputs" (of one pair each), "carry" or "page"
    first: int  # number of its first task; tasks of all steps are numbered from 1
    tasks: tuple[tuple[Task, ...], ...]  # tasks of each number, in this order; none for the page

    @property
    def last(self) -> int:
        """Number of its last task."""
        return self.first + len(self.tasks) - 1


def farm_steps(plan: Plan) -> tuple[Step, ...]:
    """Tasks of a plan without detours in steps, numbered by the job file alone."""
    steps: list[Step] = []
    first = 1
    for name in STEP_NAMES:
        tasks = [task for task in plan.tasks if STEP_OF_KIND.get(task.kind, "outputs") == name]
        groups = [tuple(group) for _, group in groupby(tasks, lambda task: task.pair or task.name)]
        if groups:
            steps.append(Step(name, first, tuple(groups)))
            first += len(groups)
    return (*steps, Step(PAGE_STEP, first, ((),)))


def numbered_tasks(steps: tuple[Step, ...]) -> Iterator[tuple[int, Task]]:
    """Every task with its number."""
    for step in steps:
        for number, group in enumerate(step.tasks, step.first):
            for task in group:
                yield number, task


def parse_task_range(words: str, last: int) -> range:
    """Numbers of the tasks ``N`` or ``A-B``."""
    match = re.fullmatch(r"(\d{1,9})(?:-(\d{1,9}))?", words.strip())
    first, end = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
    if not 1 <= first <= end <= last:
        raise ParameterError(
            f"--task: expected a number or a range such as 2-5, of tasks 1 to {last}, got '{words}'. "
            "`--dry-run` lists the numbers."
        )
    return range(first, end + 1)


def openjd_template(job: Path, steps: tuple[Step, ...]) -> dict[str, Any]:
    """Job template of Open Job Description 2023-09 whose tasks are ``cagemap run JOB --task N``.

    The template's default for JOB is the file's name without its folder: such defaults may not be absolute paths.
    """
    name = re.sub(r"[^A-Za-z0-9 ._-]", "-", job.stem)[:MAX_NAME_LENGTH]
    return {
        "specificationVersion": "jobtemplate-2023-09",
        "name": name,
        "parameterDefinitions": [
            {
                "name": "JobFile",
                "type": "PATH",
                "objectType": "FILE",
                "dataFlow": "NONE",
                "default": job.name,
                "description": "Job file of cagemap, on a disk that all machines reach by the same path.",
            }
        ],
        "steps": [
            {
                "name": step.name,
                **({"dependencies": [{"dependsOn": steps[i - 1].name}]} if i else {}),
                "parameterSpace": {
                    "taskParameterDefinitions": [
                        {"name": "Number", "type": "INT", "range": f"{step.first}-{step.last}"}
                    ]
                },
                "script": {
                    "actions": {
                        "onRun": {
                            "command": "cagemap",
                            "args": ["run", "{{Param.JobFile}}", "--task", "{{Task.Param.Number}}"],
                        }
                    }
                },
            }
            for i, step in enumerate(steps)
        ],
    }


def slurm_script(job: Path, steps: tuple[Step, ...]) -> str:
    """Bash script that submits one Slurm array a step, which starts after the step before."""
    lines = [
        "#!/bin/bash",
        "# Submit all tasks of a job of cagemap: bash SCRIPT [options of sbatch, such as --cpus-per-task=4 --mem=8G]",
        "set -euo pipefail",
        f"job={shlex.quote(str(job))}",
        'if [ "${1:-}" = task ]; then',
        '    export CAGEMAP_THREADS="${SLURM_CPUS_PER_TASK:-1}"',
        '    exec cagemap run "$job" --task "$(($2 + SLURM_ARRAY_TASK_ID))"',
        "fi",
        "# submit NAME FIRST COUNT AFTER [options]: prints the number of the array's job",
        "submit() {",
        "    local name=$1 first=$2 count=$3 after=${4:+--dependency=afterany:$4} id; shift 4",
        '    id=$(sbatch --parsable "$@" --job-name="cagemap-$name" \\',
        '        --array="0-$((count - 1))" $after "$0" task "$first") || return 1',
        '    echo "${id%%;*}"',
        "}",
        "before=",
    ]
    for step in steps:
        lines.append("now=")
        for first in range(step.first, step.last + 1, MAX_SLURM_ARRAY_SIZE):
            count = min(MAX_SLURM_ARRAY_SIZE, step.last + 1 - first)
            lines.append(f'now=${{now:+$now:}}$(submit {step.name} {first} {count} "$before" "$@")')
        lines.append("before=$now")
    return "\n".join([*lines, 'echo "submitted; the last job is $before"', ""])
