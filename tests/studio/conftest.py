"""What the tests of the studio share; one studio for a file in a real browser, a new one after a failure."""

from collections.abc import Iterator
from typing import Any

import pytest

from cagemap.studio.finish import Command
from cagemap.studio.opening import built_in_files
from cagemap.studio.session import Session
from cagemap.studio.state import Files

from browser_page import Page
from running_studio import Running


@pytest.fixture(scope="session", autouse=True)
def forked(forked_processes: None) -> None:
    """Processes of the studio are started quickly."""


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """What runs, and how many tests had failed when it was started."""
    made: dict[str, Any] = {"folder": lambda: tmp_path_factory.mktemp("built-in")}
    yield made
    if "running" in made:
        made["running"].begun.close()


@pytest.fixture
def running(browser: Any, held: dict[str, Any], request: pytest.FixtureRequest) -> Running:
    failed = request.session.testsfailed
    if held.get("failed") != failed:
        if "running" in held:
            held.pop("running").begun.close()
        held["running"] = Running.of(browser, built_in_files(held["folder"]()))
        held["failed"] = failed
    return held["running"]


@pytest.fixture
def page(running: Running) -> Page:
    return running.page


@pytest.fixture
def files(running: Running) -> Files:
    return running.files


@pytest.fixture
def started(opened: Session, monkeypatch: pytest.MonkeyPatch) -> list[Command]:
    """Commands of bakes that were asked for; none is run."""
    commands: list[Command] = []
    monkeypatch.setattr(opened._runner, "start", commands.extend)
    return commands
