"""Bake images tile by tile: layout of the target, sizes, masks and writing."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.files.atomic import check_outputs
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.textures import MaterialImage
from cagemap.files.images.image import (
    UDIM_MARK,
    Image,
    as_tile_set,
    check_writable,
    first_image,
    pixel_type,
    read_texture,
    texture_files,
    texture_pixels,
    udim_path,
    unpremultiply,
    with_udim_mark,
    write_image,
)
from cagemap.files.inner_texture import color_texture, material_document
from cagemap.files.meshes.formats import referred_files
from cagemap.files.meshes.obj_write import write_obj, write_obj_layout
from cagemap.files.result.folder import ARRAYS
from cagemap.files.result.manifest import MANIFEST, input_file, note_transfer, read_files
from cagemap.files.usd.results import preview_inputs
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import NO_UV
from cagemap.mesh.mesh_report import first_few
from cagemap.numerics.threads import ThreadPool
from cagemap.tasks.base_images import ImageSize, base_size, mask_function, require_base, written_channels
from cagemap.tasks.masks import mask_inputs
from cagemap.tasks.match_summary import colors_option
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.options import files_read
from cagemap.tasks.requests.transfer import TransferRequest, base_of
from cagemap.tasks.tiled_texture import read_texture_of
from cagemap.transfer import BakeOptions, Transfer, target_tiles, transfer_of, unwrap
from cagemap.transfer.baking import layout_cells, masked_faces
from cagemap.transfer.displacement import Displacement
from cagemap.transfer.overlapping_uvs import overlapping_materials, overlapping_share
from cagemap.transfer.texture import Pixels

# Default width and height of an image, if no source or base image gives a size.
DEFAULT_SIZE = 2048
# Least overlapping share of a layout that is reported; a small one is normal, since faces of artists' layouts touch.
MIN_REPORTED_OVERLAP = 0.02
# What to do without a colour image.
_OTHER_COLORS = "Match with another --source-uv-set, give an image made for these UVs, or bake --material-colors."
_log = logging.getLogger(__name__)
Baked = TypeVar("Baked", bound=Pixels | Image | Displacement)


@dataclass(frozen=True)
class Prepared:
    """A prepared bake: tiles of the target's layout, and warnings."""

    transfer: Transfer
    control: ControlMesh
    tiles: list[int]
    mesh: Path | None
    warnings: list[str]
    write_mesh: Callable[[], None] = lambda: None  # writes ``mesh``; called once, in the block that writes the images


@dataclass(frozen=True)
class SourceImage:
    """An image of the source, or its tiles."""

    texture: Pixels | dict[int, Pixels]
    first: Image  # gives the result its colour space and alpha
    dtype: np.dtype[Any]  # number type to write
    size: ImageSize  # to bake


def bake_inputs(request: TransferRequest) -> list[Path]:
    """Input files that the command line names, and those that these name."""
    given = files_read(request, "usd")
    return [
        request.result / MANIFEST,
        request.result / ARRAYS,
        *(file for path in given for file in (*texture_files(path), *referred_files(path))),
        *(file for _, base in request.bases for file in texture_files(as_tile_set(base))),
        *mask_inputs(request).values(),
    ]


def read_source_image(
    request: TransferRequest, result: MatchResult, path: Path, channels: int | None = None, name: str = ""
) -> SourceImage:
    """Read an image of the source, or ``channels`` of heights or directions, which the output must be able to hold."""
    # With a mask on the source, one tile may be all that is read.
    texture = read_texture_of(result.source.control, path) if result.masks.source is None else read_texture(path)
    if channels is not None:  # their values are taken without alpha
        texture = (
            unpremultiply(texture)
            if isinstance(texture, Image)
            else {n: unpremultiply(one) for n, one in texture.items()}
        )
    first = first_image(texture)
    dtype = first.pixels.dtype if request.bits is None else pixel_type(request.bits, request.output.suffix)
    size = request.size or base_size(request, name) or max(first.size)
    if channels is not None:
        check_writable(request.output, dtype, written_channels(request, result, channels))
        require_base(request, result, size, (channels,), name)
    return SourceImage(texture_pixels(texture), first, dtype, size)


def require_color_texture(
    path: Path, document: Document | None, control: ControlMesh, remedy: str = _OTHER_COLORS
) -> tuple[Document, MaterialImage]:
    """The `material_document` of a file, read if not given, and the mesh's `color_texture`; refuses files without."""
    document = document or material_document(path, control)
    found = color_texture(document, control)
    if document is None or found is None:
        raise ParameterError(
            f"{path}: expected a colour image on most of {control.name} for its UV set in use, found none. {remedy}"
        )
    return document, found


def require_source_uvs(source: ControlMesh) -> None:
    """Refuse to carry an image of a source without texture coordinates."""
    if source.uvs is None:
        raise ParameterError(
            f"{source.name}: expected texture coordinates of the source, over which its image lies, the mesh has none. "
            f"{colors_remedy(source)}"
        )


def require_layout(target: ControlMesh, remedy: str = "Unwrap") -> None:
    """Refuse to bake into a target without a layout; ``remedy``: start of the sentence on what to do."""
    if not target.has_layout:
        found = "the mesh has none" if target.uvs is None else "all of them are in one point or on a line"
        raise ParameterError(
            f"{target.name}: expected texture coordinates to bake into, {found}. {remedy} it in your modelling program "
            "and match again."
        )


def colors_remedy(mesh: ControlMesh) -> str:
    """Text for messages: the command that bakes the colours of a mesh."""
    option = colors_option(mesh)
    if option is None:
        return "Match a file that has them: a mesh without UVs and colours has no look to transfer."
    holders = "vertices" if mesh.vertex_colors is not None else "materials"
    return f"Bake the colours of its {holders}: `transfer {option}`."


def prepare_bake(
    request: TransferRequest, result: MatchResult, stages: Stages, outputs: Mapping[str, Path]
) -> Prepared:
    """Find the tiles of the target's layout, a new one if it is requested.

    Refuses outputs that would replace inputs.

    ``outputs``: the images to bake, by their use as `preview_inputs` takes it.
    """
    mesh: Path | None = None
    warnings: list[str] = []
    given_images = request.texture, request.displacement, request.normal_map, request.vector_displacement, *request.maps
    if any(given_images):
        require_source_uvs(result.source.control)
    if request.unwrap:
        stages("unwrap")
        control = unwrap(result.target.control)
        mesh = unwrapped_name(request.output)
        result = replace(result, target=result.target.with_control(control))
    else:
        require_layout(result.target.control, "Add --unwrap to write it beside the image with a new layout, or unwrap")
    stages("prepare")
    transfer = transfer_of(result)
    tiles, outside = layout_tiles(transfer)
    warnings += [*outside, *missing_uv_warnings(result.target.control)]
    warnings += target_overlap_warnings(result.target.control, masked_faces(transfer))
    if any(given_images):
        warnings += missing_uv_warnings(result.source.control, "all of them get one texel of the image")
        warnings += [] if result.masks.source is not None else _source_overlap_warnings(result.source.control)
    images = [udim_path(output, tile) for output in outputs.values() for tile in tiles]
    meshes = () if mesh is None else (mesh, mesh.with_suffix(".mtl"))
    other_outputs = [*meshes, *([] if request.usd is None else [request.usd])]
    inputs = [*bake_inputs(request), *read_files(request.result, result.manifest)]
    check_outputs([*images, *other_outputs], inputs, force=request.force)
    prepared = Prepared(transfer, result.target.control, tiles, mesh, warnings)
    if mesh is None:
        return prepared
    bound = _material_images(request, {use: udim_path(output, tiles[0]) for use, output in outputs.items()})
    write, more = _unwrapped_writer(request, result.target.control, result.manifest, bound)
    return replace(prepared, warnings=[*warnings, *more], write_mesh=write)


def layout_tiles(transfer: Transfer) -> tuple[list[int], list[str]]:
    """UDIM numbers of the target layout's tiles, [0] for the unit square; and warnings."""
    cells = layout_cells(transfer.target)
    if cells.min() >= 0:  # UDIM has no numbers for others
        return target_tiles(transfer.target), []
    outside = float(np.mean((cells != 0).any(axis=1)))
    return [0], [f"{100 * outside:.1f} % of the target's layout lies outside the unit square and is not baked: move it"]


def missing_uv_warnings(control: ControlMesh, effect: str = "no image is baked there") -> list[str]:
    """A warning if all faces of a material of an object have no texture coordinates in use, see `join_meshes`.

    None if the UV set has no name: readers of OBJ and PLY files report such faces.
    """
    if control.uvs is None or control.uv_indices is None or not control.uv_name:
        return []
    bare = np.logical_and.reduceat((control.uvs[control.uv_indices] == NO_UV).all(axis=1), control.face_offsets[:-1])
    objects, materials = (0 * bare if one is None else one for one in (control.face_objects, control.face_materials))
    number = np.unique(objects * (2 + materials.max()) + materials, return_inverse=True)[1]  # materials from -1
    bare = np.bincount(number, weights=~bare)[number] == 0  # faces of palettes may be there on purpose
    if not bare.any() or bare.all():
        return []
    numbers = np.unique(objects[bare]).tolist()
    names = first_few(control.object_names[one] for one in numbers if control.object_names)
    return [
        f"{int(bare.sum())} faces of {control.name}{names and f' ({names})'} have no texture coordinates in its UV set "
        f"{control.uv_name}, so that {effect}: match their part alone, or name the UV sets alike"
    ]


def target_overlap_warnings(control: ControlMesh, masked: NDArray[np.bool_] | None = None) -> list[str]:
    """A warning if the target's layout overlaps itself, without control faces that are ``masked``."""
    share = overlapping_share(control, masked)
    if share < MIN_REPORTED_OVERLAP:
        return []
    return [
        f"{100 * share:.0f} % of the target's layout lies over other parts of it (mirrored halves, or materials with "
        "an image each), where a texel takes what one of them gets: match its materials one by one with --part, or "
        "carry with `cagemap transfer --unwrap`, which makes another layout"
    ]


def _source_overlap_warnings(control: ControlMesh) -> list[str]:
    """A warning if layouts of the source's materials overlap."""
    names = overlapping_materials(control, MIN_REPORTED_OVERLAP)
    if not names:
        return []
    return [
        f"materials of the source lie over each other in its layout ({', '.join(names)}), and all take this image: if "
        "each has one of its own, carry them one by one with --source-mask NAME"
    ]


def bake_tiles(
    request: TransferRequest, prepared: Prepared, bake: Callable[..., Baked], stages: Stages, name: str = ""
) -> Baked:
    """Bake and write all tiles, each written while the next is baked; returns the last one, see `write_tiles`.

    Masked texels take the base image, or get alpha.

    ``request``: its output is the image to write, or a pattern for several tiles.
    ``bake``: called with ``options``, which hold the tile; returns the baked image.
    ``name``: of the map, to find its base image and to show.
    """
    return write_tiles(
        request.output,
        prepared.tiles,
        lambda options: bake(options=replace(options, filter=request.filter)),
        stages,
        mask_function(request, prepared.transfer, name),
        force=request.force,
        name=name,
    )


def write_tiles(
    output: Path,
    tiles: list[int],
    bake: Callable[..., Baked],
    stages: Stages,
    finished: Callable[[Image, BakeOptions], Image] = lambda image, _: image,
    *,
    force: bool,
    name: str = "",
) -> Baked:
    """Bake and write all tiles of any layout; returns the last. The caller moves them together (`all_or_nothing`).

    ``tiles``: UDIM numbers; [0] for a layout in the unit square.
    ``bake``, ``stages``, ``name``: as in `bake_tiles`.
    ``finished``: a baked image -> the image to write.
    """
    with ThreadPool(1) as writer:
        writes: list[Future[None]] = []
        for number, tile in enumerate(tiles):
            place = f"tile {tile}, {number + 1} of {len(tiles)}" if tile else ""
            stages(" ".join(filter(None, ["bake", name, place])))
            options = BakeOptions(tile=tile)
            baked = bake(options=options)
            for waiting in writes:
                waiting.result()  # at most one image is being written
            pixels = baked.pixels if isinstance(baked, Displacement) else baked
            image = finished(pixels if isinstance(pixels, Image) else Image(pixels), options)
            writes = [writer.submit(write_image, udim_path(output, tile), image, force=force)]
        for waiting in writes:
            waiting.result()
    return baked


def record_bake(
    request: TransferRequest, prepared: Prepared, entry: dict[str, Any], stages: Stages
) -> SummaryAndWarnings:
    """Record a bake in the stages' figures and in the manifest; returns a summary and warnings."""
    outputs = [udim_path(request.output, tile) for tile in prepared.tiles]
    stages.record({"size": entry["size"], "tiles": prepared.tiles}, of=str(entry.get("map", "")))
    level = {} if request.level is None else {"level": request.level}
    note_transfer(
        request.result, {**entry, **level, "output": outputs[0], "tiles": prepared.tiles, "mesh": prepared.mesh}
    )
    written = [*outputs, *([prepared.mesh] if prepared.mesh else [])]
    height, width = np.broadcast_to(entry["size"], 2)
    summary = f"wrote {', '.join(map(str, written))}; {width} x {height} texels"
    if prepared.transfer.masks.any:
        base = base_of(request, str(entry.get("map", "")))
        outside = "alpha holds the weights of the masks" if base is None else f"outside the masks it is {base}"
        summary += f"\n  {outside}"
    return summary, prepared.warnings


def unwrapped_name(image: Path) -> Path:
    """Name of an image's unwrapped mesh, which differs from the user's mesh."""
    stem = as_tile_set(image).stem.replace(UDIM_MARK, "").rstrip("._")
    return image.with_name(f"{stem}_unwrapped.obj")


# Statements of a .mtl file for the inputs of UsdPreviewSurface. Blender reads normals from map_Bump.
_MATERIAL_STATEMENTS = {
    "diffuseColor": ("map_Kd",),
    "emissiveColor": ("map_Ke",),
    "roughness": ("map_Pr",),
    "metallic": ("map_Pm",),
    "occlusion": ("map_Ka",),
    "opacity": ("map_d",),
    "displacement": ("disp",),
    "normal": ("norm", "map_Bump"),
}


def _material_images(request: TransferRequest, images: Mapping[str, Path]) -> dict[str, str]:
    """Image names of a ``.mtl`` file beside the images, by statement."""
    bound = {
        statement: images[use].name
        for use, name in preview_inputs(images).items()
        for statement in _MATERIAL_STATEMENTS[name]
        if name != "normal" or (request.space, request.green) == ("tangent", "up")
    }
    if "map_Kd" not in bound and "map_Ka" in bound:  # programs show ambient occlusion only as a colour
        bound["map_Kd"] = bound["map_Ka"]
    return bound


def _unwrapped_writer(
    request: TransferRequest, control: ControlMesh, manifest: dict[str, Any], images: Mapping[str, str]
) -> tuple[Callable[[], None], list[str]]:
    """Writer of the target with its new layout and images, a copy of its OBJ file or else a plain one; and warnings."""
    mesh = unwrapped_name(request.output)
    original = input_file(request.result, manifest, "target")
    whole = control.file_vertices is None
    if whole and original is not None and original.suffix.lower() == ".obj":
        return partial(write_obj_layout, mesh, original, control, images, force=request.force), []
    why = "was not found, or has changed since the match" if original is None else "is no OBJ"
    why = why if whole else "was matched in part, mended or welded"
    warning = f"{control.name} {why}: {mesh} holds faces, UVs and materials, but no groups, names or normals of it"
    return partial(write_obj, mesh, control, images, force=request.force), [warning]


def map_path(output: Path, name: str) -> Path:
    """Image of one of several maps, with the map's name before the tile number and the suffix.

    Without a name the number 1001 stays: `udim_path` puts a tile's number there.
    """
    if not name:
        return with_udim_mark(output)
    output = as_tile_set(output)
    stem, dot, rest = output.name.partition(UDIM_MARK) if UDIM_MARK in output.name else (output.stem, "", output.suffix)
    if dot:
        return output.with_name(f"{stem.rstrip('._')}_{name}.{UDIM_MARK}{rest}")
    return output.with_name(f"{stem}_{name}{rest}")
