"""`cagemap match`: match two mesh files and write a RESULT folder."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import ParameterError
from cagemap.files.atomic import require_no_input
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.files.landmarks.points import read_points, symmetry_on
from cagemap.files.meshes.formats import read_mesh, read_whole
from cagemap.files.result.folder import ARRAYS, check_result_folder, write_result
from cagemap.files.result.manifest import MANIFEST, peak_memory, stated_inputs
from cagemap.files.result.merged_parts import merge_results
from cagemap.files.result.surface_store import load_or_prepare
from cagemap.files.usd.read import objects_of
from cagemap.files.usd.space import unit_notes
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks, check_landmarks, pair_by_name
from cagemap.pipeline import MatchConfig, MatchResult, match, match_next, prepare_surfaces
from cagemap.spectral import BasisConfig, Surface
from cagemap.spectral.surface import DEFAULT_VERTICES, prepare_checked
from cagemap.tasks.job_file import note_match
from cagemap.tasks.masks import GivenMasks, mask_inputs, masks_on, read_masks
from cagemap.tasks.match_parts import PartInputs, ready_inputs, requested_parts, select_parts
from cagemap.tasks.match_summary import match_figures, next_commands, summary, warnings
from cagemap.tasks.method import (
    SIDES,
    basis_parameters,
    read_symmetries,
    require_level_or_vertices,
    require_levels,
    side_bases,
    side_levels,
    used_parameters,
    with_parameters,
)
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.match import MatchRequest as MatchRequest
from cagemap.tasks.requests.options import field_values
from cagemap.tasks.subdivision import SubdivisionRequest, weld_side

_log = logging.getLogger(__name__)

# Options whose values are written to the manifest unchanged.
_NOTED = (
    "level target_vertices source_vertices method symmetry exchange_landmarks trust_landmarks answer scheme "
    "target_scheme source_scheme boundary uv_interpolation creasing weld target_weld source_weld target_uv_set "
    "source_uv_set target_mask source_mask mask_edge"
).split()


@dataclass(frozen=True)
class Inputs:
    """Checked inputs of a match."""

    # `target`, `source`: meshes with all parts
    target: ControlMesh
    source: ControlMesh
    parts: tuple[PartInputs, ...]  # pairs of meshes that are matched, one by one
    named: bool  # whether parts were requested; otherwise the only pair is both whole files
    masks: GivenMasks = (None, None)  # of target and source
    notes: tuple[str, ...] = ()  # messages to the user


@dataclass(frozen=True, eq=False)
class ComputedMatch:
    """A match computed in the studio; `match` writes it if all its inputs are equal."""

    result: MatchResult
    config: MatchConfig

    def on_surfaces(
        self, target: Surface, source: Surface, landmarks: Landmarks, config: MatchConfig
    ) -> MatchResult | None:
        """The result, if all inputs are equal; None if one differs, or there are masks or curves."""
        computed, pairs = self.result, ((self.result.target, target), (self.result.source, source))
        if config.masks.any or computed.masks.any or replace(config, masks=self.config.masks) != self.config:
            return None
        if (landmarks.names, landmarks.places) != (computed.landmarks.names, computed.landmarks.places):
            return None
        if len(landmarks.curves) + len(computed.landmarks.curves):
            return None
        if not all(_is_same_surface(one, two) for one, two in pairs):
            return None
        points = computed.point_map
        point_map = PointMap.from_arrays(
            target.finest_triangles, source.finest_triangles, points.triangle, points.barycentric
        )
        return replace(computed, target=target, source=source, landmarks=landmarks, point_map=point_map)


def _is_same_surface(one: Surface, two: Surface) -> bool:
    """Whether two surfaces have equal levels, vertices, faces and bases."""
    return (
        one.refinement.finest_level == two.refinement.finest_level
        and one.refinement.is_plain == two.refinement.is_plain
        and one.config == two.config
        and np.array_equal(one.vertices, two.vertices)
        and np.array_equal(one.faces, two.faces)
    )


@dataclass(frozen=True, eq=False)
class MatchSettings:
    """Settings of a match."""

    bases: tuple[BasisConfig, BasisConfig]  # of target and source
    levels: tuple[int, int]  # finest levels of target and source
    config: MatchConfig  # without masks, which depend on the surfaces
    cache: Path | None = None  # folder of prepared surfaces
    entries: dict[str, Any] = field(default_factory=dict)  # for the manifest: parameters, inputs
    last_frame: MatchResult | None = None  # match of the source's last frame, from which the match starts
    computed: ComputedMatch | None = None  # is used if its inputs are equal


def run_match(request: MatchRequest, stages: Stages, computed: ComputedMatch | None = None) -> SummaryAndWarnings:
    """Match two mesh files and write the RESULT folder; returns a summary and warnings."""
    started = time.perf_counter()
    result = match_files(request, stages, computed=computed)
    stages.record(match_figures(result, time.perf_counter() - started))
    text = summary(result, request.output, stages.figures)
    return f"{text}\n{next_commands(result, request)}", warnings(result)


def match_files(
    request: MatchRequest,
    stages: Stages,
    last_frame: MatchResult | None = None,
    computed: ComputedMatch | None = None,
    require: Callable[[ControlMesh, ControlMesh], object] = lambda target, source: None,
) -> MatchResult:
    """Match two mesh files and write the RESULT folder.

    ``last_frame``, of the same target, is the start of the match; its target is used again.
    ``computed`` replaces the computation if its inputs are equal.
    ``require`` refuses target and source that the caller cannot use, before any work.
    """
    config = check_match(request)
    stages("read")
    optional = ("landmarks", "target_points", "source_points", "curves")
    files = {"target": request.target, "source": request.source}
    files |= {name: path for name in optional if (path := getattr(request, name)) is not None}
    for side, symmetries in (("target", request.target_symmetry), ("source", request.source_symmetry)):
        files.update({f"{side}_symmetry_{i}": path for i, path in enumerate(symmetries)})
    files.update(mask_inputs(request))
    check_result_folder(request.output, force=request.force)
    require_no_input([request.output / name for name in (ARRAYS, MANIFEST)], files.values())
    stated = stated_inputs(files, request.output)
    inputs = read_inputs(request)
    require(inputs.target, inputs.source)
    levels = matched_levels(request, inputs)
    for part in inputs.parts:
        require_levels(request, (part.target, part.source), levels)
    bases = side_bases(request, levels)
    sides = {
        side: basis_parameters(basis) | {"level": level}
        for side, basis, level in zip(SIDES, bases, levels, strict=True)
    }
    parts = requested_parts(request.part, request.target_part, request.source_part)
    parameters = {
        **field_values(request, *_NOTED),
        "vertices": request.vertices or (None if request.level else DEFAULT_VERTICES),
        **{f"{side}_{name}": value for side, used in sides.items() for name, value in used.items()},
        "spectral": used_parameters(config),
        **dict(zip(("target_part", "source_part"), parts, strict=True)),
    }
    entries = {"parameters": parameters, "inputs": stated}
    result = match_inputs(
        inputs, MatchSettings(bases, levels, config, request.cache, entries, last_frame, computed), stages
    )
    stages("write")
    write_result(request.output, result, force=request.force)
    note_match(request)
    return result


def check_match(request: MatchRequest) -> MatchConfig:
    """Refuse options that contradict each other, before meshes are read; returns the configuration."""
    require_level_or_vertices(request)
    side_bases(request)
    return match_config(request)


def match_config(request: MatchRequest) -> MatchConfig:
    """Configuration of a match from its request."""
    config = MatchConfig(
        method=request.method,
        use_symmetry=request.symmetry,
        symmetries=read_symmetries(request.target_symmetry, request.source_symmetry),
        check_landmarks=not request.trust_landmarks,
        answer=request.answer,
    )
    return with_parameters(config, request.parameter)


def read_inputs(request: MatchRequest) -> Inputs:
    """Read and check both meshes and the landmarks, before expensive steps."""
    files = request.target, request.source
    target, source = (read_control(path, request, side) for side, path in zip(SIDES, files, strict=True))
    landmarks, notes = read_given_landmarks(request, target, source)
    notes = (*notes, *unit_notes(request.target, request.source))
    masks = read_masks(request, (target, source), files)
    welded = [weld_side(control, request, side) for control, side in zip((target, source), SIDES, strict=True)]
    check_landmarks(landmarks, target, source)
    landmarks = landmarks.renumbered(*(weld.vertex_of.__getitem__ for weld in welded))
    target, source = (weld.mesh for weld in welded)
    notes = (*notes, *(note for weld in welded for note in weld.notes))
    names = requested_parts(request.part, request.target_part, request.source_part)
    named = names != (None, None)
    whole = PartInputs(target, source, landmarks)
    chosen, left_alone = select_parts(target, source, landmarks, *names) if named else ((whole,), ())
    parts = tuple(ready_inputs(part) for part in chosen)
    notes = (*notes, *_unused_notes(request, chosen), *left_alone, *_uv_set_notes(request, parts))
    notes = (*notes, *(note for part in parts for note in part.notes))
    return Inputs(target, source, parts, named, masks, notes)


def _uv_set_notes(request: MatchRequest, parts: tuple[PartInputs, ...]) -> list[str]:
    """Notes on parts that lack the requested UV set; see `extract_faces`, and `join_meshes` of several parts."""
    notes = []
    for side in SIDES:
        requested, meshes = getattr(request, f"{side}_uv_set"), [getattr(part, side) for part in parts]
        in_use = meshes[0].uv_name
        effect = "no image is baked there: match it alone" if in_use == requested else f"{in_use} is used"
        for mesh in meshes:
            if requested is not None and mesh.uv_name != requested:
                part = " ".join([f"{mesh.name}: the part", *filter(None, objects_of(mesh))])
                notes.append(f"--{side}-uv-set {requested}: {part} has no texture coordinates there, {effect}")
    return list(dict.fromkeys(notes))


def _unused_notes(request: MatchRequest, parts: Sequence[PartInputs]) -> list[str]:
    """A note for each option that the match of the parts does not use."""
    pairs = request.landmarks is not None or request.curves is not None
    no_file = "no file of landmarks that it applies to is given"
    other_method = f"it is of other methods than {request.method}"
    unused = (
        ("--exchange-landmarks", request.exchange_landmarks and not pairs, no_file),
        ("--trust-landmarks", request.trust_landmarks and not pairs and request.target_points is None, no_file),
        ("--no-symmetry", not request.symmetry and request.method != "paper", other_method),
        ("--set target.symmetry", bool(request.target_symmetry) and request.method == "elastic", other_method),
    )
    notes = [f"{option} is not used: {why}" for option, is_unused, why in unused if is_unused]
    subdivision = SubdivisionRequest(None, request.boundary, request.uv_interpolation, request.creasing)
    return notes + subdivision.unused_notes(mesh for part in parts for mesh in (part.target, part.source))


def matched_levels(request: MatchRequest, inputs: Inputs) -> tuple[int, int]:
    """Finest levels of target and source, by the only pair of parts or the whole files."""
    matched = inputs.parts[0] if len(inputs.parts) == 1 else inputs
    return side_levels(request, (matched.target, matched.source))


def read_given_landmarks(
    request: MatchRequest, target: ControlMesh, source: ControlMesh
) -> tuple[Landmarks, tuple[str, ...]]:
    """Landmarks of the given files, with the curves of ``--curves`` added; and notes."""
    landmarks, notes = _read_points_or_pairs(request, target, source)
    if request.curves is None:
        return landmarks, notes
    more, more_notes = _read_pairs(request.curves, request)
    if len(more):
        raise ParameterError(f"--curves: expected curves alone, got landmarks in {request.curves}. Give --landmarks.")
    return replace(landmarks, curves=landmarks.curves + more.curves), (*notes, *more_notes)


def _read_pairs(path: Path, request: MatchRequest) -> tuple[Landmarks, tuple[str, ...]]:
    """Read a file of pairs, reversed with ``--exchange-landmarks``; and notes."""
    if request.exchange_landmarks:
        exchanged, notes = read_landmarks(path, request.source, request.target)
        return exchanged.reversed(), notes
    return read_landmarks(path, request.target, request.source)


def _read_points_or_pairs(
    request: MatchRequest, target: ControlMesh, source: ControlMesh
) -> tuple[Landmarks, tuple[str, ...]]:
    """Landmarks of a pair file, of a point file for each mesh, or none; and notes."""
    points = request.target_points, request.source_points
    if points[0] is not None and points[1] is not None and request.landmarks is None:
        return pair_by_name(read_points(points[0], target), read_points(points[1], source), target, source)
    if points != (None, None):
        raise ParameterError(
            "--target-points and --source-points: expected both, and no --landmarks beside them; landmarks are pairs "
            "of points of the same name, or come from one file of pairs."
        )
    if request.landmarks is None:
        return Landmarks.none(), ()
    return _read_pairs(request.landmarks, request)


def read_control(path: Path, request: MatchRequest, side: str) -> ControlMesh:
    """Read the control mesh of one side, with the requested subdivision options and UV set."""
    scheme = getattr(request, f"{side}_scheme") or request.scheme
    subdivision = SubdivisionRequest(scheme, request.boundary, request.uv_interpolation, request.creasing)
    parts = requested_parts(request.part, request.target_part, request.source_part)[SIDES.index(side)]
    read = read_mesh if parts is None else read_whole
    control = subdivision.apply(replace(read(path), name=path.name))
    uv_set = getattr(request, f"{side}_uv_set")
    return control if uv_set is None else control.with_uv_set(uv_set)


def match_inputs(inputs: Inputs, settings: MatchSettings, stages: Stages) -> MatchResult:
    """Match both whole meshes, or every pair of parts at the same levels, as one result."""
    results = [_match_part(part, inputs, settings, stages) for part in inputs.parts]
    if not inputs.named:
        return results[0]
    stages("merge parts")
    faces = [[len(side.control.face_sizes) for side in (result.target, result.source)] for result in results]
    return merge_results(results, {"parts": [{"target_faces": t, "source_faces": s} for t, s in faces]})


def _match_part(part: PartInputs, inputs: Inputs, settings: MatchSettings, stages: Stages) -> MatchResult:
    """Prepare and match both surfaces; the result has timings and provenance."""
    controls, config = (part.target, part.source), settings.config
    for control, level in zip(controls, settings.levels, strict=True):
        _log.info("%s: level %d", control.name, level)
    prepare = prepare_checked if settings.cache is None else partial(load_or_prepare, settings.cache)
    if settings.last_frame is None:
        target, source = prepare_surfaces(*controls, settings.levels, settings.bases, prepare=prepare, progress=stages)
    else:
        stages(f"prepare {part.source.name}")
        target, source = settings.last_frame.target, prepare(part.source, settings.levels[1], settings.bases[1])
    symmetries = tuple((symmetry_on(t, target.control), symmetry_on(s, source.control)) for t, s in config.symmetries)
    config = replace(config, symmetries=symmetries, masks=masks_on(inputs.masks, (target, source)))
    computed, given = settings.computed, (target, source, part.landmarks, config)
    if computed is not None and (equal := computed.on_surfaces(*given)) is not None:
        result = equal
    elif settings.last_frame is None:
        result = match(target, source, part.landmarks, config, progress=stages)
    else:
        result = match_next(settings.last_frame, source, part.landmarks, config, progress=stages)
    repairs = [pair.repairs for pair in inputs.parts]
    provenance = {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        **settings.entries,
        "notes": list(inputs.notes),
        "repairs": repairs[0] if len(repairs) == 1 else repairs,
        "peak_memory_bytes": peak_memory(),
    }
    return replace(result, timings=dict(stages.timings), provenance=provenance)
