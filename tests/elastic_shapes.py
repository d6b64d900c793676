"""A creature at unit area, and its whole elastic fit onto shapes of the same numbers."""

from __future__ import annotations

import numpy as np

from cagemap.basis import BasisConfig, Surface, hierarchical_basis
from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.elastic.config import ElasticConfig
from cagemap.maps.elastic.fit import coarse_fit, fine_fit
from cagemap.maps.elastic.graph import ElasticGraph, mesh_graph
from cagemap.maps.elastic.prepared import PreparedPair, RestShape, level_graph
from cagemap.maps.elastic.problem import FitProblem
from cagemap.maps.pair import Pair
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import map_of_places
from cagemap.maps.spectral.hierarchical import HierarchyConfig
from cagemap.mesh import ControlMesh
from cagemap.operators import build_operators
from cagemap.refinement import Refinement, level_triangles, refine


def unit_refinement(control: ControlMesh, level: int) -> tuple[Refinement, float]:
    refinement = refine(control, level)
    return refinement, build_operators(refinement).scale


def mesh_of(refinement: Refinement, scale: float, level: int) -> TriangleSurface:
    n = refinement.levels[level].n_vertices
    return TriangleSurface(scale * refinement.finest.positions[:n], level_triangles(refinement, level), scale)


def graph_of(refinement: Refinement, scale: float, level: int) -> tuple[ElasticGraph, TriangleSurface]:
    mesh, faces = mesh_of(refinement, scale, level), refinement.levels[level].faces
    return mesh_graph(mesh, mesh.triangles if faces is None else faces), mesh


def surface_of(refinement: Refinement) -> Surface:
    """A surface with few basis functions: the fit does not ask for any."""
    operators = build_operators(refinement)
    return Surface.of(refinement, operators, hierarchical_basis(refinement, operators, BasisConfig(count=4)))


def prepared_at(target: Surface, source: Surface, level: int, config: ElasticConfig) -> PreparedPair:
    """A prepared pair that deforms a level of the target; both surfaces are small, so the sheet is the finest."""
    rest = RestShape.build(level_graph(target, level), target.triangles(level), config.fine.smoothing)
    sheet = source.triangles(source.finest)
    return PreparedPair(target, source, HierarchyConfig(), config, (level, source.finest), rest, sheet)


def fitted_map(
    target: Refinement,
    source: Refinement,
    level: int,
    match: np.ndarray,
    landmarks: np.ndarray,
    config: ElasticConfig = ElasticConfig(),
) -> PointMap:
    """The whole fit, from a source vertex for every target vertex of a level; landmarks have the same numbers."""
    pair = Pair.of_vertices(surface_of(target), surface_of(source), landmarks, landmarks)
    prepared = prepared_at(pair.target, pair.source, level, config)
    problem = FitProblem(prepared, pair)
    start = prepared.on_source.positions[match[problem.shape.vertices]]
    started = [coarse_fit(problem, first) for first in (start, None)]
    fitted = fine_fit(problem, min(started, key=lambda ended: ended.cost))
    return map_of_places(prepared, fitted, pair.landmarks)
