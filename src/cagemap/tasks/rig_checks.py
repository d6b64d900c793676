"""Warnings of `cagemap rig` about a body: other parts continue its surface, or its up axis or unit differs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cagemap.character.body_frames import BodyFrames
from cagemap.character.poses import world_transforms
from cagemap.character.roles import find_continuing_parts
from cagemap.character.values import Character, Part, skinned_positions
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import MatchResult
from cagemap.mesh.mesh_report import first_few

# Cosine of the up axes of character and body, below which the body's file has another axis up.
_MIN_UPRIGHT_COSINE = 0.5
# Ratio of the bodies' sizes, either way, above which there is a warning: feet and metres have 3.3.
_MAX_BODY_RATIO = 2.5
# Largest distance of a vertex from the bind pose without a warning, of the body's extent; files in bind pose have 0.
_MAX_POSE_SHIFT = 0.02


def split_body_warning(path: Path, character: Character, body: Part) -> list[str]:
    """A warning if other parts continue the body's surface."""
    others = [part.name for part in find_continuing_parts(body, character.parts)]
    if not others:
        return []
    return [
        f"{path}: {body.name} alone is matched as the body, but {first_few(others)} continues it. Join these parts in "
        "the modelling program (Blender: Ctrl+J, then Merge by Distance)"
    ]


def pose_warning(path: Path, character: Character, body: Part) -> list[str]:
    """A warning if the file's skeleton poses the body otherwise than its bind pose."""
    if character.rig is None:
        return []
    rest = skinned_positions(body, character.rig, world_transforms(character.rig.local, character.rig.parents))
    shifts = np.linalg.norm(rest - body.mesh.positions, axis=1)
    if shifts.max() <= _MAX_POSE_SHIFT * np.ptp(body.mesh.positions, axis=0).max():
        return []
    return [
        f"{path}: {body.name} is taken in its bind pose, not in the pose of its skeleton. To use the pose, apply it in "
        "the modelling program (Blender: apply the Armature modifier), and export the mesh again"
    ]


def up_warning(point_map: PointMap, path: Path) -> list[str]:
    """A warning if the axis that is up in the target's file is not Y, as in some OBJ files; it is Y in the source."""
    up = BodyFrames(point_map).rotation[1]
    if up[1] > _MIN_UPRIGHT_COSINE:
        return []
    number = int(np.abs(up).argmax())
    axis = ("-" if up[number] < 0 else "") + "XYZ"[number]
    return [
        f"{path}: what is up in the character is {axis} here, but glTF has Y up: if the body lies down in other "
        "programs, rotate it before"
    ]


def size_warning(result: MatchResult, body: Path, like: Path) -> list[str]:
    """A warning if the sizes of the bodies differ as those of two units do."""
    ratio = result.point_map.source.scale / result.point_map.target.scale
    if 1.0 / _MAX_BODY_RATIO <= ratio <= _MAX_BODY_RATIO:
        return []
    spans = [float(np.ptp(side.control.positions, axis=0).max()) for side in (result.target, result.source)]
    return [
        f"{body} is {ratio:.3g} times as large as {like} ({spans[0]:.3g} m, {spans[1]:.3g} m): clothes "
        f"and skeleton are scaled to the body. If {body} has another unit than the metre, scale it before"
    ]
