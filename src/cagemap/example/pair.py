"""The built-in pair: the painted pony gives its texture to the deer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cagemap.example.creatures import deer, pony
from cagemap.example.modelling import Creature
from cagemap.example.paint import paint_texture
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks


@dataclass(frozen=True)
class ExamplePair:
    """Two control meshes of different connectivity, matching points on them, and a texture to transfer.

    Attributes
    ----------
    target, source : ControlMesh
        Both closed, of genus 0, mirror-symmetric in x, +Y up, facing +Z, with UV islands.
    landmarks : Landmarks
        The same anatomical points on both.
    texture : (size, size, 3) uint8 sRGB
        The source's; row 0 is v = 1.
    """

    target: ControlMesh
    source: ControlMesh
    landmarks: Landmarks
    texture: NDArray[np.uint8]


def example_pair(texture_size: int = 2048) -> ExamplePair:
    """Model, unwrap and paint the built-in pair.

    Parameters
    ----------
    texture_size : int
        Side of the square texture, in texels.
    """
    target, source = deer(), pony()
    landmarks = creature_landmarks(target, source)
    return ExamplePair(target.mesh, source.mesh, landmarks, paint_texture(source, texture_size))


def creature_landmarks(target: Creature, source: Creature) -> Landmarks:
    """Pair the points that both creatures name."""
    names = tuple(name for name in target.landmarks if name in source.landmarks)
    return Landmarks(
        names,
        np.array([target.landmarks[name] for name in names], dtype=np.int64),
        np.array([source.landmarks[name] for name in names], dtype=np.int64),
        target.mesh.name,
        source.mesh.name,
    )
