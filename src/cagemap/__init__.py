"""Dense maps between subdivision surfaces from their control meshes and a few landmarks.

The public names below are imported on first use, so that ``import cagemap`` (and the command's ``--help``) stays
light. The rooms they come from are importable too, for researchers: see docs/architecture.md.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:
    from cagemap.basis import BasisConfig as BasisConfig
    from cagemap.basis import HierarchicalBasis as HierarchicalBasis
    from cagemap.basis import Surface as Surface
    from cagemap.errors import CagemapError as CagemapError
    from cagemap.files.landmarks import read_landmarks as read_landmarks
    from cagemap.files.meshes import read_mesh as read_mesh
    from cagemap.files.meshes import write_mesh as write_mesh
    from cagemap.files.result import read_result as read_result
    from cagemap.files.result import write_result as write_result
    from cagemap.maps.point_map import PointMap as PointMap
    from cagemap.mesh import ControlMesh as ControlMesh
    from cagemap.mesh.checks import check_mesh as check_mesh
    from cagemap.mesh.landmarks import Landmarks as Landmarks
    from cagemap.numerics.threads import thread_limit as thread_limit
    from cagemap.operators import Operators as Operators
    from cagemap.operators import build_operators as build_operators
    from cagemap.pipeline import MatchConfig as MatchConfig
    from cagemap.pipeline import MatchResult as MatchResult
    from cagemap.pipeline import choose_level as choose_level
    from cagemap.pipeline import match as match
    from cagemap.pipeline import prepare_surface as prepare_surface
    from cagemap.pipeline import update_match as update_match
    from cagemap.refinement import CatmullClark as CatmullClark
    from cagemap.refinement import Loop as Loop
    from cagemap.refinement import Refinement as Refinement
    from cagemap.refinement import refine as refine

_ROOMS = {
    "basis": ("BasisConfig", "HierarchicalBasis", "Surface"),
    "errors": ("CagemapError",),
    "files.landmarks": ("read_landmarks",),
    "files.meshes": ("read_mesh", "write_mesh"),
    "files.result": ("read_result", "write_result"),
    "mesh": ("ControlMesh",),
    "mesh.checks": ("check_mesh",),
    "mesh.landmarks": ("Landmarks",),
    "numerics.threads": ("thread_limit",),
    "operators": ("Operators", "build_operators"),
    "pipeline": ("MatchConfig", "MatchResult", "choose_level", "match", "prepare_surface", "update_match"),
    "maps.point_map": ("PointMap",),
    "refinement": ("CatmullClark", "Loop", "Refinement", "refine"),
}
_ROOM_OF = {name: room for room, names in _ROOMS.items() for name in names}

__all__ = [
    "BasisConfig",
    "CagemapError",
    "CatmullClark",
    "ControlMesh",
    "HierarchicalBasis",
    "Landmarks",
    "Loop",
    "MatchConfig",
    "MatchResult",
    "Operators",
    "PointMap",
    "Refinement",
    "Surface",
    "build_operators",
    "check_mesh",
    "choose_level",
    "match",
    "prepare_surface",
    "read_landmarks",
    "read_mesh",
    "read_result",
    "refine",
    "thread_limit",
    "write_mesh",
    "write_result",
]


def __getattr__(name: str) -> object:
    if name not in _ROOM_OF:
        raise AttributeError(f"module 'cagemap' has no attribute {name!r}")
    return getattr(import_module(f"cagemap.{_ROOM_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
