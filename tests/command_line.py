"""Commands as a user types them, in this process: what they print and how they end."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from cagemap.cli import main


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


Run = Callable[..., Outcome]
MATCH = ["--target", "deer.obj", "--source", "pony.obj", "--landmarks", "landmarks.json"]


def runner(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs commands where the test stands; an error is one message on standard error, and never a traceback."""
    monkeypatch.setenv("COLUMNS", "200")

    def call(*words: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["cagemap", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        code = ended.value.code if isinstance(ended.value.code, int) else int(bool(ended.value.code))
        assert "Traceback" not in captured.err
        return Outcome(code, captured.out, captured.err)

    return call
