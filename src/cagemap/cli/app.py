"""The typer application with all commands. It imports their requests; a task is imported when its command runs."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Annotated, Any

import typer

from cagemap import __version__
from cagemap.cli.console import say, set_verbosity, warn
from cagemap.cli.progress import ConsoleStages
from cagemap.cli.request_command import LAZY_MODULES, QUIET, VERBOSE, command_class, command_of, load_lazily
from cagemap.tasks import request_class, runner_of
from cagemap.tasks.requests.settings import moved_options
from cagemap.tasks.requests.studio import StudioRequest

# In the order of `--help`; the request of "demo" is `DemoRequest`.
_COMMANDS = "demo check refine match transfer rig face report suggest run studio functions wrap map".split()

app = typer.Typer(
    name="cagemap",
    help=(
        "Dense maps between subdivision surfaces, from their control meshes and a few landmarks, "
        "and transfer along them.\n\n"
        "The target receives, the source gives: `cagemap match` finds for every point of the target its point on the "
        "source, `cagemap transfer` transfers values along this map. Try `cagemap demo` first."
    ),
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
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


for _name in _COMMANDS:
    _kind = StudioRequest if _name == "studio" else request_class(f"{_name.capitalize()}Request")
    app.command(_name, cls=command_class(moved_options(_kind)))(command_of(_kind, _run))
