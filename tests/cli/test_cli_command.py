"""Commands made of requests: what typer sees, and what the request holds."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.testing import CliRunner

from cagemap.cli.request_command import command_of
from cagemap.tasks.requests.options import Argument, Option, PythonOnly
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.wrap import WrapConfig


@dataclass(frozen=True)
class Asked:
    """A request with a field of every kind."""

    files: Annotated[tuple[Path, ...], Argument("Files.", metavar="[FILE]")]
    kinds: Annotated[tuple[str, ...], Option("Kinds.")] = ()
    sizes: Annotated[tuple[int, ...], Option("Sizes.", names=("--size",))] = (1, 2)
    amount: Annotated[float, Option("Amount.")] = 0.5
    space: Annotated[Literal["a", "b"] | None, Option("Space.")] = None
    inner: Annotated[str, PythonOnly("Of Python alone.")] = "not of the command line"


@dataclass(frozen=True)
class AskedInWords:
    """A request with a field that is typed in another form."""

    kinds: Annotated[tuple[str, ...], Option("Kinds.", typed=str | None)] = ()

    @classmethod
    def of_words(cls, kinds: str | None) -> AskedInWords:
        """The request from what is typed."""
        return cls(kinds=tuple(kinds.split(",")) if kinds else ())


def _asked(*words: str, kind: type = Asked) -> Any:
    got: list[Any] = []
    app = typer.Typer()

    app.command()(command_of(kind, got.append))
    done = CliRunner().invoke(app, words)
    assert (done.exit_code, done.output) == (0, ""), done.output
    return got[0]


def test_what_is_not_said_is_the_requests_own_default() -> None:
    assert _asked() == Asked(())


def test_words_become_the_fields_values() -> None:
    got = _asked("a", "b", "--kinds", "x", "--kinds", "y", "--size", "3", "--amount", "1", "--space", "b")
    assert got == Asked((Path("a"), Path("b")), ("x", "y"), (3,), 1.0, "b")
    assert type(got.space) is str


def test_a_field_may_be_said_in_words_of_its_own() -> None:
    assert _asked("--kinds", "x,y", kind=AskedInWords) == AskedInWords(("x", "y"))
    assert _asked(kind=AskedInWords) == AskedInWords()


def test_wrap_is_asked_for_what_the_library_does_by_itself() -> None:
    assert WrapRequest((), Path("out.obj")).fairness == WrapConfig.fairness  # written twice so that --help starts fast


def test_what_no_command_uses_is_loaded_when_it_is_asked_for_after_all() -> None:
    asked = """
import sys
from cagemap.cli.request_command import LAZY_MODULES, load_lazily
load_lazily(LAZY_MODULES)
import numpy, scipy.linalg
print(any(name.startswith(f"{late}.") for name in sys.modules for late in LAZY_MODULES))
numpy.testing.assert_equal(1, 1)
from numpy.f2py import crackfortran
print(crackfortran.__name__)
"""
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "numpy.f2py.crackfortran"]


def test_a_match_imports_no_baking() -> None:
    script = "import sys, cagemap.tasks.match\nprint([name for name in sys.modules if 'cagemap.transfer' in name])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
