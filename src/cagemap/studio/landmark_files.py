"""Landmark files to and from the studio's places."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from cagemap.errors import CagemapError, FormatError
from cagemap.files.landmark_points import read_points, write_points
from cagemap.files.landmarks import read_landmarks, write_landmarks
from cagemap.files.marks import is_own
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import NamedCurve
from cagemap.mesh.curves import Curves
from cagemap.mesh.landmarks import CagePoints, Landmarks, NamedPoints, check_landmarks, paired
from cagemap.studio.landmarks import Landmark, LandmarkList
from cagemap.studio.places import cage_points, places_of
from cagemap.studio.scene import Scene
from cagemap.studio.state import Files

# Names that ask for a file a mesh instead of one for the pair.
PER_MESH = (".points.json", ".pp")
# 3D Slicer's form, which is read, not written.
SLICER = ".mrk.json"


def load_landmarks(
    path: Path, source_points: Path | None, scene: Scene, files: Files
) -> tuple[LandmarkList, list[str]]:
    """Read landmarks for the open models: a file of pairs, or one of points for each.

    Parameters
    ----------
    path : Path
        Of pairs; or of the target's points, in any form that `read_points` knows.
    source_points : Path or None
        Of the source's points; those of the same name are pairs.

    Raises
    ------
    FormatError, DirectionError, InvalidLandmarksError
        If a file is damaged, made for the other direction, or for other meshes.
    """
    target, source = scene.target.file_mesh, scene.source.file_mesh
    if source_points is None:
        read, notes = read_landmarks(path, files.target, files.source)
    else:
        read, notes = paired(read_points(path, target), read_points(source_points, source), target, source)
    check_landmarks(read, target, source)
    given, read = read, read.renumbered(scene.target.from_file, scene.source.from_file)
    if len(read) < len(given):
        notes = (*notes, f"{len(given) - len(read)} landmarks lie on pieces that are set aside and are left out")
    ends = zip(
        read.names,
        places_of(scene.target, read.target_points),
        places_of(scene.source, read.source_points),
        strict=True,
    )
    items = tuple(Landmark(number, *end) for number, end in enumerate(ends, 1))
    curves = read.curves
    between = [name for k, name in enumerate(curves.names) if _has_points_between(curves.only([k]))]
    if between:
        notes = (*notes, f"curves through points between vertices are left out here: {', '.join(between)}")
        curves = curves.only([k for k, name in enumerate(curves.names) if name not in between])
    return LandmarkList(items, curves if len(curves) else None), list(notes)


def save_landmarks(path: Path, landmarks: LandmarkList, scene: Scene, files: Files) -> tuple[Path, ...]:
    """Write complete landmarks; returns what was written.

    One file of pairs; a name that ends in ``.pp`` or ``.points.json`` asks for one file a mesh, NAME.target.pp and
    NAME.source.pp. The landmark file that is open may be one that a person made or edited, and one of ours may hold the
    landmarks of other models: it is copied aside before it is replaced.

    Raises
    ------
    FormatError
        If the name asks for a form that is not written, a file cannot be written, or another file of that name is there
        that cagemap did not write.
    """
    target, source = scene.target.file_mesh, scene.source.file_mesh
    complete = landmarks_of(landmarks, target, source).renumbered(scene.target.in_file, scene.source.in_file)
    ending = next((ending for ending in PER_MESH if path.name.lower().endswith(ending)), None)
    if ending is not None:
        stem = path.name[: -len(ending)]
        paths = tuple(path.with_name(f"{stem}.{side}{ending}") for side in ("target", "source"))
        sides = (
            (complete.target_points, complete.curves.target, target),
            (complete.source_points, complete.curves.source, source),
        )
        for file, (points, curves, control) in zip(paths, sides, strict=True):
            named = _named(complete.names, points, control)
            lines = tuple(
                NamedCurve(name, vertices := curves.at([k]).points.vertices, control.positions[vertices], bool(closed))
                for k, (name, closed) in enumerate(zip(complete.curves.names, curves.closed, strict=True))
            )
            write_points(file, replace(named, curves=lines), control)
        return paths
    if path.suffix.lower() != ".json" or path.name.lower().endswith(SLICER):
        known = ", ".join((".json", *PER_MESH))
        raise FormatError(f"{path.name}: expected a landmark file that ends in one of {known}. Choose such a name.")
    is_open = path == files.landmarks
    if path.is_file() and (is_open or is_own(path)) and not _is_of_this_pair(path, scene, files):
        shutil.copy2(path, next(name for name in _aside(path) if not name.exists()))
    write_landmarks(path, complete, force=is_open)
    return (path,)


def _is_of_this_pair(path: Path, scene: Scene, files: Files) -> bool:
    """Whether a file of pairs is one that cagemap wrote for these very models."""
    if not is_own(path):
        return False
    try:
        read, notes = read_landmarks(path, files.target, files.source)
        check_landmarks(read, scene.target.file_mesh, scene.source.file_mesh)
    except CagemapError:
        return False
    return not notes


def landmarks_of(landmarks: LandmarkList, target: ControlMesh, source: ControlMesh) -> Landmarks:
    """Landmarks of the package from the complete ones of the studio, and its curves."""
    items = landmarks.complete
    made = Landmarks.of_points(
        tuple(item.name for item in items),
        cage_points([item.target for item in items if item.target]),
        cage_points([item.source for item in items if item.source]),
        target.name,
        source.name,
    )
    return made if landmarks.curves is None else replace(made, curves=landmarks.curves)


def _has_points_between(curves: Curves) -> bool:
    return any(bool((side.points.vertices < 0).any()) for side in (curves.target, curves.source))


def _named(names: tuple[str, ...], points: CagePoints, control: ControlMesh) -> NamedPoints:
    vertices = points.vertices
    positions = np.where(vertices[:, None] >= 0, np.nan, points.of(control.positions))
    return NamedPoints(names, vertices, positions, control.name)


def _aside(path: Path) -> Iterator[Path]:
    yield path.with_name(f"{path.name}.before-studio")
    for number in itertools.count(2):
        yield path.with_name(f"{path.name}.before-studio-{number}")
