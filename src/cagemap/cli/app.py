"""The typer application. A command is made when it is asked for; its task is imported when it runs."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from cagemap import __version__
from cagemap.cli.console import say, set_verbosity, warn
from cagemap.cli.progress import ConsoleStages
from cagemap.cli.request_command import LAZY_MODULES, QUIET, VERBOSE, command_class, command_of, load_lazily
from cagemap.tasks import request_class, runner_of
from cagemap.tasks.requests.settings import moved_options
from cagemap.tasks.requests.studio import StudioRequest

# In the order of `--help`; the request of "demo" is `DemoRequest`.
_COMMANDS = "demo check refine match transfer rig face report suggest run studio functions wrap map".split()

_PLAIN_TYPER: dict[str, Any] = {"add_completion": False, "rich_markup_mode": None}  # no completion, no rich text


class _Commands(Mapping[str, Any]):
    """Commands by name; each is made at first use, since to make all takes 0.05 s."""

    def __getitem__(self, name: str) -> Any:
        if name not in _COMMANDS:
            raise KeyError(name)
        return _command(name)

    def __iter__(self) -> Iterator[str]:
        return iter(_COMMANDS)

    def __len__(self) -> int:
        return len(_COMMANDS)


class _Group(TyperGroup):
    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands: Any = _Commands()


app = typer.Typer(
    name="cagemap",
    cls=_Group,
    help=(
        "Dense maps between subdivision surfaces, from their control meshes and a few landmarks, "
        "and transfer along them.\n\n"
        "The target receives, the source gives: `cagemap match` finds for every point of the target its point on the "
        "source, `cagemap transfer` transfers values along this map. Try `cagemap demo` first."
    ),
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    **_PLAIN_TYPER,
)


def _version(is_wanted: bool) -> None:
    if is_wanted:
        say(f"cagemap {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_version,
            is_eager=True,
            show_default=False,
            help="Show the version and stop.  [default: off]",
        ),
    ] = False,
    threads: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="NUMBER",
            help="Largest number of threads; CAGEMAP_THREADS does the same.  [default: all cores]",
        ),
    ] = None,
    verbose: VERBOSE = 0,
    quiet: QUIET = False,
) -> None:
    set_verbosity(verbose, quiet)
    if threads is not None:
        os.environ["CAGEMAP_THREADS"] = os.environ["OPENIMAGEIO_THREADS"] = str(threads)


def _run(request: Any) -> None:
    """Run a request with its progress on standard error, and write its outcome; exit code 1 where not all is well."""
    load_lazily(LAZY_MODULES)
    if isinstance(request, StudioRequest):
        from cagemap.cli.studio import run_studio  # here, since other commands need no server

    run: Callable[..., tuple[str, Any]] = run_studio if isinstance(request, StudioRequest) else runner_of(request)
    with ConsoleStages() as stages:
        summary, outcome = run(request, stages)
    if isinstance(outcome, bool):  # whether all is well
        say(summary, always=request.for_scripts or not outcome)  # also with --quiet
        if not outcome:
            raise typer.Exit(1)
        return
    warn(outcome)
    if summary:
        say(summary)


@cache
def _command(name: str) -> Any:
    """A command by its name."""
    kind = StudioRequest if name == "studio" else request_class(f"{name.capitalize()}Request")
    alone = typer.Typer(**_PLAIN_TYPER)
    alone.command(name, cls=command_class(moved_options(kind)))(command_of(kind, _run))
    return typer.main.get_command(alone)
