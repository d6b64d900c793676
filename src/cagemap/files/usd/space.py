"""Units and axes of USD files: results are in the target's own, whatever the source's are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.usd.read import USD_SUFFIXES, named_damage, one_mesh, open_stage, read_usd_meshes, usd_modules
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray

# Z up to Y up, for rows.
_Z_TO_Y = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True)
class StageUnits:
    """What a USD file says about lengths and directions.

    Attributes
    ----------
    up_axis : str
        "Y" or "Z".
    """

    up_axis: str
    meters_per_unit: float

    def __str__(self) -> str:
        return f"{self.meters_per_unit:g} m a unit, {self.up_axis} up"


def stage_units(path: str | Path) -> StageUnits | None:
    """Units of a USD file; None where the file is another one, which says nothing about them."""
    if Path(path).suffix.lower() not in USD_SUFFIXES:
        return None
    pxr, stage = usd_modules(), open_stage(path)
    with named_damage(path):
        axis, length = str(pxr.UsdGeom.GetStageUpAxis(stage)), float(pxr.UsdGeom.GetStageMetersPerUnit(stage))
    if axis not in ("Y", "Z") or not 0.0 < length < float("inf"):
        raise FormatError(f"{path}: expected the up axis Y or Z and a positive metersPerUnit, got {axis}, {length}.")
    return StageUnits(axis, length)


@dataclass(frozen=True, eq=False)
class StageSpace:
    """The space that a mesh of a USD file is in.

    Attributes
    ----------
    to_world : (4, 4) float64
        The prim's transform, for rows.
    """

    units: StageUnits
    to_world: FloatArray


def stage_space(path: str | Path) -> StageSpace:
    """The space of a mesh that was read from a USD file."""
    units, meshes = stage_units(path), read_usd_meshes(path)
    assert units is not None
    # Several meshes are read in world space.
    return StageSpace(units, meshes[0].to_world if len(meshes) == 1 else np.eye(4))


def unit_notes(target: Path, source: Path) -> tuple[str, ...]:
    """A sentence about USD files of different units or axes."""
    units = stage_units(target), stage_units(source)
    if None in units or units[0] == units[1]:
        return ()
    return (f"{target.name} has {units[0]}, {source.name} {units[1]}: results are in the target's own",)


def to_standard(path: Path, control: ControlMesh) -> FloatArray:
    """(4, 4) from the space of a file's control mesh to metres in world space with Y up."""
    units = stage_units(path)
    assert units is not None
    meshes = read_usd_meshes(path)
    # Several meshes are read in world space.
    placed = one_mesh(path, meshes, control).to_world if len(meshes) == 1 else np.eye(4)
    turned = placed @ (_Z_TO_Y if units.up_axis == "Z" else np.eye(4))
    turned[:, :3] *= units.meters_per_unit
    return np.asarray(turned, dtype=np.float64)


def upright_turn(path: Path, control: ControlMesh) -> FloatArray | None:
    """(3, 3) rotation for rows from the space of a file's control mesh to Y up; None where the file is no USD file."""
    if path.suffix.lower() not in USD_SUFFIXES:
        return None
    left, _, right = np.linalg.svd(to_standard(path, control)[:3, :3])
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def between_spaces(
    target_file: Path | None, target: ControlMesh, source_file: Path | None, source: ControlMesh
) -> FloatArray:
    """(4, 4) from the source's space to the target's; the identity unless both are USD files, which alone say it."""
    files = [path for path in (target_file, source_file) if path is not None and path.suffix.lower() in USD_SUFFIXES]
    if len(files) < 2:
        return np.eye(4)
    there, here = to_standard(files[1], source), to_standard(files[0], target)
    return np.asarray(there @ np.linalg.inv(here), dtype=np.float64)
