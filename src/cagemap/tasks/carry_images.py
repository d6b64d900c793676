"""`cagemap transfer`: images and colours of the source, baked into the target's layout."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from cagemap.errors import ParameterError
from cagemap.files.gltf.document import SCENE_SUFFIXES
from cagemap.files.gltf.material_images import extract_texture
from cagemap.files.images.image import Image, check_writable, pixel_type, read_image_form, tile_pattern
from cagemap.files.result.folder import stated_path
from cagemap.files.usd.material import unbound_maps
from cagemap.files.usd.write import UsdResults
from cagemap.maps.result import MatchResult
from cagemap.tasks.bake_tiles import (
    DEFAULT_SIZE,
    Baked,
    Prepared,
    SourceImage,
    bake_tiles,
    base_size,
    finish,
    prepare_bake,
    read_source_image,
    written_channels,
)
from cagemap.tasks.progress import Outcome, Stages
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.texture_maps import map_path
from cagemap.tasks.usd_output import texture_reference, write_usd_results
from cagemap.transfer import BakeOptions, bake_displacement, bake_face_colors, bake_texture, face_colors
from cagemap.transfer.displacement import Displacement
from cagemap.transfer.normal_maps import looks_like_normal_map, share_of_normals
from cagemap.transfer.vectors import Green, Space, bake_normal_map, bake_vector_displacement

# Share of an image's colours that are directions, below which it is hardly a normal map. JPEG leaves most of them so.
FEWEST_NORMALS = 0.3


def carry_texture(request: TransferRequest, result: MatchResult, stages: Stages) -> Outcome:
    """One image, or all maps of a material; the map is followed once for all of them."""
    given = request.maps if request.texture is None else (("", request.texture),)
    maps = [(name, _image_file(path, request, result)) for name, path in given]
    outputs = [map_path(request.output, name) for name, _ in maps]
    for output, (name, path) in zip(outputs, maps, strict=True):
        dtype, channels = read_image_form(path)
        kept = dtype if request.bits is None else pixel_type(request.bits, output.suffix)
        check_writable(output, kept, written_channels(request, result, channels, name))
    prepared = prepare_bake(request, result, stages, outputs)
    for (name, path), output in zip(maps, outputs, strict=True):
        own = replace(request, output=output)
        image = _bake_map(own, result, prepared, name, path, stages)
        entry = _entry("texture", request, path, image)
        summary, warnings = finish(own, prepared, entry | ({"map": name} if name else {}))
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
        warnings += unbound_maps(images_by_use)
        summary += "\n" + write_usd_results(layer, request.result, result, results, force=request.force)
    if len(maps) > 1:
        summary = f"wrote {len(maps)} maps: {', '.join(map(str, outputs))}" + summary.partition("\n")[2]
    return summary, warnings


def _image_file(path: Path, request: TransferRequest, result: MatchResult) -> Path:
    """An image as given, or the one that a glTF or FBX file holds, written into RESULT."""
    if path.suffix.lower() not in SCENE_SUFFIXES:
        return path
    image = extract_texture(path, result.source.control, request.result)
    if image is None:
        raise ParameterError(
            f"{path}: expected a colour image on most of {result.source.control.name}, found none. Give an image file, "
            "or bake --material-colors."
        )
    return image


def _bake_map(
    request: TransferRequest, result: MatchResult, prepared: Prepared, name: str, path: Path, stages: Stages
) -> SourceImage:
    """Bake one map into all tiles; returns what was read."""
    given = read_source_image(request, result, path, name=name)
    turned = not request.as_color and looks_like_normal_map(given.first.pixels)
    if turned and not name:
        raise ParameterError(
            f"{path}: looks like a normal map, whose directions must turn with the map. Give it as --normal-map, or "
            "add --as-color if it is a picture after all."
        )
    if turned:
        prepared.warnings.append(f"{path} looks like a normal map and is turned with the map, not carried as colours")
    carry = partial(bake_normal_map, green=cast(Green, request.green)) if turned else bake_texture

    def bake(options: BakeOptions) -> Image:
        pixels = carry(prepared.transfer, given.texture, size=given.size, dtype=given.dtype, options=options)
        return replace(given.first, pixels=pixels)

    bake_tiles(request, prepared, bake, stages, name)
    return given


def _baked(
    bake: Callable[..., Baked], given: SourceImage, request: TransferRequest, prepared: Prepared, stages: Stages
) -> Baked:
    """Bake an image of the source into all tiles, by a bake whose own options are bound; returns the last."""
    bound = partial(bake, prepared.transfer, given.texture, size=given.size, dtype=given.dtype)
    return bake_tiles(request, prepared, bound, stages)


def _entry(kind: str, request: TransferRequest, path: Path, given: SourceImage) -> dict[str, Any]:
    """What the manifest notes of an image that was carried: its file, size baked, and word for the colour space."""
    image = stated_path(path, request.result)
    return {"kind": kind, "image": image, "size": given.size, "color_space": given.first.color_space}


def carry_normal_map(request: TransferRequest, result: MatchResult, stages: Stages) -> Outcome:
    """A normal map, in tangent or object space."""
    assert request.normal_map is not None
    given = read_source_image(request, result, request.normal_map, 3)
    prepared = prepare_bake(request, result, stages)
    share = share_of_normals(given.first.pixels)
    if share < FEWEST_NORMALS:
        prepared.warnings.append(
            f"{request.normal_map}: only {100 * share:.0f} % of its colours are directions; is it a normal map? "
            "Colours go through --texture."
        )
    bake = partial(bake_normal_map, space=cast(Space, request.space), green=cast(Green, request.green))
    _baked(bake, given, request, prepared, stages)
    entry = _entry("normal-map", request, request.normal_map, given)
    return finish(request, prepared, {**entry, "space": request.space})


def carry_displacement(request: TransferRequest, result: MatchResult, stages: Stages) -> Outcome:
    """Displacement along the normal."""
    assert request.displacement is not None
    given = read_source_image(request, result, request.displacement, 1)
    prepared = prepare_bake(request, result, stages)
    bake = partial(bake_displacement, midlevel=request.midlevel, scale=request.scale)
    baked = _baked(bake, given, request, prepared, stages)
    entry = _entry("displacement", request, request.displacement, given)
    return _finish_displacement(request, prepared, entry, baked, "height")


def carry_vector_displacement(request: TransferRequest, result: MatchResult, stages: Stages) -> Outcome:
    """Vector displacement, in tangent or object space."""
    assert request.vector_displacement is not None
    given = read_source_image(request, result, request.vector_displacement, 3)
    prepared = prepare_bake(request, result, stages)
    space = cast(Space, request.space)
    bake = partial(bake_vector_displacement, space=space, midlevel=request.midlevel, scale=request.scale)
    baked = _baked(bake, given, request, prepared, stages)
    entry = {**_entry("vector-displacement", request, request.vector_displacement, given), "space": request.space}
    return _finish_displacement(request, prepared, entry, baked, "vector")


def _finish_displacement(
    request: TransferRequest, prepared: Prepared, entry: dict[str, Any], baked: Displacement, what: str
) -> Outcome:
    """Note a displacement, and say how its values are to be read."""
    entry |= {"midlevel": baked.midlevel, "scale": baked.scale}
    summary, warnings = finish(request, prepared, entry)
    return f"{summary}\n  {what} = (value - {baked.midlevel:g}) * {baked.scale:.6g} in the target's units", warnings


def carry_material_colors(request: TransferRequest, result: MatchResult, stages: Stages) -> Outcome:
    """Colours of the source's materials."""
    floats = request.output.suffix.lower() == ".exr"
    dtype = pixel_type(request.bits or (32 if floats else 8), request.output.suffix)
    check_writable(request.output, dtype, written_channels(request, result, 3))
    colors = face_colors(result.source.control)
    size = request.size or base_size(request) or DEFAULT_SIZE
    prepared = prepare_bake(request, result, stages)

    bake = partial(bake_face_colors, prepared.transfer, colors, size=size, dtype=dtype)
    bake_tiles(request, prepared, bake, stages)
    return finish(request, prepared, {"kind": "material-colors", "size": size})
