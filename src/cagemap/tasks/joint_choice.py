"""`cagemap transfer --weights` with `--only` and `--mirror`: weights of chosen joints, symmetric weights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cagemap.character.bones import mirrored_joints
from cagemap.errors import ParameterError
from cagemap.files.values.attributes import read_attributes
from cagemap.files.values.part_numbering import FileRows
from cagemap.mesh import ControlMesh
from cagemap.mesh.mirrors import mirror_symmetries
from cagemap.numerics.arrays import FloatArray
from cagemap.tasks.requests.transfer import TransferRequest, base_of
from cagemap.transfer.skin import chosen_joints, mirrored_skin, normalised, pruned


def with_choice(
    request: TransferRequest, control: ControlMesh, carried: FloatArray, names: Sequence[str], rows: FileRows | None
) -> FloatArray:
    """Carried weights (n, j), made symmetric if asked; joints that are not chosen keep the target's own weights.

    Parameters
    ----------
    request : TransferRequest
    control : ControlMesh
        The target's.
    carried : (n, j) float64
    names : sequence of str
        Of the joints; empty where the weights have none.
    rows : FileRows or None
        Of the target's file.

    Raises
    ------
    ParameterError
        If joints have no names, or none of those asked for; if the target has no mirror plane, or no own weights.
    """
    for option, asked in (("--mirror", request.mirror), ("--only", request.only is not None)):
        if asked and not names:
            raise ParameterError(f"{option}: expected weights of named joints. Give a column for each, or --joints.")
    if request.mirror:
        carried = _alike(control, carried, names)
        carried = normalised(pruned(carried, request.influences or None), carried.sum(axis=1))
    return carried if request.only is None else _chosen(request, control, carried, names, rows)


def _alike(control: ControlMesh, carried: FloatArray, names: Sequence[str]) -> FloatArray:
    """Means with the mirror image, of the plane that changes least."""
    joints = mirrored_joints(names)
    if np.array_equal(joints, np.arange(len(names))):
        raise ParameterError(
            "--mirror: expected joints of both sides, such as arm.L and arm.R, got none by their names"
        )
    found = [mirrored_skin(carried, mirror.image, joints) for mirror in mirror_symmetries(control)]
    if not found:
        raise ParameterError(f"--mirror: expected a target with a mirror plane, {control.name} has none. Leave it out.")
    return min(found, key=lambda skin: float(np.abs(skin - carried).sum()))


def _chosen(
    request: TransferRequest, control: ControlMesh, carried: FloatArray, names: Sequence[str], rows: FileRows | None
) -> FloatArray:
    words = [word.strip() for word in str(request.only).split(",") if word.strip()]
    missing = [word for word in words if word not in names]
    if missing or not words:
        raise ParameterError(
            f"--only: expected names of joints ({', '.join(names)}), got {', '.join(missing) or 'none'}"
        )
    base = base_of(request)
    if base is None:
        raise ParameterError("--only: expected the target's own weights of the other joints. Give them as --base.")
    return chosen_joints(carried, _own(base, control, names, rows), np.array([names.index(word) for word in words]))


def _own(base: Path, control: ControlMesh, names: Sequence[str], rows: FileRows | None) -> FloatArray:
    """(n, j) weights of a file, by the joints' names; a table is taken to be in their order."""
    own = read_attributes(base, control, rows)
    if all(name in own for name in names):
        return np.column_stack([own[name] for name in names]).astype(np.float64)
    (table,) = own.values() if len(own) == 1 else (None,)
    if table is None or table.shape != (control.n_vertices, len(names)):
        raise ParameterError(f"--base {base}: expected weights of {', '.join(names)} for each vertex of {control.name}")
    return np.asarray(table, dtype=np.float64)
