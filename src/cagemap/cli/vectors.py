"""`cagemap transfer`: normal maps, vector displacement and vertex colours."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from cagemap.cli.progress import Stages
from cagemap.files.images import texture_pixels, udim_path, write_image
from cagemap.files.result import stated_path
from cagemap.files.result_values import Result
from cagemap.transfer.baking import BakeOptions
from cagemap.transfer.vectors import Green, Space, bake_normal_map, bake_vector_displacement

if TYPE_CHECKING:
    from cagemap.cli.transfer import TransferRequest

Outcome = tuple[str, list[str]]


def carry_normal_map(request: TransferRequest, result: Result, stages: Stages) -> Outcome:
    """A normal map, in tangent or object space."""
    from cagemap.cli.transfer import finish, prepare_bake, read_source_image

    assert request.normal_map is not None
    texture, first, dtype = read_source_image(request, request.normal_map, 3)
    size = request.size or max(first.size)
    prepared = prepare_bake(request, result, stages)
    stages("bake")
    for tile in prepared.tiles:
        pixels = bake_normal_map(
            prepared.transfer,
            texture_pixels(texture),
            size=size,
            space=cast(Space, request.space),
            green=cast(Green, request.green),
            dtype=dtype,
            options=BakeOptions(tile=tile),
        )
        write_image(udim_path(request.output, tile), pixels, force=request.force)
    image = stated_path(request.normal_map, request.result)
    return finish(request, prepared, {"kind": "normal-map", "image": image, "size": size, "space": request.space})


def carry_vector_displacement(request: TransferRequest, result: Result, stages: Stages) -> Outcome:
    """Vector displacement, in tangent or object space."""
    from cagemap.cli.transfer import finish, prepare_bake, read_source_image

    assert request.vector_displacement is not None
    texture, first, dtype = read_source_image(request, request.vector_displacement, 3)
    size = request.size or max(first.size)
    prepared = prepare_bake(request, result, stages)
    stages("bake")
    for tile in prepared.tiles:
        baked = bake_vector_displacement(
            prepared.transfer,
            texture_pixels(texture),
            size=size,
            space=cast(Space, request.space),
            midlevel=request.midlevel,
            scale=request.scale,
            dtype=dtype,
            options=BakeOptions(tile=tile),
        )
        write_image(udim_path(request.output, tile), baked.pixels, force=request.force)
    entry = {
        "kind": "vector-displacement",
        "image": stated_path(request.vector_displacement, request.result),
        "size": size,
        "space": request.space,
        "midlevel": baked.midlevel,
        "scale": baked.scale,
    }
    summary, warnings = finish(request, prepared, entry)
    return f"{summary}\n  vector = (value - {baked.midlevel:g}) * {baked.scale:.6g} in the target's units", warnings
