"""Images baked onto a wrapped cage: the residual to the source, or a more detailed mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import cast

from cagemap.errors import ParameterError
from cagemap.files.atomic import check_outputs
from cagemap.files.images.image import read_image_form, texture_files, udim_path
from cagemap.files.meshes.formats import read_mesh
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.tasks.bake_tiles import DEFAULT_SIZE, doubled_target, layout_tiles
from cagemap.tasks.detail_bakes import DetailBakes, Kind, bake_detail, detail_texture, mesh_detail, vertex_colors
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.transfer.vectors import Green, Space
from cagemap.wrap import Wrapped, missing_detail, wrapped_transfer


def wrap_bakes(request: WrapRequest) -> DetailBakes:
    """What is to be baked onto the wrapped cage."""
    images: dict[Kind, Path | None] = {
        "normal": request.normal_map,
        "displacement": request.displacement,
        "vector-displacement": request.vector_displacement,
        "ao": request.occlusion,
        "colors": request.colors,
        "texture": request.baked if request.detail_texture is not None else None,
    }
    return DetailBakes(
        {kind: path for kind, path in images.items() if path is not None},
        request.size or DEFAULT_SIZE,
        None,
        cast(Space, request.space),
        cast(Green, request.green),
        request.rays,
        request.force,
    )


def outputs_beside(request: WrapRequest) -> list[Path]:
    """What is written beside the mesh: images, or patterns of their tiles, and a file for MakeHuman."""
    carried = None if request.detail_texture is not None else request.baked
    others = (path for path in (carried, request.mhclo) if path is not None)
    return [*wrap_bakes(request).images.values(), *others]


def textures_read(request: WrapRequest) -> list[Path]:
    """Images that are read, tile by tile."""
    given = (path for path in (request.texture, request.detail_texture) if path is not None)
    return [file for path in given for file in texture_files(path)]


def require_bakeable(request: WrapRequest, result: MatchResult) -> ControlMesh | None:
    """Refuse images that cannot be baked, before any work is done for the mesh; gives the detailed mesh, if any."""
    images, control = wrap_bakes(request).images, result.target.control
    if images and control.uvs is None:
        raise ParameterError(
            f"{control.name}: expected texture coordinates to bake into, the mesh has none. Unwrap it in your "
            "modelling program and match again."
        )
    if "colors" in images and request.detail is None:
        vertex_colors(result.source.control)
    for texture in textures_read(request):
        read_image_form(texture)
    if request.detail is None:
        return None
    detail = read_mesh(request.detail)
    if "colors" in images:
        vertex_colors(detail)
    return detail


def bake_wrapped(
    request: WrapRequest, result: MatchResult, wrapped: Wrapped, mesh: ControlMesh | None, stages: Stages
) -> tuple[list[str], list[str]]:
    """Bake the images that were asked for, of a detailed mesh or the source; returns lines about them and warnings."""
    bakes = wrap_bakes(request)
    if not bakes.images:
        return [], []
    stages("detail")
    target, source = result.target.refinement, result.source.refinement
    warnings: list[str] = []
    colors = None
    if mesh is None:
        transfer, detail, fine = missing_detail(wrapped, target, source)
        if "colors" in bakes.images:
            colors = fine.prolong(vertex_colors(source.control), 0, fine.n_levels).clip(0.0, 1.0)
    else:
        transfer, follow = wrapped_transfer(wrapped, target)
        if request.detail_texture is not None:
            bakes = replace(bakes, texture=detail_texture(mesh, request.detail_texture))
            bakes.check()
        detail, warnings = mesh_detail(mesh, transfer)
        detail = replace(detail, follow=follow)
        colors = vertex_colors(mesh) if "colors" in bakes.images else None
    tiles, outside = layout_tiles(transfer)
    images = [udim_path(path, tile) for path in bakes.images.values() for tile in tiles]
    check_outputs(images, textures_read(request), force=request.force)
    lines = bake_detail(bakes, transfer, detail, colors, tiles, stages, "the source's")
    return lines, [*warnings, *outside, *doubled_target(result.target.control)]
