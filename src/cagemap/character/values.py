"""Values of a character, as files hold it and as functions take it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy import sparse

from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray

Channel = Literal["translation", "rotation", "scale"]
Interpolation = Literal["LINEAR", "STEP", "CUBICSPLINE"]


@dataclass(frozen=True, eq=False)
class Rig:
    """Joints with their transforms at rest.

    Matrices act on rows: a point (1, 4), times one of them, is in the parent's space.

    Attributes
    ----------
    names : tuple of str
    parents : (j,) int64
        -1 for a root. A parent stands before its children.
    local : (j, 4, 4) float64
        From a joint's space to its parent's, of a root to the world, at rest.
    bind : (j, 4, 4) float64
        From a joint's space to the world in the pose in which the weights were made.
    """

    names: tuple[str, ...]
    parents: IndexArray
    local: FloatArray = field(repr=False)
    bind: FloatArray = field(repr=False)

    @property
    def heads(self) -> FloatArray:
        """Places of the joints in the bind pose, (j, 3) float64."""
        return self.bind[:, 3, :3]


@dataclass(frozen=True, eq=False)
class Track:
    """One channel of one joint over time.

    Attributes
    ----------
    joint : int
    channel : 'translation', 'rotation' or 'scale'
    times : (k,) float64
        Seconds, rising.
    values : (k, 3) float64, or (k, 4) of a rotation
        Replace that part of the joint's local transform. Rotations are unit quaternions (x, y, z, w). With
        'CUBICSPLINE' (k, 3, 3) or (k, 3, 4): in-tangent, value, out-tangent.
    interpolation : str
    """

    joint: int
    channel: Channel
    times: FloatArray = field(repr=False)
    values: FloatArray = field(repr=False)
    interpolation: Interpolation = "LINEAR"


@dataclass(frozen=True, eq=False)
class Animation:
    """Tracks that run together."""

    name: str
    tracks: tuple[Track, ...] = field(repr=False)


@dataclass(frozen=True, eq=False)
class Part:
    """One mesh of a character in the bind pose, in world space.

    Attributes
    ----------
    name : str
    mesh : ControlMesh
        Vertices that the file splits at seams are joined; `ControlMesh.file_copies` says which they were.
    weights : (n, j) csr_array or None
        Of the joints of the character's rig, rows sum to 1.
    shapes : dict of str to (n, 3) float64
        Offsets of the vertices.
    normals : (c, 3) float64 or None
        Unit normal of every face corner, where a file states them; `cagemap.character.normals.moved` keeps them.
    """

    name: str
    mesh: ControlMesh
    weights: sparse.csr_array | None = field(default=None, repr=False)
    shapes: dict[str, FloatArray] = field(default_factory=dict, repr=False)
    normals: FloatArray | None = field(default=None, repr=False)


@dataclass(frozen=True, eq=False)
class Character:
    """Parts that share a rig."""

    parts: tuple[Part, ...]
    rig: Rig | None = None
    animations: tuple[Animation, ...] = ()


def posed(part: Part, rig: Rig, transforms: FloatArray) -> FloatArray:
    """Linear blend skinning: vertices (n, 3) of a part, its joints at ``transforms`` (j, 4, 4) in the world."""
    if part.weights is None:
        return part.mesh.positions
    return skinned(part.mesh.positions, part.weights, rig, transforms)


def skinned(
    positions: FloatArray, weights: FloatArray | sparse.csr_array, rig: Rig, transforms: FloatArray
) -> FloatArray:
    """Linear blend skinning of positions (n, 3) with weights (n, j)."""
    change = np.linalg.inv(rig.bind) @ transforms
    blended = (weights @ change.reshape(len(change), 16)).reshape(-1, 4, 4)
    places = np.concatenate([positions, np.ones((len(positions), 1))], axis=1)
    return np.einsum("na,nab->nb", places, blended)[:, :3]
