"""A rigged cube as a USD file, and a result between two of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from pxr import Gf, UsdGeom

from cagemap.character.joints import Skeleton
from cagemap.files.usd.write import UsdResults, write_usd

from example_result import textured_cube
from usd_scenes import stage_at

TURN = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])


def cube_skeleton() -> Skeleton:
    """A child before its parent, and two joints that share a parent."""
    heads = np.array([[0.0, 0.5, 0], [0, -0.5, 0], [0.3, 0.9, 0], [-0.3, 0.9, 0]])
    tails = np.array([[0.0, 0.9, 0], [0, 0.5, 0], [0.45, 1.1, 0], [-0.45, 1.1, 0]])
    axes = np.stack([np.eye(3), TURN, TURN @ TURN, TURN.T])
    return Skeleton(("chest", "hips", "left", "right"), ("hips", "", "chest", "chest"), heads, tails, axes)


def write_rigged(
    path: Path, name: str, scale: float = 1.0, matrix: np.ndarray | None = None, units: tuple | None = None
) -> None:
    """A rigged cube; its root is placed by a matrix."""
    cube = textured_cube(name, scale)
    weights = np.random.default_rng(3).random((8, 4))
    skeleton = cube_skeleton()
    skeleton = replace(skeleton, heads=scale * skeleton.heads, tails=scale * skeleton.tails)
    smile = np.zeros((8, 3))
    smile[2] = [0, 0, scale]
    attributes = {"skel:jointWeights": weights / weights.sum(axis=1, keepdims=True), "blendShape:smile": smile}
    write_usd(path, cube, UsdResults(attributes=attributes, skeleton=skeleton))
    with stage_at(path, units) as stage:
        if matrix is not None:
            UsdGeom.Xformable(stage.GetPrimAtPath("/Asset")).AddTransformOp().Set(Gf.Matrix4d(*matrix.ravel().tolist()))
