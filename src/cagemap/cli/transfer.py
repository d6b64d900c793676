"""`cagemap transfer`: something of the source, carried to the target."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from cagemap.cli.job_file import note_output
from cagemap.cli.progress import Stages
from cagemap.cli.rig import carry_blend_shapes, carry_skeleton, carry_weights, write_point_map
from cagemap.cli.texture_maps import map_path
from cagemap.cli.usd_output import texture_reference, write_usd_results
from cagemap.cli.vectors import carry_normal_map, carry_vector_displacement
from cagemap.errors import ParameterError
from cagemap.files.atomic import check_outputs, require_no_input, require_replaceable, require_writable_folder
from cagemap.files.attributes import check_attribute_path, read_attributes, write_attributes
from cagemap.files.images import (
    UDIM_MARK,
    Image,
    check_writable,
    pixel_type,
    read_image_form,
    read_texture,
    texture_files,
    texture_pixels,
    tile_pattern,
    udim_path,
    write_image,
)
from cagemap.files.meshes import write_mesh
from cagemap.files.obj_layout import write_obj_layout
from cagemap.files.result import ARRAYS, MANIFEST, Result, input_file, note_transfer, read_result, stated_path
from cagemap.files.usd_write import UsdResults
from cagemap.mesh import ControlMesh
from cagemap.numerics.threads import ThreadPool
from cagemap.transfer import (
    BakeOptions,
    Transfer,
    bake_displacement,
    bake_face_colors,
    bake_texture,
    carry_uvs,
    combine,
    control_weights,
    corner_nodes,
    corner_weights,
    face_colors,
    pull_back_faces,
    target_tiles,
    tile_cells,
    transfer_of,
    unwrap,
)
from cagemap.transfer.normal_maps import looks_like_normal_map
from cagemap.transfer.vectors import Green, bake_normal_map

DEFAULT_SIZE = 2048
Outcome = tuple[str, list[str]]


@dataclass(frozen=True)
class TransferRequest:
    """What the user asked for, as said on the command line."""

    result: Path
    output: Path
    texture: Path | None = None
    maps: tuple[tuple[str, Path], ...] = ()
    usd: Path | None = None
    displacement: Path | None = None
    normal_map: Path | None = None
    vector_displacement: Path | None = None
    space: str = "tangent"
    green: str = "up"
    as_color: bool = False
    attribute: Path | None = None
    material_colors: bool = False
    source_uvs: bool = False
    weights: Path | None = None
    influences: int = 4
    joints: Path | None = None
    blend_shapes: tuple[Path, ...] = ()
    write_map: bool = False
    size: int | None = None
    bits: int | None = None
    unwrap: bool = False
    midlevel: float | None = None
    scale: float = 1.0
    force: bool = False


def run_transfer(request: TransferRequest, stages: Stages) -> Outcome:
    """Carry one thing from source to target and write it; returns a summary and warnings."""
    carry = _carrier(request)
    for option, value in (("--scale", request.scale), ("--midlevel", request.midlevel)):
        if value is not None and not math.isfinite(value):
            raise ParameterError(f"{option}: expected a finite number, got {value}.")
    require_no_input([request.output], _inputs(request))
    require_writable_folder(request.output)
    stages("read result")
    outcome = carry(request, read_result(request.result), stages)
    note_output("transfer", request)
    return outcome


def _inputs(request: TransferRequest) -> list[Path]:
    """Files that are read, as far as the command line names them."""
    single = (request.texture, request.displacement, request.normal_map, request.vector_displacement)
    others = (request.attribute, request.weights, request.joints, *(path for _, path in request.maps))
    given = [path for path in (*single, *others) if path is not None]
    return [
        request.result / MANIFEST,
        request.result / ARRAYS,
        *(file for path in given for file in texture_files(path)),
    ]


def _carrier(request: TransferRequest) -> Callable[[TransferRequest, Result, Stages], Outcome]:
    """Choose the one thing to carry."""
    options = {
        "--texture": (request.texture is not None or bool(request.maps), _carry_texture),
        "--displacement": (request.displacement is not None, _carry_displacement),
        "--normal-map": (request.normal_map is not None, carry_normal_map),
        "--vector-displacement": (request.vector_displacement is not None, carry_vector_displacement),
        "--attribute": (request.attribute is not None, _carry_attribute),
        "--material-colors": (request.material_colors, _carry_material_colors),
        "--source-uvs": (request.source_uvs, _carry_uvs),
        "--weights": (request.weights is not None, carry_weights),
        "--joints": (request.joints is not None and request.weights is None, carry_skeleton),
        "--blend-shapes": (bool(request.blend_shapes), carry_blend_shapes),
        "--write-map": (request.write_map, write_point_map),
    }
    chosen = [option for option, (given, _) in options.items() if given]
    if len(chosen) != 1:
        raise ParameterError(
            f"expected one of {', '.join(options)}, got {' and '.join(chosen) or 'none'}. Run once for each."
        )
    return options[chosen[0]][1]


@dataclass(frozen=True)
class _Bake:
    """A prepared bake: tiles of the target's layout, and what is to be said about it."""

    transfer: Transfer
    control: ControlMesh
    tiles: list[int]
    mesh: Path | None
    warnings: list[str]


def _carry_texture(request: TransferRequest, result: Result, stages: Stages) -> Outcome:
    """One image, or all maps of a material; the map is followed once for all of them."""
    maps = request.maps if request.texture is None else (("", request.texture),)
    outputs = [map_path(request.output, name) for name, _ in maps]
    for output, (_, path) in zip(outputs, maps, strict=True):
        dtype, channels = read_image_form(path)
        check_writable(output, dtype if request.bits is None else pixel_type(request.bits, output.suffix), channels)
    prepared = prepare_bake(request, result, stages, outputs)
    for (name, path), output in zip(maps, outputs, strict=True):
        size = _bake_map(request, prepared, name, path, output, stages)
        entry = {"kind": "texture", "image": stated_path(path, request.result), "size": size}
        summary, warnings = finish(replace(request, output=output), prepared, entry | ({"map": name} if name else {}))
    if request.usd is not None:
        layer = request.usd
        images_by_use = {
            name or "texture": texture_reference(output if prepared.tiles == [0] else tile_pattern(output), layer)
            for (name, _), output in zip(maps, outputs, strict=True)
        }
        control = prepared.control
        uvs = None
        if request.unwrap and control.uvs is not None and control.uv_indices is not None:
            uvs = ("cagemap_st", control.uvs, control.uv_indices)
        results = UsdResults(textures=images_by_use, uvs=uvs)
        summary += "\n" + write_usd_results(layer, request.result, result, results, force=request.force)
    if len(maps) > 1:
        summary = f"wrote {len(maps)} maps: {', '.join(map(str, outputs))}" + summary.partition("\n")[2]
    return summary, warnings


def _bake_map(request: TransferRequest, prepared: _Bake, name: str, path: Path, output: Path, stages: Stages) -> int:
    """Bake one map into all tiles; each is written while the next one is baked. Returns the size in texels."""
    texture, first, dtype = _read_image(request, path)
    size = request.size or max(first.size)
    turned = not request.as_color and looks_like_normal_map(first.pixels)
    if turned and not name:
        raise ParameterError(
            f"{path}: looks like a normal map, whose directions must turn with the map. Give it as --normal-map, or "
            "add --as-color if it is a picture after all."
        )
    if turned:
        prepared.warnings.append(f"{path} looks like a normal map and is turned with the map, not carried as colours")
    with ThreadPool(1) as aside:
        written: list[Future[None]] = []
        for number, tile in enumerate(prepared.tiles):
            place = f"tile {tile}, {number + 1} of {len(prepared.tiles)}" if tile else ""
            stages(" ".join(filter(None, ["bake", name, place])))
            options = BakeOptions(tile=tile)
            carry = partial(bake_normal_map, green=cast(Green, request.green)) if turned else bake_texture
            pixels = carry(prepared.transfer, texture_pixels(texture), size=size, dtype=dtype, options=options)
            for waiting in written:
                waiting.result()  # at most one image is on its way to the disk
            image = replace(first, pixels=pixels)
            written = [aside.submit(write_image, udim_path(output, tile), image, force=request.force)]
        for waiting in written:
            waiting.result()
    return size


def _carry_displacement(request: TransferRequest, result: Result, stages: Stages) -> Outcome:
    assert request.displacement is not None
    texture, first, dtype = _read_image(request, request.displacement)
    check_writable(request.output, dtype, 1)
    size = request.size or max(first.size)
    prepared = prepare_bake(request, result, stages)
    stages("bake")
    for tile in prepared.tiles:
        baked = bake_displacement(
            prepared.transfer,
            texture_pixels(texture),
            size=size,
            midlevel=request.midlevel,
            scale=request.scale,
            dtype=dtype,
            options=BakeOptions(tile=tile),
        )
        write_image(udim_path(request.output, tile), baked.pixels, force=request.force)
    entry = {
        "kind": "displacement",
        "image": stated_path(request.displacement, request.result),
        "size": size,
        "midlevel": baked.midlevel,
        "scale": baked.scale,
    }
    summary, warnings = finish(request, prepared, entry)
    return f"{summary}\n  height = (value - {baked.midlevel:g}) * {baked.scale:.6g} in the target's units", warnings


def _carry_material_colors(request: TransferRequest, result: Result, stages: Stages) -> Outcome:
    floats = request.output.suffix.lower() == ".exr"
    dtype = pixel_type(request.bits or (32 if floats else 8), request.output.suffix)
    check_writable(request.output, dtype, 3)
    colors = face_colors(result.source.control)
    size = request.size or DEFAULT_SIZE
    prepared = prepare_bake(request, result, stages)
    stages("bake")
    for tile in prepared.tiles:
        pixels = bake_face_colors(prepared.transfer, colors, size=size, dtype=dtype, options=BakeOptions(tile=tile))
        write_image(udim_path(request.output, tile), pixels, force=request.force)
    return finish(request, prepared, {"kind": "material-colors", "size": size})


def _carry_attribute(request: TransferRequest, result: Result, stages: Stages) -> Outcome:
    """Values at control vertices, control faces, face corners or refined vertices; each arrives at its own kind."""
    assert request.attribute is not None
    check_attribute_path(request.output)
    require_replaceable(request.output, force=request.force)
    if request.usd is not None:
        require_replaceable(request.usd, force=request.force)
    values = read_attributes(request.attribute)
    sides = result.target.refinement, result.source.refinement
    target, source = (side.control for side in sides)
    transfer = _prepare(result, stages)
    stages("pull back")
    at_vertices = control_weights(transfer, *sides)
    carried, warnings = {}, []
    for name, array in values.items():
        if len(array) == source.n_vertices:
            carried[name] = combine(at_vertices, array)
            if source.n_faces == source.n_vertices:
                warnings.append(f"{name}: as many rows as control vertices and as control faces; taken for vertices")
        elif len(array) == source.n_faces:
            carried[name] = pull_back_faces(transfer, array, n_target_faces=target.n_faces)
        elif len(array) == len(source.face_indices):
            nodes, node_values = corner_nodes(source, array)
            carried[name] = combine(corner_weights(transfer, *sides, nodes, len(node_values)).weights, node_values)
        elif len(array) == len(result.source.vertices):
            carried[name] = combine(transfer.point_map.matrix(), array)
        else:
            raise ParameterError(
                f"{request.attribute}: {name} has {len(array)} rows; expected one for each of the source's "
                f"{source.n_vertices} control vertices, {source.n_faces} control faces, {len(source.face_indices)} "
                f"face corners, or {len(result.source.vertices)} vertices of level {result.source.level}."
            )
    write_attributes(request.output, carried, force=request.force)
    lines = []
    if request.usd is not None:
        results = UsdResults(attributes=carried)
        lines.append(write_usd_results(request.usd, request.result, result, results, force=request.force))
    files = {"file": request.attribute, "output": request.output}
    entry = {"kind": "attribute"} | {name: stated_path(path, request.result) for name, path in files.items()}
    note_transfer(request.result, entry)
    shapes = ", ".join(f"{name} {array.shape}" for name, array in carried.items())
    return "\n".join([f"wrote {request.output}: {shapes}", *lines]), warnings


def _carry_uvs(request: TransferRequest, result: Result, stages: Stages) -> Outcome:
    """The target's mesh with the source's texture coordinates, so that the source's own image fits it."""
    sides = result.target.refinement, result.source.refinement
    transfer = _prepare(result, stages)
    stages("texture coordinates")
    carried = carry_uvs(transfer, *sides)
    write_mesh(request.output, result.target.control.with_uvs(carried.uvs, carried.uv_indices))
    note_transfer(request.result, {"kind": "uvs", "output": request.output.resolve()})
    count = len(carried.crossed)
    warnings = []
    if count:
        warnings.append(
            f"seams of the source cross {count} of {result.target.control.n_faces} faces (numbers from 0), where no "
            f"texture coordinates fit: {', '.join(map(str, carried.crossed))}"
        )
    return f"wrote {request.output}: {len(carried.uvs)} texture coordinates of the source", warnings


def _read_image(request: TransferRequest, path: Path) -> tuple[Image | dict[int, Image], Image, np.dtype[Any]]:
    """Read a source image or its tiles; also the first of them, and the number type to write."""
    texture = read_texture(path)
    first = texture if isinstance(texture, Image) else next(iter(texture.values()))
    dtype = first.pixels.dtype if request.bits is None else pixel_type(request.bits, request.output.suffix)
    return texture, first, dtype


def read_source_image(
    request: TransferRequest, path: Path, channels: int
) -> tuple[Image | dict[int, Image], Image, np.dtype[Any]]:
    """Read a source image, and refuse an output that cannot hold what will be written."""
    texture, first, dtype = _read_image(request, path)
    check_writable(request.output, dtype, channels)
    return texture, first, dtype


def _prepare(result: Result, stages: Stages) -> Transfer:
    stages("prepare")
    return transfer_of(result)


def prepare_bake(
    request: TransferRequest, result: Result, stages: Stages, outputs: Sequence[Path] | None = None
) -> _Bake:
    """Lay the target out, with a new layout if asked for, and find its tiles."""
    mesh: Path | None = None
    warnings: list[str] = []
    if request.unwrap:
        stages("unwrap")
        control = unwrap(result.target.control)
        mesh = unwrapped_name(request.output)
        result = replace(result, target=replace(result.target, control=control))
    elif result.target.control.uvs is None:
        raise ParameterError(
            f"{result.target.control.name}: expected texture coordinates to bake into, the mesh has none. Add --unwrap "
            "to lay it out and write the mesh beside the image, or unwrap it in your modelling program and match again."
        )
    transfer = _prepare(result, stages)
    cells = tile_cells(transfer.target.corner_uvs())
    tiles = [0]
    if cells.min() >= 0:
        tiles = target_tiles(result.target.refinement.finest)
    else:
        outside = float(np.mean((cells != 0).any(axis=1)))
        warnings.append(
            f"{100 * outside:.1f} % of the target's layout lies outside the unit square and is not baked: move it"
        )
    images = [udim_path(output, tile) for output in outputs or [request.output] for tile in tiles]
    others = [path for path in (mesh, request.usd) if path is not None]
    check_outputs([*images, *others], _inputs(request), force=request.force)
    if mesh is not None:
        warnings += _write_unwrapped(request, result.target.control, result.manifest)
    return _Bake(transfer, result.target.control, tiles, mesh, warnings)


def finish(request: TransferRequest, prepared: _Bake, entry: dict[str, Any]) -> Outcome:
    """Note a bake in the manifest, and say what was written."""
    outputs = [udim_path(request.output, tile) for tile in prepared.tiles]
    mesh = None if prepared.mesh is None else stated_path(prepared.mesh, request.result)
    stated = stated_path(outputs[0], request.result)
    note_transfer(request.result, {**entry, "output": stated, "tiles": prepared.tiles, "mesh": mesh})
    written = [*outputs, *([prepared.mesh] if prepared.mesh else [])]
    return f"wrote {', '.join(map(str, written))}; {entry['size']} x {entry['size']} texels", prepared.warnings


def unwrapped_name(image: Path) -> Path:
    """The name of a mesh that gets a layout for an image: its own, since the image's may be that of the user's mesh."""
    return image.with_name(f"{image.stem.replace(UDIM_MARK, '').rstrip('._')}_unwrapped.obj")


def _write_unwrapped(request: TransferRequest, control: ControlMesh, manifest: dict[str, Any]) -> list[str]:
    """Write the target with its new layout: its file with other UVs where that is there; returns warnings."""
    mesh = unwrapped_name(request.output)
    original = input_file(request.result, manifest, "target")
    if original is not None and original.suffix.lower() == ".obj":
        write_obj_layout(mesh, original, control, force=request.force)
        return []
    write_mesh(mesh, control, force=request.force)
    why = "was not found, or has changed since the match" if original is None else "is no OBJ"
    return [f"{control.name} {why}: {mesh} holds faces, UVs and materials, but no groups, names or normals of it"]
