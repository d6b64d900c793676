"""`cagemap transfer --bake`: normals, displacement, occlusion and colours of a detailed mesh over the source."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import cast

from cagemap.errors import ParameterError
from cagemap.files.images.image import udim_path
from cagemap.files.meshes.formats import read_mesh
from cagemap.files.result.folder import note_transfer, stated_path
from cagemap.maps.result import MatchResult
from cagemap.tasks.bake_tiles import DEFAULT_SIZE, base_size, masking, prepare_bake, written_channels
from cagemap.tasks.detail_bakes import (
    KINDS,
    OFFSETS,
    DetailBakes,
    Kind,
    bake_detail,
    detail_texture,
    mesh_detail,
    vertex_colors,
)
from cagemap.tasks.progress import Outcome, Stages
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.texture_maps import map_path
from cagemap.transfer.detail import Detail
from cagemap.transfer.texture import Filter
from cagemap.transfer.vectors import Green, Space


def carry_detail(request: TransferRequest, result: MatchResult, stages: Stages) -> Outcome:
    """Normals, displacement, ambient occlusion and colours of a detailed mesh, or of the source itself."""
    kinds = _kinds(request)
    images = {kind: map_path(request.output, kind if len(kinds) > 1 else "") for kind in kinds}
    bakes = DetailBakes(
        images,
        request.size or base_size(request, kinds[0]) or DEFAULT_SIZE,
        request.bits,
        cast(Space, request.space),
        cast(Green, request.green),
        request.rays,
        request.force,
    )
    mesh = None if request.detail is None else read_mesh(request.detail)
    if mesh is not None and request.detail_texture is not None:
        bakes = replace(bakes, texture=detail_texture(mesh, request.detail_texture, cast(Filter, request.filter)))
    own = {kind: bakes.channels(kind) for kind in kinds}
    bakes.check({kind: written_channels(request, result, own[kind], kind) - own[kind] for kind in kinds})
    prepared = prepare_bake(request, result, stages, list(images.values()))
    warnings = prepared.warnings
    if mesh is not None:
        stages("detail")
        detail, more = mesh_detail(mesh, prepared.transfer)
        warnings += more
        colors = vertex_colors(mesh) if "colors" in kinds else None
    else:
        detail, colors = Detail(prepared.transfer.point_map.source), None
        if "colors" in kinds:
            refinement = result.source.refinement
            colors = refinement.prolong(vertex_colors(refinement.control), 0, refinement.n_levels).clip(0.0, 1.0)
    lines = bake_detail(
        bakes,
        prepared.transfer,
        detail,
        colors,
        prepared.tiles,
        stages,
        "the target's",
        partial(masking, request, prepared),
    )
    for kind, path in images.items():
        place = udim_path(path, prepared.tiles[0])
        entry = {"kind": f"bake-{kind}", "output": stated_path(place, request.result), "tiles": prepared.tiles}
        note_transfer(request.result, {**entry, "size": bakes.size, "space": request.space})
    if prepared.mesh is not None:
        lines.append(f"wrote {prepared.mesh}")
    return "\n".join(lines), warnings


def _kinds(request: TransferRequest) -> list[Kind]:
    """What to bake, checked."""
    names = list(dict.fromkeys(request.bake))
    unknown = [name for name in names if name not in KINDS]
    if unknown:
        raise ParameterError(f"--bake: expected some of {', '.join(KINDS)}, got {', '.join(unknown)}")
    kinds = [cast(Kind, name) for name in names]
    if ("texture" in kinds) != (request.detail_texture is not None):
        raise ParameterError("--bake texture and --detail-texture: expected both or neither, got one of them")
    if request.detail_texture is not None and request.detail is None:
        raise ParameterError("--detail-texture: expected --detail, the mesh that the image belongs to")
    flat = [kind for kind in kinds if kind in OFFSETS]
    if flat and request.detail is None:
        raise ParameterError(
            f"--bake {','.join(flat)}: expected --detail, a detailed mesh that lies on the source, since a surface has "
            "no detail over itself. To bake the source onto a cage that is wrapped on it, use `cagemap wrap "
            "--normal-map`."
        )
    return kinds
