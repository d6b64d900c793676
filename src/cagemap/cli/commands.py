"""Commands that make a request from their options and run its task."""

from __future__ import annotations

from typing import Any

from typer import Exit

from cagemap.cli.console import say
from cagemap.cli.progress import ConsoleStages
from cagemap.cli.request_command import request_command, with_stages
from cagemap.tasks.progress import Outcome, Stages
from cagemap.tasks.requests.face import FaceRequest
from cagemap.tasks.requests.functions import FunctionsRequest
from cagemap.tasks.requests.import_map import MapRequest
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.report import ReportRequest
from cagemap.tasks.requests.rig import RigRequest
from cagemap.tasks.requests.run import RunRequest
from cagemap.tasks.requests.studio import StudioRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.requests.wrap import WrapRequest


@request_command(MatchRequest)
@with_stages
def match(request: MatchRequest, stages: Stages) -> Outcome:
    """Find for every point of the target its place on the source.

    Writes a folder with manifest.json (settings, timings, quality) and map.npz (the map). Without landmarks several
    alignments are tried, and the verdict says how sure the best one is. Landmarks improve the map: six to thirty,
    spread over the whole surface; tips of limbs, nose and tail first.
    """
    from cagemap.tasks.match import run_match

    return run_match(request, stages)


def _read_transfer(
    texture: tuple[str, ...], bases: tuple[str, ...], bake: str | None, **others: Any
) -> TransferRequest:
    """The transfer request of option words: named images and comma-separated kinds of bakes."""
    from cagemap.tasks.requests.transfer import texture_and_maps

    image, maps = texture_and_maps(texture)
    base, named_bases = texture_and_maps(bases, "--base")
    bakes = tuple(name.strip() for name in bake.split(",")) if bake else ()
    all_bases = named_bases if base is None else (("", base),)
    return TransferRequest(texture=image, maps=maps, bases=all_bases, bake=bakes, **others)


@request_command(
    TransferRequest,
    word_types={"texture": tuple[str, ...], "bases": tuple[str, ...], "bake": str | None},
    make_request=_read_transfer,
)
@with_stages
def transfer(request: TransferRequest, stages: Stages) -> Outcome:
    """Carry textures, values, rigs or shapes to the target.

    Images are baked into the target's own UV layout, texel by texel, across the source's seams.
    """
    from cagemap.tasks.transfer import run_transfer

    return run_transfer(request, stages)


@request_command(WrapRequest)
@with_stages
def wrap(request: WrapRequest, stages: Stages) -> Outcome:
    """Give the target's cage the source's shape.

    The refined surface is fitted to the source. Vertices, faces, UVs, groups and materials stay those of the target.
    """
    from cagemap.tasks.wrap import run_wrap

    return run_wrap(request, stages)


@request_command(RigRequest)
@with_stages
def rig(request: RigRequest, stages: Stages) -> Outcome:
    """Rig, texture, dress and animate a body like a character.

    Joints, weights, blend shapes, textures, clothes, eyes, hair and animations of the character go to the body, as one
    file. The body's mesh stays as it is; what it has of its own, such as eyes, stays and follows it.
    """
    from cagemap.tasks.rig_character import run_rig

    return run_rig(request, stages)


@request_command(FaceRequest)
@with_stages
def face(request: FaceRequest, stages: Stages) -> Outcome:
    """Give a head the face shapes of ARKit.

    51 of the 52, from ICT-FaceKit (MIT): tongueOut is not among them. The head keeps its vertices, materials, rig and
    own shapes; teeth, tongue and eyes that are parts of their own stay. Of a body with a skeleton the head and neck are
    taken.
    """
    from cagemap.tasks.face import run_face

    return run_face(request, stages)


@request_command(ReportRequest)
@with_stages
def report(request: ReportRequest, stages: Stages) -> Outcome:
    """Write one HTML page: a verdict, and both models in 3D.

    Shows both models coloured by the map, marks of doubtful places, and what was transferred. The page is one file and
    needs no network.
    """
    from cagemap.tasks.report import run_report

    return run_report(request, stages)


@request_command(RunRequest)
def run(request: RunRequest) -> None:
    """Match and transfer all pairs of a job file.

    Writes a folder with a RESULT for every pair, the outputs of the job, index.html and figures.csv. Finished tasks are
    kept: after a failure or a change, run it again and only missing tasks are done. Exit code 1 if anything failed.
    """
    from cagemap.tasks.run_job import run_job

    with ConsoleStages() as stages:
        text, complete = run_job(request, stages)
    say(text, always=not complete or request.dry_run or request.export is not None)
    if not complete:
        raise Exit(1)


@request_command(StudioRequest)
def studio(request: StudioRequest) -> None:
    """View and correct the map in the browser, and bake textures.

    Without models the built-in pair opens. The page reads and writes only in the folders of the files given here.
    """
    from cagemap.cli.studio import run_studio

    run_studio(request, say)


@request_command(FunctionsRequest)
@with_stages
def functions(request: FunctionsRequest, stages: Stages) -> Outcome:
    """Write eigenfunctions and descriptors of one mesh.

    Row i belongs to vertex i of the mesh that `cagemap refine` writes at the same level. The surface has unit area:
    eigenvalues and times do not depend on the file's unit.
    """
    from cagemap.tasks.functions import run_functions

    return run_functions(request, stages)


@request_command(MapRequest)
@with_stages
def map_file(request: MapRequest, stages: Stages) -> Outcome:
    """Import a point map of any method as a RESULT.

    The RESULT can be used for baking, wrapping and reports. A map is a list of source vertices, one for each vertex of
    the target at any level; or triangles of the source's level and barycentric coordinates; or a sparse matrix.
    `cagemap transfer RESULT --write-map` writes them. With --weld the numbers are those of what `cagemap refine --weld`
    writes.
    """
    from cagemap.tasks.import_map import run_map

    return run_map(request, stages)
