"""Wrap: fit the target's cage such that its refined surface is on the source."""

from cagemap.wrap.config import WrapConfig
from cagemap.wrap.net import level_mesh
from cagemap.wrap.wrapping import Residual, Wrapped, missing_detail, wrap, wrapped_transfer

__all__ = ["Residual", "WrapConfig", "Wrapped", "level_mesh", "missing_detail", "wrap", "wrapped_transfer"]
