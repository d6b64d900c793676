"""Request of `cagemap rig`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import INPUT, LANDMARKS, OUTPUT, Argument, Force, Option


@dataclass(frozen=True)
class RigRequest:
    """Rig, texture, dress and animate a body like a character.

    Joints, weights, blend shapes, textures, clothes, eyes, hair and animations of the character go to the body, as one
    file. The body's mesh stays as it is; what it has of its own, such as eyes, stays and follows it.
    """

    body: Annotated[
        Path, Argument(metavar="BODY", help="Mesh of the body: .obj, .ply, .off, .stl, .glb, .gltf, .vrm, .fbx or USD.")
    ]
    like: Annotated[
        Path, Option(("--like",), group=INPUT, help="Character to transfer from: .glb, .gltf, .vrm, .fbx or USD.")
    ]
    output: Annotated[Path, Option(("-o", "--output"), group=OUTPUT, help="File to write: .glb, .gltf, .vrm or USD.")]
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
        Option(group=INPUT, help="Clothes, eyes and hair to transfer, by name: eyes,shirt or none.  [default: all]"),
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
