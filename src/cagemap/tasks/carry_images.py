"""`cagemap transfer`: bake images and colours of the source, or of a detailed mesh, into the target's layout."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from cagemap.errors import ParameterError
from cagemap.files.atomic import all_or_nothing
from cagemap.files.gltf.document import GLTF_SUFFIXES
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.textures import MaterialImage, write_numbered
from cagemap.files.images.image import (
    Image,
    check_writable,
    pixel_type,
    png_bytes,
    read_image_form,
    tile_pattern,
    udim_path,
)
from cagemap.files.inner_texture import material_document, tinted_materials, write_texture
from cagemap.files.meshes.formats import MESH_SUFFIXES, read_mesh
from cagemap.files.meshes.ply import ply_image
from cagemap.files.result.manifest import input_file, note_transfer
from cagemap.files.usd.results import preview_inputs, unbound_maps
from cagemap.files.usd.write import UsdResults
from cagemap.maps.result import MatchResult
from cagemap.mesh.mesh_report import first_few
from cagemap.tasks.bake_tiles import (
    DEFAULT_SIZE,
    Prepared,
    SourceImage,
    bake_tiles,
    colors_remedy,
    map_path,
    prepare_bake,
    read_source_image,
    record_bake,
    require_color_texture,
    require_source_uvs,
)
from cagemap.tasks.base_images import base_scale_warnings, base_size, mask_function, require_base, written_channels
from cagemap.tasks.detail_bakes import (
    KINDS,
    OFFSETS,
    DetailBakes,
    bake_detail,
    detail_colors,
    detail_texture,
    in_source_space,
    mesh_detail,
)
from cagemap.tasks.material_atlas import material_atlas
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.transfer import BakeKind, TransferRequest
from cagemap.tasks.usd_output import texture_reference, write_usd_results
from cagemap.transfer import BakeOptions, bake_displacement, bake_face_colors, bake_texture, face_colors
from cagemap.transfer.detail import Detail
from cagemap.transfer.displacement import Displacement, scale_ratio
from cagemap.transfer.texture import Pixels
from cagemap.transfer.vectors import (
    bake_normal_map,
    bake_vector_displacement,
    looks_like_normal_map,
    share_of_normals,
)

# Least share of a normal map's colours that are unit vectors; JPEG compression keeps more.
FEWEST_NORMALS = 0.3
# Largest difference of the surfaces' ratio of lengths from 1 with which heights need no scale.
_MAX_UNSCALED = 0.01


def carry_texture(request: TransferRequest, result: MatchResult, stages: Stages) -> SummaryAndWarnings:
    """Carry one image, or all maps of a material, with one prepared bake."""
    given, source = request.texture, result.source.control
    document = None if given is None else material_document(given, source)
    atlas = material_atlas(document, source)
    if given is not None and atlas is not None:
        joined = write_numbered(request.result / f"{given.stem}_texture.png", png_bytes(atlas.image))
        result = replace(result, source=result.source.with_control(atlas.control))
        request = replace(request, texture=joined, size=request.size or (None if base_size(request) else atlas.size))
    images = request.maps if request.texture is None else (("", request.texture),)
    maps = [(name, *_image_file(path, request, result, document if path == given else None)) for name, path in images]
    outputs = [map_path(request.output, name) for name, *_ in maps]
    for output, (name, path, _) in zip(outputs, maps, strict=True):
        dtype, channels, _ = read_image_form(path)
        kept = dtype if request.bits is None else pixel_type(request.bits, output.suffix)
        check_writable(output, kept, written_channels(request, result, channels, name))
        size = request.size or base_size(request, name)
        if size is not None:  # a normal map is baked without its alpha
            require_base(request, result, size, (3, 4) if channels == 4 else (channels,), name)
    outputs_by_use = dict(zip((name or "texture" for name, *_ in maps), outputs, strict=True))
    prepared = prepare_bake(request, result, stages, outputs_by_use)
    requests = [replace(request, output=output) for output in outputs]
    entries: list[dict[str, Any]] = []
    with all_or_nothing():
        prepared.write_mesh()
        for (name, path, texture), map_request in zip(maps, requests, strict=True):
            image = _bake_map(map_request, result, prepared, name, path, stages, texture)
            entry = _entry("texture", path if atlas is None or given is None else given, image)
            entries.append(entry | ({"map": name} if name else {}))
        lines = [] if request.usd is None else [_write_layer(request.usd, request, result, prepared, outputs_by_use)]
    for map_request, entry in zip(requests, entries, strict=True):
        summary, warnings = record_bake(map_request, prepared, entry, stages)
    is_gltf = given is not None and given.suffix.lower() in GLTF_SUFFIXES
    if is_gltf and document is not None and (tinted := tinted_materials(document, source)):
        colors = f"the colours that multiply the images of {first_few(tinted)} are not baked"
        warnings = [*warnings, f"{given}: {colors}; set them in the target's materials"]
    summary = "\n".join([summary, *lines])
    if len(maps) > 1:
        written = [*outputs, *([prepared.mesh] if prepared.mesh else [])]
        _, end, rest = summary.partition("\n")
        summary = f"wrote {len(maps)} maps: {', '.join(map(str, written))}{end}{rest}"
    return summary, warnings


def _write_layer(
    layer: Path, request: TransferRequest, result: MatchResult, prepared: Prepared, outputs_by_use: Mapping[str, Path]
) -> str:
    """Write a layer that binds baked images; returns a line for the terminal."""
    images = {
        use: texture_reference(output if prepared.tiles == [0] else tile_pattern(output), layer)
        for use, output in outputs_by_use.items()
    }
    control, uvs = prepared.control, None
    if request.unwrap and control.uvs is not None and control.uv_indices is not None:
        uvs = ("cagemap_st", control.uvs, control.uv_indices)
    prepared.warnings.extend(unbound_maps(images))
    return write_usd_results(layer, request.result, result, UsdResults(textures=images, uvs=uvs), force=request.force)


def _image_file(
    path: Path, request: TransferRequest, result: MatchResult, document: Document | None
) -> tuple[Path, MaterialImage | None]:
    """The image to bake, and how it is laid if it is a model file's.

    An image file is used as given, that of all faces of a PLY file too; other images are written into RESULT.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        return path, None
    require_source_uvs(result.source.control)
    if (image_file := ply_image(path)) != path:
        return image_file, None
    document, found = require_color_texture(path, document, result.source.control)
    return write_texture(path, document, found, request.result), found


def _bake_map(
    request: TransferRequest,
    result: MatchResult,
    prepared: Prepared,
    name: str,
    path: Path,
    stages: Stages,
    laid: MaterialImage | None,
) -> SourceImage:
    """Bake one map into all tiles; returns the source image."""
    source_image = read_source_image(request, result, path, name=name)
    transfer, texture = prepared.transfer, source_image.texture
    uvs = transfer.source.uvs
    if laid is not None and uvs is not None and not isinstance(texture, dict) and not laid.is_repeated_over(uvs):
        texture, uvs = laid.repeating(texture, laid.on_image(uvs))
        transfer = replace(transfer, source=replace(transfer.source, uvs=uvs))
    is_normal_map = not request.as_color and looks_like_normal_map(source_image.first.pixels)
    if is_normal_map and not name:
        raise ParameterError(
            f"{path}: looks like a normal map, whose directions must turn with the map. Give it as --normal-map, or "
            "add --as-color if it is a picture after all."
        )
    if is_normal_map:
        prepared.warnings.append(f"{path} looks like a normal map and is turned with the map, not carried as colours")
    use = preview_inputs([name or "texture"]).get(name or "texture")
    if use == "normal" and not is_normal_map and not request.as_color:
        prepared.warnings.append(
            f"{path} is carried as colours: it does not look like a normal map in tangent space. Carry it with "
            "--normal-map if it is one (with --space object, if its directions are in object space)"
        )
    if use == "displacement" and abs((ratio := scale_ratio(transfer)) - 1.0) > _MAX_UNSCALED:
        wrong = f"{ratio:.4g} times too small" if ratio > 1.0 else f"{1.0 / ratio:.4g} times too large"
        prepared.warnings.append(
            f"{path} is carried unscaled: the target is {ratio:.4g} times as large as the source, so that its heights "
            f"are {wrong} there; carry it with --displacement, which scales them"
        )
    if use in ("diffuseColor", "emissiveColor") and (source_image.first.pixels.dtype.kind == "f") != (
        source_image.dtype.kind == "f"
    ):
        prepared.warnings.append(
            f"{request.output} has the numbers of {path}, and programs read colours of integers as sRGB, of floats as "
            f"linear: choose the colour space of {path.name} for it there"
        )
    carry = partial(bake_normal_map, green=request.green) if is_normal_map else bake_texture

    def bake(options: BakeOptions) -> Image:
        pixels = carry(transfer, texture, size=source_image.size, dtype=source_image.dtype, options=options)
        return replace(source_image.first, pixels=pixels)

    bake_tiles(request, prepared, bake, stages, name)
    return source_image


def _entry(kind: str, path: Path, given: SourceImage) -> dict[str, Any]:
    """Manifest entry of a carried image: its file, baked size and colour space."""
    return {"kind": kind, "image": path, "size": given.size, "color_space": given.first.color_space}


def carry_normal_map(request: TransferRequest, result: MatchResult, stages: Stages) -> SummaryAndWarnings:
    """Carry a normal map, in tangent or object space."""
    bake = partial(bake_normal_map, space=request.space, green=request.green)
    return _carry("normal-map", request.normal_map, 3, bake, {"space": request.space}, request, result, stages)


def carry_displacement(request: TransferRequest, result: MatchResult, stages: Stages) -> SummaryAndWarnings:
    """Carry displacement along the normal."""
    bake = partial(bake_displacement, midlevel=request.midlevel, scale=request.scale)
    return _carry("displacement", request.displacement, 1, bake, {}, request, result, stages)


def carry_vector_displacement(request: TransferRequest, result: MatchResult, stages: Stages) -> SummaryAndWarnings:
    """Carry vector displacement, in tangent or object space."""
    bake = partial(bake_vector_displacement, space=request.space, midlevel=request.midlevel, scale=request.scale)
    more = {"space": request.space}
    return _carry("vector-displacement", request.vector_displacement, 3, bake, more, request, result, stages)


def _carry(
    kind: str,
    path: Path | None,
    channels: int,
    bake: Callable[..., Pixels | Displacement],
    more: dict[str, Any],
    request: TransferRequest,
    result: MatchResult,
    stages: Stages,
) -> SummaryAndWarnings:
    """Bake an image of the source into all tiles; the manifest entry gets ``more``."""
    assert path is not None
    source_image = read_source_image(request, result, path, channels)
    prepared = prepare_bake(request, result, stages, {kind.removesuffix("-map"): request.output})
    if kind == "normal-map" and (share := share_of_normals(source_image.first.pixels)) < FEWEST_NORMALS:
        prepared.warnings.append(
            f"{path}: only {100 * share:.0f} % of its colours are directions; is it a normal map? "
            "Colours go through --texture."
        )
    if kind != "normal-map":
        usual = 0.5 if source_image.first.pixels.dtype.kind == "u" else 0.0
        midlevel = usual if request.midlevel is None else request.midlevel
        prepared.warnings.extend(base_scale_warnings(request, result, source_image.dtype, midlevel))
    bound = partial(bake, prepared.transfer, source_image.texture, size=source_image.size, dtype=source_image.dtype)
    with all_or_nothing():
        prepared.write_mesh()
        baked = bake_tiles(request, prepared, bound, stages)
    entry = _entry(kind, path, source_image) | more
    if not isinstance(baked, Displacement):
        return record_bake(request, prepared, entry, stages)
    values = {"midlevel": baked.midlevel, "scale": baked.scale}
    stages.record(values)
    summary, warnings = record_bake(request, prepared, entry | values, stages)
    what = "height" if channels == 1 else "vector"
    return f"{summary}\n  {what} = (value - {baked.midlevel:g}) * {baked.scale:.6g} in the target's units", warnings


def carry_material_colors(request: TransferRequest, result: MatchResult, stages: Stages) -> SummaryAndWarnings:
    """Bake colours of the source's materials."""
    source, floats = result.source.control, request.output.suffix.lower() == ".exr"
    if source.material_colors is None:
        remedy = "Put its .mtl beside it and match again." if source.material_names else colors_remedy(source)
        raise ParameterError(f"{source.name}: expected materials with colours, found none. {remedy}")
    dtype = pixel_type(request.bits or (32 if floats else 8), request.output.suffix)
    check_writable(request.output, dtype, written_channels(request, result, 3))
    colors = face_colors(source)
    size = request.size or base_size(request) or DEFAULT_SIZE
    require_base(request, result, size, (3,))
    prepared = prepare_bake(request, result, stages, {"color": request.output})

    bake = partial(bake_face_colors, prepared.transfer, colors, size=size, dtype=dtype)
    with all_or_nothing():
        prepared.write_mesh()
        bake_tiles(request, prepared, bake, stages)
    return record_bake(request, prepared, {"kind": "material-colors", "size": size}, stages)


def carry_detail(request: TransferRequest, result: MatchResult, stages: Stages) -> SummaryAndWarnings:
    """Bake normals, displacement, ambient occlusion and colours of a detailed mesh or the source."""
    is_plain = result.source.refinement.is_plain
    kinds = _kinds(request, input_file(request.result, result.manifest, "source") if is_plain else None)
    images = {kind: map_path(request.output, kind if len(kinds) > 1 else "") for kind in kinds}
    of_bases = (base_size(request, kind) for kind in kinds)
    size = request.size or next((found for found in of_bases if found is not None), None)
    bakes, mesh = DetailBakes(images, size, request.bits, request), None
    if request.detail is not None:
        mesh = in_source_space(read_mesh(request.detail), request.detail, request.result, result)
        if request.detail_texture is not None:
            bakes = replace(bakes, texture=detail_texture(mesh, request.detail_texture, request.filter))
    channels = {kind: bakes.channels(kind) for kind in kinds}
    for kind in kinds:
        require_base(request, result, bakes.size_of(kind), (channels[kind],), kind)
    bakes.check({kind: written_channels(request, result, channels[kind], kind) - channels[kind] for kind in kinds})
    prepared = prepare_bake(request, result, stages, {kind.removesuffix("s"): path for kind, path in images.items()})
    warnings = prepared.warnings
    interpolated = [kind for kind in kinds if kind != "texture"]
    if request.filter == "nearest" and interpolated:
        warnings.append(
            f"--filter nearest is not used for {', '.join(interpolated)}, which are interpolated between vertices; it "
            "is for the labels of --bake texture"
        )
    for kind in kinds:
        if kind in ("displacement", "vector-displacement"):
            dtype = bakes.dtype(kind)
            warnings += base_scale_warnings(request, result, dtype, 0.5 if dtype.kind == "u" else 0.0, kind)
    if mesh is not None:
        stages("detail")
        detail, more = mesh_detail(mesh, prepared.transfer)
        warnings += more
    else:
        detail = Detail(prepared.transfer.point_map.source)
    colors = None
    if "colors" in kinds:
        colors, notes = detail_colors(mesh, result.source.refinement)
        warnings += notes
    lines = bake_detail(
        bakes,
        prepared.transfer,
        detail,
        colors,
        prepared.tiles,
        stages,
        "the target's",
        partial(mask_function, request, prepared.transfer),
        prepared.write_mesh,
    )
    for kind, path in images.items():
        entry = {"kind": f"bake-{kind}", "output": udim_path(path, prepared.tiles[0]), "tiles": prepared.tiles}
        entry |= {"size": bakes.size_of(kind), "space": request.space, "mesh": prepared.mesh}
        stages.record({"size": bakes.size_of(kind), "tiles": prepared.tiles}, of=kind if len(kinds) > 1 else "")
        note_transfer(request.result, entry)
    if prepared.mesh is not None:
        lines.append(f"wrote {prepared.mesh}")
    return "\n".join(lines), warnings


def _kinds(request: TransferRequest, source: Path | None) -> list[BakeKind]:
    """Checked kinds of images to bake; ``source``: file of a plain source."""
    kinds = list(dict.fromkeys(request.bake))
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown:
        raise ParameterError(f"--bake: expected some of {', '.join(KINDS)}, got {', '.join(unknown)}")
    if ("texture" in kinds) != (request.detail_texture is not None):
        raise ParameterError("--bake texture and --detail-texture: expected both or neither, got one of them")
    if request.detail_texture is not None and request.detail is None:
        raise ParameterError("--detail-texture: expected --detail, the mesh that the image belongs to")
    flat = [kind for kind in kinds if kind in OFFSETS]
    if flat and (request.detail is None or (source is not None and request.detail.resolve() == source.resolve())):
        raise ParameterError(
            f"--bake {','.join(flat)}: expected --detail, a detailed mesh that lies on the source, since a surface has "
            "no detail over itself. To bake the source onto a cage that is wrapped on it, use `cagemap wrap "
            "--normal-map`."
        )
    return kinds
