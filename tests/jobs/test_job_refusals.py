"""Jobs that cannot run: every message names the file or option, what is wrong, and what to do."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from cagemap.jobs.job import read_job
from cagemap.jobs.job_schema import Asset
from cagemap.jobs.run import _remote
from cagemap.jobs.tree import spanning_tree
from cagemap.tasks.requests.catalogue import COMMANDS

from refusals import Refusal


def nested(place: Path) -> None:
    (place / "job.toml").write_text("a = " + "[" * 20_000)
    read_job(place / "job.toml", COMMANDS)


def silent(patch: pytest.MonkeyPatch) -> None:
    def late(*given: Any, **options: Any) -> None:
        raise TimeoutError("10 s")

    patch.setattr("distributed.Client", late)
    _remote(ExitStack(), "tcp://127.0.0.1:9")


REFUSED = {
    "brackets without end": Refusal(
        nested, "job.toml: expected a TOML file ... got brackets within brackets without end ... Write it again."
    ),
    "a tree of a missing mesh": Refusal(
        lambda place: spanning_tree([Asset(name="a", file=place / "none.obj")]),
        "a: a spanning tree needs every mesh, and this one:  ... none.obj: expected an OBJ file",
        "Check the name",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_job_that_cannot_run_is_refused(name: str, tmp_path: Path) -> None:
    REFUSED[name].check(tmp_path)


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    Refusal(
        silent,
        "--scheduler: expected the address of a Dask scheduler ... tcp://127.0.0.1:9 does not answer (10 s)",
        "Start one with `dask scheduler`",
    ).check(monkeypatch)
