"""Units and axes of USD files: results are in the target's own, whatever the source's are."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.usd.read import USD_SUFFIXES, named_damage, open_stage, read_usd_meshes, usd_modules
from cagemap.numerics.arrays import FloatArray

# Z up to Y up, for rows.
_Z_TO_Y = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True, eq=False)
class StageSpace:
    """Lengths and directions of a USD file, and (4, 4) the transform of its mesh for rows, where it has only one."""

    up_axis: str
    meters_per_unit: float
    to_world: FloatArray = field(default_factory=lambda: np.eye(4), repr=False)

    def __str__(self) -> str:
        return f"{self.meters_per_unit:g} m a unit, {self.up_axis} up"


def stage_units(path: str | Path) -> StageSpace:
    """Units of a USD file; its transform is not read."""
    pxr, stage = usd_modules(), open_stage(path)
    with named_damage(path):
        axis, length = str(pxr.UsdGeom.GetStageUpAxis(stage)), float(pxr.UsdGeom.GetStageMetersPerUnit(stage))
    if axis not in ("Y", "Z") or not 0.0 < length < float("inf"):
        raise FormatError(f"{path}: expected the up axis Y or Z and a positive metersPerUnit, got {axis}, {length}.")
    return StageSpace(axis, length)


def stage_space(path: str | Path) -> StageSpace:
    """The space of what `read_usd` reads from a file: several meshes are read in world space."""
    units, meshes = stage_units(path), read_usd_meshes(path)
    return replace(units, to_world=meshes[0].to_world) if len(meshes) == 1 else units


def unit_notes(*files: Path) -> tuple[str, ...]:
    """A sentence about target and source where both are USD files, of different units or axes."""
    if not all(map(_is_usd, files)):
        return ()
    (target, here), (source, there) = ((file.name, stage_units(file)) for file in files)
    if (here.up_axis, here.meters_per_unit) == (there.up_axis, there.meters_per_unit):
        return ()
    return (f"{target} has {here}, {source} {there}: results are in the target's own",)


def to_standard(path: Path) -> FloatArray:
    """(4, 4) from the space of a USD file's control mesh to metres in world space with Y up."""
    space = stage_space(path)
    turned = space.to_world @ (_Z_TO_Y if space.up_axis == "Z" else np.eye(4))
    turned[:, :3] *= space.meters_per_unit
    return np.asarray(turned, dtype=np.float64)


def upright_turn(path: Path) -> FloatArray | None:
    """(3, 3) rotation for rows from the space of a file's control mesh to Y up; None where the file is no USD file."""
    if not _is_usd(path):
        return None
    left, _, right = np.linalg.svd(to_standard(path)[:3, :3])
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def between_spaces(target: Path | None, source: Path | None) -> FloatArray:
    """(4, 4) from the source's space to the target's; the identity unless both are USD files, which alone say it."""
    if target is None or source is None or not (_is_usd(target) and _is_usd(source)):
        return np.eye(4)
    return np.asarray(to_standard(source) @ np.linalg.inv(to_standard(target)), dtype=np.float64)


def _is_usd(path: Path) -> bool:
    return path.suffix.lower() in USD_SUFFIXES
