"""Poses of the source's animations, on both models; the target is rigged as by `cagemap rig`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import sparse

from cagemap.character.poses import example_times, pose_at
from cagemap.character.retarget import retarget_all
from cagemap.character.skeleton import carry_rig
from cagemap.character.values import Animation, Character, Rig, skin_positions
from cagemap.files.gltf.character import read_character
from cagemap.files.gltf.document import SCENE_SUFFIXES
from cagemap.maps.point_map import PointMap
from cagemap.mesh.parts import join_meshes
from cagemap.numerics.arrays import FloatArray
from cagemap.studio.shape import Shape
from cagemap.studio.skins import PreviewMap
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.triangles import fan_triangles, vertex_normals

NO_CHARACTER = Character(())


def animated_character(path: Path) -> Character:
    """The character in a glTF or FBX file, `NO_CHARACTER` in any other."""
    return read_character(path) if path.suffix.lower() in SCENE_SUFFIXES else NO_CHARACTER


def animation_poses(character: Character) -> dict[str, tuple[int, float]]:
    """Number of the animation and time in seconds of each pose, by its name on the page: seconds from the first key."""
    poses = dict[str, tuple[int, float]]()
    if character.rig is not None and any(part.weights is not None for part in character.parts):
        for number, animation in enumerate(character.animations):
            start, times = example_times(animation)
            poses |= {f"{animation.name}, {time - start:.2g} s": (number, float(time)) for time in times}
    return poses


def pose_shapes(
    character: Character,
    pose: tuple[int, float],
    target: Shape,
    source: Shape,
    preview_map: PreviewMap,
    point_map: PointMap,
) -> tuple[Shape, Shape]:
    """Target and source in a pose; joints and weights of the target come from the map."""
    (number, time), rig = pose, character.rig
    assert rig is not None
    animation = character.animations[number]
    source_weights = _weights_at(character, source.positions)
    target_rig = carry_rig(point_map, rig)
    (target_animation,), _ = retarget_all([animation], rig, target_rig)
    target_weights = preview_map.pull_back(source.triangles, source_weights)
    posed_target = _pose_shape(target, target_weights, target_rig, target_animation, time)
    return posed_target, _pose_shape(source, source_weights, rig, animation, time)


def _weights_at(character: Character, points: FloatArray) -> FloatArray:
    """(n, joints) skinning weights at points of the character's surface."""
    skins = [(part.mesh, part.weights) for part in character.parts if part.weights is not None]
    joined = join_meshes([mesh for mesh, _ in skins])
    triangles = fan_triangles(joined.face_offsets, joined.face_indices)[0]
    triangle, barycentric, _ = closest_points(build_tree(joined.positions, triangles), points)
    rows = sparse.vstack([weights for _, weights in skins]).toarray()
    return np.einsum("nc,ncj->nj", barycentric, rows[triangles[triangle]])


def _pose_shape(shape: Shape, weights: FloatArray, rig: Rig, animation: Animation, time: float) -> Shape:
    positions = skin_positions(shape.positions, weights, rig, pose_at(rig, animation, time))
    return replace(shape, positions=positions, normals=vertex_normals(positions, shape.triangles))
