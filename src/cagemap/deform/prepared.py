"""What the elastic fit needs of two surfaces before any landmark: built once, used for every set of landmarks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cagemap.deform.config import DataConfig, ElasticConfig, GraphConfig, StartConfig
from cagemap.deform.constraints import Anchors, Constraints, CurveConstraint, curves_on_level, with_clusters
from cagemap.deform.data import SourceSamples
from cagemap.deform.energy import ElasticEnergy, bounded_by
from cagemap.deform.graph import ElasticGraph, cluster_graph, mesh_graph
from cagemap.maps.coincidence import Coincidence
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.pair import PointPairs
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import Factorization
from cagemap.numerics.threads import ThreadPool, kept
from cagemap.spectral.surface import Surface
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import vertex_normals


@dataclass(frozen=True, eq=False)
class RestShape:
    """The energy of a rest shape, with all that the target alone decides."""

    energy: ElasticEnergy
    mesh: TriangleSurface | None  # whose graph it is; None for clusters of one
    received: Factorization | None  # smoother of received area, see `received_weights`
    masks: Masks = WHOLE  # what counts in the data: of the graph's vertices, and of the source's

    @classmethod
    def build(
        cls,
        graph: ElasticGraph,
        mesh: TriangleSurface | None,
        smoothing: float,
        config: ElasticConfig = ElasticConfig(),
        masks: Masks = WHOLE,
    ) -> RestShape:
        """Factor the matrices that stay the same in all iterations of a stage."""
        energy = ElasticEnergy.build(graph, smoothing, bounded_by(config.folds))
        received = None if mesh is None else graph.smoother(config.data.received_smoothing)
        return cls(energy, mesh, received, masks)

    @property
    def graph(self) -> ElasticGraph:
        """Whose energy it is."""
        return self.energy.graph

    def at(self, positions: FloatArray, smoothing: float) -> RestShape:
        """The same mesh at rest at other positions (n, 3), with the weights of its edges and areas as they are."""
        assert self.mesh is not None
        normals = vertex_normals(positions, self.mesh.triangles)
        graph = replace(self.graph, positions=positions, normals=normals)
        return replace(self, energy=ElasticEnergy.build(graph, smoothing, self.energy.admissible))

    def source_samples(self, source: TriangleSurface, config: DataConfig) -> SourceSamples:
        """Vertices of the source that should lie on the shape."""
        return SourceSamples.choose(source, int(config.samples * self.graph.n), self.masks)


@dataclass(frozen=True, eq=False)
class CoarseShape:
    """Clusters of a mesh's vertices, for the stage that moves whole limbs."""

    rest: RestShape  # of the k clusters
    # (k,): vertex of the mesh that stands for each; those that were to have a cluster of their own come first
    vertices: IndexArray
    # Landmarks, which are the first clusters, and curves, whose vertices have clusters of their own after them
    constraints: Constraints

    @classmethod
    def build(
        cls,
        graph: ElasticGraph,
        held: IndexArray,
        places: FloatArray,
        config: ElasticConfig,
        masks: Masks = WHOLE,
        curves: tuple[CurveConstraint, ...] = (),
    ) -> CoarseShape:
        """Cluster a mesh's graph, vertices (p,) held at places (p, 3) first, then some vertices of every curve."""
        every, own = with_clusters(curves, held, config.coarse_vertices, config.data)
        coarse, vertices = cluster_graph(graph, min(config.coarse_vertices, graph.n), every, config.graph)
        part = masks.for_vertices(vertices)
        constraints = Constraints(Anchors.of_vertices(np.arange(len(held))), places, own)
        return cls(RestShape.build(coarse, None, config.coarse.smoothing, config, part), vertices, constraints)

    def smoothed(self, smoothing: float) -> CoarseShape:
        """The same clusters with differentials smoothed over another length."""
        energy = ElasticEnergy.build(self.rest.graph, smoothing, self.rest.energy.admissible)
        return replace(self, rest=replace(self.rest, energy=energy))


@dataclass(frozen=True, eq=False, repr=False)
class PreparedPair:
    """Two surfaces with all of a match that no landmark changes.

    Attributes
    ----------
    target, source : Surface
    start : StartConfig
    elastic : ElasticConfig
    levels : (int, int)
        Of target and source, that landmark coordinates are made on. The target's is the level that is deformed.
    rest : RestShape
        Of the target's mesh of that level.
    source_surface : TriangleSurface
        A level of the source, to fit to.
    masks : Masks
        Of the finest vertices; those of ``rest`` are of ``mesh`` and ``source_surface``.
    """

    target: Surface
    source: Surface
    start: StartConfig
    elastic: ElasticConfig
    levels: tuple[int, int]
    rest: RestShape
    source_surface: TriangleSurface
    masks: Masks = WHOLE

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
        wanted = start.search_vertices, start.source_search_vertices or start.search_vertices
        levels = target.hierarchy.coarsest_level(wanted[0]), source.hierarchy.coarsest_level(wanted[1])
        fitted = source.triangles(source.hierarchy.coarsest_level(elastic.source_vertices))
        with ThreadPool(1) as aside:
            trees = aside.submit(lambda: (fitted.tree, source.finest_triangles.tree))
            graph = level_graph(target, levels[0], elastic.graph)
            made = cls._of_graph(graph, target, source, start, elastic, levels, masks)
            trees.result()
        return made

    @classmethod
    def _of_graph(
        cls,
        graph: ElasticGraph,
        target: Surface,
        source: Surface,
        start: StartConfig,
        elastic: ElasticConfig,
        levels: tuple[int, int],
        masks: Masks,
    ) -> PreparedPair:
        """The pair whose target's level has this graph."""
        mesh, fitted = target.triangles(levels[0]), source.hierarchy.coarsest_level(elastic.source_vertices)
        part = masks.at(target.hierarchy.on_finest(levels[0]), source.hierarchy.on_finest(fitted))
        rest = RestShape.build(graph, mesh, elastic.fine.smoothing, elastic, part)
        return cls(target, source, start, elastic, levels, rest, source.triangles(fitted), masks)

    @kept
    def source_samples(self) -> SourceSamples:
        """Vertices of the source that should lie on the target's mesh."""
        return self.rest.source_samples(self.source_surface, self.elastic.data)

    @property
    def mesh(self) -> TriangleSurface:
        """The target's mesh of the level that is deformed, at its places on the finest surface."""
        return self.target.triangles(self.levels[0])

    @kept
    def vertices(self) -> IndexArray:
        """(n,) finest target vertices that the vertices of `mesh` are."""
        return self.target.hierarchy.on_finest(self.levels[0])

    def curves(self, landmarks: PointPairs) -> tuple[CurveConstraint, ...]:
        """The curves among landmarks, on `mesh`."""
        return curves_on_level(self.target, self.levels[0], landmarks.curves, self.elastic.data)

    @kept
    def graphs(self) -> tuple[ElasticGraph, ElasticGraph]:
        """Graphs of both search levels, which landmarks are judged on; made once when they are first asked for."""
        return self.rest.graph, level_graph(self.source, self.levels[1], self.elastic.graph)

    @kept
    def coincidence(self) -> Coincidence | None:
        """How the target lies on the source, None where it does not; found when first asked for."""
        return Coincidence.find(self.target, self.source, self.masks, self.elastic.coincidence)

    @kept
    def reversed(self) -> PreparedPair:
        """The source in the target's place and the other way round, on the same levels; made when first asked for."""
        masks, levels = self.masks.reversed(), self.levels[::-1]
        return self._of_graph(self.graphs[1], self.source, self.target, self.start, self.elastic, levels, masks)

    def __repr__(self) -> str:
        return f"PreparedPair({self.target} -> {self.source})"


def level_graph(surface: Surface, level: int, config: GraphConfig = GraphConfig()) -> ElasticGraph:
    """Graph of a level's vertices at their places on the finest surface, at unit area."""
    faces = surface.hierarchy.levels[level].faces
    mesh = surface.triangles(level)
    return mesh_graph(mesh, mesh.triangles if faces is None else faces, config)
