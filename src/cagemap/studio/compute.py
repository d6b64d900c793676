"""Runs tasks of the preview, in the worker's process: open, map, show an image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cagemap.character.values import Character
from cagemap.deform.multi_start import FEWEST_LANDMARKS
from cagemap.deform.problem import PreparedPair
from cagemap.errors import ParameterError
from cagemap.files.result.verdicts import rate_figures
from cagemap.maps.point_map import PointMap
from cagemap.pipeline import (
    MatchConfig,
    MatchResult,
    match_pair,
    other_answer,
    prepare_pair,
    prepare_surfaces,
    update_match,
)
from cagemap.studio.landmark_files import to_landmarks
from cagemap.studio.models import OpenedModel, converted_model, open_model, textured, with_texture
from cagemap.studio.poses import animated_character, animation_poses, pose_shapes
from cagemap.studio.preview_tasks import (
    FindMap,
    ImageUpdate,
    MapUpdate,
    OpenedPair,
    OpenModels,
    PairFiles,
    ShowBaked,
    ShowImage,
    ShowPosed,
    Task,
    TaskResult,
)
from cagemap.studio.recorded_match import number_duplicates
from cagemap.studio.shape import refined_shape
from cagemap.studio.skins import PreviewMap, align_facing, source_skin, target_skin
from cagemap.studio.state import MapState
from cagemap.studio.worker import without_folders
from cagemap.subdivision import refine
from cagemap.tasks.match import ComputedMatch
from cagemap.tasks.progress import logged_warnings
from cagemap.tasks.suggest import suggested_vertices

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class PreviewCache:
    """What the preview process keeps between tasks."""

    pair_files: PairFiles
    # `target`, `source`: after a map the source is rotated to face like the target
    target: OpenedModel
    source: OpenedModel
    prepared_pair: PreparedPair | None = None  # everything that does not depend on landmarks
    free_match: MatchResult | None = None  # match without landmarks, with all its answers
    chosen_answer: int = 0  # which of its answers (alignments) maps start from
    result: MatchResult | None = None  # the current map
    config: MatchConfig | None = None  # of a match from the start that gives ``result``; None after an update
    character: Character | None = None  # of the source's file; None before the first map


def run_task(
    cache: PreviewCache | None, task: Task, progress: Progress, show: Callable[[MapUpdate], None] = lambda _: None
) -> tuple[PreviewCache, TaskResult]:
    """Run a task; return the new cache and the result.

    `ShowBaked` gives the target's glTF, `ShowPosed` that of both. ``show`` receives maps that are not checked yet:
    rough ones before the first map, and updated ones.

    CagemapError if files or landmarks are wrong.
    """
    files, notes = task.pair_files, tuple[str, ...]()
    is_open = cache is not None and replace(cache.pair_files, ups=files.ups, texture=files.texture) == files
    if cache is None or isinstance(task, OpenModels) or not is_open:
        cache = PreviewCache(files, *open_models(files, progress))
    elif cache.pair_files != files:
        sides = zip((cache.target, cache.source), files.ups, strict=True)
        target, source = (replace(model, shape=model.shape.with_up(up)) for model, up in sides)
        if cache.pair_files.texture != files.texture:
            source, notes = _with_image(source, files, progress)
        cache = replace(cache, pair_files=files, target=target, source=source)
    match task:
        case OpenModels():
            return cache, OpenedPair(cache.target, cache.source, _posed_skins(cache, None))
        case FindMap():
            return find_map(cache, task, progress, show)
        case ShowBaked():
            return cache, _baked_skin(cache, task)
        case ShowImage():
            skins = _posed_skins(cache, task.preview_map)
            return cache, ImageUpdate(skins, cache.source.texture, notes)
        case ShowPosed():
            return cache, _posed_skins(cache, task.preview_map, task.pose)


def open_models(files: PairFiles, progress: Progress) -> tuple[OpenedModel, OpenedModel]:
    """Read, check and refine both models; what was logged about their files is in notes of the source or error."""
    progress("reading the models")
    given = files.target, files.source
    folders = {files.folder, *(path.parent for path in (*given, files.texture) if path is not None)}
    with logged_warnings() as logged:
        try:
            paths, conversions = zip(*(converted_model(path, files.folder) for path in given), strict=True)
            sides = zip(paths, files.schemes, files.ups, files.parts, strict=True)
            models = (open_model(path, scheme, up, files.vertices, part) for path, scheme, up, part in sides)
            target, source = (
                replace(model, notes=(*notes, *model.notes)) for notes, model in zip(conversions, models, strict=True)
            )
            source = textured(source, files.texture or paths[1], files.folder, progress)
        except Exception as error:
            for text in without_folders(logged, folders):
                error.add_note(text)
            raise
    return target, replace(source, notes=(*source.notes, *without_folders(logged, folders)))


def _with_image(source: OpenedModel, files: PairFiles, progress: Progress) -> tuple[OpenedModel, tuple[str, ...]]:
    """The source with the image of ``files`` in place of its own, and what was logged about it."""
    assert source.path is not None
    refined = refined_shape(refine(source.control, source.level))  # several images in the file have a layout of theirs
    shape = replace(source.shape, uvs=refined.uvs, uv_triangles=refined.uv_triangles)
    look = replace(source.look, texture=None, jpeg=None, tiles=(1, 1))
    image = files.texture or source.path
    with logged_warnings() as logged:
        source = textured(replace(source, shape=shape, look=look, texture=None), image, files.folder, progress)
    return source, without_folders(logged, {files.folder, image.parent})


def find_map(
    cache: PreviewCache, task: FindMap, progress: Progress, show: Callable[[MapUpdate], None]
) -> tuple[PreviewCache, MapUpdate]:
    """Match the models with the current landmarks.

    ParameterError if there is no such answer.
    """
    if cache.prepared_pair is None:
        levels = cache.target.level, cache.source.level
        surfaces = prepare_surfaces(cache.target.control, cache.source.control, levels, progress=progress)
        cache = replace(cache, prepared_pair=prepare_pair(*surfaces))
    begun, prepared_pair = cache, cache.prepared_pair
    assert prepared_pair is not None

    def preview(point_map: PointMap) -> None:
        show(_unchecked_update(begun, point_map))

    landmarks = to_landmarks(task.landmarks, cache.target.control, cache.source.control)
    has_constraints = bool(len(landmarks) + len(landmarks.curves))
    chosen_answer = task.chosen_answer if cache.result is None else cache.chosen_answer
    answer = chosen_answer if task.answer is None else task.answer
    is_update = has_constraints
    restarts = len(landmarks) < FEWEST_LANDMARKS if task.fresh else cache.result is None
    if task.answer is not None or not has_constraints or (answer and restarts):
        first_preview = preview if cache.result is None else None
        free_match = cache.free_match or match_pair(prepared_pair, progress=progress, preview=first_preview)
        if isinstance(answer, str):  # of a RESULT, whose numbers of vertices may have given other alignments
            names = _answer_names(free_match)
            answer = names.index(answer) if answer in names else 0
        result = other_answer(free_match, answer, progress=progress) if answer else free_match
        config = MatchConfig(answer=answer)
        cache = replace(cache, free_match=free_match, chosen_answer=answer, result=result, config=config)
    elif cache.result is None or task.fresh:
        result = match_pair(prepared_pair, landmarks, progress=progress)
        cache = replace(cache, chosen_answer=0, result=result, config=MatchConfig())
        is_update = False
    if is_update:
        assert cache.result is not None
        updated = update_match(cache.result, landmarks, progress=progress, preview=preview)
        cache = replace(cache, result=updated, config=None)
    return _map_update(cache)


def _unchecked_update(cache: PreviewCache, point_map: PointMap) -> MapUpdate:
    """A map to be shown before its quality is known, with the trust of the map before."""
    trust = np.ones(point_map.target.n) if cache.result is None else cache.result.quality.trust
    preview_map = PreviewMap(point_map.triangle, point_map.barycentric, trust)
    skin = target_skin(cache.target, cache.source, preview_map)
    return MapUpdate(preview_map, (skin, None), MapState(unchecked=True))


def _map_update(cache: PreviewCache) -> tuple[PreviewCache, MapUpdate]:
    """The current map for the page, with the source rotated to face like the target."""
    result = cache.result
    assert result is not None
    preview_map = PreviewMap(result.point_map.triangle, result.point_map.barycentric, result.quality.trust)
    target = cache.target
    source = cache.source.with_shape(align_facing(cache.source.shape, target.shape, preview_map))
    rotated_skin = None if source is cache.source else source_skin(source)
    skin = target_skin(target, source, preview_map)
    character = _source_character(cache)
    cache = replace(cache, source=source, character=character)
    worst = max(rate_figures(result.quality.summary()), key=lambda rating: rating.severity)
    config = None if len(result.landmarks.curves) else cache.config
    computed = None if config is None else ComputedMatch(result, config)
    map_state = MapState(
        answers=_answer_names(cache.free_match),
        chosen_answer=cache.chosen_answer,
        poor=worst.finding if worst.verdict == "poor" else "",
        confidence="" if result.confidence is None or cache.chosen_answer else result.confidence.message,
        strain=_landmark_strain(result),
        contradictions={suspect.name: str(suspect) for suspect in result.suspects},
        notes=tuple(result.landmark_check.notes) + tuple(result.quality.warnings),
        suggestion=_suggested_vertex(cache, result),
        poses=tuple(animation_poses(character)),
        from_start=computed is not None,
    )
    return cache, MapUpdate(preview_map, (skin, rotated_skin), map_state, computed)


def _answer_names(free_match: MatchResult | None) -> tuple[str, ...]:
    confidence = None if free_match is None else free_match.confidence
    return () if confidence is None else number_duplicates([answer.name for answer in confidence.answers])


def _suggested_vertex(cache: PreviewCache, result: MatchResult) -> int | None:
    """Control vertex where `cagemap suggest` asks for a landmark; None if all have one."""
    finest = result.point_map.target
    count = result.target.control.n_vertices
    landmark_vertices = np.unique(result.landmarks.target_points.heaviest_corners)
    if len(landmark_vertices) == count:
        return None
    confidence = None if cache.free_match is None else cache.free_match.confidence
    answers = () if confidence is None else confidence.answers
    others = [answer.positions[:count] for k, answer in enumerate(answers) if k != cache.chosen_answer]
    images = result.point_map.images.positions[:count]
    runners_up = np.array(others).reshape(len(others), count, 3)
    trust, counted = result.quality.trust[:count], result.masks.within(result.shared).of_target(finest.n)[:count]
    given = finest.positions[:count], images, runners_up, trust, landmark_vertices, 1, counted
    return int(suggested_vertices(*given)[0])


def _source_character(cache: PreviewCache) -> Character:
    """The source's file as an animated character, read once."""
    assert cache.source.path is not None
    return cache.character or animated_character(cache.source.path)


def _landmark_strain(result: MatchResult) -> dict[str, float]:
    """For each landmark name, its strain, distance from the others' map or error; see `MapState.strain`."""
    strain = dict(zip(result.trusted.names, map(float, result.quality.landmark_errors), strict=True))
    checked = result.landmark_check.strains
    if len(checked) == len(result.landmarks):
        strain |= dict(zip(result.landmarks.names, checked.tolist(), strict=True))
    return strain | {suspect.name: suspect.distance for suspect in result.suspects}


def _posed_skins(cache: PreviewCache, preview_map: PreviewMap | None, pose_name: str = "") -> tuple[bytes, bytes]:
    """Target and source, in a pose of the source's animations, with a task's map: a cancelled match drops the cache's.

    ParameterError if there is no such pose.
    """
    target, source = cache.target, cache.source
    shapes = target.shape, align_facing(source.shape, target.shape, preview_map)
    if pose_name:
        character = _source_character(cache)
        pose = animation_poses(character).get(pose_name)
        if pose is None or preview_map is None:
            raise ParameterError(f"Pose: expected a pose of the source, and a map, got {pose_name!r}. Choose another.")
        surfaces = target.shape.surface, source.shape.surface
        point_map = PointMap.from_arrays(*surfaces, preview_map.triangle, preview_map.barycentric)
        shapes = pose_shapes(character, pose, *shapes, preview_map, point_map)
    target, source = (model.with_shape(shape) for model, shape in zip((target, source), shapes, strict=True))
    return target_skin(target, source, preview_map), source_skin(source)


def _baked_skin(cache: PreviewCache, task: ShowBaked) -> bytes:
    """The target with a baked image, in the task's UV set or layout."""
    target, source = cache.target, cache.source
    shape, preview_map = target.shape, task.preview_map
    if task.uv_set is not None:
        refined = refined_shape(refine(shape.control.with_uv_set(task.uv_set), target.level))
        shape = replace(shape, uvs=refined.uvs, uv_triangles=refined.uv_triangles)
    if task.layout is not None and not shape.control.has_layout:
        unwrapped = open_model(task.layout, target.scheme, None, len(shape.positions)).shape
        if np.array_equal(unwrapped.triangles, shape.triangles):
            shape = replace(shape, uvs=unwrapped.uvs, uv_triangles=unwrapped.uv_triangles)
        else:
            shape, preview_map = replace(unwrapped, rotation=shape.rotation), None
    baked = with_texture(target.look, task.image)
    if shape.uvs is not None:
        shape = replace(shape, uvs=baked.to_image_uvs(shape.uvs))
    return target_skin(target.with_shape(shape), source, preview_map, baked.jpeg)
