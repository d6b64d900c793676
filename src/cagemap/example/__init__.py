"""The built-in example pair: two four-legged creatures with landmarks and a texture; see `examples/creatures`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.files.images.image import read_image
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.files.meshes.formats import read_mesh
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks

__all__ = ["ExamplePair", "example_pair"]

TEXTURE_SIZE = 2048


@dataclass(frozen=True, eq=False)
class ExamplePair:
    """Two control meshes of different connectivity, landmarks, and a texture to transfer.

    Attributes
    ----------
    target, source : ControlMesh
        Closed, of genus 0, mirror-symmetric in x, +Y up, facing +Z, with UV islands.
    landmarks : Landmarks
        Equal anatomical points.
    texture : (size, size, 3) uint8 sRGB
        The source's; row 0 is v = 1.
    """

    target: ControlMesh
    source: ControlMesh
    landmarks: Landmarks
    texture: NDArray[np.uint8]


def example_pair(texture_size: int = TEXTURE_SIZE) -> ExamplePair:
    """Read the built-in pair: a deer as target, a textured pony as source.

    Parameters
    ----------
    texture_size : int
        Side of the square texture, in texels: 2048 divided by an integer.

    Raises
    ------
    ParameterError
        If 2048 is not a multiple of the size.
    """
    if not 1 <= texture_size <= TEXTURE_SIZE or TEXTURE_SIZE % texture_size:
        raise ParameterError(f"texture_size: expected {TEXTURE_SIZE} divided by a whole number, got {texture_size}")
    with resources.as_file(resources.files("cagemap.example")) as folder:
        target, source = (replace(read_mesh(folder / f"{name}.obj"), name=name) for name in ("deer", "pony"))
        landmarks, _ = read_landmarks(folder / "landmarks.json", target.name, source.name)
        pixels = read_image(folder / "pony.png").pixels[..., :3]
    step = TEXTURE_SIZE // texture_size
    means = pixels.reshape(texture_size, step, texture_size, step, 3).mean(axis=(1, 3))
    return ExamplePair(target, source, landmarks, np.rint(means).astype(np.uint8))
