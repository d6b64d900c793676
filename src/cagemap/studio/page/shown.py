"""The messages to a page: state and drawings, in the page's coordinates and words."""

from __future__ import annotations

from typing import Any

import numpy as np

from cagemap.files import IMAGE_SUFFIXES
from cagemap.files.meshes.formats import MESH_SUFFIXES
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.curves import Curve
from cagemap.mesh.schemes import SCHEMES
from cagemap.numerics.arrays import FloatArray, offsets_of
from cagemap.pictures.colors import distinct_colors
from cagemap.studio.downloads import ARCHIVE_NAME, archive_name, textured_model_name
from cagemap.studio.finish_layout import FOLDER_SUFFIX, in_page_words
from cagemap.studio.glb import MeshPart, pack_glb
from cagemap.studio.landmark_files import SAVE_FORMATS
from cagemap.studio.landmarks import SIDES, Place, Side
from cagemap.studio.page.words import bake_hint, confidence_text, status_entries, verdict
from cagemap.studio.places import vertex_place
from cagemap.studio.scene import Scene
from cagemap.studio.shape import Shape
from cagemap.studio.state import MODES, Files, Mode, Output, Probe, StudioState
from cagemap.studio.workspace import LANDMARK_SUFFIXES, UPLOAD_SUFFIXES, Workspace

# Colours of landmarks and curves, in their order.
_COLORS = distinct_colors(64)
_VIEW_FIELDS = ("mode", "cages", "doubts", "linked", "other_parts", "symmetric", "pose")
# Height of lines above the model, in units of its radius.
_LINE_HEIGHT = 0.004
# Files written with an image for a target without UVs.
_LAYOUT_FILES = {"_unwrapped.obj": "model with its new UVs", "_unwrapped.mtl": "material file"}
_CAGE_COLOR = np.array([0.35, 0.67, 1.0])


def listing_entries(workspace: Workspace) -> dict[str, Any]:
    """Files that can be chosen."""
    return {"listing": workspace.list_files((*UPLOAD_SUFFIXES, FOLDER_SUFFIX))}


def constant_entries() -> dict[str, Any]:
    """Lists that do not change while the studio runs."""
    kinds = {"meshes": MESH_SUFFIXES, "images": IMAGE_SUFFIXES, "landmarks": LANDMARK_SUFFIXES}
    return {"fixed": {"modes": MODES, "schemes": list(SCHEMES), "forms": list(SAVE_FORMATS.items()), "kinds": kinds}}


def page_state(state: StudioState, scene: Scene | None, workspace: Workspace, keys: dict[str, str]) -> dict[str, Any]:
    """Everything that a page shows; ``keys`` are those of its drawings."""
    map_state, present, view = state.map, state.history.present, state.view
    confidence, vertex = confidence_text(map_state.confidence), map_state.suggestion
    return {
        "status": status_entries(state, scene),
        "verdict": verdict(state, scene),
        "messages": [{"kind": message.kind, "text": confidence_text(message.text)} for message in state.messages],
        "files": None if state.files is None else _file_entries(state.files, workspace),
        "pair": [workspace.display_name(path) for path in state.models],
        "models": None if scene is None else {side: _model_entry(scene, side) for side in SIDES},
        "symmetric": scene is not None and all(mirror is not None for mirror in scene.mirrors),
        "drawn": keys,
        "view": {name: getattr(view, name) for name in _VIEW_FIELDS} | {"mode": shown_mode(state, scene)},
        "poses": map_state.poses,
        "baked": "" if view.baked is None else view.baked.name,
        "images": [path.name for path in state.baked_images],
        "landmarks": [] if scene is None else _landmark_entries(state, scene),
        "probe": None if scene is None or state.probe is None else _probe_entry(state.probe, scene),
        "count": len(present.complete_landmarks),
        "curves": len(present.curves),
        "selected": state.selected,
        "proposal": state.proposal is not None,
        "undo": len(state.history.past),
        "redo": len(state.history.future),
        "saved": state.saved,
        "revision": map_state.revision,
        "suggests": None
        if scene is None or vertex is None
        else _place_entry(scene.target, vertex_place(scene.target, vertex)),
        "said": [
            *([confidence[:1].upper() + confidence[1:]] if confidence else []),
            *(confidence_text(in_page_words(text)) for text in (*map_state.contradictions.values(), *map_state.notes)),
        ],
        "answers": map_state.answers if len(map_state.answers) > 1 else (),
        "chosen": map_state.chosen_answer,
        "outputs": _output_entries(state),
        "bake_hint": bake_hint(state, scene),
        "baking": state.finish_job is not None,
    }


def shown_mode(state: StudioState, scene: Scene | None) -> Mode:
    """The view's mode; the colours of the map instead of the texture of a source without image and colours."""
    is_bare = scene is not None and not scene.has_colors and state.files is not None and state.files.texture is None
    return "colours" if is_bare and state.view.mode == "texture" else state.view.mode


def line_drawing(state: StudioState, scene: Scene, side: Side, *, cage: bool) -> bytes:
    """The control mesh's edges, or the curves on the model, as binary glTF."""
    shape = scene.shape(side)
    curves: list[Curve[CagePoints]] = [getattr(pair, side) for pair in state.history.present.curves]
    if cage:
        ends = shape.to_view(shape.edges).reshape(-1, 3)
        colors = np.tile(_CAGE_COLOR, (len(ends), 1))
        return pack_glb([_segments("cage", ends, np.arange(len(ends)).reshape(-1, 2), colors)])
    if not curves:
        return pack_glb([])
    vertices = np.concatenate([curve.points.vertices for curve in curves])
    counts = [len(curve.points) for curve in curves]
    segments = [curve.segments + start for curve, start in zip(curves, offsets_of(counts)[:-1], strict=True)]
    points = shape.positions[vertices] + _LINE_HEIGHT * shape.radius * shape.normals[vertices]
    colors = _COLORS[np.repeat(np.arange(len(curves)), counts) % len(_COLORS)]
    return pack_glb([_segments("curves", shape.to_view(points), np.vstack(segments), colors)])


def _segments(name: str, points: FloatArray, ends: Any, colors: FloatArray) -> MeshPart:
    return MeshPart(name, {"POSITION": points, "COLOR_1": colors}, np.asarray(ends))


def _file_entries(files: Files, workspace: Workspace) -> dict[str, Any]:
    paths = {name: getattr(files, name) for name in ("target", "source", "texture", "landmarks")}
    names = {name: "" if path is None else workspace.display_name(path) for name, path in paths.items()}
    return names | {"schemes": files.schemes}


def _model_entry(scene: Scene, side: Side) -> dict[str, Any]:
    shape, number = scene.shape(side), SIDES.index(side)
    choices = scene.part_choices[number]
    return {
        "name": shape.control.name,
        "vertices": len(shape.positions),
        "parts": list(zip(choices.titles, choices.faces, strict=True)),
        "opened": choices.opened,
        "whole": choices.whole,
        "dense": scene.dense[number],
    }


def _landmark_entries(state: StudioState, scene: Scene) -> list[dict[str, Any]]:
    """Rows of the table, with position and normal on both models or the proposed place."""
    rows = []
    proposal, map_state = state.proposal, state.map
    for item in state.history.present.items:
        places = {side: item.place_on(side) for side in SIDES}
        proposed_side: Side | None = None
        if proposal is not None and proposal.number == item.number and places[proposal.side] is None:
            proposed_side = proposal.side
            places[proposed_side] = proposal.place
        strain = map_state.strain.get(item.name)
        points = {
            side: None if place is None else _place_entry(scene.shape(side), place) for side, place in places.items()
        }
        rows.append(
            {
                "number": item.number,
                "name": item.name,
                "color": _css_color(item.number),
                "complete": item.is_complete,
                "proposed": proposed_side,
                "strain": strain if strain is not None and np.isfinite(strain) else None,  # as JSON can hold it
                "wrong": map_state.contradictions.get(item.name, ""),
            }
            | points
        )
    return rows


def _place_entry(shape: Shape, place: Place) -> list[float]:
    """Position and normal in the view."""
    normal = shape.directions_to_view(np.array(place.weights) @ shape.normals[list(place.corners)])
    return _view_position(shape, place.position) + [round(value, 3) for value in normal.tolist()]


def _css_color(number: int) -> str:
    channels = np.rint(255 * _COLORS[(number - 1) % len(_COLORS)]).astype(int).tolist()
    return "#{:02x}{:02x}{:02x}".format(*channels)


def _probe_entry(probe: Probe, scene: Scene) -> dict[str, Any]:
    points = {side: getattr(probe, side) for side in SIDES}
    return {side: None if point is None else _view_position(scene.shape(side), point) for side, point in points.items()}


def _view_position(shape: Shape, position: tuple[float, float, float]) -> list[float]:
    return [round(value, 6) for value in shape.to_view(np.array(position)).tolist()]


def _output_entries(state: StudioState) -> list[dict[str, Any]]:
    """Written files, and downloads made from them."""
    rows = [_output_entry(output) for output in state.outputs]
    if rows and state.finish_job is None:
        name = textured_model_name(state)
        rows += [] if name is None else [{"what": "model with its texture", "name": name, "page": False}]
        rows.append({"what": "everything", "name": ARCHIVE_NAME, "page": False})
    return rows


def _output_entry(output: Output) -> dict[str, Any]:
    name = archive_name(output.path) if output.path.is_dir() else output.path.name
    what = next((text for ending, text in _LAYOUT_FILES.items() if name.endswith(ending)), output.title)
    return {"what": what, "name": name, "page": output.path.suffix.lower() == ".html"}
