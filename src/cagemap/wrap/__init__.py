"""Wrap: the target's cage in the source's shape, such that the refined surface lies on the source."""

from cagemap.wrap.fit import WrapConfig
from cagemap.wrap.net import level_mesh
from cagemap.wrap.offsets import Offsets, offsets_to_source
from cagemap.wrap.wrapping import Residual, Wrapped, wrap

__all__ = ["Offsets", "Residual", "WrapConfig", "Wrapped", "level_mesh", "offsets_to_source", "wrap"]
