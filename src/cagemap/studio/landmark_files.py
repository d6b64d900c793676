"""Landmark files to and from the studio's places."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from cagemap.errors import CagemapError
from cagemap.files.landmarks.pairs import read_landmarks, write_landmarks
from cagemap.files.landmarks.point_formats import POINT_FORMS, is_of_pairs, point_form, write_points
from cagemap.files.landmarks.points import read_points
from cagemap.files.ownership import is_own
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import NamedCurve
from cagemap.mesh.curves import CageCurves, Curves
from cagemap.mesh.landmarks import CagePoints, Landmarks, NamedPoints, Renumbering, check_landmarks, paired
from cagemap.studio.autosave import Owned, autosave_path, read_autosave
from cagemap.studio.landmarks import SIDES, Landmark, LandmarkList, Side
from cagemap.studio.places import cage_points, places_of
from cagemap.studio.scene import Scene
from cagemap.studio.state import Files

# What landmarks are saved as, and the endings that ask for it.
FORMS = {"pairs (.json)": ".json"} | {f"{form.title} ({form.ending})": form.ending for form in POINT_FORMS}


def load_landmarks(
    path: Path, source_points: Path | None, scene: Scene, files: Files, owned: Owned
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
    owned.know(path)
    if source_points is None:
        read, notes = read_landmarks(path, files.target, files.source)
    else:
        read, notes = paired(read_points(path, target), read_points(source_points, source), target, source)
    check_landmarks(read, target, source)
    here, elsewhere = split(read, scene)
    if elsewhere is not None and len(elsewhere):
        notes = (*notes, f"{len(elsewhere)} landmarks lie on other parts of the files; they stay in the file")
    if elsewhere is not None and len(elsewhere.curves):
        names = ", ".join(elsewhere.curves.names)
        notes = (*notes, f"curves on other parts or between vertices are not used here; they stay in the file: {names}")
    return LandmarkList(_items(here, scene, 1), here.curves if len(here.curves) else None, elsewhere), list(notes)


def opened_landmarks(files: Files, scene: Scene, owned: Owned) -> tuple[LandmarkList, list[str]] | None:
    """Landmarks of the pair's file, and notes; None where there is no such file."""
    return load_landmarks(files.landmarks, None, scene, files, owned) if files.landmarks.is_file() else None


def recovered_landmarks(files: Files, scene: Scene, owned: Owned) -> tuple[LandmarkList, list[str]] | None:
    """Landmarks that were not saved, and notes; None where there are none."""
    kept = autosave_path(files.landmarks)
    if not kept.is_file():
        return None
    owned.know(kept)
    meshes = scene.target.file_mesh, scene.source.file_mesh
    landmarks, notes = on_parts(read_autosave(kept, (meshes[0].n_vertices, meshes[1].n_vertices)), scene)
    return landmarks, [*notes, f"recovered unsaved landmarks of {files.landmarks.name}"]


# What newly opened models begin with, the first that there is; and whether that is saved.
FIRST = ((recovered_landmarks, False), (opened_landmarks, True))


def split(given: Landmarks, scene: Scene) -> tuple[Landmarks, Landmarks | None]:
    """Pairs and curves in the files' numbers: those of the open parts, in their numbers, and the others as they are."""
    here = given.renumbered(scene.target.from_file, scene.source.from_file)
    curves = here.curves
    drawn = [k for k in range(len(curves)) if not _has_points_between(curves.only([k]))]
    here = replace(here, curves=curves.only(drawn))
    pairs, lines = set(here.names), set(here.curves.names)
    others = given.without([i for i, name in enumerate(given.names) if name in pairs])
    others = replace(
        others, curves=given.curves.only([k for k, name in enumerate(given.curves.names) if name not in lines])
    )
    return here, others if len(others) + len(others.curves) else None


def in_files(landmarks: LandmarkList, scene: Scene) -> LandmarkList:
    """The same list in the numbers of the models' files."""
    numbers: dict[Side, Renumbering] = {"target": scene.target.in_file, "source": scene.source.in_file}
    curves = landmarks.curves
    if curves is not None:
        sides = (numbers["target"](curves.target.points.corners), numbers["source"](curves.source.points.corners))
        curves = curves.renumbered(*sides)
    return replace(landmarks, items=tuple(_renumbered(item, numbers) for item in landmarks.items), curves=curves)


def on_parts(kept: LandmarkList, scene: Scene) -> tuple[LandmarkList, list[str]]:
    """A list in the files' numbers in those of the open parts, and what is to be said about it."""
    numbers: dict[Side, Renumbering] = {"target": scene.target.from_file, "source": scene.source.from_file}
    moved = tuple(_renumbered(item, numbers) for item in kept.items)
    inside = [all(place is None or min(place.corners) >= 0 for place in (item.target, item.source)) for item in moved]
    away = LandmarkList(tuple(item for item, here in zip(kept.items, inside, strict=True) if not here))
    notes = [
        f"{item.name}, not yet complete, lies on another part and is left out"
        for item in away.items
        if not item.complete
    ]
    given = landmarks_of(away, scene.target.file_mesh, scene.source.file_mesh)
    if kept.elsewhere is not None:
        given = given.joined_with(kept.elsewhere)
    here, elsewhere = split(replace(given, curves=kept.curves or Curves.none()), scene)
    items = tuple(item for item, here in zip(moved, inside, strict=True) if here)
    items += _items(here, scene, 1 + max((item.number for item in items), default=0))
    if elsewhere is not None and len(elsewhere):
        notes.append(f"{len(elsewhere)} landmarks lie on other parts of the files; they are kept for these")
    return LandmarkList(items, here.curves if len(here.curves) else None, elsewhere), notes


def _items(landmarks: Landmarks, scene: Scene, first: int) -> tuple[Landmark, ...]:
    """Landmarks of the open parts as the studio has them, numbered from the first number on."""
    ends = zip(
        landmarks.names,
        places_of(scene.target, landmarks.target_points),
        places_of(scene.source, landmarks.source_points),
        strict=True,
    )
    return tuple(Landmark(number, *end) for number, end in enumerate(ends, first))


def _renumbered(item: Landmark, numbers: dict[Side, Renumbering]) -> Landmark:
    for side in SIDES:
        place = item.on(side)
        if place is not None:
            a, b, c = numbers[side](np.array(place.corners)).tolist()
            item = item.at(side, replace(place, corners=(a, b, c)))
    return item


def save_landmarks(
    path: Path, landmarks: LandmarkList, scene: Scene, files: Files, owned: Owned
) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Write complete landmarks; returns what was written, and what it could not hold or what is kept of before.

    One file of pairs; a name with the ending of one of `files.landmarks.point_formats` asks for one file a mesh,
    NAME.target.pp and NAME.source.pp. The landmark file that is open may be one that a person made or edited, and one
    of ours may hold the landmarks of other models, or what another studio has saved since: it is copied aside before
    it is replaced.

    Raises
    ------
    FormatError
        If the name asks for no form, a file cannot be written, or another file of that name is there that cagemap did
        not write.
    """
    target, source = scene.target.file_mesh, scene.source.file_mesh
    complete = landmarks_of(landmarks, scene.target.control, scene.source.control)
    complete = complete.renumbered(scene.target.in_file, scene.source.in_file)
    complete = complete if landmarks.elsewhere is None else complete.joined_with(landmarks.elsewhere)
    if not is_of_pairs(path):
        sides: tuple[tuple[Side, CagePoints, CageCurves, ControlMesh], ...] = (
            ("target", complete.target_points, complete.curves.target, target),
            ("source", complete.source_points, complete.curves.source, source),
        )
        made = [
            (points_file(path, side), _named(complete, points, curves, control), control)
            for side, points, curves, control in sides
        ]
        form = point_form(path)
        for file, named, control in made:
            write_points(file, named if form.curves else replace(named, curves=()), control)
        return tuple(file for file, _, _ in made), form.lost(made[0][1])
    is_open = path == files.landmarks
    is_other = (is_open and owned.is_other(path)) or not _is_of_this_pair(path, scene, files)
    said: tuple[str, ...] = ()
    if path.is_file() and (is_open or is_own(path)) and is_other:
        kept = next(name for name in _aside(path) if not name.exists())
        shutil.copy2(path, kept)
        said = (f"{path.name} was changed by others or is of other models; what it held is kept as {kept.name}",)
    write_landmarks(path, complete, force=is_open)
    owned.know(path)
    return (path,), said


def points_file(path: Path, side: Side) -> Path:
    """File of one mesh's points, for the name that was given for both."""
    ending = point_form(path).ending
    stem = path.name[: -len(ending)] if path.name.lower().endswith(ending) else path.stem
    return path.with_name(f"{stem}.{side}{ending}")


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


def _named(landmarks: Landmarks, points: CagePoints, curves: CageCurves, control: ControlMesh) -> NamedPoints:
    """One side of landmarks, in the numbers of its mesh."""
    vertices = points.vertices
    positions = np.where(vertices[:, None] >= 0, np.nan, points.of(control.positions))
    lines = tuple(
        NamedCurve(name, line.vertices, line.of(control.positions), bool(closed))
        for k, (name, closed) in enumerate(zip(landmarks.curves.names, curves.closed, strict=True))
        for line in (curves.at([k]).points,)
    )
    return NamedPoints(landmarks.names, vertices, positions, control.name, lines)


def _aside(path: Path) -> Iterator[Path]:
    yield path.with_name(f"{path.name}.before-studio")
    for number in itertools.count(2):
        yield path.with_name(f"{path.name}.before-studio-{number}")
