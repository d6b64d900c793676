"""Request of `cagemap face`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import INPUT, LANDMARKS, OUTPUT, Argument, Force, Option


@dataclass(frozen=True)
class FaceRequest:
    """Give a head the face shapes of ARKit.

    51 of the 52, from ICT-FaceKit (MIT): tongueOut is not among them. The head keeps its vertices, materials, rig and
    own shapes; teeth, tongue and eyes that are parts of their own stay. Of a body with a skeleton the head and neck are
    taken.
    """

    head: Annotated[Path, Argument(metavar="HEAD", help="Head, or rigged body: .glb, .vrm, .fbx, .obj, .ply or USD.")]
    output: Annotated[Path, Option(("-o", "--output"), group=OUTPUT, help="File to write: .glb, .gltf, .vrm or USD.")]
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
