"""Input of a fit: surfaces prepared once for all landmarks, and the problem with one landmark set."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from cagemap.deform.config import ElasticConfig, GraphConfig, Stage, StartConfig
from cagemap.deform.data import CurveConstraint, PlacementConstraints, SurfaceSamples, constrained_clusters
from cagemap.deform.energy import NO_VERTICES, ElasticEnergy, bounded_energy
from cagemap.deform.graph import ElasticGraph, cluster_graph, mesh_graph
from cagemap.errors import ParameterError
from cagemap.maps.coincidence import Coincidence
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.pair import PointPairs, near_vertices, point_pairs
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.sparse_algebra import Factorization
from cagemap.numerics.threads import ThreadPool, in_threads, kept
from cagemap.spectral.surface import Surface
from cagemap.surface.polylines import Polyline
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface

Tips = tuple[IndexArray, IndexArray]  # tips (k,) of limbs, corresponding vertices of the searched levels


@dataclass(frozen=True, eq=False)
class Clusters:
    """Clusters of a mesh's vertices, and the coarse stage that moves them."""

    energy: ElasticEnergy  # of the k clusters
    masks: Masks  # weights of the clusters and of the source's vertices in data terms
    vertices: IndexArray  # (k,) mesh vertex of each cluster; vertices that were given clusters of their own first
    constraints: PlacementConstraints  # constrained vertices are the first clusters, vertices of curves the next ones
    constrained_vertices: tuple[IndexArray, IndexArray]  # (p,) landmarks, then tips, on the searched levels
    stage: Stage

    def with_stage(self, stage: Stage) -> Clusters:
        """The clusters with another coarse stage."""
        return replace(self, energy=replace(self.energy, smoothing=stage.smoothing), stage=stage)


@dataclass(frozen=True, eq=False, repr=False)
class PreparedPair:
    """Two surfaces and all data of their match that can be computed without landmarks."""

    target: Surface
    source: Surface
    start: StartConfig
    elastic: ElasticConfig
    levels: tuple[int, int]  #: of target and source on which starts are found; the target's is also deformed
    energy: ElasticEnergy  #: of the target's mesh of that level; its graph has the rest shape
    source_surface: TriangleSurface  #: the level of the source that is fitted to
    masks: Masks = WHOLE  #: masks of the finest vertices

    @classmethod
    def build(
        cls,
        target: Surface,
        source: Surface,
        start: StartConfig = StartConfig(),
        elastic: ElasticConfig = ElasticConfig(),
        masks: Masks = WHOLE,
    ) -> PreparedPair:
        """Factor the elastic energy, build search trees; ParameterError without operators up to a searched level."""
        wanted = start.search_vertices, start.source_search_vertices or start.search_vertices
        levels = target.hierarchy.coarsest_level(wanted[0]), source.hierarchy.coarsest_level(wanted[1])
        for surface, level in zip((target, source), levels, strict=True):
            surface.require_operators(level, "elastic")
        fitted = fitted_surface(source, elastic)
        with ThreadPool(1) as pool:
            trees = pool.submit(lambda: (fitted.tree, source.finest_triangles.tree))
            energy = bounded_energy(
                level_graph(target, levels[0], elastic.graph), elastic.fine.smoothing, elastic.graph
            )
            _ = energy.factors  # factored while the other thread builds search trees
            trees.result()
        return cls(target, source, start, elastic, levels, energy, fitted, masks)

    def require_same(self, start: StartConfig, elastic: ElasticConfig, masks: Masks) -> None:
        """Raise ParameterError unless configs and masks are the pair's own; default configs mean those."""
        n1, n2 = len(self.target.vertices), len(self.source.vertices)
        masks.require_fit(n1, n2)
        given, own = ((one.of_target(n1), one.of_source(n2)) for one in (masks, self.masks))
        agreement = {
            "start": start in (self.start, StartConfig()),
            "elastic": elastic in (self.elastic, ElasticConfig()),
            "masks": not masks.any or all(map(np.array_equal, given, own)),
        }
        fields = [name for name, agrees in agreement.items() if not agrees]
        if fields:
            raise ParameterError(
                f"match_pair: expected the {' and '.join(fields)} that the pair was prepared with, got others; prepare "
                "the pair again with this config (cagemap.prepare_pair)"
            )

    @kept
    def source_samples(self) -> SurfaceSamples:
        """Vertices of the source that should lie on the target's mesh."""
        count = int(self.elastic.data.samples * self.energy.graph.n)
        return SurfaceSamples.at_vertices(self.source_surface, count, self.level_masks.source)

    @kept
    def level_masks(self) -> Masks:
        """Masks of the vertices of `mesh` and ``source_surface``."""
        return self.masks.at(self.vertices, self.source.hierarchy.on_finest(self.source_level))

    @kept
    def received_smoother(self) -> Factorization:
        """Smoother of received area on `mesh`, see `received_weights`."""
        return self.energy.graph.smoother(self.elastic.data.received_smoothing)

    @property
    def source_level(self) -> int:
        """Level of ``source_surface``."""
        return self.source.hierarchy.coarsest_level(self.elastic.source_vertices)

    @property
    def mesh(self) -> TriangleSurface:
        """Mesh of the target's deformed level, at its positions on the finest surface."""
        return self.target.triangles(self.levels[0])

    @kept
    def vertices(self) -> IndexArray:
        """(n,) numbers of the vertices of `mesh` among the finest target vertices."""
        return self.target.hierarchy.on_finest(self.levels[0])

    @property
    def control_vertices(self) -> IndexArray:
        """(n_0,) number of every control vertex in the finest level: the first entries of `vertices` (plain: all)."""
        return self.vertices[: self.target.control.n_vertices]

    def on_mesh(self, points: SurfacePoints) -> CagePoints:
        """Points of the finest target surface as points of `mesh`. A vertex of both surfaces stays a vertex."""
        vertices = self.target.hierarchy.on_level(self.levels[0], points.vertices)
        on_level = CagePoints.of_vertices(vertices)
        between = np.flatnonzero(vertices < 0)
        if len(between):
            some, weight = points.at(between), self.elastic.fine_normal_weight
            near = SurfacePoints.nearest(self.mesh, some.positions, some.normals, normal_weight=weight)
            on_level.corners[between], on_level.weights[between] = near.corners, near.barycentric
        return on_level

    @kept
    def graphs(self) -> tuple[ElasticGraph, ElasticGraph]:
        """Elastic graphs of the searched levels of target and source; built on first access."""
        return self.energy.graph, level_graph(self.source, self.levels[1], self.elastic.graph)

    @kept
    def coincidence(self) -> Coincidence | None:
        """Coincidence of target and source, None if they do not coincide; computed on first access."""
        return Coincidence.find(self.target, self.source, self.masks, self.elastic.coincidence)

    @kept
    def reverse_pair(self) -> PreparedPair:
        """The pair with target and source exchanged, on the same levels; built on first access."""
        elastic = self.elastic
        energy = bounded_energy(self.graphs[1], elastic.fine.smoothing, elastic.graph)
        levels, fitted = self.levels[::-1], fitted_surface(self.target, elastic)
        return PreparedPair(
            self.source, self.target, self.start, elastic, levels, energy, fitted, self.masks.reversed()
        )

    def __repr__(self) -> str:
        return f"PreparedPair({self.target} -> {self.source})"


def fitted_surface(source: Surface, config: ElasticConfig) -> TriangleSurface:
    """The level of a source that is fitted to."""
    return source.triangles(source.hierarchy.coarsest_level(config.source_vertices))


def level_graph(surface: Surface, level: int, config: GraphConfig = GraphConfig()) -> ElasticGraph:
    """Graph of a level's vertices at their positions on the finest surface, at unit area."""
    return mesh_graph(surface.triangles(level), surface.hierarchy.faces(level), config)


@dataclass(frozen=True, eq=False)
class Problem:
    """A prepared pair with landmarks; what depends on both is computed on first access and kept."""

    prepared: PreparedPair
    landmarks: PointPairs  # landmarks and curves on both surfaces

    def __post_init__(self) -> None:
        surfaces = self.prepared.target.finest_triangles, self.prepared.source.finest_triangles
        points = self.landmarks.target, self.landmarks.source
        if not all(surface.equals(side.surface) for surface, side in zip(surfaces, points, strict=True)):
            raise ParameterError("prepared: expected the surfaces of the pair, got others; they may be exchanged")

    @classmethod
    def of_landmarks(cls, prepared: PreparedPair, landmarks: Landmarks) -> Problem:
        """The problem with landmarks of the control meshes."""
        return cls(prepared, point_pairs(prepared.target, prepared.source, landmarks))

    @kept
    def landmark_vertices(self) -> tuple[IndexArray, IndexArray]:
        """(p,) vertices of target and source at or near landmarks, on the searched levels."""
        prepared, landmarks = self.prepared, self.landmarks
        target = near_vertices(landmarks.target, prepared.target, prepared.levels[0])
        return target, near_vertices(landmarks.source, prepared.source, prepared.levels[1])

    @kept
    def coarse_clusters(self) -> Clusters:
        """Clusters of the target's mesh, with a cluster for every landmark."""
        return self.clusters_with()

    @kept
    def small_clusters(self) -> Clusters:
        """The small graph on which many starts are tried, with a cluster for every landmark."""
        config = self.prepared.elastic.search
        return self.clusters_with(stage=config.small_graph_stage, count=config.small_graph_vertices)

    def clusters_with(
        self, tips: Tips = (NO_VERTICES, NO_VERTICES), stage: Stage | None = None, count: int | None = None
    ) -> Clusters:
        """About ``count`` clusters with tips of limbs as constraints, besides the landmarks."""
        prepared, landmarks, config = self.prepared, self.landmarks, self.prepared.elastic
        stage, count = stage or config.coarse, count or config.coarse_vertices
        on_target, on_source = (np.concatenate(both) for both in zip(self.landmark_vertices, tips, strict=True))
        places = prepared.source.triangles(prepared.levels[1]).positions[tips[1]]
        every, curves = constrained_clusters(self.constraints.curves, on_target, count, config.data)
        coarse, chosen = cluster_graph(prepared.energy.graph, count, every, config.graph)
        energy, masks = bounded_energy(coarse, stage.smoothing, config.graph), prepared.level_masks.at(chosen)
        anchors = CagePoints.of_vertices(np.arange(len(on_target)))
        constraints = PlacementConstraints(anchors, np.vstack([landmarks.source.positions, places]), curves)
        return Clusters(energy, masks, chosen, constraints, (on_target, on_source), stage)

    @kept
    def landmark_distances(self) -> tuple[FloatArray, FloatArray]:
        """Geodesic distances (p, m) on both surfaces, from landmarks to vertices of a coarse graph, landmarks first."""
        config = self.prepared.elastic

        def measured(side: tuple[ElasticGraph, IndexArray]) -> FloatArray:
            coarse, _ = cluster_graph(side[0], config.landmarks.distance_vertices, side[1], config.graph)
            return coarse.distances(np.arange(len(side[1])))

        target, source = in_threads(measured, list(zip(self.prepared.graphs, self.landmark_vertices, strict=True)))
        return target, source

    @kept
    def constraints(self) -> PlacementConstraints:
        """Landmarks and curves on the mesh that the fine stage deforms."""
        prepared, landmarks, curves = self.prepared, self.landmarks, list[CurveConstraint]()
        for pair in landmarks.curves:
            anchors = prepared.on_mesh(pair.target.points)
            rest = Polyline(anchors.of(prepared.mesh.positions), pair.target.closed)
            curves.append(CurveConstraint(anchors, rest, pair.source.line))
        return PlacementConstraints(prepared.on_mesh(landmarks.target), landmarks.source.positions, tuple(curves))

    @kept
    def reverse_problem(self) -> Problem:
        """The reverse problem: the source is deformed onto the target."""
        return Problem(self.prepared.reverse_pair, self.landmarks.reversed())

    def without(self, left_out: Collection[int]) -> Problem:
        """The problem without some of the landmarks; itself if none is left out."""
        return replace(self, landmarks=self.landmarks.without(left_out)) if left_out else self
