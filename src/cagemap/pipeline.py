"""The pipeline: prepare each surface once, then match a pair (paper, Fig. 2)."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

from cagemap.deform.fit import shared_area
from cagemap.deform.multi_start import FEWEST_LANDMARKS
from cagemap.deform.placement import Placement
from cagemap.deform.problem import PreparedPair, Problem
from cagemap.deform.refit import fit_from_shape
from cagemap.deform.update import linear_update
from cagemap.errors import InvalidLandmarksError, ParameterError
from cagemap.maps.coincident_map import coincident_map
from cagemap.maps.hypotheses.confidence import (
    answer_confidence,
    jump_lengths,
    kept_confidence,
    prolong_answers,
    turned_limb_answers,
)
from cagemap.maps.hypotheses.search import distinct_answers, search_both_ways, search_placements
from cagemap.maps.landmarks.check import (
    LandmarkCheck,
    check_changes,
    check_mirrored,
    check_on_map,
    landmark_outliers,
)
from cagemap.maps.pair import Pair, Progress, point_pairs
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import map_of_places
from cagemap.maps.quality import judge
from cagemap.maps.result import MatchResult as MatchResult
from cagemap.maps.result import result_of_fit
from cagemap.match_config import MatchConfig as MatchConfig
from cagemap.mesh import ControlMesh
from cagemap.mesh.inputs import LandmarksLike, MeshLike, arrays_accepted
from cagemap.mesh.landmarks import Landmarks, check_landmarks
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import in_threads, one_blas_thread
from cagemap.paper.hfm import hfm_map
from cagemap.paper.method import paper_map, search_levels
from cagemap.paper.symmetries import paired_mirrors
from cagemap.spectral.basis import MAP_BASIS as MAP_BASIS
from cagemap.spectral.surface import DEFAULT_VERTICES, Surface
from cagemap.spectral.surface import choose_level as choose_level
from cagemap.spectral.surface import default_basis as default_basis
from cagemap.spectral.surface import no_progress as no_progress
from cagemap.spectral.surface import prepare_surface as prepare_surface
from cagemap.spectral.surface import prepare_surfaces as prepare_surfaces

logger = logging.getLogger(__name__)


@kinds_checked
def prepare_pair(target: Surface, source: Surface, config: MatchConfig = MatchConfig()) -> PreparedPair:
    """Prepare everything of an elastic match that does not depend on landmarks, for repeated matches."""
    config.masks.require_fit(*(side.refinement.finest.n_vertices for side in (target, source)))
    with one_blas_thread():
        # Compute bases and triangles now, if not done yet: a result that was read has none.
        in_threads(lambda surface: (surface.basis, surface.finest_triangles), [target, source])
        return PreparedPair.build(target, source, config.start, config.elastic, config.masks)


@arrays_accepted
def match(
    target: Surface | MeshLike,
    source: Surface | MeshLike,
    landmarks: LandmarksLike | None = None,
    config: MatchConfig = MatchConfig(),
    *,
    progress: Progress = no_progress,
) -> MatchResult:
    """Map a target surface to a source surface (paper, section 5).

    With fewer than three landmarks many alignments are tried. The result has a ``confidence`` then, and with more
    landmarks if they are mirrored or leave the rotation of a limb open.

    Parameters
    ----------
    target : Surface, or mesh, see `cagemap.mesh.inputs.control_mesh`
        M1, the surface that receives. A mesh is prepared with about 200 000 vertices; use `prepare_surfaces` to choose
        levels or to reuse surfaces.
    source : Surface, or mesh, see `cagemap.mesh.inputs.control_mesh`
        M2, the surface that gives.
    landmarks : Landmarks or (p, 2) array, optional
        Corresponding points and curves; an array has rows (target vertex, source vertex).
    config : MatchConfig
    progress : callable
        Called with the name of each stage.

    Raises
    ------
    InvalidMeshError
        If a mesh is not an oriented connected manifold.
    InvalidLandmarksError
        If the landmarks do not fit the control meshes, or "hfm" has fewer than three.
    """
    landmarks = Landmarks.none() if landmarks is None else landmarks
    controls = [side.control if isinstance(side, Surface) else side for side in (target, source)]
    check_landmarks(landmarks, *controls)
    if len(landmarks) < FEWEST_LANDMARKS and config.method == "hfm":
        raise InvalidLandmarksError(
            f"landmarks: expected at least {FEWEST_LANDMARKS} pairs for the method hfm, got {len(landmarks)}. Add "
            "pairs, or use the method elastic, which needs none."
        )
    timings: dict[str, float] = {}

    def prepare(side: Surface | ControlMesh) -> Surface:
        """Prepare a mesh at the default size; a surface is returned unchanged."""
        if isinstance(side, Surface):
            return side
        level = choose_level(side, DEFAULT_VERTICES)
        return prepare_surface(side, level, default_basis(config.method, level))

    target, source = in_threads(prepare, [target, source])
    if config.method == "elastic":
        with _timed(timings, "pair"):
            prepared = prepare_pair(target, source, config)
        return match_pair(prepared, landmarks, config, progress=progress, timings=timings)
    needed = target.finest_level, source.finest_level
    if config.method == "hfm":
        needed = search_levels(target, source, config.hfm.search_vertices, config.hfm.source_search_vertices)
    for surface, level in zip((target, source), needed, strict=True):
        surface.require_operators(level, config.method)
    with _timed(timings, "symmetry"):
        pair = pair_of(target, source, landmarks, config)
    with one_blas_thread():
        with _timed(timings, "map"):
            if config.method == "paper":
                level_maps, point_map = paper_map(pair, config.paper, progress)
            else:
                level_maps, point_map = hfm_map(pair, config.hfm, progress)
        progress("quality")
        with _timed(timings, "quality"):
            quality = judge(target, point_map, pair.landmarks)
    return MatchResult(target, source, landmarks, point_map, quality, timings, level_maps=level_maps)


@arrays_accepted
def match_pair(
    prepared: PreparedPair,
    landmarks: LandmarksLike | None = None,
    config: MatchConfig = MatchConfig(),
    *,
    progress: Progress = no_progress,
    timings: dict[str, float] | None = None,
    preview: Callable[[PointMap], None] | None = None,
) -> MatchResult:
    """Match a prepared pair by the elastic method.

    Parameters
    ----------
    prepared : PreparedPair
    landmarks : Landmarks, optional
        As in `match`.
    config : MatchConfig
        Its start, elastic and masks must be those of the prepared pair; defaults mean those.
    progress : callable
    timings : dict of str to float, optional
        Seconds of earlier stages.
    preview : callable, optional
        Called with approximate maps during the search, with fewer than three landmarks.

    Raises
    ------
    InvalidLandmarksError
        If the landmarks do not fit the control meshes.
    ParameterError
        If the config asks for another method, start, elastic fit or masks than the pair was prepared for.
    """
    config.require_elastic("match_pair")
    prepared.require_same(config.start, config.elastic, config.masks)
    landmarks = Landmarks.none() if landmarks is None else landmarks
    check_landmarks(landmarks, prepared.target.control, prepared.source.control)
    problem, timings = Problem.of_landmarks(prepared, landmarks), dict(timings or {})
    check, confidence = LandmarkCheck(), None
    placements: Sequence[Placement]

    def show(coarse: Placement) -> None:
        if preview is not None:
            preview(map_of_places(problem, coarse.extrapolate_to(prepared.energy.graph, prepared.elastic.graph)))

    with one_blas_thread(), _timed(timings, "map"):
        coincident = coincident_map(problem)
        if coincident is not None:
            point_map, confidence = coincident
            placements = confidence.answers
        elif len(landmarks) < FEWEST_LANDMARKS:
            placements = distinct_answers(prepared, search_both_ways(problem, progress, show))
            progress("closest points")
            point_map = map_of_places(problem, placements[0].map_positions)
        else:
            outliers, notes = dict[int, str](), list[str]()
            if config.check_landmarks:
                outliers, notes = landmark_outliers(problem, progress)
            trusted = problem.without(outliers)
            placements = search_placements(trusted, progress)
            progress("closest points")
            point_map = map_of_places(trusted, placements[0].map_positions)
            if config.check_landmarks:
                progress("test landmarks on the map")
                check = check_on_map(problem, point_map, outliers, notes)
                mirrored, check = check_mirrored(problem, placements[0], outliers, check, progress)
                confidence = mirrored or turned_limb_answers(placements, prepared)
        shared = shared_area(prepared, placements[0].map_positions)
        jumps = jump_lengths(prepared, point_map, shared)
        if coincident is None and len(landmarks) < FEWEST_LANDMARKS:
            confidence = answer_confidence(problem, point_map, tuple(placements), shared, jumps)
        confidence = None if confidence is None else prolong_answers(confidence, prepared)
    progress("quality")
    result = result_of_fit(problem, point_map, landmarks, check, timings, shared, confidence, jumps)
    return other_answer(result, config.answer, config, progress=progress) if config.answer else result


@arrays_accepted
def update_match(
    before: MatchResult,
    landmarks: LandmarksLike,
    config: MatchConfig = MatchConfig(),
    *,
    progress: Progress = no_progress,
    preview: Callable[[PointMap], None] | None = None,
) -> MatchResult:
    """Update a match after landmarks were added, moved or removed: a fast preview.

    The map responds elastically to the landmarks; its error is within a few percent of that of a new match
    (docs/lab/fit_experiments.md). If landmarks change which parts correspond (an arm instead of a leg), match again.
    The ``confidence`` of the match before stays while there are fewer than three landmarks, none was moved or removed,
    and every answer fits all of them; else the result has none.

    Parameters
    ----------
    before : MatchResult
    landmarks : Landmarks
        All landmarks, changed or not. Pairs that the match left out stay out unless they changed; changed pairs are
        checked by their distances to the others.
    config : MatchConfig
        The config of the match before.
    progress : callable
        Called with the name of each stage.
    preview : callable, optional
        Called with the updated map before its quality is measured.

    Raises
    ------
    InvalidLandmarksError
        If the landmarks do not fit the control meshes.
    """
    target, source = before.target, before.source
    check_landmarks(landmarks, target.control, source.control)
    prepared = before.prepared or prepare_pair(target, source, replace(config, masks=before.masks))
    point_map = before.point_map
    check = before.landmark_check.for_changed(before.landmarks, landmarks)
    timings: dict[str, float] = {}
    problem, confidence = Problem.of_landmarks(prepared, landmarks), None
    with one_blas_thread(), _timed(timings, "map"):
        if config.check_landmarks and len(landmarks) >= FEWEST_LANDMARKS:
            check = check_changes(problem, landmarks.new_since(before.landmarks), check, point_map)
        trusted = problem.without(check.left_out)
        coincident = coincident_map(trusted)
        if coincident is not None:
            point_map, confidence = coincident
            confidence = prolong_answers(confidence, prepared)
        else:
            progress("elastic update")
            places = linear_update(trusted, point_map)
            progress("closest points")
            point_map = map_of_places(trusted, places)
            if len(landmarks) < FEWEST_LANDMARKS and not len(before.landmarks.new_since(landmarks)):
                confidence = kept_confidence(before.confidence, trusted)
    if preview is not None:
        preview(point_map)
    progress("quality")
    return result_of_fit(problem, point_map, landmarks, check, timings, before.shared, confidence)


@arrays_accepted
def match_next(
    before: MatchResult,
    source: Surface | MeshLike,
    landmarks: LandmarksLike | None = None,
    config: MatchConfig = MatchConfig(),
    *,
    progress: Progress = no_progress,
) -> MatchResult:
    """Map the target to the next frame of a moving source, from the map to the last frame.

    The fit starts from the map to the last frame; no other starts are tried, and errors add up from frame to frame
    (docs/lab/sequences.md). If the map folds more than ``max_folded_frame`` of `RefitConfig`, the frame is matched
    without the last one; without landmarks only such a result has a ``confidence``.

    Parameters
    ----------
    before : MatchResult
        Of the same target and the last frame.
    source : Surface, or mesh, see `cagemap.mesh.inputs.control_mesh`
        The next frame, in units and axes of the last one. Its connectivity may be another.
    landmarks : Landmarks or (p, 2) array, optional
        Between the target and this frame; constraints of the fit.
    config : MatchConfig
        Of method "elastic". Without a mask of the target, that of the match before is used.
    progress : callable

    Raises
    ------
    InvalidMeshError
        If the frame is not an oriented connected manifold.
    InvalidLandmarksError
        If the landmarks do not fit the control meshes.
    ParameterError
        If the config asks for another method.
    """
    config.require_elastic("match_next")
    if config.masks.target is None and before.masks.target is not None:
        config = replace(config, masks=replace(config.masks, target=before.masks.target))
    landmarks = Landmarks.none() if landmarks is None else landmarks
    if not isinstance(source, Surface):
        source = prepare_surface(source, choose_level(source, DEFAULT_VERTICES))
    check_landmarks(landmarks, before.target.control, source.control)
    prepared, timings = prepare_pair(before.target, source, config), dict[str, float]()
    problem = Problem.of_landmarks(prepared, landmarks)
    # Positions at unit area of the last frame, whose area may differ
    last = before.point_map.images.at(prepared.vertices).positions * (source.scale / before.source.scale)
    with one_blas_thread(), _timed(timings, "map"):
        progress("elastic alignment")
        places = fit_from_shape(problem, last)
        progress("closest points")
        point_map = map_of_places(problem, places)
        shared = shared_area(prepared, places)
    progress("quality")
    found = result_of_fit(problem, point_map, landmarks, LandmarkCheck(), timings, shared)
    followed = found.quality.flipped_area <= config.elastic.refit.max_folded_frame
    return found if followed else match_pair(prepared, landmarks, config, progress=progress)


def other_answer(
    before: MatchResult, index: int, config: MatchConfig = MatchConfig(), *, progress: Progress = no_progress
) -> MatchResult:
    """Result with another of ``before.confidence.answers``; index 0 is the match's own.

    Raises
    ------
    ParameterError
        If there is no such answer, or a result that was read does not contain it in full.
    """
    answers = () if before.confidence is None else before.confidence.answers
    if not 0 <= index < len(answers):
        expected = (
            f"one of the {len(answers)} that the match found, from 0" if answers else "0: the match found no other"
        )
        raise ParameterError(f"answer {index}: expected {expected}")
    config, landmarks = replace(config, masks=before.masks, answer=0), before.landmarks
    prepared = before.prepared or prepare_pair(before.target, before.source, config)
    if answers[index].exchange:
        return match_pair(prepared, landmarks.exchanged(answers[index].exchange), config, progress=progress)
    if len(answers[index].positions) < prepared.mesh.n:
        raise ParameterError(
            f"answer {index}: a result that was read knows it at the control vertices only; match again to have it"
        )
    problem, check = Problem.of_landmarks(prepared, landmarks), before.landmark_check
    places = answers[index].positions[prepared.vertices]  # answers of a plain target have all its vertices
    timings: dict[str, float] = {}
    with one_blas_thread(), _timed(timings, "map"):
        point_map = map_of_places(problem.without(check.left_out), places)
        shared = shared_area(prepared, places)
    progress("quality")
    return result_of_fit(problem, point_map, landmarks, check, timings, shared, before.confidence)


@arrays_accepted
def pair_of(target: Surface, source: Surface, landmarks: LandmarksLike, config: MatchConfig = MatchConfig()) -> Pair:
    """Pair of two surfaces with landmarks, and with symmetries, given or found for "paper" (5.2)."""
    pair = Pair(target, source, point_pairs(target, source, landmarks), config.symmetries)
    if config.method != "paper" or not config.use_symmetry or config.symmetries:
        return pair
    symmetries = paired_mirrors(pair)
    if symmetries:
        logger.info("both surfaces are mirrored in %d planes that landmarks agree with: used", len(symmetries))
    return replace(pair, symmetries=symmetries)


@contextmanager
def _timed(timings: dict[str, float], stage: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    timings[stage] = time.perf_counter() - start
