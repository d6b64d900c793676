"""What the elastic fit needs of two surfaces before any landmark: built once, used for every set of landmarks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cagemap.basis import Surface
from cagemap.geometry.surface import TriangleSurface
from cagemap.geometry.triangles import vertex_normals
from cagemap.maps.elastic.anchors import Anchors
from cagemap.maps.elastic.config import ElasticConfig, StartConfig
from cagemap.maps.elastic.constants import CURVE_SHARE, PULLERS, SHEET_VERTICES
from cagemap.maps.elastic.counterparts import received_factors
from cagemap.maps.elastic.curves import PulledCurve, with_clusters
from cagemap.maps.elastic.data import Pullers
from cagemap.maps.elastic.graph import DifferentialField, ElasticGraph, bounded_maps, cluster_graph, mesh_graph
from cagemap.maps.elastic.ties import Ties
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.spectral.levels import search_levels
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import Factorization
from cagemap.numerics.threads import ThreadPool, kept


@dataclass(frozen=True, eq=False)
class RestShape:
    """A graph with all that its rest shape alone decides: built before it is known where the shape goes.

    Attributes
    ----------
    graph : ElasticGraph
    field : DifferentialField
    mesh : TriangleSurface or None
        The mesh whose graph it is; None for clusters of one.
    received : Factorization or None
        See `received_weights`, of a mesh.
    masks : Masks
        What counts in the data: of the graph's vertices, and of the source's.
    """

    graph: ElasticGraph
    field: DifferentialField
    mesh: TriangleSurface | None
    received: Factorization | None
    masks: Masks = WHOLE

    @classmethod
    def build(
        cls, graph: ElasticGraph, mesh: TriangleSurface | None, smoothing: float, masks: Masks = WHOLE
    ) -> RestShape:
        """Factor the matrices that stay the same in all iterations of a stage."""
        laplacian = graph.laplacian()
        field = DifferentialField.build(graph, laplacian, smoothing)
        return cls(graph, field, mesh, None if mesh is None else received_factors(graph.areas, laplacian), masks)

    def at(self, positions: FloatArray, smoothing: float) -> RestShape:
        """The same mesh at rest at other positions (n, 3), with the weights of its edges and areas as they are."""
        assert self.mesh is not None
        normals = vertex_normals(positions, self.mesh.triangles)
        graph = replace(self.graph, positions=positions, normals=normals)
        return replace(self, graph=graph, field=DifferentialField.build(graph, graph.laplacian(), smoothing))

    def differentials(self, positions: FloatArray) -> tuple[FloatArray, IndexArray]:
        """(n, 3, 3) maps A for positions x (n, 3), none of which folds or flattens, and which of them were bounded."""
        return bounded_maps(self.field.solve(positions), self.graph.normals)

    def pullers(self, sheet: TriangleSurface) -> Pullers:
        """Points of the source that pull at the shape, or are looked for on it."""
        return Pullers.choose(sheet, int(PULLERS * self.graph.n), self.masks)


@dataclass(frozen=True, eq=False)
class CoarseShape:
    """Clusters of a mesh's vertices, for the stage that moves whole limbs.

    Attributes
    ----------
    rest : RestShape
        Of the k clusters.
    vertices : (k,) int64
        Vertex of the mesh that stands for each; those that were to have a cluster of their own come first.
    ties : Ties
        Landmarks, which are the first clusters, and curves, whose vertices have clusters of their own after them.
    """

    rest: RestShape
    vertices: IndexArray
    ties: Ties

    @classmethod
    def build(
        cls,
        graph: ElasticGraph,
        kept: IndexArray,
        places: FloatArray,
        config: ElasticConfig,
        masks: Masks = WHOLE,
        curves: tuple[PulledCurve, ...] = (),
    ) -> CoarseShape:
        """Cluster a mesh's graph, vertices (p,) held at places (p, 3) first, then some vertices of every curve."""
        every, own = with_clusters(curves, kept, config.coarse_vertices // CURVE_SHARE)
        coarse, vertices = cluster_graph(graph, min(config.coarse_vertices, graph.n), every)
        part = masks.for_vertices(vertices)
        ties = Ties(Anchors.of_vertices(np.arange(len(kept))), places, own)
        return cls(RestShape.build(coarse, None, config.coarse.smoothing, part), vertices, ties)

    def smoothed(self, smoothing: float) -> CoarseShape:
        """The same clusters with differentials smoothed over another length."""
        return replace(self, rest=RestShape.build(self.rest.graph, None, smoothing, self.rest.masks))


@dataclass(frozen=True, eq=False, repr=False)
class PreparedPair:
    """Two surfaces with all of a match that no landmark changes.

    Attributes
    ----------
    target, source : Surface
    start : StartConfig
    elastic : ElasticConfig
    levels : (int, int)
        Of target and source, where the spectral map is searched in full. The target's is the level that is deformed.
    rest : RestShape
        Of the target's mesh of that level.
    sheet : TriangleSurface
        A level of the source, to lie on.
    """

    target: Surface
    source: Surface
    start: StartConfig
    elastic: ElasticConfig
    levels: tuple[int, int]
    rest: RestShape
    sheet: TriangleSurface

    @classmethod
    def build(
        cls,
        target: Surface,
        source: Surface,
        start: StartConfig = StartConfig(),
        elastic: ElasticConfig = ElasticConfig(),
        masks: Masks = WHOLE,
    ) -> PreparedPair:
        """Factor the target's rest shape, and order the source's triangles for closest points."""
        levels = search_levels(target, source, start.search_vertices, start.source_search_vertices)
        sheet = source.triangles(source.refinement.coarsest_level(SHEET_VERTICES))
        with ThreadPool(1) as aside:
            trees = aside.submit(lambda: (sheet.tree, source.triangles(source.finest).tree))
            graph = level_graph(target, levels[0])
            rest = RestShape.build(graph, target.triangles(levels[0]), elastic.fine.smoothing, masks)
            trees.result()
        return cls(target, source, start, elastic, levels, rest, sheet)

    @property
    def mesh(self) -> TriangleSurface:
        """The target's mesh of the level that is deformed, at its places on the finest surface."""
        return self.target.triangles(self.levels[0])

    @kept
    def graphs(self) -> tuple[ElasticGraph, ElasticGraph]:
        """Graphs of both search levels, which landmarks are judged on; made once when they are first asked for."""
        return self.rest.graph, level_graph(self.source, self.levels[1])

    @property
    def on_source(self) -> TriangleSurface:
        """The source's finest surface, which maps lead to."""
        return self.source.triangles(self.source.finest)

    @kept
    def reversed(self) -> PreparedPair:
        """The source in the target's place and the other way round, on the same levels; made when first asked for."""
        target, source = self.source, self.target
        mesh, masks = target.triangles(self.levels[1]), self.rest.masks.reversed()
        rest = RestShape.build(self.graphs[1], mesh, self.elastic.fine.smoothing, masks)
        sheet = source.triangles(source.refinement.coarsest_level(SHEET_VERTICES))
        return PreparedPair(target, source, self.start, self.elastic, self.levels[::-1], rest, sheet)

    def __repr__(self) -> str:
        return f"PreparedPair({self.target} -> {self.source})"


def level_graph(surface: Surface, level: int) -> ElasticGraph:
    """Graph of a level's vertices at their places on the finest surface, at unit area."""
    faces = surface.refinement.levels[level].faces
    mesh = surface.triangles(level)
    return mesh_graph(mesh, mesh.triangles if faces is None else faces)
