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
    own shapes. Its lashes, brows, beard, lower teeth and tongue move along; its upper teeth and eyeballs stay. Of a
    body with a skeleton the head and neck are taken.
    """

    head: Annotated[Path, Argument("Head, or rigged body: .glb, .vrm, .fbx, .obj, .ply or USD.", metavar="HEAD")]
    output: Annotated[Path, Option("File to write: .glb, .gltf, .vrm or USD.", OUTPUT, ("-o",))]
    part: Annotated[str | None, Option("Part of HEAD that has the face.  [default: the largest]", INPUT)] = None
    only: Annotated[
        str | None, Option("Shapes to make, by ARKit's names: jawOpen,eyeBlinkLeft.  [default: all]", INPUT)
    ] = None
    landmarks: Annotated[
        Path | None, Option("Points file of HEAD: nose_tip, chin, mouth_left and others.", LANDMARKS)
    ] = None
    sheet: Annotated[Path | None, Option("Image to write, with pictures of all shapes.", OUTPUT)] = None
    force: Force = False
