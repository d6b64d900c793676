"""Data classes of characters: rigs, animations, parts."""

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
    """Joints with their rest and bind transforms.

    Matrices act on rows: a point (1, 4) times a matrix is in the parent's space.

    Attributes
    ----------
    names : tuple of str
    parents : (j,) int64
        -1 for a root. Parents stand before children.
    local : (j, 4, 4) float64
        From a joint's space to its parent's (a root's: to the world) in the rest pose.
    bind : (j, 4, 4) float64
        From a joint's space to the world in the bind pose.
    """

    names: tuple[str, ...]
    parents: IndexArray
    local: FloatArray = field(repr=False)
    bind: FloatArray = field(repr=False)

    @property
    def heads(self) -> FloatArray:
        """Positions of the joints in the bind pose, (j, 3) float64."""
        return self.bind[:, 3, :3]


@dataclass(frozen=True, eq=False)
class Track:
    """One channel of one joint over time.

    Attributes
    ----------
    joint : int
    channel : 'translation', 'rotation' or 'scale'
    times : (k,) float64
        Seconds, increasing.
    values : (k, 3) float64, or (k, 4) of a rotation
        Of that part of the joint's local transform. Rotations are unit quaternions (x, y, z, w). With 'CUBICSPLINE'
        (k, 3, 3) or (k, 3, 4): in-tangent, value, out-tangent.
    interpolation : str
    """

    joint: int
    channel: Channel
    times: FloatArray = field(repr=False)
    values: FloatArray = field(repr=False)
    interpolation: Interpolation = "LINEAR"


@dataclass(frozen=True, eq=False)
class ShapeTrack:
    """Weights of blend shapes of one part over time.

    Attributes
    ----------
    part : str
    shapes : tuple of str
    times : (k,) float64
        Seconds, increasing.
    values : (k, s) float64
        With 'CUBICSPLINE' (k, 3, s), see `Track`.
    interpolation : str
    """

    part: str
    shapes: tuple[str, ...]
    times: FloatArray = field(repr=False)
    values: FloatArray = field(repr=False)
    interpolation: Interpolation = "LINEAR"

    def values_of(self, part: Part) -> FloatArray:
        """Values with a column for each of the part's shapes, at rest where the track has none of that name."""
        values = np.zeros((*self.values.shape[:-1], len(part.shapes)))
        keys = values[:, 1] if self.interpolation == "CUBICSPLINE" else values
        for column, name in enumerate(part.shapes):
            if name in self.shapes:
                values[..., column] = self.values[..., self.shapes.index(name)]
            else:
                keys[..., column] = part.shape_weights.get(name, 0.0)
        return values


@dataclass(frozen=True, eq=False)
class Animation:
    """Tracks that are played together.

    Attributes
    ----------
    name : str
    tracks : tuple of Track
        At most one for each channel of a joint.
    shape_tracks : tuple of ShapeTrack
        At most one for each part. Those of parts and shapes that the character does not have are not written.
    """

    name: str
    tracks: tuple[Track, ...] = field(repr=False)
    shape_tracks: tuple[ShapeTrack, ...] = field(default=(), repr=False)

    def shape_tracks_of(self, part: Part) -> tuple[ShapeTrack, ...]:
        """Tracks of blend shapes that a part has."""
        return tuple(one for one in self.shape_tracks if one.part == part.name and part.shapes.keys() & set(one.shapes))


@dataclass(frozen=True, eq=False)
class Part:
    """One mesh of a character in the bind pose, in world space.

    Attributes
    ----------
    name : str
    mesh : ControlMesh
        Vertices that the file splits at seams are joined; `ControlMesh.file_copies` lists them.
    weights : (n, j) csr_array or None
        Of the rig's joints; rows sum to 1.
    shapes : dict of str to (n, 3) float64
        Offsets of the vertices.
    normals : (c, 3) float64 or None
        Unit normal of every face corner, if the file has them; see `cagemap.character.normals.move_vertices`.
    shape_normals : dict of str to (c, 3) float64
        Offsets of ``normals``, of the shapes that state them.
    colors : (c, 4) float64 or None
        Linear red, green, blue and opacity of every face corner, if the file has them. ``mesh.vertex_colors`` has
        one for each vertex.
    shape_weights : dict of str to float
        Weights of shapes at rest, if the file has them; 0 for others.
    """

    name: str
    mesh: ControlMesh
    weights: sparse.csr_array | None = field(default=None, repr=False)
    shapes: dict[str, FloatArray] = field(default_factory=dict, repr=False)
    normals: FloatArray | None = field(default=None, repr=False)
    shape_normals: dict[str, FloatArray] = field(default_factory=dict, repr=False)
    colors: FloatArray | None = field(default=None, repr=False)
    shape_weights: dict[str, float] = field(default_factory=dict, repr=False)


@dataclass(frozen=True, eq=False)
class Character:
    """Parts that share a rig."""

    parts: tuple[Part, ...]
    rig: Rig | None = None
    animations: tuple[Animation, ...] = ()


def skinned_positions(part: Part, rig: Rig, transforms: FloatArray) -> FloatArray:
    """Linear blend skinning: vertices (n, 3) of a part with its joints at world transforms (j, 4, 4)."""
    if part.weights is None:
        return part.mesh.positions
    return skin_positions(part.mesh.positions, part.weights, rig, transforms)


def skin_positions(
    positions: FloatArray, weights: FloatArray | sparse.csr_array, rig: Rig, transforms: FloatArray
) -> FloatArray:
    """Linear blend skinning: positions (n, 3) with weights (n, j) and world transforms (j, 4, 4)."""
    from_bind = np.linalg.inv(rig.bind) @ transforms
    blended = (weights @ from_bind.reshape(len(from_bind), 16)).reshape(-1, 4, 4)
    homogeneous = np.concatenate([positions, np.ones((len(positions), 1))], axis=1)
    return np.einsum("na,nab->nb", homogeneous, blended)[:, :3]
