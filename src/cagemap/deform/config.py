"""Every number that decides a deformation: of its spectral start, and of the fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.brief import Brief
from cagemap.spectral.zoomout import ZoomOutSchedule


@dataclass(frozen=True)
class Stage:
    """One run of `cagemap.deform.minimise.minimise`; lengths are of sqrt(area).

    Attributes
    ----------
    iterations : int
    stiffness : (float, float)
        Weight alpha of the energy against the data, first and last; it falls geometrically over the first ``ramp`` of
        the iterations. sqrt(alpha) is the length below which the energy outweighs the data.
    smoothing : float
        epsilon: its square root is the length over which differentials are smoothed.
    ramp : float
        See ``stiffness``.
    momentum : float
        Every iteration but the last goes on by this share of its change: x <- x + momentum (x - x_before).
    patience : int
        At most this many iterations more, at the last stiffness, while more than ``max_bounded`` is bounded.
    factored : int
        The positions' matrix is factored every so many iterations; those between use the earlier factors.
    max_bounded : float
        Share of the vertices whose differentials would fold or flatten the surface.
    on_surface : float
        Root mean square distance within which a mesh lies on the source as well as flat triangles can.
    stiffening, max_stiffness : float
        On the surface alpha is multiplied by the first in every iteration, up to the second.
    gradients : int
        Conjugate gradients of an iteration with earlier factors.
    tolerance : float
        Share of the residual at which they stop before.
    max_unsolved : float
        Share of the residual that they may leave; above it the matrix is factored anew (0.11 on the built-in pair).
    """

    iterations: int
    stiffness: tuple[float, float]
    smoothing: float
    ramp: float = 0.7
    momentum: float = 0.0
    patience: int = 0
    factored: int = 1
    max_bounded: float = 0.005
    on_surface: float = 2e-5
    stiffening: float = 2.0
    max_stiffness: float = 5e-2
    gradients: int = 4
    tolerance: float = 1e-9
    max_unsolved: float = 0.5

    def __post_init__(self) -> None:
        """Check the counts."""
        if min(self.iterations, self.factored) < 1 or self.patience < 0:
            raise ParameterError(
                "a stage of the elastic fit: expected at least 1 iteration, factored at least every iteration (1), and "
                f"no negative patience, got {self}"
            )

    def ramped(self) -> FloatArray:
        """(iterations + patience,) stiffness alpha of every iteration."""
        first, last = self.stiffness
        steps = np.minimum(np.arange(self.iterations + self.patience) / max(self.ramp * self.iterations, 1e-9), 1.0)
        return np.asarray(first * (last / first) ** steps)


@dataclass(frozen=True, repr=False)
class StartConfig(Brief):
    """Parameters of the map that the elastic fit starts from; the defaults are the measured ones.

    Attributes
    ----------
    search_vertices : int
        The target is deformed at its coarsest level with at least this many vertices; the source's vertices are
        searched at its own such level.
    source_search_vertices : int
        The same of the source alone; 0: as the target's.
    zoomout : ZoomOutSchedule
    """

    search_vertices: int = 3000
    source_search_vertices: int = 0
    zoomout: ZoomOutSchedule = ZoomOutSchedule()

    def __post_init__(self) -> None:
        """Check the ranges."""
        require_search(self.search_vertices, self.source_search_vertices)


def require_search(vertices: int, source_vertices: int) -> None:
    """Refuse numbers of searched vertices below 0."""
    if min(vertices, source_vertices) < 0:
        raise ParameterError(f"expected 0 search vertices or more, got {vertices} and {source_vertices}")


@dataclass(frozen=True)
class GraphConfig:
    """The elastic graph of a mesh, and its clusters."""

    min_weight: float = 1e-2  #: least weight of an edge, of the median: cotangents may be negative
    normal_length: float = 1.0  #: how far apart opposite normals are, of a cluster's size
    min_cell: float = 0.3  #: area, of the mean cell's, below which a piece of a cell is joined to a neighbour
    joining_rounds: int = 4  #: how often: two tiny ones may join each other first
    neighbours: int = 6  #: coarse vertices whose affine extrapolations are blended at a finer vertex


@dataclass(frozen=True)
class FoldConfig:
    """Differentials that fold or flatten a surface."""

    flat: float = 0.2  #: ratio of the two stretches in the tangent plane below which a differential flattens
    min_stretch: float = 0.3  #: such a differential gets all singular values up to this share of its largest


@dataclass(frozen=True)
class DataConfig:
    """Data terms; lengths are of sqrt(area)."""

    samples: float = 2.0  #: source samples per vertex of the target's mesh; more change nothing
    received_smoothing: float = 0.005  #: length over which received area is smoothed: less than a finger's width
    received: tuple[float, float] = (0.25, 0.5)  #: received area, of a vertex's own, with no data term and with all
    inside_trip: float = 0.006  #: round trip at which the weight of a source sample inside the target is a quarter
    outside_trips: float = 6.0  #: the same outside, of sqrt(alpha): the target may not have reached it yet
    cluster_trip: float = 0.4  #: the same of source samples and clusters: legs may be that much longer
    towards_point: float = 0.3  #: share of a source sample's term on a cluster towards the point, not its plane
    uncovered: float = 0.02  #: most that the distance from an open surface costs: what is beyond its end is no misfit
    anchor_normal_weight: float = 0.01  #: how far apart opposite normals are where points come to a coarser mesh
    curve_share: int = 6  #: one in so many coarse vertices may be a curve's, all curves together
    min_curve_points: int = 6  #: coarse vertices of a curve, which it needs to bend


@dataclass(frozen=True)
class SearchConfig:
    """Several starts, where joints are in doubt (docs/lab/elastic.md); lengths are of sqrt(area)."""

    doubtful: float = 0.004  #: mean distance of the placements from landmarks and spectral map: more are tried above it
    limb_rotation: float = 0.48  #: rotation of a limb, in radians, from which on more are tried
    limb_area: float = 0.02  #: share of the area of a limb: less than a forearm and its hand
    min_distance: float = 0.001  #: mean distance of two coarse placements from which on both are refined
    max_refined: int = 3  #: coarse placements that are refined
    max_cost: float = 1.5  #: a coarse placement that costs this many times the cheapest one is not refined
    part_distance: float = 0.02  #: distance of two placements from which on either may be the better one there
    part_area: float = 5e-4  #: least share of the area of a part that is taken of another placement
    as_cheap: float = 1.15  #: cost of a placement that was led to tips or finished, of it before, up to which it counts
    part_rings: int = 3  #: rings of edges around a part that count for it, and fade


@dataclass(frozen=True)
class PoseConfig:
    """The target in the source's pose (docs/lab/elastic.md); lengths are of sqrt(area)."""

    difference: float = 0.3  #: mean rotation, in radians, from which on poses differ
    stage: Stage = Stage(5, (0.1, 0.1), 1e-3)  #: positions and rotations; stiffness of limbs against the placement
    joint_rounds: int = 2  #: how often joints are looked for
    joint_smoothing: float = 0.02  #: length over which the gradient of rotations is smoothed
    min_stiffness: float = 0.02  #: least weight of an edge at a joint, of its own
    rounds: int = 2  #: how often the target is posed and fitted


@dataclass(frozen=True)
class InverseConfig:
    """The average with the inverse of the reverse fit (docs/lab/elastic.md); lengths are of sqrt(area)."""

    smoothing: float = 0.02  #: length over which the shifts are smoothed
    gap: float = 0.01  #: distance from the inverse's mesh at which a vertex counts a quarter
    normal_weight: float = 0.02  #: how far apart opposite normals are where the inverse is read
    far: float = 0.03  #: distance from the inverse that counts for `max_far`
    max_far: float = 0.03  #: share of the area that may be so far; otherwise the placement stays as it is


@dataclass(frozen=True, repr=False)
class ElasticConfig(Brief):
    """Parameters of the fit; the defaults are the measured ones (docs/lab/accuracy.md).

    Attributes
    ----------
    coarse_vertices : int
        Size of the coarse graph.
    source_vertices : int
        Vertices from which on a level of the source is fine enough to fit to.
    coarse, fine : Stage
    stiff_coarse : Stage
        Instead of `coarse` where its placements from both starts agree, see `cagemap.deform.multi_start`.
    landmark_start : Stage
        Positions from the landmarks alone; differentials are smoothed as in the stage that starts there.
    normal_weight : float
        Closest points count position and this length times the normal.
    fine_normal_weight : float
        The same for those of the fine stage's vertices.
    projection_normal_weights : (float, float)
        The same in the last projection, see `facing_points`.
    landmark_weight : float
        Of a landmark, against a data weight of 1 for the whole surface.
    curve_weight : float
        Of a curve, by its length in sqrt(area), against the same.
    cost_stiffness : float
        Stiffness alpha at which placements are compared.
    stretch_weight : float
        Of the variance of logarithmic stretches, where placements of open surfaces are compared.
    response : Stage
        What changed landmarks do to a map that is there, on the coarse graph (`cagemap.deform.update`).
    graph, folds, data, search, pose, inverse
        Numbers of the parts of the method.
    """

    coarse_vertices: int = 1500
    source_vertices: int = 15_000
    coarse: Stage = Stage(10, (5e-3, 5e-5), 1e-3, momentum=0.6)
    stiff_coarse: Stage = Stage(10, (5e-2, 2e-4), 1e-2, momentum=0.6)
    fine: Stage = Stage(12, (2e-4, 1e-5), 1e-4, momentum=0.8, patience=12, factored=4)
    landmark_start: Stage = Stage(20, (1.0, 1.0), 1e-3)
    normal_weight: float = 0.03
    fine_normal_weight: float = 0.01
    projection_normal_weights: tuple[float, float] = (0.002, 0.02)
    landmark_weight: float = 1e2
    curve_weight: float = 1.0
    cost_stiffness: float = 1e-3
    stretch_weight: float = 3e-3
    response: Stage = Stage(8, (2e-4, 2e-4), 1e-2, momentum=0.6)
    graph: GraphConfig = GraphConfig()
    folds: FoldConfig = FoldConfig()
    data: DataConfig = DataConfig()
    search: SearchConfig = SearchConfig()
    pose: PoseConfig = PoseConfig()
    inverse: InverseConfig = InverseConfig()

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.coarse_vertices < 4:
            raise ParameterError(f"coarse_vertices: expected at least 4, got {self.coarse_vertices}; 1500 is usual")
        weights = (
            *(self.normal_weight, self.fine_normal_weight, self.landmark_weight, self.curve_weight),
            *self.projection_normal_weights,
        )
        if not all(0.0 <= weight < np.inf for weight in weights):
            raise ParameterError(f"weights of the elastic fit: expected numbers of 0 or more, got {weights}")
