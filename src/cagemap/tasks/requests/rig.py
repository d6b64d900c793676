"""Request of `cagemap rig`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import INPUT, LANDMARKS, OUTPUT, Answer, Argument, Force, Option


@dataclass(frozen=True)
class RigRequest:
    """Rig, texture, dress and animate a body like a character.

    Joints, weights, blend shapes, textures, clothes, eyes, hair and animations of the character go to the body, as one
    file. The body's mesh stays as it is; what it has of its own, such as eyes, stays and follows it.
    """

    body: Annotated[Path, Argument("Body: .obj, .ply, .off, .stl, .glb, .gltf, .vrm, .fbx or USD.", metavar="BODY")]
    like: Annotated[Path, Option("Character to transfer from: .glb, .gltf, .vrm, .fbx or USD.", INPUT)]
    output: Annotated[Path, Option("File to write: .glb, .gltf, .vrm or USD.", OUTPUT, ("-o",))]
    landmarks: Annotated[Path | None, Option("JSON file of corresponding points of the two bodies.", LANDMARKS)] = None
    answer: Answer = 0
    body_part: Annotated[str | None, Option("Part of BODY that is the body.  [default: the largest]", INPUT)] = None
    like_part: Annotated[
        str | None, Option("Part of the character that is its body.  [default: the largest]", INPUT)
    ] = None
    passengers: Annotated[
        str | None, Option("Clothes, eyes and hair to transfer, by name: eyes,shirt or none.  [default: all]", INPUT)
    ] = None
    rigid: Annotated[str | None, Option("Passengers whose pieces keep their shape: hat,glasses.", INPUT)] = None
    cloth: Annotated[str | None, Option("Passengers that follow the skin: mask,belt.", INPUT)] = None
    influences: Annotated[int, Option("Most joints per vertex; 0 for all.", OUTPUT, min=0)] = 4
    keep_textures: Annotated[bool, Option("BODY keeps its own materials and textures.", OUTPUT)] = False
    size: Annotated[
        int | None,
        Option("Width and height of baked textures.  [default: as the character's]", OUTPUT, min=1, max=32767),
    ] = None
    report: Annotated[Path | None, Option("HTML page to write, which shows the animated result.", OUTPUT)] = None
    force: Force = False
