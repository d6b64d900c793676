"""Landmark files to and from the studio's places."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cagemap.errors import InvalidLandmarksError
from cagemap.files.landmarks import read_landmarks, write_landmarks
from cagemap.files.marks import is_own
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import IndexArray
from cagemap.studio.landmarks import Landmark, LandmarkList, Place
from cagemap.studio.scene import Scene
from cagemap.studio.shape import Shape, nearest_vertex, vertex_place
from cagemap.studio.state import Files


def load_landmarks(path: Path, scene: Scene, files: Files) -> tuple[LandmarkList, tuple[str, ...]]:
    """Read a landmark file for the open models.

    Raises
    ------
    FormatError, DirectionError, InvalidLandmarksError
        If it is damaged, made for the other direction, or for other meshes.
    """
    read, notes = read_landmarks(path, files.target, files.source)
    sides = ((read.target, scene.target), (read.source, scene.source))
    for vertices, shape in sides:
        if len(vertices) and not 0 <= vertices.min() <= vertices.max() < shape.n_control:
            raise InvalidLandmarksError(
                f"{path}: expected control vertices 0 to {shape.n_control - 1} of {shape.name}, got {vertices.max()}. "
                "Choose the landmark file of these models."
            )
    items = tuple(
        Landmark(number + 1, name, *(vertex_place(shape, int(vertices[number])) for vertices, shape in sides))
        for number, name in enumerate(read.names)
    )
    return LandmarkList(items), notes


def save_landmarks(path: Path, items: tuple[Landmark, ...], scene: Scene, files: Files) -> None:
    """Write complete landmarks.

    The landmark file that is open may be one that a person made or edited: it is copied aside before it is replaced.

    Raises
    ------
    FormatError
        If the file cannot be written, or another file of that name is there that cagemap did not write.
    """
    target = vertices_of(tuple(item.target for item in items if item.target), scene.target)
    source = vertices_of(tuple(item.source for item in items if item.source), scene.source)
    names = tuple(item.name for item in items)
    is_open = path == files.landmarks
    if is_open and path.is_file() and not is_own(path):
        shutil.copy2(path, next(name for name in _aside(path) if not name.exists()))
    landmarks = Landmarks(names, target, source, files.target.name, files.source.name)
    write_landmarks(path, landmarks, force=is_open)


def _aside(path: Path) -> Iterator[Path]:
    yield path.with_name(f"{path.name}.before-studio")
    for number in itertools.count(2):
        yield path.with_name(f"{path.name}.before-studio-{number}")


def vertices_of(places: tuple[Place, ...], shape: Shape) -> IndexArray:
    """Control vertices of places: their own, or the nearest ones."""
    return np.array(
        [
            nearest_vertex(shape, np.array(place.position), shape.n_control) if place.vertex is None else place.vertex
            for place in places
        ],
        dtype=np.int64,
    )
