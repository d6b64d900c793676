"""Bake images of a match in one call."""

from __future__ import annotations

from collections.abc import Mapping

from numpy.typing import DTypeLike

from cagemap.maps.result import MatchResult
from cagemap.numerics.kinds import kinds_checked
from cagemap.transfer.baking import BakeOptions, Transfer, bake_texture, prepare_transfer
from cagemap.transfer.texture import Pixels


@kinds_checked
def transfer_of(result: MatchResult) -> Transfer:
    """Prepare a match for bakes; one `Transfer` serves several images."""
    target = result.target.refinement
    holes = target.holes(target.finest_level)
    return prepare_transfer(target.finest, result.source.refinement.finest, result.point_map, result.masks, holes)


@kinds_checked
def bake(
    result: MatchResult,
    texture: Pixels | Mapping[int, Pixels],
    *,
    size: int | tuple[int, int],
    dtype: DTypeLike | None = None,
    options: BakeOptions | None = None,
) -> Pixels:
    """Bake the source's texture into the target's layout: `bake_texture` after `transfer_of`.

    Parameters
    ----------
    result : MatchResult
        Of `cagemap.match` or `cagemap.read_result`.
    texture, size, dtype, options
        See `cagemap.bake_texture`.
    """
    return bake_texture(transfer_of(result), texture, size=size, dtype=dtype, options=options)
