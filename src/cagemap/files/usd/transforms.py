"""Transforms of USD prims: (4, 4) matrices that take points as rows."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import FormatError
from cagemap.numerics.arrays import FloatArray

logger = logging.getLogger(__name__)

# Condition from which on a transform counts as one that flattens: float32 scales hold seven digits.
_FLATTENING = 1e12


def moved(points: FloatArray, matrix: FloatArray) -> FloatArray:
    """(n, 3) points through a (4, 4) matrix of USD, which takes rows."""
    return np.asarray(points @ matrix[:3, :3] + matrix[3, :3])


def is_mirrored(matrix: FloatArray) -> bool:
    """Whether a (4, 4) transform makes left hands of right ones."""
    return bool(np.linalg.det(matrix[:3, :3]) < 0)


def local_to_world(prim: Any) -> FloatArray:
    """(4, 4) from a prim's own space to the world's.

    Raises
    ------
    FormatError
        If it flattens what it moves, or is not finite.
    """
    matrix = _to_world(prim)
    if not np.isfinite(matrix).all() or _is_flattening(matrix):
        raise FormatError(
            f"{prim.GetStage().GetRootLayer().realPath}: {prim.GetPath()}: expected a transform that can be undone, "
            "got one that flattens the mesh or holds no numbers. Repair its scale and export again."
        )
    return matrix


def unflattened(file: Path, prims: list[Any]) -> list[Any]:
    """Meshes that are no points, lines or planes in world space; all of them where none is."""
    flat = [_is_flattening(_to_world(prim)) for prim in prims]
    if not any(flat) or all(flat):
        return prims
    names = ", ".join(str(prim.GetPath()) for prim, flattened in zip(prims, flat, strict=True) if flattened)
    logger.warning("%s: left out what its transform flattens (a scale of 0): %s", file, names)
    return [prim for prim, flattened in zip(prims, flat, strict=True) if not flattened]


def _to_world(prim: Any) -> FloatArray:
    from pxr import Usd, UsdGeom

    time = Usd.TimeCode.EarliestTime()
    return np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time), dtype=np.float64)


def _is_flattening(matrix: FloatArray) -> bool:
    return bool(np.isfinite(matrix).all() and np.linalg.cond(matrix[:3, :3]) > _FLATTENING)
