"""`cagemap report`: write an HTML page about a RESULT folder."""

from __future__ import annotations

import logging
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import CagemapError, FormatError, ParameterError
from cagemap.files.atomic import check_outputs, require_no_input
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.textures import read_material_image
from cagemap.files.images.image import UDIM_MARK, Image, Pixels, read_image, read_texture
from cagemap.files.inner_texture import material_document, repeated_texture
from cagemap.files.meshes.formats import MESH_SUFFIXES, read_mesh
from cagemap.files.meshes.ply import ply_image
from cagemap.files.result.folder import ARRAYS, read_result
from cagemap.files.result.manifest import MANIFEST, input_file
from cagemap.files.values.part_numbering import file_rows
from cagemap.files.values.rigs import read_shapes
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.pictures import UP_AXES, stated_turn, usual_turn
from cagemap.report import (
    BakedImage,
    CarriedData,
    CarriedItem,
    Weights,
    check_page_path,
    display_image,
    write_report,
)
from cagemap.tasks.job_file import note_output
from cagemap.tasks.material_atlas import MaterialAtlas, material_atlas
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.report import ReportRequest
from cagemap.tasks.rig import read_weights, weight_table
from cagemap.wrap import level_mesh

_log = logging.getLogger(__name__)


def run_report(request: ReportRequest, stages: Stages) -> SummaryAndWarnings:
    """Write the report of a RESULT folder; returns a summary and no warnings."""
    folder, output, texture, force = request.result, request.output, request.texture, request.force
    stages("read result")
    require_no_input([output], [folder / MANIFEST, folder / ARRAYS, *([] if texture is None else [texture])])
    check_page_path(output)
    check_outputs([output], [folder / MANIFEST, folder / ARRAYS], force=force)
    whole = read_result(folder)
    result = whole if request.level is None else whole.at_level(request.level)
    known = [entry for entry in result.manifest.get("transfers", []) if entry.get("kind") == "texture"]
    if texture is None:
        known = [entry for entry in known if (folder / entry["image"]).is_file()]
        texture = folder / known[-1]["image"] if known else None
    if texture is not None:
        texture = ply_image(texture)
        check_outputs([output], [texture], force=force)
    source = result.source.control
    document = None if texture is None else material_document(texture, source)
    atlas = material_atlas(document, source)
    if atlas is not None:
        result = replace(result, source=result.source.with_control(atlas.control))
    pixels = None if texture is None else _texture_pixels(texture, source, document, atlas, given=request.texture)
    baked, baked_entry = None, None
    for entry in known:
        shown = entry.get("level", whole.target.refinement.finest_level) == result.target.refinement.finest_level
        if shown and texture is not None and _is_shown(folder / entry["image"], texture, pixels):
            try:
                result, baked = _read_bake(folder, result, entry)
                baked_entry = entry if baked is not None else baked_entry
            except FormatError as error:
                _log.info("the texture is shown vertex by vertex, what was baked is not there any more: %s", error)
                continue
    carried = replace(carried_data(folder, result), images=_baked_images(folder, result, baked_entry))
    stages("draw")
    file = input_file(folder, result.manifest, "target")
    upright, reason = (
        stated_turn(file or Path(result.target.control.name), result.target.control.upright),
        "as its file says",
    )
    if request.up is not None:
        upright, reason = UP_AXES[request.up], "as asked"
    write_report(
        output,
        result,
        texture=pixels,
        baked=baked,
        carried=carried,
        upright=upright,
        reason=reason,
        usual=usual_turn(file),
        force=force,
    )
    note_output("report", folder, request)
    return f"Open {output} in a browser.", []


def _texture_pixels(
    texture: Path, source: ControlMesh, document: Document | None, atlas: MaterialAtlas | None, *, given: Path | None
) -> Pixels | None:
    """The pixels of an image, or of a model's; None for tiles, which are not shown.

    ``given``: the path of ``--texture``; None if the manifest names the texture.
    """
    if atlas is not None:
        return atlas.image.pixels
    if texture.suffix.lower() not in MESH_SUFFIXES:
        image = read_texture(texture)
        return image.pixels if isinstance(image, Image) else None
    found = repeated_texture(document, source)
    if document is None or found is None:
        option = "" if given is None else "--texture "
        raise ParameterError(
            f"{option}{texture}: expected a colour image on most of {source.name} for its UV set in use, found none. "
            "Give an image (--texture)."
        )
    return read_material_image(document, found).pixels


def carried_data(folder: Path, result: MatchResult) -> CarriedData:
    """Last wrapped cage, weights and shapes in the manifest whose files still exist."""
    last = {entry["kind"]: entry for entry in result.manifest.get("transfers", [])}
    carried = CarriedData()
    for kind, add in (("wrap", _with_wrapped_cage), ("weights", _with_weights), ("blend-shapes", _with_shapes)):
        if kind not in last:
            continue
        try:
            carried = add(carried, folder, last[kind], result)
        except CagemapError as error:
            _log.info("%s of %s are not shown: %s", kind, folder, error)
    return carried


def _baked_images(folder: Path, result: MatchResult, left_out: dict[str, Any] | None) -> tuple[BakedImage, ...]:
    """All baked images in the manifest whose files still exist, except one that the models are drawn with."""
    images = list[BakedImage]()
    for entry in result.manifest.get("transfers", []):
        if "tiles" not in entry or entry is left_out:
            continue
        try:
            images.append(_baked_image(folder, result, entry))
        except CagemapError as error:
            _log.info("%s is not shown: %s", entry["output"], error)
    return tuple(images)


def _baked_image(folder: Path, result: MatchResult, entry: dict[str, Any]) -> BakedImage:
    first, tiles = folder / entry["output"], entry["tiles"]
    before, _, after = first.name.rpartition(str(tiles[0])) if tiles != [0] else (first.name, "", "")
    file = first.name if tiles == [0] else f"{before}{UDIM_MARK}{after}"
    pixels = {tile: read_image(first.with_name(f"{before}{tile or ''}{after}")).pixels for tile in tiles}
    control = _with_bake_layout(folder, result, entry)
    if control.uvs is None:
        raise FormatError(f"{control.name} has no texture coordinates (any more)")
    kind = entry["kind"].removeprefix("bake-").replace("-", " ").replace("colors", "colours")
    is_displacement = kind.endswith("displacement")
    if is_displacement:
        low, high = (float(bound([bound(image) for image in pixels.values()])) for bound in (np.min, np.max))
        pixels = {tile: (image - low) / (high - low or 1.0) for tile, image in pixels.items()}
    is_data = is_displacement or kind.startswith("normal")
    shown = {tile: display_image(image, is_data=is_data) for tile, image in pixels.items()}
    title = "ambient occlusion" if kind == "ao" else " ".join(filter(None, [kind, entry.get("map")]))
    return BakedImage(f"{title}: {file}", shown, control)


def _with_wrapped_cage(carried: CarriedData, folder: Path, entry: dict[str, Any], result: MatchResult) -> CarriedData:
    cage = read_mesh(folder / entry["output"])
    level = int(entry.get("fit_level", 0))
    if level > result.target.refinement.finest_level:
        raise FormatError(f"{entry['output']}: is a wrapped net of level {level}, finer than the map that is shown")
    rows = file_rows(folder, result, "target")
    if rows is not None and level == 0 and cage.n_vertices == rows.whole.n_vertices:
        cage = result.target.control.with_positions(cage.positions[rows.vertices])
    if entry.get("amount", 1.0) != 1.0 or cage.n_vertices != result.target.refinement.levels[level].n_vertices:
        raise FormatError(f"{entry['output']}: is not the wrapped cage (any more)")
    return replace(carried, wrapped=level_mesh(result.target.refinement, level).with_positions(cage.positions))


def _with_weights(carried: CarriedData, folder: Path, entry: dict[str, Any], result: MatchResult) -> CarriedData:
    sides = []
    for name, file, side in (("source", entry.get("file"), result.source), ("target", entry["output"], result.target)):
        if file is None:
            raise FormatError("the file that they were carried from is not known")
        table = weight_table(read_weights(folder / file, side.control, file_rows(folder, result, name)))
        if len(table) != side.control.n_vertices:
            raise FormatError(f"{file}: expected {side.control.n_vertices} rows, got {len(table)}")
        sides.append(table)
    if sides[0].shape[1] != sides[1].shape[1]:
        raise FormatError(f"{entry['output']}: has other joints than {entry['file']}")
    return replace(carried, weights=Weights(*sides))


def _with_shapes(carried: CarriedData, folder: Path, entry: dict[str, Any], result: MatchResult) -> CarriedData:
    files = [folder / file for file in entry.get("files", [])]
    given, received = (
        read_shapes(paths, side.control, file_rows(folder, result, name), input_file(folder, result.manifest, name))
        for name, paths, side in (
            ("source", files, result.source),
            ("target", [folder / entry["output"]], result.target),
        )
    )
    both = [name for name in given if name in received]
    return replace(carried, shapes=tuple(CarriedItem(name, given[name], received[name]) for name in both))


def _is_shown(image: Path, texture: Path, pixels: Pixels | None) -> bool:
    """Whether a baked image is the texture; images of model files are compared by their pixels."""
    if os.path.realpath(image) == os.path.realpath(texture):
        return True
    if texture.suffix.lower() not in MESH_SUFFIXES or pixels is None or not image.is_file():
        return False
    try:
        return np.array_equal(read_image(image).pixels, pixels)
    except CagemapError:
        return False


def _read_bake(folder: Path, result: MatchResult, entry: dict[str, Any]) -> tuple[MatchResult, Pixels | None]:
    """The result with the layout of a bake, and the baked pixels; None for several tiles."""
    if len(entry.get("tiles", [0])) != 1:
        return result, None
    pixels = read_image(folder / entry["output"]).pixels
    if entry.get("mesh") is None:
        return result, pixels
    return replace(result, target=result.target.with_control(_with_bake_layout(folder, result, entry))), pixels


def _with_bake_layout(folder: Path, result: MatchResult, entry: dict[str, Any]) -> ControlMesh:
    """The target with the layout of a bake."""
    control = result.target.control
    if entry.get("mesh") is None:
        return control
    mesh = read_mesh(folder / entry["mesh"])
    return control.with_uvs(mesh.uvs, mesh.uv_indices)
