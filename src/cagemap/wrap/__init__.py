"""Wrap: fit the target's cage such that its refined surface is on the source."""

from cagemap.wrap.net import WrapConfig as WrapConfig
from cagemap.wrap.net import level_mesh as level_mesh
from cagemap.wrap.wrapping import Wrapped as Wrapped
from cagemap.wrap.wrapping import missing_detail as missing_detail
from cagemap.wrap.wrapping import wrap as wrap
from cagemap.wrap.wrapping import wrapped_transfer as wrapped_transfer
