"""`cagemap wrap`: fit the target's cage to the source's shape."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import ParameterError
from cagemap.files.atomic import all_or_nothing, check_outputs, require_no_input
from cagemap.files.meshes.formats import mesh_files, write_mesh
from cagemap.files.meshes.obj_write import write_obj_positions
from cagemap.files.result.folder import read_result
from cagemap.files.result.manifest import input_file, mesh_hash, note_transfer, read_files
from cagemap.files.usd.prims import transform_points
from cagemap.files.usd.space import between_spaces, to_standard
from cagemap.files.usd.stages import is_usd
from cagemap.files.usd.write import UsdResults
from cagemap.files.values.part_numbering import file_rows, rows_of
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.threads import one_blas_thread
from cagemap.pipeline import choose_level
from cagemap.tasks.detail_bakes import bake_wrapped, outputs_beside, require_wrappable
from cagemap.tasks.follower import require_whole, write_follower
from cagemap.tasks.import_map import MAP_VERTICES, run_map
from cagemap.tasks.job_file import note_output
from cagemap.tasks.masks import with_masks
from cagemap.tasks.match import match_files
from cagemap.tasks.match_summary import warnings as result_warnings
from cagemap.tasks.method import side_levels
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.import_map import MapRequest
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.options import field_values
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.tasks.transfer import carry_one
from cagemap.tasks.usd_output import left_out_warnings, old_rig_warnings, write_usd_results
from cagemap.tasks.wrap_checks import (
    check_files,
    check_wrap,
    mirror_image,
    read_follow,
    require_inputs,
    shape_files,
    side_options,
)
from cagemap.tasks.wrap_figures import distances_text, fold_warnings, size_warnings, wrap_figures
from cagemap.wrap import WrapConfig, Wrapped, level_mesh, wrap
from cagemap.wrap.wrapping import finest_follow


def run_wrap(request: WrapRequest, stages: Stages) -> SummaryAndWarnings:
    """Wrap the target of one or several results, and write the cages; returns a summary and warnings."""
    check_wrap(request)
    check_files(request)
    match_inputs = (request.target, request.source, request.landmarks, request.map)
    if not any(match_inputs):
        return _with_texture(request, *_run(request, stages), stages)
    frames = request.results
    sources = frames if request.source is None else (request.source, *frames)
    mixed = any(frame.is_dir() for frame in frames) or (request.source is not None and bool(frames))
    if request.target is None or not sources or mixed:
        raise ParameterError(
            "expected RESULT folders, or --target and --source together to match first, or --target and the frames of "
            "a motion"
        )
    if request.blend_shapes:  # refuse names and files before the matches
        files = shape_files(request, request.target, sources)
        written = files if request.output.is_dir() else [request.output]
        check_outputs(written, [request.target, *sources], force=request.force)
    with tempfile.TemporaryDirectory() as folder:
        results, warnings = _match_sources(request, request.target, sources, Path(folder), stages)
        request = replace(request, results=results)
        summary, more = _with_texture(request, *_run(request, stages), stages)
        return summary, warnings + more


def _match_sources(
    request: WrapRequest, target: Path, sources: Sequence[Path], folder: Path, stages: Stages
) -> tuple[tuple[Path, ...], list[str]]:
    """Match the target with each source, or read the user's point map; returns the RESULT folders and warnings.

    Several sources are frames of a motion: the match of each frame starts from the map to the frame before it.
    """
    results = tuple(folder / f"{frame}" for frame in range(len(sources)))
    if request.map is not None:
        of_map = MapRequest(request.map, target, sources[0], results[0], **side_options(request, "weld"))

        def require_of_map(*meshes: ControlMesh) -> None:
            require_inputs(request, (target, sources[0]), choose_level(meshes[0], MAP_VERTICES), *meshes)

        return results, run_map(of_map, stages, require_of_map)[1]
    options, warnings = side_options(request, "scheme", "weld"), list[str]()
    last_frame: MatchResult | None = None
    for frame, (source, output) in enumerate(zip(sources, results, strict=True)):
        one = MatchRequest(target, source, output, None if frame else request.landmarks, **options)

        def require(*meshes: ControlMesh, one: MatchRequest = one) -> None:
            require_inputs(request, (one.target, one.source), side_levels(one, meshes)[0], *meshes)

        result = match_files(one, stages, last_frame, require=require)
        name = f"{source.name}: " if len(sources) > 1 else ""
        if name:
            stages.note(f"frame {frame + 1} of {len(sources)}, {name}{_frame_text(result, last_frame)}")
        warnings += [f"{name}{message}" for message in result_warnings(result)]
        last_frame = replace(result, prepared=None)
    return results, list(dict.fromkeys(warnings))


def _frame_text(result: MatchResult, last_frame: MatchResult | None) -> str:
    """How a frame was matched, its folded area and how far it moved."""
    folded = f"{100 * result.quality.flipped_area:.2f} % folded"
    if last_frame is None:
        return f"matched, {folded}"
    if result.confidence is not None:
        return f"matched afresh, since the map from the last frame folds too much; {folded}"
    last, images = last_frame.image() * last_frame.source.scale, result.image() * last_frame.source.scale
    moved_by = 100 * float(np.linalg.norm(images - last, axis=1).mean())
    return f"follows the last frame, {folded}, moved by {moved_by:.2f} % of sqrt(area) on average"


def _with_texture(request: WrapRequest, summary: str, warnings: list[str], stages: Stages) -> SummaryAndWarnings:
    """Also bake the source's texture into the target's layout, if requested."""
    if request.texture is None or request.baked is None:
        return summary, warnings
    options = field_values(request, "texture", "size", "target_mask", "source_mask", "mask_edge", "force")
    more, others = carry_one(TransferRequest(request.results[0], request.baked, **options), stages)
    return f"{summary}\n{more}", warnings + others


def _run(request: WrapRequest, stages: Stages) -> SummaryAndWarnings:
    config = WrapConfig(level=request.fit_level, fairness=request.fairness)
    stages("read result")
    results = [with_masks(read_result(folder), request, folder) for folder in request.results]
    if not results:
        raise ParameterError("expected a RESULT folder of `cagemap match`, or --target and --source")
    if len({mesh_hash(result.target.control) for result in results}) > 1:
        raise ParameterError("--blend-shapes: expected results of one target, got several; the cages would differ")
    require_no_input([request.output, *outputs_beside(request)], _meshes_read(request, results))
    details = [require_wrappable(request, result.target.control, result.source.control) for result in results]
    if request.blend_shapes:
        return _write_shapes(request, results, config, stages)
    result, folder = results[0], request.results[0]
    original = input_file(folder, result.manifest, "target")
    rows = None if request.mhclo is None or request.fit_level else rows_of(original, result.target.control)
    require_whole(rows)
    wrapped = _wrap(request, result, config, stages)
    stages("write")
    space = _source_to_target(folder, result)
    figures, cage, output = wrap_figures(wrapped), wrapped.mesh, request.output
    with all_or_nothing():
        written, warnings = _write(request, _in_target_space(wrapped, space), result, original, output)
        if request.mhclo is not None:
            triangles = wrapped.closest.triangle[: cage.n_vertices]
            write_follower(request.mhclo, cage.positions, triangles, result, rows, output, force=request.force)
        more, outside = bake_wrapped(request, result, wrapped, details[0], stages)
    stages.record(figures)
    note_transfer(folder, {"kind": "wrap", "output": output, "amount": request.amount, **figures})
    note_output("wrap", folder, request)
    among = f", {cage.n_vertices} of them wrapped" if written != cage.n_vertices else ""
    lines = [
        f"wrote {output}: {written} vertices{among} (level {wrapped.level})",
        distances_text(figures, request.amount),
    ]
    if request.mhclo is not None:
        lines.append(f"wrote {request.mhclo}: the mesh follows {result.source.control.name}")
    if more:
        if output.suffix.lower() == ".glb" and original is not None and is_usd(original):  # in metres with Y up
            space = space @ to_standard(original)
        if not np.allclose(space, np.eye(4)):
            length = np.cbrt(abs(np.linalg.det(space[:3, :3])))
            note = "images are in the source's units and axes; one of its units is"
            outside.append(f"{note} {length:.6g} of {output.name}")
    return "\n".join(lines + more), warnings + outside + fold_warnings(figures)


def _meshes_read(request: WrapRequest, results: list[MatchResult]) -> list[Path]:
    """Files that the results were made from."""
    both = zip(request.results, results, strict=True)
    return [file for folder, result in both for file in read_files(folder, result.manifest)]


def _wrap(request: WrapRequest, result: MatchResult, config: WrapConfig, stages: Stages) -> Wrapped:
    follow, control, target = None, result.target.control, result.target.refinement
    if request.weights is not None:
        rows = file_rows(request.results[0], result, "target")
        follow = read_follow(request.weights, control, rows, len(result.target.vertices))
    if result.masks.any:
        follow = result.masks.joint(result.point_map) * finest_follow(target, follow)
    stages(f"wrap {result.source.control.name}")
    symmetry = mirror_image(control) if request.symmetric else None
    with one_blas_thread():
        return wrap(target, result.point_map, config, follow=follow, symmetry=symmetry)


def _write(
    request: WrapRequest, wrapped: Wrapped, result: MatchResult, original: Path | None, output: Path
) -> tuple[int, list[str]]:
    """Write the target's file with the wrapped vertices; returns its number of vertices, and warnings."""
    rest, control, mesh = level_mesh(result.target.refinement, wrapped.level), result.target.control, wrapped.mesh
    is_blended = request.blend_shapes or request.amount < 1.0
    warnings = size_warnings(rest.positions, mesh.positions) if is_blended else []
    if request.amount < 1.0:
        mesh = mesh.with_positions((1 - request.amount) * rest.positions + request.amount * mesh.positions)
    if wrapped.level == 0 and original is not None and is_usd(output) and is_usd(original):
        check_outputs(mesh_files(output, mesh, original), [], force=request.force)
        points = UsdResults(points=mesh.positions)
        write_usd_results(output, request.results[0], result, points, force=request.force)
        return mesh.n_vertices, warnings + old_rig_warnings(original, output)
    rows = rows_of(original, control)
    if rows is not None and wrapped.level:
        left = rows.whole.n_faces - control.n_faces
        if left > 0:
            warnings.append(f"{control.name}: {left} faces that were not matched are not written. Give --fit-level 0")
    elif rows is not None:
        mesh = rows.whole.with_positions(rows.placed(mesh.positions))
        left = mesh.n_vertices - len(np.unique([*rows.vertices, *rows.copies[:, 1]]))
        if left:
            warnings.append(f"{control.name}: {left} vertices that were not matched stay where they are")
    if wrapped.level == 0 and original is not None and {output.suffix.lower(), original.suffix.lower()} == {".obj"}:
        write_obj_positions(output, original, mesh, force=request.force)
        return mesh.n_vertices, warnings
    check_outputs(mesh_files(output, mesh, original), [], force=request.force)
    write_mesh(output, mesh, like=original, force=request.force)
    if original is not None or not wrapped.level or output.suffix.lower() != ".obj":  # refined: no groups of the file
        warnings += left_out_warnings(original, control.name, output)
    if wrapped.level == 0 and original is not None and output.suffix.lower() == ".glb" and not is_usd(original):
        warnings += old_rig_warnings(original, output)
    return mesh.n_vertices, warnings


def _source_to_target(folder: Path, result: MatchResult) -> FloatArray:
    """(4, 4) transform from the source's space to the target's; see `between_spaces`."""
    return between_spaces(*(input_file(folder, result.manifest, side) for side in ("target", "source")))


def _in_target_space(wrapped: Wrapped, space: FloatArray) -> Wrapped:
    """The wrapped cage in the target's own units and axes."""
    return replace(wrapped, mesh=wrapped.mesh.with_positions(transform_points(wrapped.mesh.positions, space)))


def _write_shapes(
    request: WrapRequest, results: list[MatchResult], config: WrapConfig, stages: Stages
) -> SummaryAndWarnings:
    """Write a folder of OBJ files: the target at rest, and its cage in every source's shape."""
    sources = [Path(result.source.control.name) for result in results]
    files = shape_files(request, Path(results[0].target.control.name), sources)
    names = [source.stem for source in sources]
    lines, warnings, entries = [f"wrote {files[0]}: the target"], list[str](), list[dict[str, Any]]()
    with _new_folder(request.output), all_or_nothing():
        check_outputs(files, _meshes_read(request, results), force=request.force)
        for file, name, result, folder in zip(files[1:], names, results, request.results, strict=True):
            wrapped = _wrap(request, result, config, stages)
            original = input_file(folder, result.manifest, "target")
            if file == files[1]:
                rest = replace(wrapped, mesh=level_mesh(result.target.refinement, wrapped.level))
                _write(replace(request, amount=1.0), rest, result, original, files[0])
            placed = _in_target_space(wrapped, _source_to_target(folder, result))
            warnings += _write(request, placed, result, original, file)[1]
            figures = wrap_figures(wrapped)
            stages.record(figures, of=name)
            entries.append({"kind": "wrap", "output": file, "amount": request.amount, **figures})
            lines.append(f"wrote {file}\n{distances_text(figures, request.amount)}")
            warnings += [f"{name}: {message}" for message in fold_warnings(figures)]
    for folder, entry in zip(request.results, entries, strict=True):
        note_transfer(folder, entry)
        note_output("wrap", folder, request)
    return "\n".join(lines), list(dict.fromkeys(warnings))


@contextmanager
def _new_folder(folder: Path) -> Iterator[None]:
    """Make a folder if there is none; after an error it is removed again, if nothing is in it."""
    made = not folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        yield
    except BaseException:
        if made:
            with suppress(OSError):
                folder.rmdir()
        raise
