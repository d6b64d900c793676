"""The built-in face: the head of ICT-FaceKit with the blend shapes of ARKit."""

from __future__ import annotations

from importlib import resources

import numpy as np

from cagemap.character.values import Part
from cagemap.errors import InvalidLandmarksError, ParameterError
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import first_few

# Blend shape of ARKit that ICT-FaceKit lacks.
ABSENT = "tongueOut"
# Vertices of the head on its midline and at the corners of eyes and mouth.
POINTS = {
    "nose_tip": 4841,
    "chin": 968,
    "mouth_left": 6684,
    "mouth_right": 6648,
    "eye_outer_left": 6548,
    "eye_inner_left": 6588,
    "eye_outer_right": 6590,
    "eye_inner_right": 6630,
}


def kit_vertices(names: tuple[str, ...]) -> list[int]:
    """Vertices of the head at named points."""
    unknown = [name for name in names if name not in POINTS]
    if unknown:
        raise InvalidLandmarksError(
            f"expected points of a face named {', '.join(POINTS)}, got {first_few(unknown)}. Rename them."
        )
    return [POINTS[name] for name in names]


def read_face_kit(only: tuple[str, ...] | None = None) -> Part:
    """Read the head with its blend shapes: in centimetres, Y up, facing +Z, open at the neck.

    ``only``: ARKit's names of the shapes to read. Default: all 51 of ICT-FaceKit; it has no tongueOut.
    """
    with resources.as_file(resources.files("cagemap.character.face")) as folder, np.load(folder / "face.npz") as kept:
        given = {name: kept[name] for name in kept.files}
    number = {str(name): k for k, name in enumerate(given["names"])}
    wanted = tuple(number) if only is None else only
    if ABSENT in wanted:
        raise ParameterError(f"only: {ABSENT} is not among the shapes of ICT-FaceKit. Leave it out.")
    unknown = [name for name in wanted if name not in number]
    if unknown:
        raise ParameterError(f"only: expected names among {', '.join(number)}, got {first_few(unknown)}")
    shapes = {}
    for name in wanted:
        start, end = given["starts"][number[name] : number[name] + 2]
        offsets = np.zeros((len(given["positions"]), 3))
        offsets[given["rows"][start:end]] = given["shifts"][start:end]
        shapes[name] = offsets
    mesh = ControlMesh.from_faces(given["positions"].astype(np.float64), given["quads"], name="ICT-FaceKit")
    return Part("face", mesh, None, shapes)
