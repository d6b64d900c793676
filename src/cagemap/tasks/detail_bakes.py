"""Bake images from a detailed mesh, for `cagemap transfer --bake` and `cagemap wrap`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.files.atomic import all_or_nothing, check_outputs
from cagemap.files.images.image import (
    Image,
    check_writable,
    first_image,
    pixel_type,
    texture_files,
    texture_pixels,
    udim_path,
)
from cagemap.files.inner_texture import color_texture, material_document
from cagemap.files.meshes.formats import MESH_SUFFIXES, read_mesh
from cagemap.files.meshes.ply import ply_image
from cagemap.files.result.manifest import input_file
from cagemap.files.usd.space import between_spaces, transform_mesh
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import UNKNOWN_COLOR
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.schemes import Plain
from cagemap.numerics.arrays import FloatArray, IndexArray, decode_srgb, encode_srgb
from cagemap.subdivision import Refinement, default_scheme
from cagemap.surface.triangles import fan_triangles
from cagemap.tasks.bake_tiles import (
    DEFAULT_SIZE,
    colors_remedy,
    layout_tiles,
    missing_uv_warnings,
    require_color_texture,
    require_layout,
    require_source_uvs,
    target_overlap_warnings,
    write_tiles,
)
from cagemap.tasks.base_images import ImageSize
from cagemap.tasks.material_atlas import material_atlas
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.catalogue import WRITTEN
from cagemap.tasks.requests.transfer import BakeKind, TransferRequest
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.tasks.tiled_texture import read_texture_of
from cagemap.transfer import BakeOptions, Transfer
from cagemap.transfer.detail import (
    Detail,
    bake_detail_heights,
    bake_detail_normals,
    bake_detail_texture,
    bake_detail_values,
    bake_detail_vectors,
    detail_over,
    detailed_share,
)
from cagemap.transfer.displacement import Displacement
from cagemap.transfer.lookups import plain_lookups
from cagemap.transfer.rays import ambient_occlusion
from cagemap.transfer.texture import Filter, Pixels, lay_texture
from cagemap.wrap import Wrapped, missing_detail, wrapped_transfer
from cagemap.wrap.wrapping import NO_CAGE

_OTHER_TEXTURE = "Give an image made for these UVs, or the RESULT of `cagemap match` with another --source-uv-set."
KINDS: tuple[BakeKind, ...] = get_args(BakeKind)
# Kinds of the detail's offset or direction: empty for a surface over itself.
OFFSETS: tuple[BakeKind, ...] = ("normal", "displacement", "vector-displacement")
_CHANNELS: dict[BakeKind, int] = {
    "normal": 3,
    "displacement": 1,
    "vector-displacement": 3,
    "ao": 1,
    "colors": 3,
    "texture": 1,  # replaced by the image's number once it is read
}
# Formats with 16 bits.
_DEEP = (".png", ".tif", ".tiff")
# Share of the source with detail near it; below it there is a warning.
_COVERED = 0.99
# Lengths up to this, as a share of the target's largest coordinate, are rounding: the detail is the source itself.
_ROUNDING_LENGTH = 1e-12


@dataclass(frozen=True, eq=False)
class DetailTexture:
    """A detailed mesh's own image, with its texture coordinates."""

    texture: Pixels | dict[int, Pixels]
    first: Image  # gives the result its number type and colour space
    uvs: FloatArray  # (p, 2)
    uv_triangles: IndexArray  # (t, 3)
    filter: Filter = "smooth"  # as `BakeOptions` has it


@dataclass(frozen=True)
class DetailBakes:
    """Images to bake from a detailed mesh, with their files."""

    images: dict[BakeKind, Path]
    size: ImageSize | None  # as requested, or of a base image; None: see `size_of`
    bits: int | None  # by default floats in EXR; elsewhere 16 for directions and offsets, 8 for colours and occlusion
    request: TransferRequest | WrapRequest  # gives space, green, rays and force
    texture: DetailTexture | None = None  # of the detailed mesh, for the kind "texture"

    def size_of(self, kind: BakeKind) -> ImageSize:
        """Size of an image; by default the detailed mesh's own image gives that of the kind "texture"."""
        own = DEFAULT_SIZE if kind != "texture" or self.texture is None else max(self.texture.first.size)
        return self.size or own

    def channels(self, kind: BakeKind) -> int:
        """Channels of an image."""
        if kind == "texture" and self.texture is not None:
            return int(np.atleast_3d(self.texture.first.pixels).shape[2])
        return _CHANNELS[kind]

    def dtype(self, kind: BakeKind) -> np.dtype[Any]:
        """Number type of an image."""
        if kind == "texture" and self.texture is not None and self.bits is None:
            return self.texture.first.pixels.dtype
        suffix = self.images[kind].suffix.lower()
        default = 32 if suffix == ".exr" else 16 if suffix in _DEEP and kind in OFFSETS else 8
        return pixel_type(self.bits or default, suffix)

    def check(self, more: Mapping[BakeKind, int] = MappingProxyType({})) -> None:
        """Refuse file formats that cannot hold their images, with ``more`` channels (alpha)."""
        for kind, path in self.images.items():
            check_writable(path, self.dtype(kind), self.channels(kind) + more.get(kind, 0))


def require_green(request: TransferRequest | WrapRequest) -> None:
    """Refuse ``--green down`` in object space, where it means nothing."""
    if request.space == "object" and request.green != "up":
        raise ParameterError(
            "--green: expected with --space tangent, object space has no such convention. Leave it out."
        )


def mesh_detail(mesh: ControlMesh, transfer: Transfer) -> tuple[Detail, list[str]]:
    """`Detail` of a mesh over the source of a bake, and warnings."""
    source = transfer.point_map.source
    detail = detail_over(source, mesh.positions, cage_triangles(mesh)[0])
    share = detailed_share(detail, source)
    if share >= _COVERED:
        return detail, []
    return detail, [f"{100 * (1 - share):.1f} % of the source has nothing of {mesh.name} near it, and stays flat there"]


def in_source_space(mesh: ControlMesh, file: Path | None, folder: Path, result: MatchResult) -> ControlMesh:
    """A detailed mesh as read from a file, in the units and axes of the source's file."""
    return transform_mesh(mesh, between_spaces(input_file(folder, result.manifest, "source"), file))


def detail_texture(mesh: ControlMesh, path: Path, kind: Filter = "smooth") -> DetailTexture:
    """Read an image of a detailed mesh; refuse meshes without texture coordinates."""
    if mesh.uvs is None or mesh.uv_indices is None:
        raise ParameterError(f"{mesh.name}: expected texture coordinates for --detail-texture, the mesh has none")
    texture = read_texture_of(mesh, path)
    triangles = fan_triangles(mesh.face_offsets, mesh.uv_indices)[0]
    return DetailTexture(texture_pixels(texture), first_image(texture), mesh.uvs, triangles, kind)


def vertex_colors(mesh: ControlMesh) -> FloatArray:
    """(n, 3) vertex colours of a detailed mesh, grey for vertices without one; refuse meshes without them."""
    if mesh.vertex_colors is None or not np.isfinite(mesh.vertex_colors).any():
        raise ParameterError(
            f"{mesh.name}: expected colours at its vertices to bake, got none (OBJ: six numbers a `v` line; PLY: red, "
            f"green, blue). {colors_remedy(mesh)}"
        )
    return np.where(_is_colored(mesh)[:, None], mesh.vertex_colors, encode_srgb(np.array(UNKNOWN_COLOR)))


def detail_colors(mesh: ControlMesh | None, source: Refinement) -> tuple[FloatArray, list[str]]:
    """`vertex_colors` of a detailed mesh, or of the source's finest level without one; a warning if some are grey."""
    colored = source.control if mesh is None else mesh
    colors = vertex_colors(colored)
    is_colored = _is_colored(colored)[np.unique(colored.face_indices)]
    grey = int(np.count_nonzero(~is_colored))
    text = f"{colored.name}: {grey} of {len(is_colored)} vertices have no colour and are baked in grey"
    if mesh is None:
        colors = source.prolong(colors, 0, source.finest_level).clip(0.0, 1.0)
    return colors, [text] if grey else []


def _is_colored(mesh: ControlMesh) -> NDArray[np.bool_]:
    """(n,) whether a vertex has a colour."""
    assert mesh.vertex_colors is not None
    return np.asarray(np.isfinite(mesh.vertex_colors).all(axis=1))


def bake_detail(
    bakes: DetailBakes,
    transfer: Transfer,
    detail: Detail,
    colors: FloatArray | None,
    tiles: list[int],
    stages: Stages,
    units: str,
    finished: Callable[[BakeKind], Callable[[Image, BakeOptions], Image]] = lambda _: lambda image, _: image,
    write_mesh: Callable[[], None] = lambda: None,
) -> list[str]:
    """Bake and write all images together; returns one line about each.

    ``colors``: (n, 3) at the detail's vertices, or None if colours are not requested.
    ``units``: owner of the units of lengths, for the lines.
    ``finished``: kind -> function from a baked image to the image to write.
    ``write_mesh``: writes the mesh that belongs to the images.
    """
    lines, request, image = [], bakes.request, bakes.texture
    space, green = request.space, request.green
    lookups = None
    if image is not None:
        lookups = plain_lookups(lay_texture(image.texture, image.uvs, image.uv_triangles), image.filter)

    def bake(
        kind: BakeKind, values: FloatArray | None, dtype: np.dtype[Any], scale: float, *, options: BakeOptions
    ) -> Pixels | Image | Displacement:
        given: dict[str, Any] = {"size": bakes.size_of(kind), "dtype": dtype, "options": options}
        if kind == "texture" and image is not None:
            given |= {"options": replace(options, filter=image.filter), "lookups": lookups}
            pixels = bake_detail_texture(transfer, detail, image.texture, image.uvs, image.uv_triangles, **given)
            return replace(image.first, pixels=pixels)
        if kind == "normal":
            return bake_detail_normals(transfer, detail, space=space, green=green, **given)
        if kind == "displacement":
            return bake_detail_heights(transfer, detail, scale=scale, **given)
        if kind == "vector-displacement":
            return bake_detail_vectors(transfer, detail, space=space, scale=scale, **given)
        assert values is not None
        return bake_detail_values(transfer, detail, values, **given)

    with all_or_nothing():
        write_mesh()
        for kind, path in bakes.images.items():
            dtype, scale, values = bakes.dtype(kind), 1.0, colors
            if kind == "ao":
                stages("ambient occlusion")
                values = ambient_occlusion(detail.surface, request.rays)
            elif kind == "colors" and colors is not None and dtype.kind == "f":  # images of floats are linear
                values = decode_srgb(colors)
            elif kind in ("displacement", "vector-displacement") and dtype.kind == "u":
                stages(f"range of {kind}")
                scale = _range(partial(bake, kind, None, np.dtype(np.float32), 1.0), tiles)
                scale = scale if scale > _ROUNDING_LENGTH * np.abs(transfer.target.positions).max() else 1.0
            bake_kind = partial(bake, kind, values, dtype, scale)
            write_tiles(path, tiles, bake_kind, stages, finished(kind), force=request.force, name=kind)
            meaning = f"(value - {0.5 if dtype.kind == 'u' else 0.0:g}) * {scale:.6g} in {units} units"
            descriptions: dict[BakeKind, str] = {
                "normal": f"normals in {request.space} space, green {request.green}",
                "displacement": f"height along the normal = {meaning}",
                "vector-displacement": f"offset in {request.space} space = {meaning}",
                "ao": "ambient occlusion",
                "colors": "colours",
                "texture": "the detailed mesh's texture",
            }
            lines.append(f"wrote {path}: {descriptions[kind]}")
    return lines


def _range(bake: Callable[..., Pixels | Image | Displacement], tiles: list[int]) -> float:
    """Scale of integer images: length between the values 0 and 1 that holds all floats of a bake."""
    largest = 0.0
    for tile in tiles:
        baked = bake(options=BakeOptions(tile=tile))
        pixels = baked.pixels if isinstance(baked, Displacement | Image) else baked
        largest = max(largest, float(np.abs(pixels).max()))
    # Slightly larger, since the maximum is rounded to single precision.
    return 2.0 * (1.0 + 1e-6) * largest


def wrap_bakes(request: WrapRequest) -> DetailBakes:
    """Images to bake onto the wrapped cage."""
    images: dict[BakeKind, Path | None] = {
        "normal": request.normal_map,
        "displacement": request.displacement,
        "vector-displacement": request.vector_displacement,
        "ao": request.occlusion,
        "colors": request.colors,
        "texture": request.baked if request.detail_texture is not None else None,
    }
    given = {kind: path for kind, path in images.items() if path is not None}
    return DetailBakes(given, request.size, None, request)


def outputs_beside(request: WrapRequest) -> list[Path]:
    """Further output files: images, or patterns of their tiles, and a file for MakeHuman."""
    return [path for name in WRITTEN["wrap"] if (path := getattr(request, name)) is not None]


def require_wrappable(request: WrapRequest, target: ControlMesh, source: ControlMesh) -> ControlMesh | None:
    """Refuse a plain target, and images that cannot be baked; returns the detailed mesh, if any."""
    if isinstance(default_scheme(target), Plain):
        raise ParameterError(f"{target.name}: {NO_CAGE}")
    images = wrap_bakes(request).images
    if images or request.texture is not None:
        require_layout(target)
    if request.texture is not None:
        require_source_uvs(source)
        if request.texture.suffix.lower() in MESH_SUFFIXES and ply_image(request.texture) == request.texture:
            document = material_document(request.texture, source)
            if color_texture(document, source) is None and material_atlas(document, source) is None:
                require_color_texture(request.texture, document, source, _OTHER_TEXTURE)
    if "colors" in images and request.detail is None:
        vertex_colors(source)
    if request.detail is None:
        return None
    detail = read_mesh(request.detail)
    if "colors" in images:
        vertex_colors(detail)
    return detail


def bake_wrapped(
    request: WrapRequest, result: MatchResult, wrapped: Wrapped, mesh: ControlMesh | None, stages: Stages
) -> tuple[list[str], list[str]]:
    """Bake the requested images of a detailed mesh or the source; returns lines and warnings."""
    bakes = wrap_bakes(request)
    if not bakes.images:
        return [], []
    stages("detail")
    target, source = result.target.refinement, result.source.refinement
    warnings: list[str] = []
    colors = None
    if mesh is None:
        transfer, detail, fine = missing_detail(wrapped, target, source)
    else:
        fine = source
        transfer, follow = wrapped_transfer(wrapped, target)
        mesh = in_source_space(mesh, request.detail, request.results[0], result)
        if request.detail_texture is not None:
            bakes = replace(bakes, texture=detail_texture(mesh, request.detail_texture))
            bakes.check()
        detail, warnings = mesh_detail(mesh, transfer)
        detail = replace(detail, follow=follow)
    if "colors" in bakes.images:
        colors, notes = detail_colors(mesh, fine)
        warnings = [*warnings, *notes]
    tiles, outside = layout_tiles(transfer)
    images = [udim_path(path, tile) for path in bakes.images.values() for tile in tiles]
    textures = [path for path in (request.texture, request.detail_texture) if path is not None]
    check_outputs(images, [file for path in textures for file in texture_files(path)], force=request.force)
    lines = bake_detail(bakes, transfer, detail, colors, tiles, stages, "the source's")
    control = result.target.control
    return lines, [*warnings, *outside, *missing_uv_warnings(control), *target_overlap_warnings(control)]
