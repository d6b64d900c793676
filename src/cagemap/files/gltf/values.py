"""Weights, blend shapes and skeletons of glTF files, as other files of values hold them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cagemap.character.values import Rig
from cagemap.errors import FormatError
from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.parts import read_scene
from cagemap.mesh.skeleton import Skeleton, tails_of
from cagemap.numerics.arrays import FloatArray


def gltf_weights(path: str | Path) -> FloatArray:
    """Weights (n, j) of the joints of `gltf_skeleton`, at the vertices of `read_gltf`; 0 for meshes without a skin.

    Raises
    ------
    FormatError
        If the file cannot be read, or has no skin.
    """
    scene = read_scene(read_document(path))
    if scene.joints is None:
        raise FormatError(f"{path}: expected a mesh with a skin, got none. Export it with its rig.")
    count = len(scene.joints.rig.names)
    tables = [
        np.zeros((one.part.mesh.n_vertices, count)) if one.part.weights is None else one.part.weights.toarray()
        for one in scene.parts
    ]
    return np.concatenate(tables)


def gltf_shapes(path: str | Path) -> dict[str, FloatArray]:
    """Offsets (n, 3) of the blend shapes by name, at the vertices of `read_gltf`; shapes of one name are one.

    Raises
    ------
    FormatError
        If the file cannot be read.
    """
    parts = [one.part for one in read_scene(read_document(path)).parts]
    names = dict.fromkeys(name for part in parts for name in part.shapes)
    return {
        name: np.concatenate([part.shapes.get(name, np.zeros((part.mesh.n_vertices, 3))) for part in parts])
        for name in names
    }


def gltf_skeleton(path: str | Path) -> Skeleton:
    """Joints of all skins in the bind pose.

    Raises
    ------
    FormatError
        If the file cannot be read, or has no skin.
    """
    scene = read_scene(read_document(path))
    if scene.joints is None:
        raise FormatError(f"{path}: expected a mesh with a skin, got none. Export it with its rig.")
    return skeleton_of(scene.joints.rig)


def skeleton_of(rig: Rig) -> Skeleton:
    """The joints of a rig in the bind pose; tails lie where the children are."""
    parents = tuple(rig.names[parent] if parent >= 0 else "" for parent in rig.parents)
    axes = rig.bind[:, :3, :3] / np.linalg.norm(rig.bind[:, :3, :3], axis=2, keepdims=True)
    return Skeleton(rig.names, parents, rig.heads, tails_of(rig.heads, rig.parents), axes)
