"""`cagemap transfer`: carry skinning weights, joints and blend shapes; write the map itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cagemap.character.bones import mirrored_joints
from cagemap.character.joints import Skeleton
from cagemap.character.passengers import MAX_BODY_DISTANCE
from cagemap.errors import ParameterError, values_of
from cagemap.files.atomic import all_or_nothing, check_outputs
from cagemap.files.meshes.formats import read_whole
from cagemap.files.meshes.mhclo import FOLLOWER_SUFFIXES
from cagemap.files.result.manifest import input_file, note_transfer, read_files
from cagemap.files.result.maps import write_map
from cagemap.files.usd.prims import BLEND_SHAPE, JOINT_WEIGHTS
from cagemap.files.usd.space import between_spaces
from cagemap.files.usd.write import UsdResults
from cagemap.files.values.attributes import read_attributes, write_attributes
from cagemap.files.values.part_numbering import Attributes, FileRows, file_rows, other_rows, to_file
from cagemap.files.values.rigs import (
    check_shapes,
    read_shapes,
    read_skeleton,
    scene_skeleton,
    write_shapes,
    write_skeleton,
)
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.mirrors import mirror_symmetries
from cagemap.numerics.arrays import FloatArray, box_diagonal
from cagemap.surface.triangle_surface import SurfacePoints
from cagemap.tasks.carry_arrays import carry_shapes, carry_weights, trusted_vertices
from cagemap.tasks.follower import write_follower
from cagemap.tasks.masks import keep_base, own_values, to_file_values
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.options import comma_words
from cagemap.tasks.requests.transfer import TransferRequest, base_of
from cagemap.tasks.usd_output import write_usd_results
from cagemap.transfer.skin import (
    carry_joints,
    normalise_rows,
    normalise_skin,
    prune_rows,
    symmetrize_skin,
    with_chosen_joints,
)

# Mean distance of a mesh from its base, in units of sqrt(area), above which there is a warning.
_APART = 0.05
# Largest ratio, either way, of the sizes of the body and of all joints without a warning. Joints of a hand or jaw are
# up to 35 times smaller than the body.
_MAX_SIZE_RATIO = 35.0


def transfer_weights(request: TransferRequest, result: MatchResult, stages: Stages) -> SummaryAndWarnings:
    """Carry skinning weights: a column or array for each joint, or one array of all joints."""
    assert request.weights is not None
    check_outputs([request.output], [request.weights], force=request.force)
    rows = file_rows(request.result, result, "source")
    arrays = read_weights(request.weights, result.source.control, rows)
    _require_rows(arrays, result.source.control, rows, request)
    with values_of(request.weights):
        skin, scaled = normalise_skin(weight_table(arrays))
    joints_file = request.weights if request.joints is None else request.joints
    skeleton = _read_joints(joints_file, request, result)
    if request.joints is not None and skeleton is not None:
        _require_joints(arrays, skeleton, request)
    stages("weights")
    with values_of(request.weights):
        carried = carry_weights(result, skin, influences=request.influences or None)
    target_rows = file_rows(request.result, result, "target")
    named = all(array.ndim == 1 for array in arrays.values())
    names = tuple(arrays) if named else () if skeleton is None else skeleton.names
    carried = with_choice(request, result.target.control, carried, names, target_rows)
    columns = _columns(carried, arrays)
    if skeleton is not None:
        columns = _by_joint(columns, skeleton)
    columns, notes = keep_base(request, result, columns, target_rows)
    columns = _limit_influences(request, result, columns)
    vertices, joints = carried.shape
    most = int((weight_table(columns) > 0).sum(axis=1).max())
    filled = int(np.count_nonzero(~trusted_vertices(result)))
    figures = {"vertices": vertices, "joints": joints, "influences": most, "untrusted_vertices": filled}
    stages.record(figures)
    text = f"wrote {request.output}: {vertices} vertices, {joints} joints, at most {most} a vertex"
    whole = to_file_values(request, columns, target_rows)
    if not named and request.output.suffix.lower() == ".npy":  # it holds one array
        whole = {JOINT_WEIGHTS: weight_table(whole)}
    with all_or_nothing():
        write_attributes(request.output, whole, force=request.force)
        if request.usd is not None:
            moved = _carry_in_column_order(skeleton, columns, result.point_map)
            skinning = UsdResults(attributes={JOINT_WEIGHTS: weight_table(columns)}, skeleton=moved)
            text += "\n" + write_usd_results(request.usd, request.result, result, skinning, force=request.force)
    note_transfer(request.result, {"kind": "weights", "file": request.weights, "output": request.output})
    if skeleton is not None and request.usd is not None:
        notes = [*_far_joints(joints_file, skeleton, request, result), *notes]
    if filled:
        text += f"\n  {filled} vertices where the map is not to be trusted take theirs from around them"
    return text, [f"{request.weights}: {scaled}", *notes] if scaled else notes


def _read_joints(file: Path, request: TransferRequest, result: MatchResult) -> Skeleton | None:
    """Joints in the units and axes of the source's file; None if a file of weights has none."""
    read = scene_skeleton if request.joints is None else read_skeleton
    skeleton = read(file, result.source.control)
    source = input_file(request.result, result.manifest, "source")
    return None if skeleton is None else skeleton.transformed(between_spaces(source, file))


def _far_joints(file: Path, skeleton: Skeleton, request: TransferRequest, result: MatchResult) -> list[str]:
    """A warning on joints whose size or place is not that of the source."""
    body = result.point_map.source
    ends = body.scale * np.concatenate([skeleton.heads, skeleton.tails])
    distance = float(np.linalg.norm(SurfacePoints.nearest(body, ends).positions - ends, axis=1).mean())
    ratio = box_diagonal(ends) / box_diagonal(body.positions)
    is_likely = ratio == 0.0 or 1.0 / _MAX_SIZE_RATIO <= ratio <= _MAX_SIZE_RATIO  # one joint may have no length
    if is_likely and (distance <= MAX_BODY_DISTANCE or _is_part(request, result)):
        return []
    return [
        f"{file}: the joints are {ratio:.2g} times as large as {result.source.control.name} and "
        f"{distance:.1f} body sizes away from it on average: check that both have the same units and place"
    ]


def _is_part(request: TransferRequest, result: MatchResult) -> bool:
    """Whether faces of the source's file are left out; also if the file is gone."""
    faces, file = result.source.control.file_faces, input_file(request.result, result.manifest, "source")
    return faces is not None and (file is None or len(np.unique(faces)) < read_whole(file).n_faces)


def read_weights(path: Path, control: ControlMesh, rows: FileRows | None) -> Attributes:
    """Arrays of a file with skinning weights, without other primvars of a USD or glTF file."""
    arrays = read_attributes(path, control, rows)
    return {JOINT_WEIGHTS: arrays[JOINT_WEIGHTS]} if JOINT_WEIGHTS in arrays else arrays


def _limit_influences(request: TransferRequest, result: MatchResult, columns: Attributes) -> Attributes:
    """Weights with at most ``--influences`` joints at vertices where masks blended them with those of ``--base``."""
    if not result.masks.any:
        return columns
    blended = result.masks.joint(result.point_map)[: result.target.control.n_vertices, None] > 0.0
    table = weight_table(columns)
    return _columns(np.where(blended, _prune_influences(request, table), table), columns)


def _prune_influences(request: TransferRequest, table: FloatArray) -> FloatArray:
    """Weights with at most ``--influences`` joints at every vertex, of the same sums."""
    return normalise_rows(prune_rows(table, request.influences or None), table.sum(axis=1))


def weight_table(arrays: Attributes) -> FloatArray:
    """(n, j) weights of all joints from columns or tables."""
    return np.column_stack([np.asarray(array, dtype=np.float64).reshape(len(array), -1) for array in arrays.values()])


def _columns(table: FloatArray, like: Attributes) -> Attributes:
    """The weights of a table as arrays with the names and widths of others."""
    parts = np.split(table, np.cumsum([array.size // len(array) for array in like.values()])[:-1], axis=1)
    shapes = [(name, array.shape[1:]) for name, array in like.items()]
    return {name: part.reshape(-1, *shape) for (name, shape), part in zip(shapes, parts, strict=True)}


def _require_rows(given: Attributes, control: ControlMesh, rows: FileRows | None, request: TransferRequest) -> None:
    wrong = {name: len(array) for name, array in given.items() if len(array) != control.n_vertices}
    if wrong:
        raise ParameterError(
            f"{request.weights}: expected weights, one a vertex of {control.name} ({control.n_vertices}), got "
            f"{wrong}{other_rows(control, rows)}. Export them from the mesh that was matched."
        )


def _require_joints(given: Attributes, skeleton: Skeleton, request: TransferRequest) -> None:
    named = all(array.ndim == 1 for array in given.values())
    missing = [name for name in given if named and name not in skeleton.names]
    if missing:
        raise ParameterError(
            f"{request.weights}: weights of {', '.join(missing)}, which {request.joints} has no joint for"
        )
    count = sum(array.size // len(array) for array in given.values())
    if not named and count != len(skeleton.names):
        raise ParameterError(
            f"{request.weights}: expected weights of {len(skeleton.names)} joints, as {request.joints} has, got {count}"
        )


def _by_joint(columns: Attributes, skeleton: Skeleton) -> Attributes:
    """A table of all joints as one named column per joint; columns with names keep them."""
    named = all(array.ndim == 1 for array in columns.values()) or len(set(skeleton.names)) < len(skeleton.names)
    return columns if named else dict(zip(skeleton.names, weight_table(columns).T, strict=True))


def _carry_in_column_order(skeleton: Skeleton | None, columns: Attributes, point_map: PointMap) -> Skeleton | None:
    """The skeleton carried to the target, its joints in the order of the weights' columns."""
    if skeleton is None:
        return None
    moved = _carry_skeleton(skeleton, point_map)
    if any(array.ndim > 1 for array in columns.values()):  # a table of all joints, in their order
        return moved
    order = [moved.names.index(name) for name in columns]
    order += [joint for joint in range(len(moved.names)) if joint not in order]
    axes = None if moved.axes is None else moved.axes[order]
    names, parents = (tuple(of[joint] for joint in order) for of in (moved.names, moved.parents))
    return Skeleton(names, parents, moved.heads[order], moved.tails[order], axes)


def _carry_skeleton(skeleton: Skeleton, point_map: PointMap) -> Skeleton:
    """The source's skeleton carried to the target."""
    count = len(skeleton.names)
    ends, turns = carry_joints(point_map, np.concatenate([skeleton.heads, skeleton.tails]))
    axes = None if skeleton.axes is None else skeleton.axes @ turns[:count]
    return replace(skeleton, heads=ends[:count], tails=ends[count:], axes=axes)


def transfer_skeleton(request: TransferRequest, result: MatchResult, stages: Stages) -> SummaryAndWarnings:
    """Carry heads and tails of joints."""
    assert request.joints is not None
    check_outputs([request.output], [request.joints], force=request.force)
    skeleton = _read_joints(request.joints, request, result)
    assert skeleton is not None
    stages("joints")
    count = len(skeleton.names)
    write_skeleton(request.output, _carry_skeleton(skeleton, result.point_map), force=request.force)
    note_transfer(request.result, {"kind": "joints", "output": request.output})
    return f"wrote {request.output}: {count} joints", _far_joints(request.joints, skeleton, request, result)


def transfer_shapes(request: TransferRequest, result: MatchResult, stages: Stages) -> SummaryAndWarnings:
    """Carry blend shapes of the source's cage to the target's."""
    rows, target_rows = (
        file_rows(request.result, result, name) for name, side in (("source", result.source), ("target", result.target))
    )
    source_file = input_file(request.result, result.manifest, "source")
    shapes = read_shapes(request.blend_shapes, result.source.control, rows, source_file)
    rest = result.target.control if target_rows is None else target_rows.whole
    inputs = [*request.blend_shapes, *read_files(request.result, result.manifest)]
    check_shapes(request.output, shapes, rest, inputs, force=request.force)
    stages("shapes")
    carried = carry_shapes(result, shapes)
    assert isinstance(carried, dict)
    with all_or_nothing():
        files = write_shapes(request.output, to_file(carried, target_rows), rest, inputs, force=request.force)
        text = f"wrote {len(carried)} shapes to {request.output} ({len(files)} files)"
        if request.usd is not None:
            shaped = UsdResults(attributes={f"{BLEND_SHAPE}{name}": offsets for name, offsets in carried.items()})
            text += "\n" + write_usd_results(request.usd, request.result, result, shaped, force=request.force)
    note_transfer(request.result, {"kind": "blend-shapes", "files": request.blend_shapes, "output": request.output})
    return text, []


def write_point_map(request: TransferRequest, result: MatchResult, stages: Stages) -> SummaryAndWarnings:
    """Write the map itself, for other programs."""
    check_outputs([request.output], [], force=request.force)
    stages("write map")
    point_map = result.point_map
    if request.output.suffix.lower() not in FOLLOWER_SUFFIXES:
        write_map(request.output, point_map, force=request.force)
        return f"wrote {request.output}: the place of {len(result.triangle)} target vertices on the source", []
    control, source = result.target.control, result.source
    rows, triangles = file_rows(request.result, result, "target"), result.triangle[: control.n_vertices]
    if rows is None and control.file_vertices is not None:
        raise ParameterError(
            f"{control.name}: expected the file that was matched, which has other numbers than the RESULT. Put it back "
            "where the match read it."
        )
    obj = Path(control.name).with_suffix(".obj")
    offsets = write_follower(request.output, control.positions, triangles, result, rows, obj, force=request.force)
    apart = float(np.linalg.norm(offsets, axis=1).mean()) * point_map.source.scale
    warnings = []
    if apart > _APART:
        warnings.append(
            f"{control.name} lies {100 * apart:.1f} % of sqrt(area) from {source.control.name} on average, and follows "
            "it at that distance; `cagemap wrap --mhclo` puts it onto it first"
        )
    return f"wrote {request.output}: {control.name} follows {source.control.name}", warnings


def with_choice(
    request: TransferRequest, control: ControlMesh, carried: FloatArray, names: Sequence[str], rows: FileRows | None
) -> FloatArray:
    """Carried weights (n, j), symmetric if requested; joints not chosen keep the target's own weights.

    ``carried``: (n, j).
    ``names``: of the joints; empty if the weights have no names.
    """
    for option, requested in (("--mirror", request.mirror), ("--only", request.only is not None)):
        if requested and not names:
            raise ParameterError(f"{option}: expected weights of named joints. Give a column for each, or --joints.")
    if request.mirror:
        carried = _prune_influences(request, _symmetrize(control, carried, names))
    return carried if request.only is None else _with_chosen_joints(request, control, carried, names, rows)


def _symmetrize(control: ControlMesh, carried: FloatArray, names: Sequence[str]) -> FloatArray:
    """Means of the weights and their mirror image, for the mirror plane that changes them least."""
    joints = mirrored_joints(names)
    if np.array_equal(joints, np.arange(len(names))):
        raise ParameterError(
            "--mirror: expected joints of both sides, such as arm.L and arm.R, got none by their names. "
            "Rename them, or leave it out."
        )
    mirrored = [symmetrize_skin(carried, mirror.image, joints) for mirror in mirror_symmetries(control)]
    if not mirrored:
        raise ParameterError(f"--mirror: expected a target with a mirror plane, {control.name} has none. Leave it out.")
    return min(mirrored, key=lambda skin: float(np.abs(skin - carried).sum()))


def _with_chosen_joints(
    request: TransferRequest, control: ControlMesh, carried: FloatArray, names: Sequence[str], rows: FileRows | None
) -> FloatArray:
    words = comma_words(str(request.only))
    missing = [word for word in words if word not in names]
    if missing or not words:
        raise ParameterError(
            f"--only: expected names of joints ({', '.join(names)}), got {', '.join(missing) or 'none'}"
        )
    base = base_of(request)
    if base is None:
        raise ParameterError("--only: expected the target's own weights of the other joints. Give them as --base.")
    columns = np.array([names.index(word) for word in words])
    own = own_values(base, control, rows, names, of_weights=True)
    if any(own[name].shape != (control.n_vertices,) for name in names):
        raise ParameterError(f"--base {base}: expected weights of {', '.join(names)} for each vertex of {control.name}")
    kept = np.column_stack([own[name] for name in names]).astype(np.float64)
    chosen = with_chosen_joints(carried, kept, columns)
    return np.where(np.any(carried[:, columns], axis=1, keepdims=True), _prune_influences(request, chosen), chosen)
