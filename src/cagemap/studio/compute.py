"""What the studio computes: models, maps and their skins. Runs in the worker's process; every task gives a value."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cagemap.deform.multi_start import FEWEST_LANDMARKS
from cagemap.deform.prepared import PreparedPair
from cagemap.errors import ParameterError
from cagemap.maps.landmarks.suggest import suggested_vertices
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import MatchResult, match_pair, other_answer, prepare_pair, prepare_surfaces, update_match
from cagemap.studio.landmark_files import landmarks_of
from cagemap.studio.landmarks import LandmarkList
from cagemap.studio.models import OpenedModel, open_model, with_texture
from cagemap.studio.scene import Scene
from cagemap.studio.skins import Images, faced, source_skin, target_skin
from cagemap.studio.state import MapState, View

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Opening:
    """Which models a task is about; a bench that has others, or was killed, opens them first.

    Attributes
    ----------
    target, source : Path
    texture : Path or None
    vertices : int
        Of each previewed surface, about.
    schemes, ups, parts : (str or None, str or None)
        See `cagemap.studio.state.Files`.
    """

    target: Path
    source: Path
    texture: Path | None
    vertices: int
    schemes: tuple[str | None, str | None] = (None, None)
    ups: tuple[str | None, str | None] = (None, None)
    parts: tuple[str | None, str | None] = (None, None)


@dataclass(frozen=True)
class OpenModels:
    """Read both models and show them."""

    opening: Opening
    view: View


@dataclass(frozen=True)
class FindMap:
    """Map target to source; from the map before where there is one and ``fresh`` is not asked for."""

    opening: Opening
    landmarks: LandmarkList
    view: View
    fresh: bool = False


@dataclass(frozen=True)
class ChooseAnswer:
    """Go on from another of the landmark-free answers."""

    opening: Opening
    landmarks: LandmarkList
    index: int
    view: View


@dataclass(frozen=True)
class Dress:
    """Show the models in another way, under the map that is shown; a bench that was killed has none of its own."""

    opening: Opening
    view: View
    images: Images | None = None


Task = OpenModels | FindMap | ChooseAnswer | Dress


@dataclass(frozen=True)
class Models:
    """Both."""

    target: OpenedModel
    source: OpenedModel


@dataclass(frozen=True, eq=False)
class Opened:
    """Answer to `OpenModels`: the models without a map, how they are subdivided and welded, what there is to say."""

    scene: Scene
    schemes: tuple[str | None, str | None] = (None, None)
    welds: tuple[str | None, str | None] = (None, None)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Found:
    """Answer to `FindMap`: the map, the target under it, and what is known of it but how many there were before."""

    images: Images
    skin: bytes
    known: MapState


@dataclass(frozen=True)
class Dressed:
    """Answer to `Dress`."""

    skins: tuple[bytes, bytes]


Answer = Opened | Found | Dressed


@dataclass(frozen=True, eq=False)
class Bench:
    """What is open and prepared; each task gives the next one.

    Attributes
    ----------
    opening : Opening or None
    models : Models or None
    prepared : PreparedPair or None
        All that no landmark changes.
    free : MatchResult or None
        The match without landmarks, with all its answers.
    chosen : int
        The answer that maps go on from.
    result : MatchResult or None
        The map that is shown.
    """

    opening: Opening | None = None
    models: Models | None = None
    prepared: PreparedPair | None = None
    free: MatchResult | None = None
    chosen: int = 0
    result: MatchResult | None = None


def perform(bench: Bench, task: Task, progress: Progress) -> tuple[Bench, Answer]:
    """Do one task.

    Raises
    ------
    CagemapError
        Whatever is wrong with files or landmarks.
    """
    if isinstance(task, OpenModels) or bench.opening != task.opening:
        bench = Bench(task.opening, open_models(task.opening, progress))
    match task:
        case OpenModels():
            models = _opened(bench)
            target, source = models.target, models.source
            scene = Scene(
                target.shape,
                source.shape,
                (target.mirror, source.mirror),
                _skins(bench, task.view, None),
                offers=(target.offer, source.offer),
                dense=(target.dense, source.dense),
            )
            schemes, welds = (target.scheme, source.scheme), (target.weld, source.weld)
            return bench, Opened(scene, schemes, welds, target.notes + source.notes)
        case FindMap():
            return find_map(bench, task, progress)
        case ChooseAnswer():
            return choose_answer(bench, task, progress)
        case Dress():
            return bench, Dressed(_skins(bench, task.view, task.images))


def open_models(opening: Opening, progress: Progress) -> Models:
    """Read, check and refine both models."""
    progress("reading the models")
    sides = zip((opening.target, opening.source), opening.schemes, opening.ups, opening.parts, strict=True)
    target, source = (open_model(path, scheme, up, opening.vertices, part) for path, scheme, up, part in sides)
    if opening.texture is not None:
        progress("reading the texture")
        source = replace(source, look=with_texture(source.look, opening.texture))
    return Models(target, source)


def find_map(bench: Bench, task: FindMap, progress: Progress) -> tuple[Bench, Found]:
    """Map the models with the landmarks there are."""
    started = time.perf_counter()
    bench, prepared = _prepared(bench, progress)
    landmarks = _landmarks(_opened(bench), task.landmarks)
    if not len(landmarks) + len(landmarks.curves):
        free = bench.free or match_pair(prepared, progress=progress)
        bench = replace(bench, free=free, result=other_answer(free, bench.chosen) if bench.chosen else free)
    elif bench.result is None or (task.fresh and len(landmarks) >= FEWEST_LANDMARKS):
        bench = replace(bench, result=match_pair(prepared, landmarks, progress=progress))
    else:
        bench = replace(bench, result=update_match(bench.result, landmarks, progress=progress))
    return bench, _found(bench, task.view, started)


def choose_answer(bench: Bench, task: ChooseAnswer, progress: Progress) -> tuple[Bench, Found]:
    """Go on from another landmark-free answer, with the landmarks there are.

    Raises
    ------
    ParameterError
        If there is no such answer.
    """
    started = time.perf_counter()
    bench, prepared = _prepared(bench, progress)
    free = bench.free or match_pair(prepared, progress=progress)
    result = other_answer(free, task.index, progress=progress)
    landmarks = _landmarks(_opened(bench), task.landmarks)
    if len(landmarks) + len(landmarks.curves):
        result = update_match(result, landmarks, progress=progress)
    after = replace(bench, free=free, chosen=task.index, result=result)
    return after, _found(after, task.view, started)


def _prepared(bench: Bench, progress: Progress) -> tuple[Bench, PreparedPair]:
    """The bench with its pair prepared, and the pair."""
    if bench.prepared is not None:
        return bench, bench.prepared
    target, source = _opened(bench).target, _opened(bench).source
    surfaces = prepare_surfaces(target.control, source.control, (target.level, source.level), progress=progress)
    prepared = prepare_pair(*surfaces)
    return replace(bench, prepared=prepared), prepared


def _landmarks(models: Models, landmarks: LandmarkList) -> Landmarks:
    return landmarks_of(landmarks, models.target.control, models.source.control)


def _opened(bench: Bench) -> Models:
    if bench.models is None:
        raise ParameterError("expected two models, none are open; open them first")
    return bench.models


def told_apart(names: Sequence[str]) -> tuple[str, ...]:
    """Names of answers with a number after those that were there before: several may end from one kind of start."""
    counts = [names[: i + 1].count(name) for i, name in enumerate(names)]
    return tuple(f"{name} ({count})" if count > 1 else name for name, count in zip(names, counts, strict=True))


def _found(bench: Bench, view: View, started: float) -> Found:
    """What the page is told about the map there is now."""
    result = bench.result
    assert result is not None
    images = Images(result.point_map.triangle, result.point_map.barycentric, result.quality.trust)
    skin = _target_skin(_opened(bench), images, view)
    free = None if bench.free is None else bench.free.confidence
    known = MapState(
        answers=() if free is None else told_apart([reading.name for reading in free.readings]),
        chosen=bench.chosen,
        confidence="" if result.confidence is None or bench.chosen else result.confidence.message,
        strain=_strain(result),
        contradictions={suspect.name: str(suspect) for suspect in result.suspects},
        notes=tuple(result.landmark_check.notes) + tuple(result.quality.warnings),
        seconds=time.perf_counter() - started,
        suggestion=_suggestion(bench, result),
    )
    return Found(images, skin, known)


def _suggestion(bench: Bench, result: MatchResult) -> int | None:
    """Where `cagemap suggest` would ask for the next landmark; None if every control vertex is one."""
    finest = result.point_map.target
    count = result.target.control.n_vertices
    known = np.unique(result.landmarks.target_points.nearest_vertices)
    if len(known) == count:
        return None
    known_answers = None if bench.free is None else bench.free.confidence
    readings = () if known_answers is None else known_answers.readings
    others = [reading.positions[:count] for k, reading in enumerate(readings) if k != bench.chosen]
    images = result.point_map.images.positions[:count]
    runners_up = np.array(others).reshape(len(others), count, 3)
    trust = result.quality.trust[:count]
    return int(suggested_vertices(finest.positions[:count], images, runners_up, trust, known, 1)[0])


def _strain(result: MatchResult) -> dict[str, float]:
    """Per landmark, of the model's size: how far it would move if let go, where a match says so, or is missed."""
    missed = dict(zip(result.trusted.names, map(float, result.quality.landmark_errors), strict=True))
    known = result.landmark_check.strains
    if len(known) == len(result.landmarks):
        missed |= dict(zip(result.landmarks.names, known.tolist(), strict=True))
    return missed | {suspect.name: suspect.distance for suspect in result.suspects}


def _skins(bench: Bench, view: View, images: Images | None) -> tuple[bytes, bytes]:
    models = _opened(bench)
    source = faced(models.source.shape, models.target.shape, images)
    return _target_skin(models, images, view), source_skin(source, models.source.look, _map_view(view))


def _target_skin(models: Models, images: Images | None, view: View) -> bytes:
    target, source = models.target, models.source
    if view.mode == "baked" and view.baked is not None:
        return _baked_skin(models, view)
    return target_skin(target.shape, target.look, source.shape, source.look, images, _map_view(view))


def _map_view(view: View) -> View:
    """How the map is shown where no baked image is."""
    return replace(view, mode="texture") if view.mode == "baked" else view


def _baked_skin(models: Models, view: View) -> bytes:
    """The target with an image that was baked, in its own layout or the one that was made for it."""
    assert view.baked is not None
    shape = models.target.shape
    if shape.uvs is None and view.layout is not None:
        laid_out = open_model(view.layout, models.target.scheme, None, len(shape.positions)).shape
        shape = replace(laid_out, turn=shape.turn)
    return source_skin(shape, with_texture(models.target.look, view.baked), _map_view(view))
