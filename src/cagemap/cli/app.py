"""The typer application with all commands; tasks are imported when a command runs."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer

from cagemap import __version__
from cagemap.cli.commands import face, functions, map_file, match, report, rig, run, studio, transfer, wrap
from cagemap.cli.console import say, set_verbosity
from cagemap.cli.request_command import command_class, typer_parameter
from cagemap.tasks.requests.options import (
    BoundaryOption,
    CreasingOption,
    Force,
    MeshFile,
    ResultFolder,
    SchemeOption,
    UvOption,
    WeldOption,
)

_Verbose = Annotated[
    int,
    typer.Option(
        "--verbose",
        "-v",
        count=True,
        show_default=False,
        help="Print every step and every fallback; -vv: more.  [default: off]",
    ),
]
_Quiet = Annotated[
    bool,
    typer.Option(
        "--quiet", "-q", show_default=False, help="Print errors only: no results, warnings or progress.  [default: off]"
    ),
]

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


def _command(name: str | None = None) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator that adds a command with the options -v and -q."""

    def add(run: Callable[..., None]) -> Callable[..., None]:
        @wraps(run)
        def command(*, verbose: int, quiet: bool, **options: Any) -> None:
            if verbose or quiet:
                set_verbosity(verbose, quiet)
            run(**options)

        hints = get_type_hints(run, include_extras=True)
        parameters = [
            parameter.replace(annotation=_typer_annotation(hints[parameter.name], parameter.default))
            for parameter in signature(run).parameters.values()
        ]
        output_options = [
            Parameter("verbose", Parameter.KEYWORD_ONLY, default=0, annotation=_Verbose),
            Parameter("quiet", Parameter.KEYWORD_ONLY, default=False, annotation=_Quiet),
        ]
        vars(command).update(__signature__=Signature([*parameters, *output_options]))
        app.command(name, cls=command_class(getattr(run, "replacements", {})))(command)
        return run

    return add


def _typer_annotation(hint: Any, default: Any) -> Any:
    """A parameter's type with request options converted for typer."""
    if get_origin(hint) is not Annotated:
        return hint
    kind, *metadata = get_args(hint)
    return Annotated[kind, *(typer_parameter(item, default) for item in metadata)]


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
            help="Largest number of threads; CAGEMAP_THREADS does the same.  [default: all cores]",
        ),
    ] = None,
    verbose: _Verbose = 0,
    quiet: _Quiet = False,
) -> None:
    set_verbosity(verbose, quiet)
    if threads is not None:
        os.environ["CAGEMAP_THREADS"] = os.environ["OPENIMAGEIO_THREADS"] = str(threads)


@_command()
def demo(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to write everything to.")] = Path(
        "cagemap-demo"
    ),
    force: Force = False,
) -> None:
    """Run the built-in pair end to end and write DIR/report.html.

    Two small creatures made for this purpose: the striped pony gives its texture to the deer. The folder also gets
    the meshes, landmarks and texture, so that you can repeat every step by hand.
    """
    from cagemap.cli.progress import ConsoleStages
    from cagemap.tasks.demo import run_demo

    with ConsoleStages() as stages:
        report, by_hand = run_demo(output, stages, force=force)
    say(f"The same by hand:\n{by_hand}\nOpen {report} in a browser.")


@_command()
def check(
    meshes: Annotated[
        list[Path],
        typer.Argument(metavar="MESH", help="Control meshes, .obj, .ply, .off, .stl, glTF, VRM, FBX or USD."),
    ],
    as_json: Annotated[
        bool, typer.Option("--json", show_default=False, help="Print JSON, for scripts.  [default: off]")
    ] = False,
    scheme: SchemeOption = None,
    weld: WeldOption = None,
) -> None:
    """Check control meshes, and say what to repair.

    A mesh must be manifold, consistently oriented and in one piece; boundaries are allowed. With scheme none, of the
    file or by --scheme, it lists what a match repairs and leaves out. Exit code 1 if any mesh has a problem.
    """
    from cagemap.tasks import mesh_commands
    from cagemap.tasks.subdivision import SubdivisionRequest

    check_meshes = mesh_commands.check_values if as_json else mesh_commands.check_files
    text, sound = check_meshes(meshes, SubdivisionRequest(scheme), weld)
    say(text, always=as_json or not sound)
    if not sound:
        raise typer.Exit(1)


@_command()
def refine(
    mesh: MeshFile,
    level: Annotated[
        int, typer.Option("--level", "-l", min=0, help="Subdivision steps; each has about 4 times the faces.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Mesh to write, .obj, .ply, .off, .glb or USD.")],
    scheme: SchemeOption = None,
    boundary: BoundaryOption = None,
    uv_interpolation: UvOption = None,
    creasing: CreasingOption = None,
    weld: WeldOption = None,
    quads: Annotated[
        bool,
        typer.Option(
            "--quads", show_default=False, help="Join triangles to the quads that an exporter split.  [default: off]"
        ),
    ] = False,
    force: Force = False,
) -> None:
    """Subdivide a control mesh.

    Loop for triangle meshes, Catmull-Clark for all others, unless its file says otherwise. Creases and corners shape
    it, holes are left out. Vertex i of the mesh stays vertex i (but for holes and welded vertices). UVs, materials,
    objects and groups come along. The mesh may have several pieces.
    """
    from cagemap.tasks.mesh_commands import refine_file
    from cagemap.tasks.subdivision import SubdivisionRequest

    subdivision = SubdivisionRequest(scheme, boundary, uv_interpolation, creasing)
    say(refine_file(mesh, level, output, subdivision=subdivision, weld=weld, quads=quads, force=force))


_command()(match)
_command()(transfer)
_command()(rig)
_command()(face)
_command()(report)


@_command()
def suggest(
    result: ResultFolder,
    output: Annotated[Path, typer.Option("-o", "--output", help="Landmark file to write, .json.")] = Path(
        "landmarks.json"
    ),
    count: Annotated[int, typer.Option(min=1, help="How many more landmarks.")] = 3,
    force: Force = False,
) -> None:
    """Suggest places for more landmarks.

    The file holds the landmarks of the result and the new ones, on the source where the map puts them now. Correct the
    wrong ones and match again.
    """
    from cagemap.tasks.suggest import run_suggest

    say(run_suggest(result, output, count, force=force))


_command()(run)
_command()(studio)
_command()(functions)
_command()(wrap)
_command("map")(map_file)
