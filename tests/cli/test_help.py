"""Help: quick, and what the commands say."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

from cagemap.cli.app import app
from cagemap.cli.entry import HELP_FILE

RENEW = (
    "the text of `cagemap --help` is not that of its commands any more: run COLUMNS=80 python -c "
    '\'import sys; sys.argv[1:] = ["--help"]; from cagemap.cli.app import app; app(prog_name="cagemap")\' > '
    "src/cagemap/cli/help.txt"
)


def test_the_kept_help_is_what_the_commands_say(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        app(["--help"], prog_name="cagemap")
    assert capsys.readouterr().out == HELP_FILE.read_text(encoding="utf-8"), RENEW


@pytest.mark.parametrize("word", ["--help", "-h"])
def test_help_loads_no_library(word: str) -> None:
    script = (
        f"import sys; sys.argv = ['cagemap', '{word}']\nfrom cagemap.cli.entry import main\n"
        "try:\n    main()\nexcept SystemExit as ended:\n    assert ended.code == 0\n"
        "slow = {'typer', 'pydantic', 'numpy', 'scipy', 'numba', 'rich', 'embreex', 'OpenImageIO'}\n"
        "assert not slow & set(sys.modules), slow & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == HELP_FILE.read_text(encoding="utf-8")


def test_commands_load_no_pydantic_before_they_run() -> None:
    script = "import sys, cagemap.cli.app\nassert not {'pydantic', 'numpy', 'rich'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", script], check=True)
