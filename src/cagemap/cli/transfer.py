"""`cagemap transfer`: something of the source, carried to the target."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cagemap.cli.progress import Stages
from cagemap.errors import ParameterError
from cagemap.files.images import (
    Image,
    check_writable,
    pixel_type,
    read_texture,
    texture_pixels,
    udim_path,
    write_image,
)
from cagemap.files.result import Result, note_transfer, read_result
from cagemap.point_map.point_map import PointMap
from cagemap.transfer.bake import BakeOptions, Transfer, bake_texture, prepare_transfer, target_tiles

DEFAULT_SIZE = 2048


@dataclass(frozen=True)
class TransferRequest:
    """What the user asked for, as said on the command line."""

    result: Path
    output: Path
    texture: Path | None = None
    displacement: Path | None = None
    attribute: Path | None = None
    material_colors: bool = False
    size: int | None = None
    bits: int | None = None
    unwrap: bool = False


def run_transfer(request: TransferRequest, stages: Stages) -> tuple[str, list[str]]:
    """Carry one thing from source to target and write it; returns a summary and warnings."""
    kind = _kind(request)
    stages("read")
    result = read_result(request.result)
    carry = _CARRIERS[kind]
    return carry(request, result, stages)


def _kind(request: TransferRequest) -> str:
    given = {
        "--texture": request.texture is not None,
        "--displacement": request.displacement is not None,
        "--attribute": request.attribute is not None,
        "--material-colors": request.material_colors,
    }
    chosen = [option for option, there in given.items() if there]
    if len(chosen) != 1:
        raise ParameterError(
            f"expected one of {', '.join(given)}, got {' and '.join(chosen) or 'none'}. Run the command once for each."
        )
    return chosen[0]


def _prepare(result: Result, stages: Stages) -> Transfer:
    stages("prepare")
    return prepare_transfer(
        result.target.refinement().finest,
        result.source.refinement().finest,
        PointMap(result.triangle, result.barycentric),
    )


def _carry_texture(request: TransferRequest, result: Result, stages: Stages) -> tuple[str, list[str]]:
    assert request.texture is not None
    texture = read_texture(request.texture)
    first = texture if isinstance(texture, Image) else next(iter(texture.values()))
    dtype = first.pixels.dtype if request.bits is None else pixel_type(request.bits, request.output.suffix)
    check_writable(request.output, dtype, first.pixels.shape[2])
    size = request.size or max(first.size)
    transfer = _prepare(result, stages)
    tiles = target_tiles(result.target.refinement().finest)
    stages("bake")
    for tile in tiles:
        pixels = bake_texture(transfer, texture_pixels(texture), size=size, dtype=dtype, options=BakeOptions(tile=tile))
        write_image(udim_path(request.output, tile), replace(first, pixels=pixels))
    entry = {"kind": "texture", "image": request.texture.resolve(), "tiles": tiles}
    return _finish(request, entry, [udim_path(request.output, tile) for tile in tiles], size), []


def _finish(request: TransferRequest, entry: dict[str, Any], outputs: list[Path], size: int) -> str:
    note_transfer(request.result, {**entry, "output": outputs[0].resolve()})
    return f"wrote {', '.join(map(str, outputs))}, {size} x {size}"


_CARRIERS = {"--texture": _carry_texture}
