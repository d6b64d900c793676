"""From a match, fresh or read back, to baked images in one call."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from numpy.typing import DTypeLike

from cagemap.maps.masks import Masks
from cagemap.maps.point_map import PointMap
from cagemap.refinement import Refinement
from cagemap.transfer.baking import BakeOptions, Transfer, bake_texture, prepare_transfer
from cagemap.transfer.texture import Pixels


class Refined(Protocol):
    """A surface with its refinement, such as `cagemap.Surface` and a side of a result that was read."""

    @property
    def refinement(self) -> Refinement:
        """All levels."""


class Matched(Protocol):
    """Two surfaces and the map between them: what `cagemap.match` gives, and what `cagemap.read_result` gives."""

    @property
    def target(self) -> Refined:
        """The surface that receives."""

    @property
    def source(self) -> Refined:
        """The surface that gives."""

    @property
    def point_map(self) -> PointMap:
        """T12, between the finest levels."""

    @property
    def masks(self) -> Masks:
        """What of both surfaces counts."""


def transfer_of(result: Matched) -> Transfer:
    """Put a match into the form that bakes need; keep it for several images.

    Parameters
    ----------
    result : MatchResult or Result
    """
    levels = result.target.refinement.finest, result.source.refinement.finest
    return prepare_transfer(*levels, result.point_map, result.masks)


def bake(
    result: Matched,
    texture: Pixels | Mapping[int, Pixels],
    *,
    size: int | tuple[int, int],
    dtype: DTypeLike | None = None,
    options: BakeOptions | None = None,
) -> Pixels:
    """Bake the source's texture into the target's layout; `bake_texture` of `transfer_of` a match.

    Parameters
    ----------
    result : MatchResult or Result
        Of `cagemap.match` or `cagemap.read_result`.
    texture, size, dtype, options
        See `cagemap.bake_texture`.
    """
    return bake_texture(transfer_of(result), texture, size=size, dtype=dtype, options=options)
