"""Commands and their options; the work is in the modules beside this one, imported only when a command runs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from cagemap import __version__
from cagemap.cli.functions_request import functions
from cagemap.cli.map_request import map_file
from cagemap.cli.match_request import match
from cagemap.cli.options import BoundaryOption, CreasingOption, Force, MeshFile, ResultFolder, SchemeOption, UvOption
from cagemap.cli.report_request import report
from cagemap.cli.run_request import run
from cagemap.cli.studio_request import studio
from cagemap.cli.transfer_request import transfer
from cagemap.cli.words import say, set_verbosity
from cagemap.cli.wrap_request import wrap

app = typer.Typer(
    name="cagemap",
    help=(
        "Dense maps between subdivision surfaces, from their control meshes and a few landmarks, "
        "and textures carried across.\n\n"
        "The target receives, the source gives: `cagemap match` finds for every point of the target its place on the "
        "source, `cagemap transfer` fetches what is there. Try `cagemap demo` first."
    ),
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        say(f"cagemap {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and stop.")
    ] = False,
    threads: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Spread work over at most this many threads; all cores by default. CAGEMAP_THREADS says the same.",
        ),
    ] = None,
    verbose: Annotated[
        int, typer.Option("--verbose", "-v", count=True, help="Say every step, and what was fallen back to; -vv: more.")
    ] = 0,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    set_verbosity(verbose, quiet)
    if threads is not None:
        os.environ["CAGEMAP_THREADS"] = os.environ["OPENIMAGEIO_THREADS"] = str(threads)


@app.command()
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
    from cagemap.cli.demo import run_demo
    from cagemap.cli.progress import Stages

    with Stages() as stages:
        report, by_hand = run_demo(output, stages, force=force)
    say(f"The same by hand:\n{by_hand}\nOpen {report} in a browser.")


@app.command()
def check(
    meshes: Annotated[
        list[Path], typer.Argument(metavar="MESH", help="Control meshes, .obj, .ply, .off, .stl or USD.")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Say the same as JSON, for scripts.")] = False,
) -> None:
    """Tell whether control meshes can be used, or what to mend.

    A mesh must be manifold, consistently oriented and in one piece; boundaries are fine. Exit code 1 if any has a
    problem.
    """
    from cagemap.cli import mesh_commands

    text, sound = (mesh_commands.check_values if as_json else mesh_commands.check_files)(meshes)
    say(text, always=not sound)
    if not sound:
        raise typer.Exit(1)


@app.command()
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
    force: Force = False,
) -> None:
    """Subdivide a control mesh.

    Loop for triangle meshes, Catmull-Clark for all others, unless its file says otherwise. Creases and corners shape
    it, holes are left out. Vertex i of the mesh stays vertex i (but for holes). UVs, materials, objects and groups come
    along.
    """
    from cagemap.cli.mesh_commands import refine_file
    from cagemap.cli.subdivision import SubdivisionRequest

    subdivision = SubdivisionRequest(scheme, boundary, uv_interpolation, creasing)
    say(refine_file(mesh, level, output, subdivision=subdivision, force=force))


app.command()(match)
app.command()(transfer)
app.command()(report)


@app.command()
def suggest(
    result: ResultFolder,
    output: Annotated[Path, typer.Option("-o", "--output", help="Landmark file to write, .json.")] = Path(
        "landmarks.json"
    ),
    count: Annotated[int, typer.Option(min=1, help="How many more landmarks.")] = 3,
    force: Force = False,
) -> None:
    """Say where more landmarks would tell most.

    The file holds the landmarks of the result and the new ones, on the source where the map puts them now. Move those
    that are wrong there, and match again.
    """
    from cagemap.cli.suggest import run_suggest

    say(run_suggest(result, output, count, force=force))


app.command()(run)
app.command()(studio)
app.command()(functions)
app.command()(wrap)
app.command("map")(map_file)
