"""Plain meshes of a match (scheme none): made ready, and what was done to them."""

from __future__ import annotations

from dataclasses import dataclass

from cagemap.cli.match_parts import PartInputs
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import require_valid
from cagemap.mesh.landmarks import Renumbering, check_landmarks
from cagemap.mesh.plain import plain_mesh
from cagemap.mesh.schemes import Plain
from cagemap.numerics.arrays import IndexArray


@dataclass(frozen=True)
class ReadyInputs:
    """Two meshes that can be matched.

    Attributes
    ----------
    inputs : PartInputs
    notes : tuple of str
        What was done to plain meshes.
    repairs : dict
        The same in numbers, for a manifest, by side.
    """

    inputs: PartInputs
    notes: tuple[str, ...]
    repairs: dict[str, dict[str, float]]


def ready_inputs(given: PartInputs) -> ReadyInputs:
    """Check two meshes and their landmarks; plain ones are mended, and what of them is set aside is said.

    Raises
    ------
    InvalidMeshError
        If a mesh cannot be matched, and mending does not help.
    InvalidLandmarksError
        If landmarks do not fit the meshes.
    """
    check_landmarks(given.landmarks, given.target, given.source)
    meshes: list[ControlMesh] = []
    numbers: list[Renumbering] = []
    notes: list[str] = []
    repairs: dict[str, dict[str, float]] = {}
    for side, mesh in (("target", given.target), ("source", given.source)):
        if isinstance(mesh.scheme, Plain):
            plain = plain_mesh(mesh)
            notes += plain.notes
            repairs[side] = plain.repairs.summary()
            meshes.append(plain.mesh)
            numbers.append(plain.renumber)
        else:
            require_valid(mesh)
            meshes.append(mesh)
            numbers.append(_same)
    landmarks = given.landmarks.renumbered(*numbers)
    left = len(given.landmarks) - len(landmarks)
    if left:
        notes.append(f"{left} of {len(given.landmarks)} landmarks lie on pieces that are set aside and are left out")
    return ReadyInputs(PartInputs(meshes[0], meshes[1], landmarks), tuple(notes), repairs)


def _same(vertices: IndexArray) -> IndexArray:
    return vertices
