"""`cagemap studio` refuses what it cannot open before it serves; faults in the code are shown whole if asked for."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from cagemap.cli import main

from command_line import Run


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--folder none", "--folder none: expected a folder, found none. Check the name."),
        ("-t a.obj -s b.obj", "a.obj: expected a mesh file, found none. Check the name."),
    ],
)
def test_what_is_not_there_is_not_opened(run: Run, words: str, says: str) -> None:
    run.refused(f"studio --no-browser {words}", says=says)
    assert list(Path().iterdir()) == []


def test_without_its_server_the_studio_says_what_to_install(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith(("cagemap.studio.page", "websockets"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "websockets", None)
    run.refused("studio --no-browser", says="which is not installed. Run pip install 'cagemap[studio]'.")


def test_a_fault_in_the_code_is_shown_whole_if_asked_for(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def fault(*given: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("cagemap.cli.entry._check_words", fault)
    assert run("check a.obj").code not in (0, 2)
    monkeypatch.setenv("CAGEMAP_DEBUG", "1")
    monkeypatch.setattr(sys, "argv", ["cagemap", "check", "a.obj"])
    with pytest.raises(ZeroDivisionError):
        main()
