"""Reading and saving landmark files, with the vertex numbers of files and of open parts."""

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
from cagemap.mesh.cage_points import CagePoints, NamedCurve, NamedPoints, Renumbering
from cagemap.mesh.curves import Curve
from cagemap.mesh.landmarks import Landmarks, check_landmarks, pair_by_name
from cagemap.studio.autosave import FileTracker, autosave_path, read_autosave
from cagemap.studio.landmarks import SIDES, Landmark, LandmarkList, Side
from cagemap.studio.opening import default_files
from cagemap.studio.places import cage_places, cage_points
from cagemap.studio.scene import Scene
from cagemap.studio.state import Files
from cagemap.studio.workspace import relative_path
from cagemap.tasks.match import read_given_landmarks

# Titles of the formats that landmarks are saved in, and their file endings.
SAVE_FORMATS = {"pairs (.json)": ".json"} | {f"{form.title} ({form.ending})": form.ending for form in POINT_FORMS}


def load_landmarks(
    path: Path, source_points: Path | None, scene: Scene, files: Files, tracker: FileTracker
) -> tuple[LandmarkList, list[str]]:
    """Read landmarks from a file of pairs or two files of points; also return notes.

    ``path``: file of pairs; or of the target's points, in any format of `read_points`.
    ``source_points``: file of the source's points; points of equal name are pairs.
    FormatError, DirectionError, InvalidLandmarksError if a file is damaged, made for the other direction, or for other
    meshes.
    """
    target, source = scene.target.file_mesh, scene.source.file_mesh
    tracker.record(path)
    if source_points is None:
        landmarks, notes = read_landmarks(path, files.target, files.source)
    else:
        landmarks, notes = pair_by_name(read_points(path, target), read_points(source_points, source), target, source)
    return _to_list(landmarks, notes, scene)


def _to_list(landmarks: Landmarks, notes: tuple[str, ...], scene: Scene) -> tuple[LandmarkList, list[str]]:
    """A list of the files' landmarks on the open parts, and notes."""
    check_landmarks(landmarks, scene.target.file_mesh, scene.source.file_mesh)
    used, unused = split_by_part(landmarks, scene)
    if unused is not None and len(unused):
        notes = (*notes, f"{len(unused)} landmarks are on other parts of the files; they stay in the file")
    if unused is not None and unused.curves:
        names = ", ".join(pair.name for pair in unused.curves)
        notes = (*notes, f"curves on other parts or between vertices are not used here; they stay in the file: {names}")
    return LandmarkList(_to_items(used, scene, 1), used.curves, unused), list(notes)


def file_landmarks(files: Files, scene: Scene, tracker: FileTracker) -> tuple[LandmarkList, list[str]] | None:
    """Landmarks of the pair's file, and notes; None without a file."""
    return load_landmarks(files.landmarks, None, scene, files, tracker) if files.landmarks.is_file() else None


def earlier_landmarks(
    files: Files, scene: Scene, tracker: FileTracker, folder: Path
) -> tuple[LandmarkList, list[str]] | None:
    """Landmarks of the pair in the first folder, where earlier versions saved them, and notes.

    None if the pair has a landmark file or another name for it, or if the one in the folder is of other models.
    """
    default = default_files(files.target, files.source, None).landmarks
    path = folder / default.name
    if files.landmarks != default or default.is_file() or path.is_symlink() or not path.is_file():
        return None
    if not _names_these_models(path, scene, files):
        return None
    landmarks, notes = load_landmarks(path, None, scene, files, tracker)
    return landmarks, [*notes, f"the landmarks are from {path}; from now on they are saved beside the target"]


def autosaved_landmarks(files: Files, scene: Scene, tracker: FileTracker) -> tuple[LandmarkList, list[str]] | None:
    """Unsaved landmarks of an earlier session, and notes; None without any."""
    path = autosave_path(files.landmarks)
    if not path.is_file():
        return None
    tracker.record(path)
    counts = scene.target.file_mesh.n_vertices, scene.source.file_mesh.n_vertices
    landmarks, notes = to_part_numbers(read_autosave(path, counts, autosave_models(files, scene)), scene)
    return landmarks, [*notes, f"recovered unsaved landmarks of {files.landmarks.name}"]


def autosave_models(files: Files, scene: Scene) -> tuple[str, str]:
    """For target and source, path from the landmark file and number of vertices: models may have equal names."""
    target, source = (
        f"{relative_path(path, files.landmarks.parent)}, {shape.file_mesh.n_vertices} vertices"
        for path, shape in ((files.target, scene.target), (files.source, scene.source))
    )
    return target, source


def recorded_landmarks(files: Files, scene: Scene, tracker: FileTracker) -> tuple[LandmarkList, list[str]] | None:
    """Landmarks and curves of an opened RESULT that are not in one file of pairs, and notes; None without any."""
    match = files.recorded_match
    if match is None or match.has_only_pairs:
        return None
    landmarks, notes = read_given_landmarks(match.request, scene.target.file_mesh, scene.source.file_mesh)
    if match.request.landmarks == files.landmarks:
        tracker.record(files.landmarks)
    return _to_list(landmarks, notes, scene)


# Tried in this order for newly opened models; with whether the landmarks count as saved.
INITIAL_LANDMARK_READERS = ((autosaved_landmarks, False), (recorded_landmarks, False), (file_landmarks, True))


def split_by_part(landmarks: Landmarks, scene: Scene) -> tuple[Landmarks, Landmarks | None]:
    """Split landmarks into those of the open parts, renumbered to these, and the others."""
    used = landmarks.renumbered(scene.target.to_control_vertices, scene.source.to_control_vertices)
    curves = tuple(pair for pair in used.curves if all((side.vertices >= 0).all() for side in pair.points))
    used = replace(used, curves=curves)
    pair_names, curve_names = set(used.names), {pair.name for pair in curves}
    unused = landmarks.without([i for i, name in enumerate(landmarks.names) if name in pair_names])
    unused = replace(unused, curves=tuple(pair for pair in landmarks.curves if pair.name not in curve_names))
    return used, unused if len(unused) + len(unused.curves) else None


def to_file_numbers(landmarks: LandmarkList, scene: Scene) -> LandmarkList:
    """Renumber landmarks from the open parts to the files' vertices."""
    target, source = scene.target.to_file_vertices, scene.source.to_file_vertices
    curves = tuple(pair.renumbered(target, source) for pair in landmarks.curves)
    items = tuple(_renumber(item, target, source) for item in landmarks.items)
    return replace(landmarks, items=items, curves=curves)


def to_part_numbers(file_list: LandmarkList, scene: Scene) -> tuple[LandmarkList, list[str]]:
    """Renumber landmarks from the files' vertices to the open parts; also return notes."""
    target, source = scene.target.to_control_vertices, scene.source.to_control_vertices
    renumbered = [_renumber(item, target, source) for item in file_list.items]
    is_inside = [
        all(place is None or min(place.corners) >= 0 for place in (item.target, item.source)) for item in renumbered
    ]
    outside = LandmarkList(tuple(item for item, inside in zip(file_list.items, is_inside, strict=True) if not inside))
    notes = [
        f"{item.name} is incomplete and on another part; it is removed"
        for item in outside.items
        if not item.is_complete
    ]
    landmarks = to_landmarks(outside, scene.target.file_mesh, scene.source.file_mesh)
    if file_list.unused_landmarks is not None:
        landmarks = landmarks.joined_with(file_list.unused_landmarks)
    used, unused = split_by_part(replace(landmarks, curves=file_list.curves), scene)
    items = tuple(item for item, inside in zip(renumbered, is_inside, strict=True) if inside)
    items += _to_items(used, scene, 1 + max((item.number for item in items), default=0))
    if unused is not None and len(unused):
        notes.append(f"{len(unused)} landmarks are on other parts of the files; they are kept for these parts")
    return LandmarkList(items, used.curves, unused), notes


def _to_items(landmarks: Landmarks, scene: Scene, first_number: int) -> tuple[Landmark, ...]:
    """Landmarks of the open parts as items of a list."""
    places = zip(
        landmarks.names,
        cage_places(scene.target, landmarks.target_points),
        cage_places(scene.source, landmarks.source_points),
        strict=True,
    )
    return tuple(Landmark(number, *row) for number, row in enumerate(places, first_number))


def _renumber(item: Landmark, target: Renumbering, source: Renumbering) -> Landmark:
    for side, renumber in zip(SIDES, (target, source), strict=True):
        place = item.place_on(side)
        if place is not None:
            a, b, c = renumber(np.array(place.corners)).tolist()
            item = item.with_place(side, replace(place, corners=(a, b, c)))
    return item


def save_landmarks(
    path: Path, landmarks: LandmarkList, scene: Scene, files: Files, tracker: FileTracker
) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Write complete landmarks; return the written files and notes.

    One file of pairs; for a name with an ending of `files.landmarks.point_formats` one file for each model,
    NAME.target.pp and NAME.source.pp. A file of pairs that others changed, or of other models, is first copied.

    FormatError if the ending is unknown, a file cannot be written, or cagemap did not write the existing file.
    """
    target, source = scene.target.file_mesh, scene.source.file_mesh
    complete = to_landmarks(landmarks, scene.target.control, scene.source.control)
    complete = complete.renumbered(scene.target.to_file_vertices, scene.source.to_file_vertices)
    complete = complete if landmarks.unused_landmarks is None else complete.joined_with(landmarks.unused_landmarks)
    if not is_of_pairs(path):
        form, models = point_form(path), zip(SIDES, (target, source), strict=True)
        sides = [(side_file(path, side), _named_points(complete, side, mesh), mesh) for side, mesh in models]
        for file, points, mesh in sides:
            write_points(file, points if form.curves else replace(points, curves=()), mesh)
        return tuple(file for file, *_ in sides), form.lost(sides[0][1])
    is_open = path == files.landmarks
    is_foreign = (is_open and tracker.is_changed(path)) or not (
        is_own(path) and _names_these_models(path, scene, files)
    )
    notes: tuple[str, ...] = ()
    if path.is_file() and (is_open or is_own(path)) and is_foreign:
        copy = next(name for name in _backup_names(path) if not name.exists())
        shutil.copy2(path, copy)
        notes = (f"{path.name} was changed by others or belongs to other models; its old content is in {copy.name}",)
    write_landmarks(path, complete, force=is_open)
    tracker.record(path)
    return (path,), notes


def side_file(path: Path, side: Side) -> Path:
    """File of one model's points, from the name given for both."""
    ending = point_form(path).ending
    stem = path.name[: -len(ending)] if path.name.lower().endswith(ending) else path.stem
    return path.with_name(f"{stem}.{side}{ending}")


def _names_these_models(path: Path, scene: Scene, files: Files) -> bool:
    """Whether a file of pairs names these models and vertices that they have."""
    try:
        landmarks, notes = read_landmarks(path, files.target, files.source)
        check_landmarks(landmarks, scene.target.file_mesh, scene.source.file_mesh)
    except CagemapError:
        return False
    names = scene.target.file_mesh.name, scene.source.file_mesh.name  # the notes compare them without their endings
    return not notes and (landmarks.target_name, landmarks.source_name) == names


def to_landmarks(landmarks: LandmarkList, target: ControlMesh, source: ControlMesh) -> Landmarks:
    """Convert the complete landmarks and curves of a list."""
    items = landmarks.complete_landmarks
    return Landmarks.of_points(
        tuple(item.name for item in items),
        cage_points([item.target for item in items if item.target]),
        cage_points([item.source for item in items if item.source]),
        target.name,
        source.name,
        landmarks.curves,
    )


def _named_points(landmarks: Landmarks, side: Side, control: ControlMesh) -> NamedPoints:
    """Landmarks and curves of one model."""
    points: CagePoints = getattr(landmarks, f"{side}_points")
    vertices = points.vertices
    positions = np.where(vertices[:, None] >= 0, np.nan, points.of(control.positions))
    curves: list[tuple[str, Curve[CagePoints]]] = [(pair.name, getattr(pair, side)) for pair in landmarks.curves]
    named_curves = tuple(
        NamedCurve(name, curve.points.vertices, curve.points.of(control.positions), curve.closed)
        for name, curve in curves
    )
    return NamedPoints(landmarks.names, vertices, positions, control.name, named_curves)


def _backup_names(path: Path) -> Iterator[Path]:
    yield path.with_name(f"{path.name}.before-studio")
    for number in itertools.count(2):
        yield path.with_name(f"{path.name}.before-studio-{number}")
