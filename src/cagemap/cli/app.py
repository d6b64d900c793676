"""Commands and their options; the work is in the modules beside this one, imported only when a command runs."""

from __future__ import annotations

import os
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from cagemap import __version__
from cagemap.cli.map_command import map_file
from cagemap.cli.subdivision import BoundaryName, CreasingName, SchemeName, UvName
from cagemap.cli.words import say, set_verbosity, warn
from cagemap.cli.wrap_command import wrap

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
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)

MeshFile = Annotated[Path, typer.Argument(help="Control mesh, .obj, .ply or USD.", show_default=False)]
Force = Annotated[
    bool, typer.Option("--force", help="Overwrite files that cagemap did not write, or that were changed since.")
]
ResultFolder = Annotated[Path, typer.Argument(help="Folder that `cagemap match` wrote.", show_default=False)]

SchemeOption = Annotated[
    SchemeName | None,
    typer.Option(
        "--scheme",
        help="Subdivision scheme; none takes the mesh as it is.  [default: as the file says, else loop for triangles]",
        show_default=False,
    ),
]
BoundaryOption = Annotated[
    BoundaryName | None,
    typer.Option(
        "--boundary",
        help="Whether boundary vertices with a single face stay.  [default: as the file says, else edge-and-corner]",
        show_default=False,
    ),
]
UvOption = Annotated[
    UvName | None,
    typer.Option(
        "--uv-interpolation", help="Where UVs stay linear.  [default: as the file says, else all]", show_default=False
    ),
]
CreasingOption = Annotated[
    CreasingName | None,
    typer.Option(
        "--creasing", help="How creases soften.  [default: as the file says, else uniform]", show_default=False
    ),
]


class Method(StrEnum):
    """Matching methods."""

    ELASTIC = "elastic"
    HFM = "hfm"
    PAPER = "paper"


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
            "--threads",
            min=1,
            help="Spread work over at most this many threads; all cores by default. CAGEMAP_THREADS says the same.",
            show_default=False,
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
        list[Path], typer.Argument(metavar="MESH...", help="Control meshes, .obj, .ply or USD.", show_default=False)
    ],
) -> None:
    """Tell whether control meshes can be used, and if not, what to mend and where.

    A mesh must be manifold, consistently oriented and in one piece; boundaries are fine. Exit code 1 if any has a
    problem.
    """
    from cagemap.cli.mesh_commands import check_files

    text, sound = check_files(meshes)
    say(text)
    if not sound:
        raise typer.Exit(1)


@app.command()
def refine(
    mesh: MeshFile,
    level: Annotated[
        int, typer.Option("--level", "-l", min=0, help="Subdivision steps; each has about 4 times the faces.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Mesh to write, .obj, .ply or USD.")],
    scheme: SchemeOption = None,
    boundary: BoundaryOption = None,
    uv_interpolation: UvOption = None,
    creasing: CreasingOption = None,
    force: Force = False,
) -> None:
    """Subdivide a control mesh: Loop for triangle meshes, Catmull-Clark for all others, unless its file says otherwise.

    Creases and corners shape it, holes are left out. Vertex i of the mesh stays vertex i (but for holes). UVs,
    materials, objects and groups come along.
    """
    from cagemap.cli.mesh_commands import refine_file
    from cagemap.cli.subdivision import SubdivisionRequest

    subdivision = SubdivisionRequest(scheme, boundary, uv_interpolation, creasing)
    say(refine_file(mesh, level, output, subdivision=subdivision, force=force))


@app.command()
def match(
    target: Annotated[Path, typer.Option("--target", "-t", help="Control mesh that receives, .obj, .ply or USD.")],
    source: Annotated[Path, typer.Option("--source", "-s", help="Control mesh that gives, .obj, .ply or USD.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="RESULT folder to write.")],
    landmarks: Annotated[
        Path | None,
        typer.Option(
            "--landmarks",
            help="JSON file of corresponding control vertices; without one the shapes alone decide.",
            show_default=False,
        ),
    ] = None,
    level: Annotated[
        int | None, typer.Option("--level", min=1, help="Subdivision level of both surfaces.", show_default=False)
    ] = None,
    vertices: Annotated[
        int | None,
        typer.Option(
            "--vertices",
            min=1,
            help="Instead of --level: about this many vertices each.  [default: 200000]",
            show_default=False,
        ),
    ] = None,
    k: Annotated[
        int | None,
        typer.Option(
            "-k",
            min=3,
            help="Basis functions of each surface.  [default: 150; 300 with --method hfm]",
            show_default=False,
        ),
    ] = None,
    tolerance: Annotated[
        float, typer.Option("--tolerance", help="Relative error allowed in eigenvalues; sets the level of each band.")
    ] = 0.05,
    schedule: Annotated[
        str | None,
        typer.Option(
            "--schedule",
            help="Basis functions per level, such as 100,50,50,50 (the paper's); replaces -k and --tolerance.",
            show_default=False,
        ),
    ] = None,
    target_level: Annotated[
        int | None, typer.Option("--target-level", help="--level of the target alone.", show_default=False)
    ] = None,
    target_k: Annotated[
        int | None, typer.Option("--target-k", help="-k of the target alone.", show_default=False)
    ] = None,
    target_tolerance: Annotated[
        float | None, typer.Option("--target-tolerance", help="--tolerance of the target alone.", show_default=False)
    ] = None,
    target_schedule: Annotated[
        str | None, typer.Option("--target-schedule", help="--schedule of the target alone.", show_default=False)
    ] = None,
    source_level: Annotated[
        int | None, typer.Option("--source-level", help="--level of the source alone.", show_default=False)
    ] = None,
    source_k: Annotated[
        int | None, typer.Option("--source-k", help="-k of the source alone.", show_default=False)
    ] = None,
    source_tolerance: Annotated[
        float | None, typer.Option("--source-tolerance", help="--tolerance of the source alone.", show_default=False)
    ] = None,
    source_schedule: Annotated[
        str | None, typer.Option("--source-schedule", help="--schedule of the source alone.", show_default=False)
    ] = None,
    method: Annotated[
        Method,
        typer.Option(
            "--method",
            help="elastic: spectral map finished by an elastic fit, landmarks met exactly. "
            "hfm: hierarchical functional map, each band found by the paper's eqs. 14-16 and by the map so far. "
            "paper: the paper's own method, from level 0 on; give it a --schedule.",
        ),
    ] = Method.ELASTIC,
    parameter: Annotated[
        list[str] | None,
        typer.Option(
            "--parameter",
            metavar="NAME=VALUE",
            help="A parameter of the spectral method, such as laplacian=0.01; repeat it for more.",
            show_default=False,
        ),
    ] = None,
    symmetry: Annotated[
        bool, typer.Option("--symmetry/--no-symmetry", help="Use mirror symmetry where both meshes have it.")
    ] = True,
    target_symmetry: Annotated[
        list[Path] | None,
        typer.Option(
            "--target-symmetry", help="File with the image of every control vertex of the target.", show_default=False
        ),
    ] = None,
    source_symmetry: Annotated[
        list[Path] | None,
        typer.Option(
            "--source-symmetry", help="The same symmetry of the source; repeat both for more.", show_default=False
        ),
    ] = None,
    exchange_landmarks: Annotated[
        bool, typer.Option("--exchange-landmarks", help="The landmark file was made for the other direction.")
    ] = False,
    trust_landmarks: Annotated[
        bool,
        typer.Option("--trust-landmarks", help="Meet every landmark; otherwise pairs that look wrong are left out."),
    ] = False,
    target_points: Annotated[
        Path | None,
        typer.Option(
            "--target-points",
            help="Instead of --landmarks: named points of the target (.json, .pp, .mrk.json, .fcsv, .csv, Wrap's).",
            show_default=False,
        ),
    ] = None,
    source_points: Annotated[
        Path | None,
        typer.Option("--source-points", help="The source's points; equal names are landmarks.", show_default=False),
    ] = None,
    scheme: SchemeOption = None,
    boundary: BoundaryOption = None,
    uv_interpolation: UvOption = None,
    creasing: CreasingOption = None,
    part: Annotated[
        str | None,
        typer.Option(
            "--part",
            help="Match only this object, group, material or component of both files, the largest, or each with its "
            "counterpart; `cagemap check` lists them.",
            show_default=False,
        ),
    ] = None,
    target_part: Annotated[
        str | None, typer.Option("--target-part", help="As --part, of the target alone.", show_default=False)
    ] = None,
    source_part: Annotated[
        str | None, typer.Option("--source-part", help="As --part, of the source alone.", show_default=False)
    ] = None,
    target_uv_set: Annotated[
        str | None,
        typer.Option("--target-uv-set", help="UV set of the target to bake into, by name.", show_default=False),
    ] = None,
    source_uv_set: Annotated[
        str | None,
        typer.Option("--source-uv-set", help="UV set of the source that its images belong to.", show_default=False),
    ] = None,
    cache: Annotated[
        Path | None,
        typer.Option(
            "--cache", help="Folder that keeps prepared surfaces, so that each is prepared once.", show_default=False
        ),
    ] = None,
    force: Force = False,
) -> None:
    """Find for every point of the target its place on the source.

    Writes a folder with manifest.json (what was done, how long it took, how good the map is) and map.npz (the map
    itself). Without landmarks every way in which one shape may lie on the other is tried, and the answer says how sure
    it is. Landmarks make it better: six to thirty, spread over the whole surface, are a good number; tips of limbs,
    nose and tail first.
    """
    from cagemap.cli.match import MatchRequest, run_match
    from cagemap.cli.progress import Stages

    request = MatchRequest(
        target=target,
        source=source,
        landmarks=landmarks,
        output=output,
        level=level,
        vertices=vertices,
        k=k,
        tolerance=tolerance,
        schedule=schedule,
        target_level=target_level,
        source_level=source_level,
        target_k=target_k,
        source_k=source_k,
        target_tolerance=target_tolerance,
        source_tolerance=source_tolerance,
        target_schedule=target_schedule,
        source_schedule=source_schedule,
        method=method.value,
        parameter=tuple(parameter or ()),
        symmetry=symmetry,
        target_symmetry=tuple(target_symmetry or ()),
        source_symmetry=tuple(source_symmetry or ()),
        exchange_landmarks=exchange_landmarks,
        trust_landmarks=trust_landmarks,
        target_points=target_points,
        source_points=source_points,
        scheme=scheme,
        boundary=boundary,
        uv_interpolation=uv_interpolation,
        creasing=creasing,
        part=part,
        target_part=target_part,
        source_part=source_part,
        target_uv_set=target_uv_set,
        source_uv_set=source_uv_set,
        cache=cache,
        force=force,
    )
    with Stages() as stages:
        summary, warnings = run_match(request, stages)
    warn(warnings)
    say(summary)


@app.command()
def transfer(
    result: ResultFolder,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help="Image to write; with --attribute a .npy, .npz or .csv, with --source-uvs a mesh."
        ),
    ],
    texture: Annotated[
        list[str] | None,
        typer.Option(
            "--texture",
            help="Source texture: colour, roughness, any image. Several as NAME=IMAGE, once each; -o gets their names.",
            show_default=False,
        ),
    ] = None,
    usd: Annotated[
        Path | None,
        typer.Option(
            "--usd",
            help="Also write a USD layer over the target that has the textures or attributes.",
            show_default=False,
        ),
    ] = None,
    displacement: Annotated[
        Path | None, typer.Option("--displacement", help="Source displacement along the normal.", show_default=False)
    ] = None,
    normal_map: Annotated[
        Path | None, typer.Option("--normal-map", help="Source normal map, turned with the map.", show_default=False)
    ] = None,
    vector_displacement: Annotated[
        Path | None, typer.Option("--vector-displacement", help="Source vector displacement.", show_default=False)
    ] = None,
    space: Annotated[str, typer.Option("--space", help="Of normals and vectors: tangent (MikkTSpace) or object.")] = (
        "tangent"
    ),
    green: Annotated[str, typer.Option("--green", help="Normal map: green up (OpenGL) or down (DirectX).")] = "up",
    as_color: Annotated[
        bool, typer.Option("--as-color", help="Texture: carry what looks like a normal map as a picture.")
    ] = False,
    attribute: Annotated[
        Path | None,
        typer.Option(
            "--attribute",
            help="Values at the source's control vertices, faces or face corners: .npy, .npz or .csv.",
            show_default=False,
        ),
    ] = None,
    material_colors: Annotated[
        bool, typer.Option("--material-colors", help="Bake the source's material colours.")
    ] = False,
    source_uvs: Annotated[
        bool,
        typer.Option("--source-uvs", help="Give the target the source's UVs; -o names the mesh, and seams are listed."),
    ] = False,
    weights: Annotated[
        Path | None,
        typer.Option(
            "--weights", help="Skinning weights of the source's cage, a column a joint: .csv, .npz.", show_default=False
        ),
    ] = None,
    influences: Annotated[
        int, typer.Option("--influences", min=0, help="Weights: at most so many joints a vertex; 0 for all.")
    ] = 4,
    joints: Annotated[
        Path | None,
        typer.Option("--joints", help="Skeleton of the source, .json; with --weights its names.", show_default=False),
    ] = None,
    blend_shapes: Annotated[
        list[Path] | None,
        typer.Option(
            "--blend-shapes",
            help="Shapes of the source's cage: .obj, .npz or a folder; repeat it for more.",
            show_default=False,
        ),
    ] = None,
    write_map: Annotated[
        bool, typer.Option("--write-map", help="The map itself, for other programs: .npy, .npz, .mtx or .vts.")
    ] = False,
    size: Annotated[
        int | None,
        typer.Option(
            "--size",
            min=1,
            max=65_536,
            help="Width and height in texels.  [default: the source image's, or 2048]",
            show_default=False,
        ),
    ] = None,
    bits: Annotated[
        int | None,
        typer.Option(
            "--bits", help="8, 16 or 32 (float) a channel.  [default: as the source image]", show_default=False
        ),
    ] = None,
    scale: Annotated[
        float, typer.Option("--scale", help="Displacement: source height between the values 0 and 1.")
    ] = 1.0,
    midlevel: Annotated[
        float | None,
        typer.Option(
            "--midlevel",
            help="Displacement: value that means none.  [default: 0.5 for integers, 0 for floats]",
            show_default=False,
        ),
    ] = None,
    unwrap: Annotated[
        bool,
        typer.Option(
            "--unwrap", help="Give a target without UVs a layout, and write a mesh that has it beside the image."
        ),
    ] = False,
    force: Force = False,
) -> None:
    """Carry something from source to target: textures, attributes, UVs, skinning weights, joints, blend shapes.

    Images are baked into the target's own UV layout, texel by texel, across the source's seams.
    """
    from cagemap.cli.progress import Stages
    from cagemap.cli.texture_maps import texture_and_maps
    from cagemap.cli.transfer import TransferRequest, run_transfer

    image, maps = texture_and_maps(texture or [])
    request = TransferRequest(
        result=result,
        output=output,
        texture=image,
        maps=maps,
        usd=usd,
        displacement=displacement,
        normal_map=normal_map,
        vector_displacement=vector_displacement,
        space=space,
        green=green,
        as_color=as_color,
        attribute=attribute,
        material_colors=material_colors,
        source_uvs=source_uvs,
        weights=weights,
        influences=influences,
        joints=joints,
        blend_shapes=tuple(blend_shapes or ()),
        write_map=write_map,
        size=size,
        bits=bits,
        unwrap=unwrap,
        midlevel=midlevel,
        scale=scale,
        force=force,
    )
    with Stages() as stages:
        summary, warnings = run_transfer(request, stages)
    warn(warnings)
    say(summary)


@app.command()
def report(
    result: ResultFolder,
    output: Annotated[Path, typer.Option("-o", "--output", help="HTML file to write.")] = Path("report.html"),
    texture: Annotated[
        Path | None,
        typer.Option(
            "--texture", help="Source texture to show.  [default: that of the last transfer]", show_default=False
        ),
    ] = None,
    force: Force = False,
) -> None:
    """Write one HTML page: both surfaces in the same views, the map as colours, quality in plain words.

    The page needs nothing beside it: mail it, print it.
    """
    from cagemap.cli.progress import Stages
    from cagemap.cli.report import run_report

    with Stages() as stages:
        run_report(result, output, texture, stages, force=force)
    say(f"Open {output} in a browser.")


@app.command()
def suggest(
    result: ResultFolder,
    output: Annotated[Path, typer.Option("-o", "--output", help="Landmark file to write, .json.")] = Path(
        "landmarks.json"
    ),
    count: Annotated[int, typer.Option("--count", min=1, help="How many more landmarks.")] = 3,
    force: Force = False,
) -> None:
    """Say where more landmarks would tell most, and write them for correction.

    The file holds the landmarks of the result and the new ones, on the source where the map puts them now. Move those
    that are wrong there, and match again.
    """
    from cagemap.cli.suggest import run_suggest

    say(run_suggest(result, output, count, force=force))


@app.command()
def run(
    job: Annotated[Path, typer.Argument(help="Job file, .toml.", show_default=False)],
    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler",
            help="Address of a running Dask scheduler, such as tcp://host:8786.  [default: processes here]",
            show_default=False,
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option("--workers", min=1, help="Processes here.  [default: one for each core]", show_default=False),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only say what would be done, and about how long it takes.")
    ] = False,
) -> None:
    """Match and transfer many pairs, as a job file says: each surface is prepared once, what is done is kept.

    Writes a folder with a RESULT for every pair, what the job asks for beside it, index.html and figures.csv.
    Run it again after a failure or a change: only what is missing is done. Exit code 1 if anything failed.
    """
    from cagemap.cli.library import RunRequest, run_job
    from cagemap.cli.progress import Stages

    with Stages() as stages:
        text, complete = run_job(RunRequest(job, scheduler, workers, dry_run), stages)
    say(text)
    if not complete:
        raise typer.Exit(1)


@app.command()
def studio(
    target: Annotated[
        Path | None, typer.Option("--target", "-t", help="Control mesh that receives.", show_default=False)
    ] = None,
    source: Annotated[
        Path | None, typer.Option("--source", "-s", help="Control mesh that gives.", show_default=False)
    ] = None,
    landmarks: Annotated[
        Path | None, typer.Option("--landmarks", help="Landmark file to open and save.", show_default=False)
    ] = None,
    texture: Annotated[
        Path | None, typer.Option("--texture", help="Image over the source's UVs.", show_default=False)
    ] = None,
    result: Annotated[
        Path | None, typer.Option("--result", help="RESULT folder of the finish.", show_default=False)
    ] = None,
    folder: Annotated[
        list[Path] | None,
        typer.Option("--folder", help="Folder whose files the page may open and write; repeat it for more."),
    ] = None,
    host: Annotated[str, typer.Option("--host", help="Address to serve; others than loopback need the token.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="The next free one is taken.")] = 8765,
    vertices: Annotated[int, typer.Option("--vertices", min=1, help="About this many a model, in the page.")] = 25_000,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Do not open the page.")] = False,
) -> None:
    """Open both models in the browser: see the map, click landmarks where it is wrong, bake.

    Without models the built-in pair opens. The page reads and writes only in the folders of the files given here.
    """
    from cagemap.cli.studio import StudioRequest, run_studio

    request = StudioRequest(
        target=target,
        source=source,
        landmarks=landmarks,
        texture=texture,
        result=result,
        folder=tuple(folder or ()),
        host=host,
        port=port,
        vertices=vertices,
        no_browser=no_browser,
    )
    run_studio(request, say)


app.command()(wrap)
app.command("map")(map_file)
