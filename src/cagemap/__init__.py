"""Dense maps between subdivision surfaces from their control meshes and a few landmarks.

The public names below are imported on first use, so that ``import cagemap`` (and the command's ``--help``) stays
light. So are the packages they come from, such as `cagemap.wrap`: see docs/architecture.md.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:
    from cagemap.deform.config import ElasticConfig as ElasticConfig
    from cagemap.deform.problem import PreparedPair as PreparedPair
    from cagemap.diffusion_net import operators_for_diffusion_net as operators_for_diffusion_net
    from cagemap.errors import CagemapError as CagemapError
    from cagemap.files.images.image import read_image as read_image
    from cagemap.files.images.image import write_image as write_image
    from cagemap.files.landmarks.pairs import read_landmarks as read_landmarks
    from cagemap.files.meshes.formats import read_mesh as read_mesh
    from cagemap.files.meshes.formats import write_mesh as write_mesh
    from cagemap.files.result.folder import read_result as read_result
    from cagemap.files.result.folder import write_result as write_result
    from cagemap.maps.functional_maps import functional_map_of as functional_map_of
    from cagemap.maps.geodesic import geodesic_error as geodesic_error
    from cagemap.maps.hypotheses.search import fit as fit
    from cagemap.maps.masks import Masks as Masks
    from cagemap.maps.masks import face_mask as face_mask
    from cagemap.maps.masks import soft_edge as soft_edge
    from cagemap.maps.masks import vertex_mask as vertex_mask
    from cagemap.maps.pair import Pair as Pair
    from cagemap.maps.pair import PointPairs as PointPairs
    from cagemap.maps.point_map import PointMap as PointMap
    from cagemap.maps.projection.project import project as project
    from cagemap.maps.projection.project import unfold as unfold
    from cagemap.maps.quality import QualityFigures as QualityFigures
    from cagemap.maps.quality import judge as judge
    from cagemap.maps.regions import RegionFigures as RegionFigures
    from cagemap.maps.regions import region_figures as region_figures
    from cagemap.maps.result import MatchResult as MatchResult
    from cagemap.match_config import MatchConfig as MatchConfig
    from cagemap.mesh import CatmullClark as CatmullClark
    from cagemap.mesh import ControlMesh as ControlMesh
    from cagemap.mesh import Loop as Loop
    from cagemap.mesh import Plain as Plain
    from cagemap.mesh.checks import check_mesh as check_mesh
    from cagemap.mesh.landmarks import Landmarks as Landmarks
    from cagemap.mesh.plain import plain_mesh as plain_mesh
    from cagemap.mesh.repairs import RepairedMesh as RepairedMesh
    from cagemap.mesh.weld import weld_mesh as weld_mesh
    from cagemap.numerics.threads import thread_limit as thread_limit
    from cagemap.operators import Operators as Operators
    from cagemap.operators import build_operators as build_operators
    from cagemap.pipeline import choose_level as choose_level
    from cagemap.pipeline import default_basis as default_basis
    from cagemap.pipeline import match as match
    from cagemap.pipeline import match_next as match_next
    from cagemap.pipeline import match_pair as match_pair
    from cagemap.pipeline import pair_of as pair_of
    from cagemap.pipeline import prepare_pair as prepare_pair
    from cagemap.pipeline import prepare_surface as prepare_surface
    from cagemap.pipeline import prepare_surfaces as prepare_surfaces
    from cagemap.pipeline import update_match as update_match
    from cagemap.report import write_report as write_report
    from cagemap.spectral import BasisConfig as BasisConfig
    from cagemap.spectral import HierarchicalBasis as HierarchicalBasis
    from cagemap.spectral import Surface as Surface
    from cagemap.spectral.mesh_eigenpairs import eigenpairs as eigenpairs
    from cagemap.subdivision import Refinement as Refinement
    from cagemap.subdivision import refine as refine
    from cagemap.surface.triangle_surface import SurfacePoints as SurfacePoints
    from cagemap.surface.triangle_surface import TriangleSurface as TriangleSurface
    from cagemap.tasks.carry_arrays import carry_shapes as carry_shapes
    from cagemap.tasks.carry_arrays import carry_values as carry_values
    from cagemap.tasks.carry_arrays import carry_weights as carry_weights
    from cagemap.transfer import BakeOptions as BakeOptions
    from cagemap.transfer import bake as bake
    from cagemap.transfer import bake_displacement as bake_displacement
    from cagemap.transfer import bake_texture as bake_texture
    from cagemap.transfer import prepare_transfer as prepare_transfer
    from cagemap.transfer import transfer_of as transfer_of
    from cagemap.transfer.masks import bake_mask as bake_mask
    from cagemap.transfer.masks import blend as blend
    from cagemap.transfer.masks import painted_mask as painted_mask
    from cagemap.transfer.masks import with_alpha as with_alpha
    from cagemap.transfer.unwrap import unwrap as unwrap

# Public names by package; `__all__` and `dir` are made from it.
_PACKAGES = {
    "spectral": ("BasisConfig", "HierarchicalBasis", "Surface"),
    "spectral.mesh_eigenpairs": ("eigenpairs",),
    "diffusion_net": ("operators_for_diffusion_net",),
    "deform.config": ("ElasticConfig",),
    "deform.problem": ("PreparedPair",),
    "errors": ("CagemapError",),
    "files.images.image": ("read_image", "write_image"),
    "files.landmarks.pairs": ("read_landmarks",),
    "files.meshes.formats": ("read_mesh", "write_mesh"),
    "files.result.folder": ("read_result", "write_result"),
    "surface.triangle_surface": ("SurfacePoints", "TriangleSurface"),
    "maps.hypotheses.search": ("fit",),
    "maps.geodesic": ("geodesic_error",),
    "maps.functional_maps": ("functional_map_of",),
    "maps.masks": ("Masks", "face_mask", "soft_edge", "vertex_mask"),
    "maps.pair": ("Pair", "PointPairs"),
    "maps.point_map": ("PointMap",),
    "maps.projection.project": ("project", "unfold"),
    "maps.quality": ("QualityFigures", "judge"),
    "maps.regions": ("RegionFigures", "region_figures"),
    "maps.result": ("MatchResult",),
    "match_config": ("MatchConfig",),
    "mesh": ("CatmullClark", "ControlMesh", "Loop", "Plain"),
    "mesh.checks": ("check_mesh",),
    "mesh.landmarks": ("Landmarks",),
    "mesh.plain": ("plain_mesh",),
    "mesh.repairs": ("RepairedMesh",),
    "mesh.weld": ("weld_mesh",),
    "numerics.threads": ("thread_limit",),
    "operators": ("Operators", "build_operators"),
    "pipeline": (
        "choose_level",
        "default_basis",
        "match",
        "match_next",
        "match_pair",
        "pair_of",
        "prepare_pair",
        "prepare_surface",
        "prepare_surfaces",
        "update_match",
    ),
    "subdivision": ("Refinement", "refine"),
    "report": ("write_report",),
    "tasks.carry_arrays": ("carry_shapes", "carry_values", "carry_weights"),
    "transfer": ("BakeOptions", "bake", "bake_displacement", "bake_texture", "prepare_transfer", "transfer_of"),
    "transfer.unwrap": ("unwrap",),
    "transfer.masks": ("bake_mask", "blend", "painted_mask", "with_alpha"),
}
_PACKAGE_OF = {name: package for package, names in _PACKAGES.items() for name in names}

__all__ = sorted(_PACKAGE_OF)


def __getattr__(name: str) -> object:
    if name in _PACKAGE_OF:
        return getattr(import_module(f"cagemap.{_PACKAGE_OF[name]}"), name)
    from importlib.util import find_spec  # here, since `--help` needs no package

    if find_spec(f"cagemap.{name}") is not None:
        return import_module(f"cagemap.{name}")
    raise AttributeError(f"module 'cagemap' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
