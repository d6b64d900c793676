"""The options of `cagemap match`, each said once: fields of a request for Python, options for the command line."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from cagemap.cli.options import (
    BoundaryOption,
    CreasingOption,
    Force,
    MaskEdgeOption,
    Method,
    SchemeOption,
    SourceMaskOption,
    SourceSchemeOption,
    TargetMaskOption,
    TargetSchemeOption,
    UvOption,
)


@dataclass(frozen=True)
class MatchRequest:
    """What the user asked for, as said on the command line."""

    target: Annotated[Path, typer.Option("--target", "-t", help="Mesh that receives, .obj, .ply, .off, .stl or USD.")]
    source: Annotated[Path, typer.Option("--source", "-s", help="Mesh that gives, .obj, .ply, .off, .stl or USD.")]
    landmarks: Annotated[
        Path | None,
        typer.Option(
            "--landmarks",
            help="JSON file of pairs of corresponding points; without one the shapes alone decide.",
            show_default=False,
        ),
    ]
    output: Annotated[Path, typer.Option("-o", "--output", help="RESULT folder to write.")]
    level: Annotated[
        int | None, typer.Option("--level", min=1, help="Subdivision level of both surfaces.", show_default=False)
    ] = None
    vertices: Annotated[
        int | None,
        typer.Option(
            "--vertices",
            min=1,
            help="Instead of --level: about this many vertices each, or more.  [default: 200000]",
            show_default=False,
        ),
    ] = None
    k: Annotated[
        int | None,
        typer.Option(
            "-k",
            min=3,
            help="Basis functions of each surface.  [default: 150; 300 with --method hfm]",
            show_default=False,
        ),
    ] = None
    tolerance: Annotated[
        float, typer.Option("--tolerance", help="Relative error allowed in eigenvalues; sets the level of each band.")
    ] = 0.05
    schedule: Annotated[
        str | None,
        typer.Option(
            "--schedule",
            help="Basis functions per level, such as 100,50,50,50 (the paper's); replaces -k and --tolerance.",
            show_default=False,
        ),
    ] = None
    target_level: Annotated[
        int | None, typer.Option("--target-level", help="--level of the target alone.", show_default=False)
    ] = None
    target_vertices: Annotated[
        int | None,
        typer.Option("--target-vertices", min=1, help="--vertices of the target alone.", show_default=False),
    ] = None
    target_k: Annotated[int | None, typer.Option("--target-k", help="-k of the target alone.", show_default=False)] = (
        None
    )
    target_tolerance: Annotated[
        float | None, typer.Option("--target-tolerance", help="--tolerance of the target alone.", show_default=False)
    ] = None
    target_schedule: Annotated[
        str | None, typer.Option("--target-schedule", help="--schedule of the target alone.", show_default=False)
    ] = None
    source_level: Annotated[
        int | None, typer.Option("--source-level", help="--level of the source alone.", show_default=False)
    ] = None
    source_vertices: Annotated[
        int | None,
        typer.Option("--source-vertices", min=1, help="--vertices of the source alone.", show_default=False),
    ] = None
    source_k: Annotated[int | None, typer.Option("--source-k", help="-k of the source alone.", show_default=False)] = (
        None
    )
    source_tolerance: Annotated[
        float | None, typer.Option("--source-tolerance", help="--tolerance of the source alone.", show_default=False)
    ] = None
    source_schedule: Annotated[
        str | None, typer.Option("--source-schedule", help="--schedule of the source alone.", show_default=False)
    ] = None
    laplacian: Annotated[
        str | None,
        typer.Option(
            "--laplacian",
            help="Of quads: mean of both triangulations, alexa-wardetzky (the paper's) or de-goes-butts-desbrun, these "
            "with :LAMBDA where it is not 1.  [default: mean]",
            show_default=False,
        ),
    ] = None
    accuracy: Annotated[
        float | None,
        typer.Option(
            "--accuracy",
            help="Convergence of the eigensolver.  [default: a thousandth of --tolerance, 1e-5 of a --schedule]",
            show_default=False,
        ),
    ] = None
    literal: Annotated[
        bool, typer.Option("--literal", help="With --schedule: the paper's Definition 2 to the letter.")
    ] = False
    target_laplacian: Annotated[
        str | None, typer.Option("--target-laplacian", help="--laplacian of the target alone.", show_default=False)
    ] = None
    target_accuracy: Annotated[
        float | None, typer.Option("--target-accuracy", help="--accuracy of the target alone.", show_default=False)
    ] = None
    target_literal: Annotated[bool, typer.Option("--target-literal", help="--literal of the target alone.")] = False
    source_laplacian: Annotated[
        str | None, typer.Option("--source-laplacian", help="--laplacian of the source alone.", show_default=False)
    ] = None
    source_accuracy: Annotated[
        float | None, typer.Option("--source-accuracy", help="--accuracy of the source alone.", show_default=False)
    ] = None
    source_literal: Annotated[bool, typer.Option("--source-literal", help="--literal of the source alone.")] = False
    method: Annotated[
        Method,
        typer.Option(
            "--method",
            help="elastic: spectral map finished by an elastic fit, landmarks met exactly. "
            "hfm: hierarchical functional map, each band found by the paper's eqs. 14-16 and by the map so far. "
            "paper: the paper's own method, from level 0 on; give it a --schedule.",
        ),
    ] = Method.ELASTIC
    parameter: Annotated[
        tuple[str, ...],
        typer.Option(
            "--parameter",
            metavar="NAME=VALUE",
            help="A parameter of the spectral method, such as laplacian=0.01; repeat it for more.",
            show_default=False,
        ),
    ] = ()
    symmetry: Annotated[
        bool, typer.Option("--symmetry/--no-symmetry", help="Use mirror symmetry where both meshes have it.")
    ] = True
    target_symmetry: Annotated[
        tuple[Path, ...],
        typer.Option(
            "--target-symmetry", help="File with the image of every control vertex of the target.", show_default=False
        ),
    ] = ()
    source_symmetry: Annotated[
        tuple[Path, ...],
        typer.Option(
            "--source-symmetry", help="The same symmetry of the source; repeat both for more.", show_default=False
        ),
    ] = ()
    exchange_landmarks: Annotated[
        bool, typer.Option("--exchange-landmarks", help="The landmark file was made for the other direction.")
    ] = False
    trust_landmarks: Annotated[
        bool,
        typer.Option("--trust-landmarks", help="Meet every landmark; otherwise pairs that look wrong are left out."),
    ] = False
    answer: Annotated[
        int,
        typer.Option(
            "--answer",
            min=0,
            help="Take another of the answers that a match named: 1 is the runner-up, or the mirrored reading.",
        ),
    ] = 0
    target_points: Annotated[
        Path | None,
        typer.Option(
            "--target-points",
            help="Instead of --landmarks: named points of the target (.json, .pp, .mrk.json, .fcsv, .csv, Wrap's).",
            show_default=False,
        ),
    ] = None
    source_points: Annotated[
        Path | None,
        typer.Option("--source-points", help="The source's points; equal names are landmarks.", show_default=False),
    ] = None
    curves: Annotated[
        Path | None,
        typer.Option(
            "--curves",
            help="JSON file of curves that correspond (eyelids, lips, hems), as chains or loops of control vertices.",
            show_default=False,
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
        typer.Option(
            "--part",
            help="Match only this object, group, material or component of both files, the largest, or each piece, or "
            "material, with its counterpart (each, material); `cagemap check` lists them.",
            show_default=False,
        ),
    ] = None
    target_part: Annotated[
        str | None, typer.Option("--target-part", help="As --part, of the target alone.", show_default=False)
    ] = None
    source_part: Annotated[
        str | None, typer.Option("--source-part", help="As --part, of the source alone.", show_default=False)
    ] = None
    target_uv_set: Annotated[
        str | None,
        typer.Option("--target-uv-set", help="UV set of the target to bake into, by name.", show_default=False),
    ] = None
    source_uv_set: Annotated[
        str | None,
        typer.Option("--source-uv-set", help="UV set of the source that its images belong to.", show_default=False),
    ] = None
    target_mask: TargetMaskOption = None
    source_mask: SourceMaskOption = None
    mask_edge: MaskEdgeOption = None
    cache: Annotated[
        Path | None,
        typer.Option(
            "--cache", help="Folder that keeps prepared surfaces, so that each is prepared once.", show_default=False
        ),
    ] = None
    force: Force = False
