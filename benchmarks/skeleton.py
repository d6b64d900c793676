"""Bodies posed and proportioned by a simple skeleton: linear blend skinning with shares of the nearest bones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from cagemap.numerics.sparse_algebra import factor
from cagemap.operators.laplacian import stiffness, vertex_areas


@dataclass(frozen=True)
class Bone:
    """One bone.

    Attributes
    ----------
    start, end : (3,) float64
        At rest; it turns about its start.
    parent : str
        Bone that it hangs on; empty for the root.
    radius : float
        Of the part around it: distances from the bone count in it.
    """

    start: np.ndarray
    end: np.ndarray
    parent: str
    radius: float


# Degrees about x, y and z in the rest pose's axes, by bone; and factors of length and girth.
Turns = Mapping[str, tuple[float, float, float]]
Sizes = Mapping[str, tuple[float, float]]


def distances(positions: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """(n, b) from every vertex to every segment (b, 2, 3)."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    offsets = positions[:, None] - start
    at = np.clip(np.einsum("nbd,bd->nb", offsets, along) / (along**2).sum(axis=1), 0, 1)
    return np.linalg.norm(offsets - at[:, :, None] * along, axis=2)


def shares(positions: np.ndarray, triangles: np.ndarray, bones: Mapping[str, Bone], fading: float) -> np.ndarray:
    """(n, b) share of every bone at every vertex: all the nearest's, faded over a length, of sqrt(area)."""
    away = distances(positions, np.array([(bone.start, bone.end) for bone in bones.values()]))
    nearest = (away / [bone.radius for bone in bones.values()]).argmin(axis=1)
    areas = vertex_areas(positions, triangles)
    heat = sparse.diags_array(areas) + fading**2 * areas.sum() * sparse.csc_array(stiffness(positions, triangles))
    faded = factor(sparse.csc_array(heat)).solve(areas[:, None] * np.eye(len(bones))[nearest])
    faded = np.clip(np.asarray(faded), 0, None)
    return faded / faded.sum(axis=1, keepdims=True)


def skinned(
    positions: np.ndarray, weights: np.ndarray, bones: Mapping[str, Bone], turns: Turns, sizes: Sizes | None = None
) -> np.ndarray:
    """(n, 3) positions after every bone is turned, made longer and thicker; bones come after their parents."""
    carried: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
    moved = np.zeros_like(positions)
    for (name, bone), share in zip(bones.items(), weights.T, strict=True):
        turn, place = np.eye(3), bone.start
        if bone.parent:
            turn, parent, shift = carried[bone.parent]
            place = parent @ bone.start + shift
        turn = turn @ Rotation.from_euler("xyz", turns.get(name, (0, 0, 0)), degrees=True).as_matrix()
        length, girth = (sizes or {}).get(name, (1.0, 1.0))
        axis = (bone.end - bone.start) / np.linalg.norm(bone.end - bone.start)
        matrix = turn @ (girth * np.eye(3) + (length - girth) * np.outer(axis, axis))
        carried[name] = turn, matrix, place - matrix @ bone.start
        moved += share[:, None] * (positions @ matrix.T + carried[name][2])
    return moved
