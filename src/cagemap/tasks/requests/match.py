"""Request of `cagemap match`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cagemap.tasks.requests.options import (
    INPUT,
    LANDMARKS,
    OUTPUT,
    RESEARCH,
    Answer,
    BoundaryOption,
    CreasingOption,
    Force,
    MaskEdgeOption,
    Option,
    SchemeOption,
    SourceMaskOption,
    SourcePartOption,
    SourceSchemeOption,
    SourceWeldOption,
    TargetMaskOption,
    TargetPartOption,
    TargetSchemeOption,
    TargetWeldOption,
    UvOption,
    WeldOption,
    setting,
)


@dataclass(frozen=True)
class MatchRequest:
    """Find for every point of the target its place on the source.

    Writes a folder with manifest.json (settings, timings, quality) and map.npz (the map). Without landmarks several
    alignments are tried, and the verdict says how sure the best one is. Landmarks improve the map: ten to thirty
    are good; tips of limbs, nose and tail first.
    """

    target: Annotated[
        Path, Option("Mesh that receives, .obj, .ply, .off, .stl, glTF, VRM, FBX or USD.", INPUT, ("-t",))
    ]
    source: Annotated[Path, Option("Mesh that gives, .obj, .ply, .off, .stl, glTF, VRM, FBX or USD.", INPUT, ("-s",))]
    output: Annotated[Path, Option("RESULT folder to write.", OUTPUT, ("-o",), metavar="FOLDER")]
    landmarks: Annotated[Path | None, Option("JSON file of pairs of corresponding points.", LANDMARKS)] = None
    level: Annotated[
        int | None, Option("Subdivision level of both surfaces.  [default: chosen by --vertices]", INPUT, min=1)
    ] = None
    vertices: Annotated[
        int | None, Option("Instead of --level: 0.75 to 3 times this many vertices.  [default: 200000]", INPUT, min=1)
    ] = None
    k: Annotated[int | None, Option("Basis functions of each surface.  [default: 100]", RESEARCH, min=3)] = None
    schedule: Annotated[
        str | None, setting("Basis functions per level, such as 100,50,50,50 (the paper's); replaces -k.")
    ] = None
    target_level: Annotated[int | None, setting("level of the target alone.", min=0)] = None
    target_vertices: Annotated[int | None, setting("vertices of the target alone.", min=1)] = None
    target_k: Annotated[int | None, setting("k of the target alone.", min=3)] = None
    target_schedule: Annotated[str | None, setting("schedule of the target alone.")] = None
    source_level: Annotated[int | None, setting("level of the source alone.", min=0)] = None
    source_vertices: Annotated[int | None, setting("vertices of the source alone.", min=1)] = None
    source_k: Annotated[int | None, setting("k of the source alone.", min=3)] = None
    source_schedule: Annotated[str | None, setting("schedule of the source alone.")] = None
    laplacian: Annotated[
        str | None, setting("Of quads: mean, alexa-wardetzky or de-goes-butts-desbrun, with :LAMBDA.  [default: mean]")
    ] = None
    accuracy: Annotated[float | None, setting("Convergence of the eigensolver.  [default: 1e-3; paper: 1e-5]")] = None
    literal: Annotated[bool, setting("With schedule: the paper's Definition 2 exactly as printed.")] = False
    target_laplacian: Annotated[str | None, setting("laplacian of the target alone.")] = None
    target_accuracy: Annotated[float | None, setting("accuracy of the target alone.")] = None
    target_literal: Annotated[bool, setting("literal of the target alone.")] = False
    source_laplacian: Annotated[str | None, setting("laplacian of the source alone.")] = None
    source_accuracy: Annotated[float | None, setting("accuracy of the source alone.")] = None
    source_literal: Annotated[bool, setting("literal of the source alone.")] = False
    method: Annotated[
        Literal["elastic", "hfm", "paper"],
        Option("elastic maps landmarks exactly; hfm and paper are functional maps.", RESEARCH),
    ] = "elastic"
    parameter: Annotated[
        tuple[str, ...],
        setting("A parameter of the method, such as search_vertices=6000; repeat it for more.", metavar="NAME=VALUE"),
    ] = ()
    symmetry: Annotated[
        bool,
        Option(
            "--method paper: use mirror symmetry where both meshes have it.", RESEARCH, ("--symmetry/--no-symmetry",)
        ),
    ] = True
    target_symmetry: Annotated[
        tuple[Path, ...], setting("--method paper or hfm: image of every control vertex of the target.")
    ] = ()
    source_symmetry: Annotated[tuple[Path, ...], setting("The same symmetry of the source; repeat both for more.")] = ()
    exchange_landmarks: Annotated[bool, Option("The landmark file was made for the other direction.", LANDMARKS)] = (
        False
    )
    trust_landmarks: Annotated[bool, Option("Keep every landmark; by default, outliers are left out.", LANDMARKS)] = (
        False
    )
    answer: Answer = 0
    target_points: Annotated[
        Path | None, Option("Named points of the target; equal names on both are landmarks.", LANDMARKS)
    ] = None
    source_points: Annotated[Path | None, Option("Named points of the source.", LANDMARKS)] = None
    curves: Annotated[Path | None, Option("JSON file of corresponding curves: eyelids, lips, hems.", LANDMARKS)] = None
    scheme: SchemeOption = None
    target_scheme: TargetSchemeOption = None
    source_scheme: SourceSchemeOption = None
    boundary: BoundaryOption = None
    uv_interpolation: UvOption = None
    creasing: CreasingOption = None
    weld: WeldOption = None
    target_weld: TargetWeldOption = None
    source_weld: SourceWeldOption = None
    part: Annotated[
        str | None,
        Option("Object, group, material or component by name; largest, each or material.  [default: all]", INPUT),
    ] = None
    target_part: TargetPartOption = None
    source_part: SourcePartOption = None
    target_uv_set: Annotated[
        str | None, Option("UV set of the target to bake into, by name.  [default: first]", INPUT)
    ] = None
    source_uv_set: Annotated[
        str | None, Option("UV set of the source that its images belong to.  [default: first]", INPUT)
    ] = None
    target_mask: TargetMaskOption = None
    source_mask: SourceMaskOption = None
    mask_edge: MaskEdgeOption = None
    cache: Annotated[
        Path | None,
        Option("Folder that keeps prepared surfaces, so that each is prepared once.", INPUT, metavar="FOLDER"),
    ] = None
    force: Force = False
