"""Requests of commands on meshes and characters (functions, rig, face), annotated with their options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import (
    INPUT,
    LANDMARKS,
    OUTPUT,
    Argument,
    BoundaryOption,
    CreasingOption,
    Force,
    MeshFile,
    Option,
    SchemeOption,
    WeldOption,
)


@dataclass(frozen=True)
class FunctionsRequest:
    """Request of `cagemap functions`."""

    mesh: MeshFile
    output: Annotated[
        Path, Option(("-o", "--output"), help="Arrays, .npz, .npy or .csv; or the mesh in colours, .ply.")
    ]
    kinds: Annotated[
        str,
        Option(
            help="eigenfunctions, heat-signatures, wave-signatures, heat-kernels, wave-kernels; several with commas."
        ),
    ] = "eigenfunctions"
    level: Annotated[
        int | None,
        Option(("--level", "-l"), min=1, help="Finest level of the surface.  [default: about 50000 vertices]"),
    ] = None
    at: Annotated[
        int | None, Option(min=0, help="Level at whose vertices the functions are given.  [default: the finest]")
    ] = None
    k: Annotated[int, Option(("-k",), min=1, help="Basis functions.")] = 100
    schedule: Annotated[str | None, Option(help="Basis functions per level, such as 100,50,50,50; replaces -k.")] = None
    laplacian: Annotated[str, Option(help="mean, alexa-wardetzky[:LAMBDA] or de-goes-butts-desbrun[:LAMBDA].")] = "mean"
    accuracy: Annotated[float, Option(help="Convergence of the eigensolver.")] = 1e-5
    literal: Annotated[
        bool, Option(("--literal",), help="With --schedule: the paper's Definition 2 exactly as printed.")
    ] = False
    heat: Annotated[int, Option(min=1, help="Heat signatures or kernels: diffusion times.")] = 10
    wave: Annotated[int, Option(min=1, help="Wave signatures or kernels: energies.")] = 20
    points: Annotated[str | None, Option(help="Kernels: control vertices that they start from, such as 0,12,40.")] = (
        None
    )
    column: Annotated[
        int | None,
        Option(min=0, help="Function that a .ply shows as colours.  [default: the first that is not constant]"),
    ] = None
    scheme: SchemeOption = None
    weld: WeldOption = None
    boundary: BoundaryOption = None
    creasing: CreasingOption = None
    force: Force = False


@dataclass(frozen=True)
class RigRequest:
    """Request of `cagemap rig`."""

    body: Annotated[Path, Argument(metavar="BODY", help="Mesh of the body: .glb, .vrm, .fbx, .obj, .ply or USD.")]
    like: Annotated[
        Path, Option(("--like",), group=INPUT, help="Character to transfer from: .glb, .gltf, .vrm or .fbx.")
    ]
    output: Annotated[Path, Option(("-o", "--output"), group=OUTPUT, help="File to write: .glb, .gltf or .vrm.")]
    landmarks: Annotated[
        Path | None, Option(group=LANDMARKS, help="JSON file of corresponding points of the two bodies.")
    ] = None
    body_part: Annotated[
        str | None, Option(group=INPUT, help="Part of BODY that is the body.  [default: the largest]")
    ] = None
    like_part: Annotated[
        str | None, Option(group=INPUT, help="Part of the character that is its body.  [default: the largest]")
    ] = None
    passengers: Annotated[
        str | None,
        Option(group=INPUT, help="Clothes, eyes and hair to carry, by name: eyes,shirt or none.  [default: all]"),
    ] = None
    rigid: Annotated[str | None, Option(group=INPUT, help="Passengers whose pieces keep their shape: hat,glasses.")] = (
        None
    )
    cloth: Annotated[str | None, Option(group=INPUT, help="Passengers that follow the skin: mask,belt.")] = None
    influences: Annotated[int, Option(group=OUTPUT, min=0, help="Most joints per vertex; 0 for all.")] = 4
    keep_textures: Annotated[
        bool, Option(("--keep-textures",), group=OUTPUT, help="BODY keeps its own materials and textures.")
    ] = False
    size: Annotated[
        int | None,
        Option(group=OUTPUT, min=1, help="Width and height of baked textures.  [default: as the character's]"),
    ] = None
    report: Annotated[
        Path | None, Option(group=OUTPUT, help="HTML page to write, which shows the animated result.")
    ] = None
    force: Force = False


@dataclass(frozen=True)
class FaceRequest:
    """Request of `cagemap face`."""

    head: Annotated[Path, Argument(metavar="HEAD", help="Head, or rigged body: .glb, .vrm, .fbx, .obj, .ply or USD.")]
    output: Annotated[Path, Option(("-o", "--output"), group=OUTPUT, help="File to write: .glb, .gltf or .vrm.")]
    part: Annotated[str | None, Option(group=INPUT, help="Part of HEAD that has the face.  [default: the largest]")] = (
        None
    )
    only: Annotated[
        str | None, Option(group=INPUT, help="Shapes to make, by ARKit's names: jawOpen,eyeBlinkLeft.  [default: all]")
    ] = None
    landmarks: Annotated[
        Path | None,
        Option(
            group=LANDMARKS,
            help="Points file of HEAD: nose_tip, chin, mouth_left and others.",
        ),
    ] = None
    sheet: Annotated[Path | None, Option(group=OUTPUT, help="Image to write, with pictures of all shapes.")] = None
    force: Force = False
