"""`cagemap transfer`: carry images, values, rigs, shapes or passengers of the source to the target."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from cagemap.character.passengers import carry_passenger, far_passenger, unit_factor
from cagemap.errors import ParameterError
from cagemap.files import VALUE_SUFFIXES
from cagemap.files.atomic import (
    all_or_nothing,
    check_outputs,
    require_no_input,
    require_replaceable,
    require_writable_folder,
)
from cagemap.files.gltf.document import SCENE_SUFFIXES
from cagemap.files.images.image import check_image_name
from cagemap.files.meshes.formats import check_mesh_path, mesh_files, read_mesh, write_mesh
from cagemap.files.meshes.mhclo import FOLLOWER_SUFFIXES
from cagemap.files.result.folder import read_result
from cagemap.files.result.manifest import input_file, note_transfer, read_files, stated_file
from cagemap.files.result.maps import SUFFIXES as MAP_SUFFIXES
from cagemap.files.text import require_file, require_suffix
from cagemap.files.usd.prims import BLEND_SHAPE, JOINT_WEIGHTS
from cagemap.files.usd.space import from_mesh_space, states_units, transform_mesh
from cagemap.files.usd.stages import USD_SUFFIXES, is_usd
from cagemap.files.usd.write import UsdResults, check_usd_path
from cagemap.files.values.attributes import read_attributes, write_attributes
from cagemap.files.values.part_numbering import Attributes, FileRows, file_rows, other_rows
from cagemap.files.values.rigs import check_shapes_path
from cagemap.maps.quality import unshared_warnings
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import place_of_rows
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.parts import extract_faces
from cagemap.mesh.topology import face_components
from cagemap.numerics.arrays import FloatArray
from cagemap.tasks.bake_tiles import bake_inputs
from cagemap.tasks.carry_arrays import carry_values
from cagemap.tasks.carry_images import (
    carry_detail,
    carry_displacement,
    carry_material_colors,
    carry_normal_map,
    carry_texture,
    carry_vector_displacement,
)
from cagemap.tasks.detail_bakes import require_green
from cagemap.tasks.job_file import note_output
from cagemap.tasks.masks import ASSUMED_AT_VERTICES, keep_base, to_file_values, with_masks
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.options import refuse_unread
from cagemap.tasks.requests.transfer import IMAGE_KINDS, READ_BY, TransferRequest, require_map_names
from cagemap.tasks.rig import transfer_shapes, transfer_skeleton, transfer_weights, write_point_map
from cagemap.tasks.usd_output import left_out_warnings, texture_reference, write_usd_results
from cagemap.transfer import carry_uvs, transfer_of

# Options that read weights and blend shapes of a scene.
_RIG_OPTIONS = "--weights and --blend-shapes"
Carrier = Callable[[TransferRequest, MatchResult, Stages], SummaryAndWarnings]
# Checks of the output's name, by the data that it will contain.
_NAME_CHECKS: dict[str, Callable[[Path], None]] = {
    **dict.fromkeys(("texture", "maps", *IMAGE_KINDS), check_image_name),
    **dict.fromkeys(("attribute", "weights"), partial(require_suffix, suffixes=VALUE_SUFFIXES)),
    **dict.fromkeys(("source_uvs", "passenger"), check_mesh_path),
    "joints": partial(require_suffix, suffixes=(".json",)),
    "blend_shapes": check_shapes_path,
    "write_map": partial(require_suffix, suffixes=(*MAP_SUFFIXES, *FOLLOWER_SUFFIXES)),
}


def run_transfer(request: TransferRequest, stages: Stages) -> SummaryAndWarnings:
    """Carry one kind of data to the target, write and record it; returns a summary and warnings."""
    outcome = carry_one(request, stages)
    note_output("transfer", request.result, request)
    return outcome


def carry_one(request: TransferRequest, stages: Stages) -> SummaryAndWarnings:
    """Carry one kind of data to the target and write it, without a note in the RESULT's job file."""
    carry = check_transfer(request)
    outputs = [path for path in (request.output, request.usd) if path is not None]
    require_no_input(outputs, bake_inputs(request))
    require_writable_folder(request.output)
    stages("read result")
    result = read_result(request.result)
    require_no_input(outputs, read_files(request.result, result.manifest))
    if request.usd is not None:
        texture_reference(request.output, request.usd)
        require_replaceable(request.usd, force=request.force)
    result = result if request.level is None else result.at_level(request.level)
    masked = with_masks(result, request, request.result)
    summary, warnings = carry(request, masked, stages)
    of_part = request.attribute is not None or request.weights is not None
    of_part = of_part and result.target.control.file_vertices is not None
    if request.bases and not (masked.masks.any or of_part or request.only is not None):
        warnings = [*warnings, "--base is not used, for no mask is given. Give --target-mask or --source-mask"]
    if result.shared is not None and request.target_mask is None:
        warnings = [*warnings, *unshared_warnings(result.shared_shares[0], 1.0)]
    return summary, warnings


def check_transfer(request: TransferRequest) -> Carrier:
    """Refuse options that contradict each other and names of outputs; returns the function that carries the data."""
    carry = _carrier(request)
    if request.usd is not None:
        check_usd_path(request.usd)
    check = next((check for kind, check in _NAME_CHECKS.items() if getattr(request, kind)), None)
    if check is not None:
        check(request.output)
    require_map_names(request.maps)
    named = [base for base in request.bases if base[0]]
    require_map_names(named if len(request.bases) - len(named) < 2 else request.bases, "--base")
    images = [name for name, _ in request.maps] or list(request.bake)
    unknown = [name for name, _ in named if name not in images]
    if unknown:
        expected = f"names of what is carried ({', '.join(images)})" if images else "one file without a name"
        raise ParameterError(f"--base: expected {expected}, got {', '.join(unknown)}. Name them alike.")
    for option, value in (("--scale", request.scale), ("--midlevel", request.midlevel)):
        if value is not None and not math.isfinite(value):
            raise ParameterError(f"{option}: expected a finite number, got {value}.")
    return carry


def _carrier(request: TransferRequest) -> Carrier:
    """Function that carries the requested kind of data; refuses none or several kinds."""
    carriers: dict[str, Carrier] = {
        "texture": carry_texture,
        "displacement": carry_displacement,
        "normal_map": carry_normal_map,
        "vector_displacement": carry_vector_displacement,
        "attribute": _carry_attribute,
        "material_colors": carry_material_colors,
        "bake": carry_detail,
        "source_uvs": _carry_uvs,
        "weights": transfer_weights,
        "joints": transfer_skeleton,
        "blend_shapes": transfer_shapes,
        "passenger": transfer_passenger,
        "write_map": write_point_map,
    }
    chosen = [name for name in carriers if getattr(request, name) or (name == "texture" and request.maps)]
    if "weights" in chosen and "joints" in chosen:  # the joints name the weights' columns
        chosen.remove("joints")
    if len(chosen) != 1:
        listed, got = ([f"--{name.replace('_', '-')}" for name in names] for names in (carriers, chosen))
        raise ParameterError(
            f"expected one of {', '.join(listed)}, got {' and '.join(got) or 'none'}. Run the command once for each "
            "kind of data."
        )
    require_green(request)
    refuse_unread(request, READ_BY, chosen)
    return carriers[chosen[0]]


def _carry_attribute(request: TransferRequest, result: MatchResult, stages: Stages) -> SummaryAndWarnings:
    """Carry values at control vertices, control faces, face corners or refined vertices."""
    assert request.attribute is not None
    require_replaceable(request.output, force=request.force)
    rows = file_rows(request.result, result, "source")
    source = result.source.control
    values, notes = _read_values(request.attribute, source, rows)
    stages("carry values")
    try:
        carried = carry_values(result, values)
    except ParameterError as error:
        raise ParameterError(
            f"{request.attribute}: {error}{other_rows(source, rows)}. Give the source's values: {request.result} "
            f"carries from {source.name} to {result.target.control.name}."
        ) from None
    assert isinstance(carried, dict)
    places = {name: place_of_rows(source, len(array)) for name, array in values.items()}
    given = source if rows is None else rows.whole
    ambiguous = source.n_vertices == source.n_faces or given.n_vertices == given.n_faces
    ambiguous &= request.attribute.suffix.lower() in (".npy", ".npz", ".csv")  # others say where values are
    assumed = [name for name, place in places.items() if place == "vertices" and ambiguous]
    notes += [f"{first_few(assumed)}: {ASSUMED_AT_VERTICES}"] if assumed else []
    target_rows = file_rows(request.result, result, "target")
    carried, base_notes = keep_base(request, result, carried, target_rows, places)
    whole = to_file_values(request, carried, target_rows, places)
    lines = []
    with all_or_nothing():
        write_attributes(request.output, whole, force=request.force)
        if request.usd is not None:
            results = UsdResults(attributes=carried, places=places)
            lines.append(write_usd_results(request.usd, request.result, result, results, force=request.force))
    note_transfer(request.result, {"kind": "attribute", "file": request.attribute, "output": request.output})
    stages.record({name: list(array.shape) for name, array in whole.items()}, of="arrays")
    shapes = ", ".join(f"{name} {array.shape}" for name, array in whole.items())
    return "\n".join([f"wrote {request.output}: {shapes}", *lines]), notes + base_notes


def _read_values(file: Path, control: ControlMesh, rows: FileRows | None) -> tuple[Attributes, list[str]]:
    """Arrays of a file, and a note; weights and blend shapes of a scene are left out: their transfer adapts them."""
    require_file(file, "a file of attributes")
    suffix = file.suffix.lower()
    remedy = f"Give its weights and shapes to {_RIG_OPTIONS}." if suffix in SCENE_SUFFIXES else "Export them as such."
    require_suffix(file, (*VALUE_SUFFIXES, *USD_SUFFIXES), "a file of values", remedy)
    values = read_attributes(file, control, rows)
    of_rig = [name for name in values if name == JOINT_WEIGHTS or name.startswith(BLEND_SHAPE)]
    of_rig = of_rig if is_usd(file) else []
    if len(values) == len(of_rig):
        got = f"{first_few(of_rig)}. Give the file to {_RIG_OPTIONS}" if of_rig else "none"
        raise ParameterError(f"{file}: expected primvars of vertices, faces or face corners, got {got}.")
    notes = [f"{file}: left out {first_few(of_rig)}: give the file to {_RIG_OPTIONS}"] if of_rig else []
    return {name: array for name, array in values.items() if name not in of_rig}, notes


def _carry_uvs(request: TransferRequest, result: MatchResult, stages: Stages) -> SummaryAndWarnings:
    """Write the target's mesh with the source's texture coordinates, so that the source's images fit it."""
    sides = result.target.refinement, result.source.refinement
    original, control = input_file(request.result, result.manifest, "target"), result.target.control
    like = None if original is not None and original.suffix.lower() == ".obj" else original  # its images do not fit
    check_outputs(mesh_files(request.output, control, like), [], force=request.force)
    stages("prepare")
    transfer = transfer_of(result)
    stages("texture coordinates")
    carried = carry_uvs(transfer, *sides)
    rows = file_rows(request.result, result, "target")
    layout = carried.uvs, carried.uv_indices
    laid_out = control.with_uvs(*layout) if rows is None else rows.laid_out(*layout)
    write_mesh(request.output, laid_out, like=like, force=request.force)
    note_transfer(request.result, {"kind": "uvs", "output": request.output})
    crossed = carried.crossed if rows is None else rows.faces[carried.crossed]
    stages.record({"uvs": len(carried.uvs), "crossed_faces": crossed.tolist()})
    count, others = len(crossed), laid_out.n_faces - control.n_faces
    warnings = left_out_warnings(original, control.name, request.output)
    if count:
        warnings.append(
            f"seams of the source cross {count} of {control.n_faces} faces, which get no fitting texture "
            f"coordinates (0-based): {first_few(crossed)}"
        )
    line = f"wrote {request.output}: {len(carried.uvs)} texture coordinates of the source"
    if rows is not None and others:
        kept = "have them all at (0, 0)" if rows.whole.uvs is None else "keep theirs"
        line += f"; {others} faces that were not matched {kept}"
    return line, warnings


def transfer_passenger(request: TransferRequest, result: MatchResult, stages: Stages) -> SummaryAndWarnings:
    """Carry clothes, eyes, hair or a prop; UVs and materials do not change."""
    assert request.passenger is not None
    mesh, notes = _without_matched(read_mesh(request.passenger), request, result)
    check_outputs(mesh_files(request.output, mesh, request.passenger), [request.passenger], force=request.force)
    stages("passenger")
    target = input_file(request.result, result.manifest, "target")
    of_target, of_source = _to_passenger(request, result)
    worn = transform_mesh(mesh, np.asarray(np.linalg.inv(of_source), dtype=np.float64))
    carried = carry_passenger(result, worn, kind=request.kind)
    placed, like = worn.with_positions(carried.positions), request.passenger
    if states_units(request.passenger) and states_units(request.output):  # in the passenger's own units and axes
        placed = transform_mesh(placed, of_target)
    else:
        placed = replace(placed, upright=result.target.control.upright)
        if states_units(request.output) and target is not None and is_usd(target):
            like = target
    write_mesh(request.output, placed, like=like, force=request.force)
    note_transfer(request.result, {"kind": "passenger", "file": request.passenger, "output": request.output})
    factor = unit_factor(result.point_map.source, worn.positions)
    figures = {"vertices": mesh.n_vertices, "distance": carried.distance, "unit_factor": factor}
    stages.record(figures)
    doubt = far_passenger(str(request.passenger), result.source.control.name, carried.distance, factor)
    warnings = [*notes, *left_out_warnings(request.passenger, mesh.name, request.output)]
    warnings += [f"{doubt}: check that both have the same units and place"] if doubt else []
    return f"wrote {request.output}: {mesh.n_vertices} vertices on {result.target.control.name}", warnings


def _without_matched(mesh: ControlMesh, request: TransferRequest, result: MatchResult) -> tuple[ControlMesh, list[str]]:
    """A passenger without pieces of the source's own file that were matched, if it has others; and notes."""
    file, stated = request.passenger, stated_file(request.result, result.manifest, "source")
    if file is None or stated is None or not stated.samefile(file):
        return mesh, []
    if input_file(request.result, result.manifest, "source") is None:
        return mesh, [f"{file} has changed since the match: what was matched of it is not left out"]
    pieces, matched = face_components(mesh), np.isin(mesh.file_numbers[1], result.source.control.file_numbers[1])
    others = np.flatnonzero(~np.isin(pieces, pieces[matched]))
    if not len(others):
        return mesh, []
    return extract_faces(mesh, others), [f"{mesh.n_faces - len(others)} faces of {file} were matched, and are left out"]


def _to_passenger(request: TransferRequest, result: MatchResult) -> tuple[FloatArray, FloatArray]:
    """(4, 4) from the spaces of target and source to the passenger's; a target without one has the source's."""
    assert request.passenger is not None
    found = np.eye(4)
    matrices = []
    for side, control in (("source", result.source.control), ("target", result.target.control)):
        stated = from_mesh_space(request.passenger, control, input_file(request.result, result.manifest, side))
        found = found if stated is None else stated
        matrices.append(found)
    return matrices[1], matrices[0]
