"""Transforms of USD prims: from their space to the world, and what they do to a mesh."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.usd.stages import pxr
from cagemap.numerics.arrays import FloatArray

_log = logging.getLogger(__name__)

# Condition number from which a transform counts as flattening: float32 scales have seven digits.
_FLATTENING = 1e12


def is_mirrored(matrix: FloatArray) -> bool:
    """Whether a (4, 4) transform reverses orientation."""
    return bool(np.linalg.det(matrix[:3, :3]) < 0)


def is_similarity(matrix: FloatArray) -> bool:
    """Whether a (4, 4) transform scales all directions alike."""
    products = matrix[:3, :3] @ matrix[:3, :3].T
    return bool(np.allclose(products, products[0, 0] * np.eye(3), atol=1e-6 * products[0, 0]))


def local_to_world(prim: Any) -> FloatArray:
    """(4, 4) transform from a prim's local space to world space."""
    matrix = _to_world(prim)
    if not np.isfinite(matrix).all() or _is_flattening(matrix):
        raise FormatError(
            f"{prim.GetStage().GetRootLayer().realPath}: {prim.GetPath()}: expected a transform that can be undone, "
            "got one that flattens the mesh or holds no numbers. Repair its scale and export again."
        )
    return matrix


def drop_flattened(file: Path, prims: list[Any], *, warn: bool = True) -> list[Any]:
    """The meshes whose transforms are invertible; all of them if no transform is.

    ``warn``: warn of those that are left out.
    """
    flat = [_is_flattening(_to_world(prim)) for prim in prims]
    if not any(flat) or all(flat):
        return prims
    names = ", ".join(str(prim.GetPath()) for prim, flattened in zip(prims, flat, strict=True) if flattened)
    if warn:
        _log.warning("%s: left out what its transform flattens (a scale of 0): %s", file, names)
    return [prim for prim, flattened in zip(prims, flat, strict=True) if not flattened]


def _to_world(prim: Any) -> FloatArray:
    time = pxr.Usd.TimeCode.EarliestTime()
    return np.array(pxr.UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time), dtype=np.float64)


def _is_flattening(matrix: FloatArray) -> bool:
    return bool(np.isfinite(matrix).all() and np.linalg.cond(matrix[:3, :3]) > _FLATTENING)
