"""The version of the code that keys stored work."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest

from cagemap.files.result.manifest import code_version


def test_it_changes_with_any_python_file_and_with_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    room = tmp_path / "cagemap" / "room"
    room.mkdir(parents=True)
    (room / "a.py").write_text("x = 1\n")
    monkeypatch.setattr(resources, "files", lambda _: tmp_path / "cagemap")
    version = code_version.__wrapped__  # a process keeps that of its start
    before = version()
    (room / "style.css").write_text("p {}")
    assert version() == before
    (room / "a.py").write_text("x = 2\n")
    changed = version()
    assert changed != before
    (room / "a.py").rename(room / "b.py")
    assert version() not in (before, changed)
