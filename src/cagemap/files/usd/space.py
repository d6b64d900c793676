"""Units and axes of USD files, and transforms between them; results are in the target's."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.character.values import Part
from cagemap.errors import FormatError
from cagemap.files.gltf.document import SCENE_SUFFIXES
from cagemap.files.gltf.geometry import Z_TO_Y, is_z_up
from cagemap.files.gltf.parts import transform_part
from cagemap.files.usd.read import meshes_with_points, read_usd_meshes
from cagemap.files.usd.stages import damage_as_error, is_usd, open_stage, pxr
from cagemap.files.usd.transforms import drop_flattened, is_mirrored, is_similarity, local_to_world
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class StageSpace:
    """Unit and up axis of a USD file, and the (4, 4) transform of its only mesh, for rows."""

    up_axis: str
    meters_per_unit: float
    to_world: FloatArray = field(default_factory=lambda: np.eye(4), repr=False)

    def __str__(self) -> str:
        return f"{self.meters_per_unit:g} m a unit, {self.up_axis} up"


def stage_units(path: str | Path) -> StageSpace:
    """Unit and up axis of a USD file, without the transform of its mesh; glTF and FBX are read in metres, Y up."""
    if Path(path).suffix.lower() in SCENE_SUFFIXES:
        return StageSpace("Y", 1.0)
    return _units_of(path, open_stage(path))


def _units_of(path: str | Path, stage: Any) -> StageSpace:
    """Unit and up axis of an open USD file."""
    with damage_as_error(path):
        axis, length = str(pxr.UsdGeom.GetStageUpAxis(stage)), float(pxr.UsdGeom.GetStageMetersPerUnit(stage))
    if axis not in ("Y", "Z") or not 0.0 < length < float("inf"):
        raise FormatError(
            f"{path}: expected the up axis Y or Z and a positive metersPerUnit, got {axis}, {length}. Export it again."
        )
    return StageSpace(axis, length)


def stage_space(path: str | Path) -> StageSpace:
    """The space of a file's control mesh by `read_usd`; world space if it has several meshes.

    Gives no warnings on parts of the file that are left out: `read_usd` gives them.
    """
    stage = open_stage(path, warn=False)
    units = _units_of(path, stage)
    with damage_as_error(path):
        prims = drop_flattened(Path(path), meshes_with_points(stage), warn=False)
        if not prims:
            read_usd_meshes(path)  # refuses the file
        return replace(units, to_world=local_to_world(prims[0])) if len(prims) == 1 else units


def similar_space(path: str | Path) -> StageSpace:
    """The space of a file's control mesh, as by `stage_space`; world space if a transform mirrors or distorts it."""
    space = stage_space(path)
    is_kept = is_similarity(space.to_world) and not is_mirrored(space.to_world)
    return space if is_kept else replace(space, to_world=np.eye(4))


def states_units(path: Path) -> bool:
    """Whether a file states its units and axes: USD, glTF and FBX."""
    return is_usd(path) or path.suffix.lower() in SCENE_SUFFIXES


def unit_notes(*files: Path) -> tuple[str, ...]:
    """A sentence on target and source if both state their units and axes, and these differ."""
    if not all(map(states_units, files)):
        return ()
    (target, target_space), (source, source_space) = ((file.name, stage_units(file)) for file in files)
    if (target_space.up_axis, target_space.meters_per_unit) == (source_space.up_axis, source_space.meters_per_unit):
        return ()
    return (f"{target} has {target_space}, {source} {source_space}: results are in the target's own",)


def to_standard(path: Path) -> FloatArray:
    """(4, 4) from the space of the control mesh of a USD, glTF or FBX file to metres in world space with Y up."""
    return to_metres(stage_space(path) if is_usd(path) else stage_units(path))


def to_metres(space: StageSpace) -> FloatArray:
    """(4, 4) from a space to metres in world space with Y up."""
    turned = space.to_world @ (Z_TO_Y if space.up_axis == "Z" else np.eye(4))
    turned[:, :3] *= space.meters_per_unit
    return np.asarray(turned, dtype=np.float64)


def between_spaces(target: Path | None, source: Path | None) -> FloatArray:
    """(4, 4) from the source's space to the target's; the identity for one file, or if one does not state its own."""
    if target is None or source is None or not states_units(target) or not states_units(source):
        return np.eye(4)
    if target.resolve() == source.resolve():
        return np.eye(4)
    return np.asarray(to_standard(source) @ np.linalg.inv(to_standard(target)), dtype=np.float64)


def from_mesh_space(target: Path, mesh: ControlMesh, file: Path | None) -> FloatArray | None:
    """(4, 4) from the space of a mesh to that of a USD, glTF or FBX file; if its own states none, in the same unit.

    None if nothing states the mesh's axes.
    """
    if not states_units(target) or (file is not None and states_units(file)):
        return between_spaces(target, file)
    if mesh.upright is None:
        return None
    space = StageSpace("Z" if is_z_up(mesh) else "Y", stage_units(target).meters_per_unit)
    return np.asarray(to_metres(space) @ np.linalg.inv(to_standard(target)), dtype=np.float64)


def transform_mesh(mesh: ControlMesh, matrix: FloatArray) -> ControlMesh:
    """The mesh transformed by a (4, 4) matrix for points as rows; its faces are reversed if this mirrors it."""
    return transform_part(Part(mesh.name, mesh), matrix).mesh
