"""Input of a fit: surfaces prepared once for all landmarks, and the problem with one landmark set."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cagemap.deform.config import ElasticConfig, GraphConfig, Stage, StartConfig
from cagemap.deform.constraints import CurveConstraint, PlacementConstraints, constrained_clusters, points_on_level
from cagemap.deform.data import SourceSamples
from cagemap.deform.energy import NONE, ElasticEnergy, bounded_maps
from cagemap.deform.graph import ElasticGraph, cluster_graph, mesh_graph
from cagemap.errors import ParameterError
from cagemap.maps.coincidence import Coincidence
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.pair import PointPairs, point_pairs, vertices_near
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import Factorization
from cagemap.numerics.threads import ThreadPool, in_threads, kept
from cagemap.spectral.surface import Surface
from cagemap.surface.polylines import Polyline
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import vertex_normals

# Corresponding tips (k,) of limbs, as vertices of the searched levels of target and source.
Tips = tuple[IndexArray, IndexArray]


@dataclass(frozen=True, eq=False)
class RestShape:
    """Elastic energy of a rest shape, with everything that depends on the target alone."""

    energy: ElasticEnergy
    mesh: TriangleSurface | None  # mesh of the graph; None for clusters of a mesh
    received: Factorization | None  # smoother of received area, see `received_weights`
    masks: Masks = WHOLE  # weights of the graph's and the source's vertices in data terms

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
        energy = ElasticEnergy.build(graph, smoothing, partial(bounded_maps, config=config.graph))
        received = None if mesh is None else graph.smoother(config.data.received_smoothing)
        return cls(energy, mesh, received, masks)

    @property
    def graph(self) -> ElasticGraph:
        """Graph of the energy."""
        return self.energy.graph

    def moved_to(self, positions: FloatArray, smoothing: float) -> RestShape:
        """The rest shape moved to positions (n, 3), with its edge weights and areas unchanged."""
        assert self.mesh is not None
        normals = vertex_normals(positions, self.mesh.triangles)
        graph = replace(self.graph, positions=positions, normals=normals)
        return replace(self, energy=ElasticEnergy.build(graph, smoothing, self.energy.admissible))


@dataclass(frozen=True, eq=False)
class CoarseShape:
    """Clusters of a mesh's vertices, and the coarse stage that moves them."""

    rest: RestShape  # of the k clusters
    # (k,): mesh vertex of each cluster; vertices that were given clusters of their own come first
    vertices: IndexArray
    # Constrained vertices are the first clusters, vertices of curves the next ones
    constraints: PlacementConstraints
    # (p,) landmarks, then tips of limbs if any, as vertices of the searched levels of target and source
    constrained_vertices: tuple[IndexArray, IndexArray]
    stage: Stage

    def with_stage(self, stage: Stage) -> CoarseShape:
        """The clusters with another coarse stage."""
        energy = ElasticEnergy.build(self.rest.graph, stage.smoothing, self.rest.energy.admissible)
        return replace(self, rest=replace(self.rest, energy=energy), stage=stage)


@dataclass(frozen=True, eq=False, repr=False)
class PreparedPair:
    """Two surfaces with everything of a match that does not depend on landmarks.

    Attributes
    ----------
    target, source : Surface
    start : StartConfig
    elastic : ElasticConfig
    levels : (int, int)
        Searched levels of target and source; the target's is the deformed level.
    rest : RestShape
        Rest shape of the target's mesh of that level.
    source_surface : TriangleSurface
        The level of the source that is fitted to.
    masks : Masks
        Masks of the finest vertices; ``rest`` has those of ``mesh`` and ``source_surface``.
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
        """Factor the target's rest shape, and build the source's search trees."""
        wanted = start.search_vertices, start.source_search_vertices or start.search_vertices
        levels = target.hierarchy.coarsest_level(wanted[0]), source.hierarchy.coarsest_level(wanted[1])
        fitted = source.triangles(source.hierarchy.coarsest_level(elastic.source_vertices))
        with ThreadPool(1) as pool:
            trees = pool.submit(lambda: (fitted.tree, source.finest_triangles.tree))
            graph = level_graph(target, levels[0], elastic.graph)
            pair = cls._of_graph(graph, target, source, start, elastic, levels, masks)
            trees.result()
        return pair

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
        """Build the pair with a given graph of the target's level."""
        mesh, fitted_level = target.triangles(levels[0]), source.hierarchy.coarsest_level(elastic.source_vertices)
        level_masks = masks.at(target.hierarchy.on_finest(levels[0]), source.hierarchy.on_finest(fitted_level))
        rest = RestShape.build(graph, mesh, elastic.fine.smoothing, elastic, level_masks)
        return cls(target, source, start, elastic, levels, rest, source.triangles(fitted_level), masks)

    def require_same(self, start: StartConfig, elastic: ElasticConfig, masks: Masks) -> None:
        """Raise ParameterError unless configs and masks are the pair's own; default configs mean those."""
        counts = [len(side.vertices) for side in (self.target, self.source)]
        masks.require_fit(*counts)
        own = self.masks
        same_masks = np.array_equal(masks.of_target(counts[0]), own.of_target(counts[0])) and np.array_equal(
            masks.of_source(counts[1]), own.of_source(counts[1])
        )
        agreement = {
            "start": start in (self.start, StartConfig()),
            "elastic": elastic in (self.elastic, ElasticConfig()),
            "masks": same_masks or not masks.any,
        }
        fields = [name for name, agrees in agreement.items() if not agrees]
        if fields:
            raise ParameterError(
                f"match_pair: expected the {' and '.join(fields)} that the pair was prepared with, got others; prepare "
                "the pair again with this config (cagemap.prepare_pair)"
            )

    @kept
    def source_samples(self) -> SourceSamples:
        """Vertices of the source that should lie on the target's mesh."""
        count = int(self.elastic.data.samples * self.rest.graph.n)
        return SourceSamples.choose(self.source_surface, count, self.rest.masks)

    @property
    def mesh(self) -> TriangleSurface:
        """Mesh of the target's deformed level, at its positions on the finest surface."""
        return self.target.triangles(self.levels[0])

    @kept
    def vertices(self) -> IndexArray:
        """(n,) numbers of the vertices of `mesh` among the finest target vertices."""
        return self.target.hierarchy.on_finest(self.levels[0])

    def curves(self, landmarks: PointPairs) -> tuple[CurveConstraint, ...]:
        """Constraints on `mesh` of the landmarks' curves."""
        constraints = []
        for pair in landmarks.curves:
            anchors = points_on_level(self.target, self.levels[0], pair.target.points, self.elastic.data)
            rest = Polyline(anchors.of(self.mesh.positions), pair.target.closed)
            constraints.append(CurveConstraint(anchors, rest, pair.source.line))
        return tuple(constraints)

    @kept
    def graphs(self) -> tuple[ElasticGraph, ElasticGraph]:
        """Elastic graphs of the searched levels of target and source; built on first access."""
        return self.rest.graph, level_graph(self.source, self.levels[1], self.elastic.graph)

    @kept
    def coincidence(self) -> Coincidence | None:
        """Coincidence of target and source, None if they do not coincide; computed on first access."""
        return Coincidence.find(self.target, self.source, self.masks, self.elastic.coincidence)

    @kept
    def reverse_pair(self) -> PreparedPair:
        """The pair with target and source exchanged, on the same levels; built on first access."""
        masks, levels = self.masks.reversed(), self.levels[::-1]
        return self._of_graph(self.graphs[1], self.source, self.target, self.start, self.elastic, levels, masks)

    def __repr__(self) -> str:
        return f"PreparedPair({self.target} -> {self.source})"


def level_graph(surface: Surface, level: int, config: GraphConfig = GraphConfig()) -> ElasticGraph:
    """Graph of a level's vertices at their positions on the finest surface, at unit area."""
    faces = surface.hierarchy.levels[level].faces
    mesh = surface.triangles(level)
    return mesh_graph(mesh, mesh.triangles if faces is None else faces, config)


@dataclass(frozen=True, eq=False)
class Problem:
    """A prepared pair with landmarks; what depends on both is computed on first access and kept."""

    prepared: PreparedPair
    landmarks: PointPairs  # landmarks and curves on both surfaces

    @classmethod
    def of_landmarks(cls, prepared: PreparedPair, landmarks: Landmarks) -> Problem:
        """The problem with landmarks of the control meshes."""
        return cls(prepared, point_pairs(prepared.target, prepared.source, landmarks))

    @kept
    def landmark_vertices(self) -> tuple[IndexArray, IndexArray]:
        """(p,) vertices of target and source at or near landmarks, on the searched levels."""
        prepared, landmarks = self.prepared, self.landmarks
        target = vertices_near(landmarks.target, prepared.target, prepared.levels[0])
        return target, vertices_near(landmarks.source, prepared.source, prepared.levels[1])

    @kept
    def coarse_shape(self) -> CoarseShape:
        """Clusters of the target's mesh, with a cluster for every landmark."""
        return self.coarse_shape_with()

    @kept
    def small_shape(self) -> CoarseShape:
        """The small graph on which many starts are tried, with a cluster for every landmark."""
        config = self.prepared.elastic.search
        return self.coarse_shape_with(stage=config.small_graph_stage, count=config.small_graph_vertices)

    def coarse_shape_with(
        self, tips: Tips = (NONE, NONE), stage: Stage | None = None, count: int | None = None
    ) -> CoarseShape:
        """About ``count`` clusters with tips of limbs as constraints, besides the landmarks."""
        prepared, rest, landmarks = self.prepared, self.prepared.rest, self.landmarks
        config = prepared.elastic
        stage, count = stage or config.coarse, count or config.coarse_vertices
        on_target, on_source = (np.concatenate(both) for both in zip(self.landmark_vertices, tips, strict=True))
        places = prepared.source.triangles(prepared.levels[1]).positions[tips[1]]
        every, curves = constrained_clusters(prepared.curves(landmarks), on_target, count, config.data)
        coarse, chosen = cluster_graph(rest.graph, count, every, config.graph)
        clusters = RestShape.build(coarse, None, stage.smoothing, config, rest.masks.for_vertices(chosen))
        anchors = CagePoints.of_vertices(np.arange(len(on_target)))
        constraints = PlacementConstraints(anchors, np.vstack([landmarks.source.positions, places]), curves)
        return CoarseShape(clusters, chosen, constraints, (on_target, on_source), stage)

    @kept
    def landmark_distances(self) -> tuple[FloatArray, FloatArray]:
        """Geodesic distances (p, m) on both surfaces, from landmarks to vertices of a coarse graph, landmarks first."""
        count = self.prepared.elastic.landmarks.distance_vertices

        def measured(side: tuple[ElasticGraph, IndexArray]) -> FloatArray:
            coarse, _ = cluster_graph(side[0], count, side[1])
            return coarse.distances(np.arange(len(side[1])))

        target, source = in_threads(measured, list(zip(self.prepared.graphs, self.landmark_vertices, strict=True)))
        return target, source

    @kept
    def constraints(self) -> PlacementConstraints:
        """Landmarks and curves on the mesh that the fine stage deforms."""
        prepared, landmarks = self.prepared, self.landmarks
        anchors = points_on_level(prepared.target, prepared.levels[0], landmarks.target, prepared.elastic.data)
        return PlacementConstraints(anchors, landmarks.source.positions, prepared.curves(landmarks))

    @kept
    def reverse_problem(self) -> Problem:
        """The reverse problem: the source is deformed onto the target."""
        return Problem(self.prepared.reverse_pair, self.landmarks.reversed())

    def without(self, left_out: Collection[int]) -> Problem:
        """The problem without some of the landmarks; itself if none is left out."""
        return replace(self, landmarks=self.landmarks.without(left_out)) if left_out else self
