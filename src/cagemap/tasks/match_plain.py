"""Plain meshes of a match (scheme none): repair, and notes on it."""

from __future__ import annotations

from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import require_valid
from cagemap.mesh.landmarks import check_landmarks
from cagemap.mesh.mesh_report import counted
from cagemap.mesh.plain import PlainMesh, plain_mesh
from cagemap.mesh.schemes import Plain
from cagemap.mesh.topology import handle_count
from cagemap.mesh.weld import Welded, unwelded
from cagemap.numerics.threads import in_threads
from cagemap.tasks.match_parts import PartInputs


def ready_inputs(given: PartInputs) -> PartInputs:
    """Check two meshes and their landmarks; plain ones are mended, and what of them is set aside is said.

    Raises
    ------
    InvalidMeshError
        If a mesh cannot be matched, and mending does not help.
    InvalidLandmarksError
        If landmarks do not fit the meshes.
    """
    check_landmarks(given.landmarks, given.target, given.source)
    ready = dict(zip(("target", "source"), in_threads(ready_mesh, [given.target, given.source]), strict=True))
    plain = {side: one for side, one in ready.items() if isinstance(one, PlainMesh)}
    meshes = [one.mesh for one in ready.values()]
    numbers = [one.vertex_of.__getitem__ for one in ready.values()]
    notes = [note for one in plain.values() for note in one.notes]
    repairs = {side: one.repairs.summary() for side, one in plain.items()}
    landmarks = given.landmarks.renumbered(*numbers)
    for what, before, after in (
        ("landmarks", len(given.landmarks), len(landmarks)),
        ("curves", len(given.landmarks.curves), len(landmarks.curves)),
    ):
        if after < before:
            notes.append(f"{before - after} of {before} {what} lie on pieces that are set aside and are left out")
    if not plain:  # a scan's holes and bridges say little
        notes += _handle_notes(*meshes)
    return PartInputs(meshes[0], meshes[1], landmarks, tuple(notes), repairs)


def _handle_notes(*meshes: ControlMesh) -> list[str]:
    """Whether two cages cannot be one to one."""
    counts = [handle_count(mesh) for mesh in meshes]
    if counts[0] == counts[1]:
        return []
    (one, a), (other, b) = zip((mesh.name for mesh in meshes), counts, strict=True)
    return [f"{one} has {counted(a, 'handle')}, {other} {b}: no map is one to one, this one tears or folds somewhere"]


def ready_mesh(mesh: ControlMesh) -> PlainMesh | Welded:
    """A cage as it is, or a plain mesh repaired, once it is checked; ``mesh``, ``vertex_of`` and ``notes`` of either.

    Raises
    ------
    InvalidMeshError
        If it cannot be matched.
    """
    ready = plain_mesh(mesh) if isinstance(mesh.scheme, Plain) else unwelded(mesh)
    require_valid(ready.mesh)
    return ready
