"""What the studio computes: models, maps and their skins. Runs in the worker's process; every task gives a value."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cagemap.character.values import Character
from cagemap.deform.multi_start import FEWEST_LANDMARKS
from cagemap.deform.problem import PreparedPair
from cagemap.errors import ParameterError
from cagemap.files.gltf.material_images import extract_texture
from cagemap.maps.landmarks.suggest import suggested_vertices
from cagemap.maps.point_map import PointMap
from cagemap.pipeline import MatchResult, match_pair, other_answer, prepare_pair, prepare_surfaces, update_match
from cagemap.studio.landmark_files import landmarks_of
from cagemap.studio.landmarks import LandmarkList
from cagemap.studio.models import OpenedModel, open_model, with_texture
from cagemap.studio.poses import NO_CHARACTER, animated_character, pose_shapes, poses_of
from cagemap.studio.scene import Scene
from cagemap.studio.skins import Images, faced, source_skin, target_skin
from cagemap.studio.state import MapState

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
    folder : Path
        Where an image inside the source's file is put.
    schemes, ups, parts : (str or None, str or None)
        See `cagemap.studio.state.Files`.
    """

    target: Path
    source: Path
    texture: Path | None
    vertices: int
    folder: Path
    schemes: tuple[str | None, str | None] = (None, None)
    ups: tuple[str | None, str | None] = (None, None)
    parts: tuple[str | None, str | None] = (None, None)


@dataclass(frozen=True)
class OpenModels:
    """Read both models and show them."""

    opening: Opening


@dataclass(frozen=True)
class FindMap:
    """Map target to source; from the map before where there is one and ``fresh`` is not asked for.

    With ``answer``, go on from that one of the landmark-free answers.
    """

    opening: Opening
    landmarks: LandmarkList
    fresh: bool = False
    answer: int | None = None


@dataclass(frozen=True)
class ShowBaked:
    """Show an image that was baked, in the target's layout or that of another file, beside a map."""

    opening: Opening
    image: Path
    layout: Path | None
    images: Images | None


@dataclass(frozen=True)
class ShowPosed:
    """Show both models in a pose of the source's animations; '': as their files have them."""

    opening: Opening
    pose: str


Task = OpenModels | FindMap | ShowBaked | ShowPosed


@dataclass(frozen=True, eq=False)
class Opened:
    """Answer to `OpenModels`: the models, without a map."""

    target: OpenedModel
    source: OpenedModel
    skins: tuple[bytes, bytes]

    @property
    def scene(self) -> Scene:
        """The models to show, to click and to place landmarks on."""
        target, source = self.target, self.source
        return Scene(
            target.shape,
            source.shape,
            (target.mirror, source.mirror),
            self.skins,
            offers=(target.offer, source.offer),
            dense=(target.dense, source.dense),
            colored=source.look.colors is not None,
        )


@dataclass(frozen=True)
class Found:
    """Answer to `FindMap`.

    Attributes
    ----------
    images : Images
        The map.
    skins : (bytes, bytes or None)
        Target and source under it; None where the source is drawn as before.
    known : MapState
        What is known of the map but how many there were before.
    """

    images: Images
    skins: tuple[bytes, bytes | None]
    known: MapState


Answer = Opened | Found | bytes | tuple[bytes, bytes]


@dataclass(frozen=True, eq=False)
class Bench:
    """What is open and prepared; each task gives the next one.

    Attributes
    ----------
    opening : Opening or None
    target, source : OpenedModel or None
    prepared : PreparedPair or None
        All that no landmark changes.
    free : MatchResult or None
        The match without landmarks, with all its answers.
    chosen : int
        The answer that maps go on from.
    result : MatchResult or None
        The map that is shown.
    character : Character or None
        Of the source's file; None as long as there was no map.
    """

    opening: Opening | None = None
    target: OpenedModel | None = None
    source: OpenedModel | None = None
    prepared: PreparedPair | None = None
    free: MatchResult | None = None
    chosen: int = 0
    result: MatchResult | None = None
    character: Character | None = None


def perform(
    bench: Bench, task: Task, progress: Progress, show: Callable[[Found], None] = lambda _: None
) -> tuple[Bench, Answer]:
    """Do one task; `ShowBaked` gives the target's skin, `ShowPosed` both. Rough maps are shown before the first one.

    Raises
    ------
    CagemapError
        Whatever is wrong with files or landmarks.
    """
    if isinstance(task, OpenModels) or bench.opening != task.opening:
        bench = Bench(task.opening, *open_models(task.opening, progress))
    target, source = _models(bench)
    match task:
        case OpenModels():
            skins = (
                target_skin(target.shape, target.look, source.shape, source.look, None),
                source_skin(source.shape, source.look),
            )
            return bench, Opened(target, source, skins)
        case FindMap():
            return find_map(bench, task, progress, show)
        case ShowBaked():
            return bench, _baked_skin(target, source, task)
        case ShowPosed():
            return bench, _posed_skins(bench, task.pose)


def open_models(opening: Opening, progress: Progress) -> tuple[OpenedModel, OpenedModel]:
    """Read, check and refine both models."""
    progress("reading the models")
    sides = zip((opening.target, opening.source), opening.schemes, opening.ups, opening.parts, strict=True)
    target, source = (open_model(path, scheme, up, opening.vertices, part) for path, scheme, up, part in sides)
    image = opening.texture or extract_texture(opening.source, source.control, opening.folder)
    if image is not None:
        progress("reading the texture")
        source = replace(source, look=with_texture(source.look, image), texture=image)
    return target, source


def find_map(bench: Bench, task: FindMap, progress: Progress, show: Callable[[Found], None]) -> tuple[Bench, Found]:
    """Match the models with the current landmarks.

    Raises
    ------
    ParameterError
        If there is no such answer.
    """
    started = time.perf_counter()
    bench, prepared = _prepared(bench, progress)
    target, source = _models(bench)
    landmarks = landmarks_of(task.landmarks, target.control, source.control)
    guided = bool(len(landmarks) + len(landmarks.curves))
    if task.answer is not None or not guided:
        first = None if bench.result is not None else lambda rough: show(_rough(bench, rough))
        free = bench.free or match_pair(prepared, progress=progress, preview=first)
        chosen = bench.chosen if task.answer is None else task.answer
        result = other_answer(free, chosen, progress=progress) if chosen or task.answer is not None else free
        bench = replace(bench, free=free, chosen=chosen, result=result)
        if guided:
            bench = replace(bench, result=update_match(result, landmarks, progress=progress))
    elif bench.result is None or (task.fresh and len(landmarks) >= FEWEST_LANDMARKS):
        bench = replace(bench, result=match_pair(prepared, landmarks, progress=progress))
    else:
        bench = replace(bench, result=update_match(bench.result, landmarks, progress=progress))
    return _found(bench, started)


def _rough(bench: Bench, point_map: PointMap) -> Found:
    """A rough map to look at while the search goes on; the source stays turned as it is."""
    target, source = _models(bench)
    images = Images(point_map.triangle, point_map.barycentric, np.ones(point_map.target.n))
    skin = target_skin(target.shape, target.look, source.shape, source.look, images)
    return Found(images, (skin, None), MapState(rough=True))


def _prepared(bench: Bench, progress: Progress) -> tuple[Bench, PreparedPair]:
    """The bench with its pair prepared, and the pair."""
    if bench.prepared is not None:
        return bench, bench.prepared
    target, source = _models(bench)
    surfaces = prepare_surfaces(target.control, source.control, (target.level, source.level), progress=progress)
    prepared = prepare_pair(*surfaces)
    return replace(bench, prepared=prepared), prepared


def _models(bench: Bench) -> tuple[OpenedModel, OpenedModel]:
    assert bench.target is not None
    assert bench.source is not None
    return bench.target, bench.source


def told_apart(names: Sequence[str]) -> tuple[str, ...]:
    """Names of answers with a number after those that were there before: several may end from one kind of start."""
    counts = [names[: i + 1].count(name) for i, name in enumerate(names)]
    return tuple(f"{name} ({count})" if count > 1 else name for name, count in zip(names, counts, strict=True))


def _found(bench: Bench, started: float) -> tuple[Bench, Found]:
    """What the page is told about the map there is now; the source is turned to face as the target does."""
    result = bench.result
    assert result is not None
    images = Images(result.point_map.triangle, result.point_map.barycentric, result.quality.trust)
    target, source = _models(bench)
    shape = faced(source.shape, target.shape, images)
    turned = None if shape is source.shape else source_skin(shape, source.look)
    bench = replace(bench, source=replace(source, shape=shape))
    skin = target_skin(target.shape, target.look, shape, source.look, images)
    free = None if bench.free is None else bench.free.confidence
    if bench.character is None:
        assert bench.opening is not None
        bench = replace(bench, character=animated_character(bench.opening.source))
    known = MapState(
        answers=() if free is None else told_apart([reading.name for reading in free.readings]),
        chosen=bench.chosen,
        confidence="" if result.confidence is None or bench.chosen else result.confidence.message,
        strain=_strain(result),
        contradictions={suspect.name: str(suspect) for suspect in result.suspects},
        notes=tuple(result.landmark_check.notes) + tuple(result.quality.warnings),
        seconds=time.perf_counter() - started,
        suggestion=_suggestion(bench, result),
        poses=tuple(poses_of(bench.character or NO_CHARACTER)),
    )
    return bench, Found(images, (skin, turned), known)


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


def _posed_skins(bench: Bench, pose: str) -> tuple[bytes, bytes]:
    """Target and source in a pose of the source's animations, with what the map gives.

    Raises
    ------
    ParameterError
        If there is no such pose.
    """
    target, source = _models(bench)
    shapes, images, result = (target.shape, source.shape), None, bench.result
    if result is not None:
        images = Images(result.point_map.triangle, result.point_map.barycentric, result.quality.trust)
    if pose:
        character = bench.character or NO_CHARACTER
        found = poses_of(character).get(pose)
        if found is None or result is None or images is None:
            raise ParameterError(f"Pose: expected a pose of the source, and a map, got {pose!r}. Choose another.")
        shapes = pose_shapes(character, found, *shapes, images, result.point_map)
    skin = target_skin(shapes[0], target.look, shapes[1], source.look, images)
    return skin, source_skin(shapes[1], source.look)


def _baked_skin(target: OpenedModel, source: OpenedModel, task: ShowBaked) -> bytes:
    """The target with an image that was baked, in its own layout or the one that was made for it."""
    shape, images = target.shape, task.images
    if shape.uvs is None and task.layout is not None:
        laid_out = open_model(task.layout, target.scheme, None, len(shape.positions)).shape
        if np.array_equal(laid_out.triangles, shape.triangles):
            shape = replace(shape, uvs=laid_out.uvs, uv_triangles=laid_out.uv_triangles)
        else:
            shape, images = replace(laid_out, turn=shape.turn), None
    baked = with_texture(target.look, task.image)
    if shape.uvs is not None:
        shape = replace(shape, uvs=baked.on_image(shape.uvs))
    return target_skin(shape, target.look, source.shape, source.look, images, baked.encoded)
