"""What a page is told: the state as JSON, in the words and coordinates of the page."""

from __future__ import annotations

from typing import Any

import numpy as np

from cagemap.mesh.schemes import SCHEMES
from cagemap.numerics.arrays import FloatArray
from cagemap.pictures.colors import distinct_colors
from cagemap.studio.downloads import ALL, archive_name, textured_name
from cagemap.studio.finish_layout import FOLDERS
from cagemap.studio.glb import Drawn, glb
from cagemap.studio.landmark_files import FORMS
from cagemap.studio.landmarks import SIDES, Place, Side
from cagemap.studio.page.words import confidence_text, status, verdict
from cagemap.studio.scene import Scene
from cagemap.studio.shape import Shape
from cagemap.studio.state import MODES, Files, Output, Studio
from cagemap.studio.workspace import ADDED, IMAGES, LANDMARKS, MESHES, Workspace

# Of landmarks and curves, by their numbers.
_COLORS = distinct_colors(64)
# Fields of the view that pages show.
_VIEW = ("mode", "cages", "doubts", "linked", "rest", "symmetric", "pose")
# Of a model's radius: lines lie above the model.
_LIFT = 0.004
_CAGE = np.array([0.35, 0.67, 1.0])


def listing(workspace: Workspace) -> dict[str, Any]:
    """Files to choose from."""
    return {"listing": workspace.listing((*ADDED, FOLDERS))}


def fixed() -> dict[str, Any]:
    """What does not change while the studio runs."""
    kinds = {"meshes": MESHES, "images": IMAGES, "landmarks": LANDMARKS}
    return {"fixed": {"modes": MODES, "schemes": list(SCHEMES), "forms": list(FORMS.items()), "kinds": kinds}}


def page_state(state: Studio, scene: Scene | None, workspace: Workspace, keys: dict[str, str]) -> dict[str, Any]:
    """Everything that a page shows; ``keys`` are the names of what it draws."""
    known, present, view = state.map, state.history.present, state.view
    return {
        "status": status(state),
        "verdict": verdict(state, scene),
        "messages": [{"kind": one.kind, "text": one.text} for one in state.messages],
        "files": None if state.files is None else _files(state.files, workspace),
        "models": None if scene is None else {side: _model(scene, side) for side in SIDES},
        "symmetric": scene is not None and scene.symmetric,
        "rest": scene is not None and scene.leaves_any,
        "drawn": keys,
        "view": {name: getattr(view, name) for name in _VIEW},
        "poses": known.poses,
        "baked": "" if view.baked is None else view.baked.name,
        "images": [path.name for path in state.images],
        "landmarks": [] if scene is None else _landmarks(state, scene),
        "probe": None if scene is None or state.probe is None else _probe(state, scene),
        "count": len(present.complete),
        "curves": 0 if present.curves is None else len(present.curves),
        "selected": state.selected,
        "asks": present.open is not None,
        "proposal": state.proposal is not None,
        "undo": len(state.history.past),
        "redo": len(state.history.future),
        "saved": state.saved,
        "revision": known.revision,
        "seconds": known.seconds,
        "suggests": known.suggestion is not None,
        "said": [
            *([confidence_text(known.confidence)] if known.confidence else []),
            *known.contradictions.values(),
            *known.notes,
        ],
        "answers": known.answers if len(known.answers) > 1 else (),
        "chosen": known.chosen,
        "outputs": _outputs(state),
        "baking": state.finish_job is not None,
    }


def lines(state: Studio, scene: Scene, side: Side, *, cage: bool) -> bytes:
    """Edges of a model's control mesh, or the curves on it; a binary glTF file."""
    shape = scene.shape(side)
    curves = state.history.present.curves
    if cage:
        ends = shape.to_view(shape.edges).reshape(-1, 3)
        return glb([_segments("cage", ends, np.arange(len(ends)).reshape(-1, 2), np.tile(_CAGE, (len(ends), 1)))])
    if curves is None:
        return glb([])
    lies = curves.target if side == "target" else curves.source
    vertices = lies.points.vertices
    points = shape.positions[vertices] + _LIFT * shape.radius * shape.normals[vertices]
    colors = _COLORS[lies.curve_of % len(_COLORS)]
    return glb([_segments("curves", shape.to_view(points), lies.segments, colors)])


def _segments(name: str, points: FloatArray, ends: Any, colors: FloatArray) -> Drawn:
    return Drawn(name, {"POSITION": points, "COLOR_1": colors}, np.asarray(ends))


def _files(files: Files, workspace: Workspace) -> dict[str, Any]:
    names = {name: getattr(files, name) for name in ("target", "source", "texture", "landmarks")}
    shown = {name: "" if path is None else workspace.show(path) for name, path in names.items()}
    return shown | {"schemes": files.schemes, "ups": files.ups}


def _model(scene: Scene, side: Side) -> dict[str, Any]:
    shape, number = scene.shape(side), SIDES.index(side)
    offer = scene.offers[number]
    parts = list(zip(offer.titles, offer.faces, strict=True))
    return {
        "name": shape.name,
        "vertices": len(shape.positions),
        "parts": parts,
        "opened": offer.opened,
        "whole": offer.whole,
        "dense": scene.dense[number],
    }


def _landmarks(state: Studio, scene: Scene) -> list[dict[str, Any]]:
    """Rows of the list, in the order of their making, with position and normal on either model."""
    rows = []
    proposal, known = state.proposal, state.map
    for item in state.history.present.items:
        places = {side: item.on(side) for side in SIDES}
        proposed: Side | None = None
        if proposal is not None and proposal.number == item.number and places[proposal.side] is None:
            proposed = proposal.side
            places[proposed] = proposal.place
        at = {
            side: None
            if place is None
            else _in_view(scene.shape(side), place.position) + _facing(scene.shape(side), place)
            for side, place in places.items()
        }
        rows.append(
            {"number": item.number, "name": item.name, "color": _css(item.number)}
            | {"complete": item.complete, "proposed": proposed, "strain": _finite(known.strain.get(item.name))}
            | {"wrong": known.contradictions.get(item.name, "")}
            | at
        )
    return rows


def _finite(value: float | None) -> float | None:
    """A number that JSON has; None for others."""
    return value if value is not None and np.isfinite(value) else None


def _facing(shape: Shape, place: Place) -> list[float]:
    """Where the surface looks to at a place, in the view."""
    normal = shape.turned(np.array(place.weights) @ shape.normals[list(place.corners)])
    return [round(value, 3) for value in normal.tolist()]


def _css(number: int) -> str:
    """Colour of a landmark for a style sheet."""
    channels = np.rint(255 * _COLORS[(number - 1) % len(_COLORS)]).astype(int).tolist()
    return "#{:02x}{:02x}{:02x}".format(*channels)


def _probe(state: Studio, scene: Scene) -> dict[str, Any]:
    ends = {side: getattr(state.probe, side) for side in SIDES}
    return {side: None if end is None else _in_view(scene.shape(side), end) for side, end in ends.items()}


def _in_view(shape: Shape, position: tuple[float, float, float]) -> list[float]:
    return [round(value, 6) for value in shape.to_view(np.array(position)).tolist()]


def _outputs(state: Studio) -> list[dict[str, Any]]:
    """What was written, to look at or to keep."""
    rows = [_output(output) for output in state.outputs]
    if rows and state.finish_job is None:
        name = textured_name(state)
        rows += [] if name is None else [{"what": "model with its texture", "name": name, "page": False}]
        rows.append({"what": "everything", "name": ALL, "page": False})
    return rows


def _output(output: Output) -> dict[str, Any]:
    name = archive_name(output.path) if output.path.is_dir() else output.path.name
    return {"what": output.what, "name": name, "page": output.path.suffix.lower() == ".html"}
