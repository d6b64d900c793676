"""`cagemap match`: its options, each said once, for the command line, job files and the studio's page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option

from cagemap.cli.command import Outcome, asks, in_stages
from cagemap.cli.options import (
    BoundaryOption,
    CreasingOption,
    Force,
    MaskEdgeOption,
    Method,
    SchemeOption,
    SourceMaskOption,
    SourcePartOption,
    SourceSchemeOption,
    TargetMaskOption,
    TargetPartOption,
    TargetSchemeOption,
    UvOption,
)
from cagemap.cli.progress import Stages


@dataclass(frozen=True)
class MatchRequest:
    """What the user asked for, as said on the command line."""

    target: Annotated[Path, Option("--target", "-t", help="Mesh that receives, .obj, .ply, .off, .stl or USD.")]
    source: Annotated[Path, Option("--source", "-s", help="Mesh that gives, .obj, .ply, .off, .stl or USD.")]
    landmarks: Annotated[
        Path | None, Option(help="JSON file of pairs of corresponding points; without one the shapes alone decide.")
    ]
    output: Annotated[Path, Option("-o", "--output", help="RESULT folder to write.")]
    level: Annotated[int | None, Option(min=1, help="Subdivision level of both surfaces.")] = None
    vertices: Annotated[
        int | None, Option(min=1, help="Instead of --level: about this many vertices each, or more.  [default: 200000]")
    ] = None
    k: Annotated[
        int | None, Option("-k", min=3, help="Basis functions of each surface.  [default: 150; 300 with --method hfm]")
    ] = None
    tolerance: Annotated[float, Option(help="Relative error allowed in eigenvalues; sets the level of each band.")] = (
        0.05
    )
    schedule: Annotated[
        str | None,
        Option(help="Basis functions per level, such as 100,50,50,50 (the paper's); replaces -k and --tolerance."),
    ] = None
    target_level: Annotated[int | None, Option(help="--level of the target alone.")] = None
    target_vertices: Annotated[int | None, Option(min=1, help="--vertices of the target alone.")] = None
    target_k: Annotated[int | None, Option(help="-k of the target alone.")] = None
    target_tolerance: Annotated[float | None, Option(help="--tolerance of the target alone.")] = None
    target_schedule: Annotated[str | None, Option(help="--schedule of the target alone.")] = None
    source_level: Annotated[int | None, Option(help="--level of the source alone.")] = None
    source_vertices: Annotated[int | None, Option(min=1, help="--vertices of the source alone.")] = None
    source_k: Annotated[int | None, Option(help="-k of the source alone.")] = None
    source_tolerance: Annotated[float | None, Option(help="--tolerance of the source alone.")] = None
    source_schedule: Annotated[str | None, Option(help="--schedule of the source alone.")] = None
    laplacian: Annotated[
        str | None,
        Option(
            help="Of quads: mean of both triangulations, alexa-wardetzky (the paper's) or de-goes-butts-desbrun, these "
            "with :LAMBDA where it is not 1.  [default: mean]"
        ),
    ] = None
    accuracy: Annotated[
        float | None,
        Option(help="Convergence of the eigensolver.  [default: a thousandth of --tolerance, 1e-5 of a --schedule]"),
    ] = None
    literal: Annotated[bool, Option("--literal", help="With --schedule: the paper's Definition 2 to the letter.")] = (
        False
    )
    target_laplacian: Annotated[str | None, Option(help="--laplacian of the target alone.")] = None
    target_accuracy: Annotated[float | None, Option(help="--accuracy of the target alone.")] = None
    target_literal: Annotated[bool, Option("--target-literal", help="--literal of the target alone.")] = False
    source_laplacian: Annotated[str | None, Option(help="--laplacian of the source alone.")] = None
    source_accuracy: Annotated[float | None, Option(help="--accuracy of the source alone.")] = None
    source_literal: Annotated[bool, Option("--source-literal", help="--literal of the source alone.")] = False
    method: Annotated[
        Method,
        Option(
            help="elastic: spectral map finished by an elastic fit, landmarks met exactly. "
            "hfm: hierarchical functional map, each band found by the paper's eqs. 14-16 and by the map so far. "
            "paper: the paper's own method, from level 0 on; give it a --schedule."
        ),
    ] = Method.ELASTIC
    parameter: Annotated[
        tuple[str, ...],
        Option(
            metavar="NAME=VALUE", help="A parameter of the spectral method, such as laplacian=0.01; repeat it for more."
        ),
    ] = ()
    symmetry: Annotated[
        bool, Option("--symmetry/--no-symmetry", help="Use mirror symmetry where both meshes have it.")
    ] = True
    target_symmetry: Annotated[
        tuple[Path, ...], Option(help="File with the image of every control vertex of the target.")
    ] = ()
    source_symmetry: Annotated[
        tuple[Path, ...], Option(help="The same symmetry of the source; repeat both for more.")
    ] = ()
    exchange_landmarks: Annotated[
        bool, Option("--exchange-landmarks", help="The landmark file was made for the other direction.")
    ] = False
    trust_landmarks: Annotated[
        bool, Option("--trust-landmarks", help="Meet every landmark; otherwise pairs that look wrong are left out.")
    ] = False
    answer: Annotated[
        int,
        Option(
            min=0, help="Take another of the answers that a match named: 1 is the runner-up, or the mirrored reading."
        ),
    ] = 0
    target_points: Annotated[
        Path | None,
        Option(help="Instead of --landmarks: named points of the target (.json, .pp, .mrk.json, .fcsv, .csv, Wrap's)."),
    ] = None
    source_points: Annotated[Path | None, Option(help="The source's points; equal names are landmarks.")] = None
    curves: Annotated[
        Path | None,
        Option(
            help="JSON file of curves that correspond (eyelids, lips, hems), as chains or loops of control vertices."
        ),
    ] = None
    scheme: SchemeOption = None
    target_scheme: TargetSchemeOption = None
    source_scheme: SourceSchemeOption = None
    boundary: BoundaryOption = None
    uv_interpolation: UvOption = None
    creasing: CreasingOption = None
    part: Annotated[
        str | None,
        Option(
            help="Match only this object, group, material or component of both files, the largest, or each piece, or "
            "material, with its counterpart (each, material); `cagemap check` lists them."
        ),
    ] = None
    target_part: TargetPartOption = None
    source_part: SourcePartOption = None
    target_uv_set: Annotated[str | None, Option(help="UV set of the target to bake into, by name.")] = None
    source_uv_set: Annotated[str | None, Option(help="UV set of the source that its images belong to.")] = None
    target_mask: TargetMaskOption = None
    source_mask: SourceMaskOption = None
    mask_edge: MaskEdgeOption = None
    cache: Annotated[
        Path | None, Option(help="Folder that keeps prepared surfaces, so that each is prepared once.")
    ] = None
    force: Force = False


@asks(MatchRequest)
@in_stages
def match(request: MatchRequest, stages: Stages) -> Outcome:
    """Find for every point of the target its place on the source.

    Writes a folder with manifest.json (what was done, how long it took, how good the map is) and map.npz (the map
    itself). Without landmarks every way in which one shape may lie on the other is tried, and the answer says how sure
    it is. Landmarks make it better: six to thirty, spread over the whole surface, are a good number; tips of limbs,
    nose and tail first.
    """
    from cagemap.cli.match import run_match

    return run_match(request, stages)
