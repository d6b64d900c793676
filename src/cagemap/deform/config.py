"""Every number that decides a deformation: of its spectral start, and of the fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.kinds import Brief
from cagemap.spectral.zoomout import ZoomOutSchedule


@dataclass(frozen=True)
class Stage:
    """One run of `cagemap.deform.minimise.minimise`; lengths are of sqrt(area)."""

    iterations: int
    #: Weight alpha of the energy against the data, first and last; it falls geometrically over the first ``ramp`` of
    #: the iterations. sqrt(alpha) is the length below which the energy outweighs the data.
    stiffness: tuple[float, float]
    smoothing: float  #: epsilon: its square root is the length over which differentials are smoothed
    ramp: float = 0.7
    momentum: float = 0.0  #: share of its change by which every iteration but the last goes on
    patience: int = 0  #: at most this many iterations more, at the last stiffness, while more than ``max_bounded`` is
    factored: int = 1  #: the matrix is factored every so many iterations; those between use the earlier factors
    max_bounded: float = 0.005  #: share of the vertices whose differentials would fold or flatten the surface
    on_surface: float = 2e-5  #: root mean square distance within which a mesh lies on the source, as far as it can
    stiffening: float = 2.0  #: factor on alpha in every iteration on the surface
    max_stiffness: float = 5e-2  #: up to which it is applied
    gradients: int = 4  #: conjugate gradients of an iteration with earlier factors
    tolerance: float = 1e-9  #: share of the residual at which they stop before
    max_unsolved: float = 0.5  #: share of the residual above which the matrix is factored anew

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
    """Starts of the elastic fit by ZoomOut (`deform.multi_start`), from landmarks and from a fit's closest points."""

    search_vertices: int = 3000  #: least vertices of the level that is deformed, and of the source's searched one
    source_search_vertices: int = 0  #: the same of the source alone; 0: as the target's
    zoomout: ZoomOutSchedule = ZoomOutSchedule()
    samples: int = 3000  #: source vertices that a start is sought among: twice as many as there are vertices to start
    curve_points: int = 40  #: points of a curve on which its coordinate is 1
    trusted_functions: tuple[int, ...] = (8, 20)  #: basis functions that are trusted of a fit, one start for each
    growth: float = 1.5  #: factor by which upsampling of its match lets their number grow
    last_functions: int = 100  #: where it ends
    places: int = 3000  #: source points that a fit is matched with
    normal_length: float = 0.1  #: how far apart opposite normals are there, of sqrt(area)

    def __post_init__(self) -> None:
        """Check the ranges."""
        require_search(self.search_vertices, self.source_search_vertices)


def require_search(vertices: int, source_vertices: int) -> None:
    """Refuse numbers of searched vertices below 0."""
    if min(vertices, source_vertices) < 0:
        raise ParameterError(f"expected 0 search vertices or more, got {vertices} and {source_vertices}")


@dataclass(frozen=True)
class GraphConfig:
    """The elastic graph of a mesh, its clusters, and differentials that fold or flatten a surface."""

    min_weight: float = 1e-2  #: least weight of an edge, of the median: cotangents may be negative
    normal_length: float = 1.0  #: how far apart opposite normals are, of a cluster's size
    min_cell: float = 0.3  #: area, of the mean cell's, below which a piece of a cell is joined to a neighbour
    joining_rounds: int = 4  #: how often: two tiny ones may join each other first
    neighbours: int = 6  #: coarse vertices whose affine extrapolations are blended at a finer vertex
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
    shared_gap: float = 0.03  #: what a fit leaves farther from the other surface has no counterpart there
    at_boundary: float = 1e-4  #: what is so near has one, also on the boundary of the other


@dataclass(frozen=True)
class SearchConfig:
    """Several starts, where joints are in doubt, and alignments with few landmarks; lengths are of sqrt(area).

    Measured in docs/lab/elastic.md and docs/lab/poses.md.
    """

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
    rough_vertices: int = 400  #: size of the graph on which all starts are tried
    rough: Stage = Stage(14, (1.0, 2e-4), 1e-2, momentum=0.6)  #: from stiff, which turns and shifts as a whole, to soft
    alike: float = 0.03  #: mean distance below which two starts are one
    different: float = 0.08  #: mean distance from which on two fits are two answers
    max_coarse: int = 4  #: candidates of the coarse stage, where no limbs are assigned
    max_assigned: int = 2  #: assignments of limbs of the coarse stage
    max_finished: int = 3  #: candidates of the fine stage, and as the files stand: boxes cost alike all round
    hopeless: float = 2.5  #: cost, of the best one's, above which a candidate is not finished
    unlikely: float = 1.5  #: cost of assigned limbs, of the files' alignment, above which they are dropped: fins
    mirrored_starts: int = 4  #: starts on the mirror image that are fitted, the nearest ones
    turned_doubt: float = 1.1  #: factor on the cost of a start turned about the vertical: files mostly agree in front
    other_doubt: float = 1.3  #: factor on the cost of a start turned otherwise: files nearly always agree in up
    max_unit_ratio: float = 4.0  #: files of parts whose sizes differ by more are in different units
    limb_height: float = 0.1  #: height of a limb's tip over its pass: fingers and ears to 0.07, feet from 0.12
    fewest_points: int = 4  #: limbs and landmarks that an assignment needs
    fewest_of_part: int = 3  #: the same where a surface is a part: its other limbs may be cut off
    max_limbs: int = 7  #: the most prominent ones are assigned
    max_assignments: int = 10  #: how many are fitted
    girth_weight: float = 0.5  #: sums of log ratios of girths, beside those of lengths
    girth_part: float = 0.7  #: share of a limb's length, from its tip, of which the girth is taken
    tip_height: float = 0.01  #: height of a tip over its pass: ears have 0.01 to 0.05, feet 0.1 to 0.3
    tips_near: float = 0.2  #: tips of two surfaces that a fit leaves so close are the same
    tips_met: float = 0.02  #: a fit that leaves all of them closer needs no help
    tip_taken: float = 0.05  #: a tip this near to a landmark is the landmark's
    led: Stage = Stage(20, (5e-2, 2e-4), 1e-2, momentum=0.6)  #: holds tips; as stiff as for bodies that stand alike
    led_samples: int = 4000  #: source samples of that stage
    of_one_kind: float = 1e-4  #: cost below which bodies are of one kind: no later stage gains anything


@dataclass(frozen=True)
class RefitConfig:
    """Refit in the source's pose, and the average with the inverse (docs/lab/elastic.md); lengths are of sqrt(area)."""

    difference: float = 0.3  #: mean rotation, in radians, from which on poses differ
    stage: Stage = Stage(5, (0.1, 0.1), 1e-3)  #: positions and rotations; stiffness of limbs against the placement
    joint_rounds: int = 2  #: how often joints are looked for
    joint_smoothing: float = 0.02  #: length over which the gradient of rotations is smoothed
    min_stiffness: float = 0.02  #: least weight of an edge at a joint, of its own
    rounds: int = 2  #: how often the target is posed and fitted
    smoothing: float = 0.02  #: length over which the shifts towards the inverse are smoothed
    gap: float = 0.01  #: distance from the inverse's mesh at which a vertex counts a quarter
    normal_weight: float = 0.02  #: how far apart opposite normals are where the inverse is read
    far: float = 0.03  #: distance from the inverse that counts for `max_far`
    max_far: float = 0.03  #: share of the area that may be so far; otherwise the placement stays as it is


@dataclass(frozen=True)
class CoincidenceConfig:
    """Test whether two surfaces coincide (`maps.coincidence`); lengths are in units of sqrt(source area).

    Chosen on seven cages of one body and on two other bodies (docs/lab/accuracy.md).
    """

    mean_gap: float = 0.003  #: mean distance of vertices from the other mesh; of one body to 0.0023, of two from 0.0204
    max_gap: float = 0.01  #: distance that `share` of them keep; to 0.0085, from 0.048
    near: float = 0.03  #: a point farther from the other surface is not on it
    share: float = 0.95  #: share of the target that is on the source
    clothed: float = 0.6  #: clothes cover less of the source: shirts and trousers 0.34 to 0.5, two bodies 0.81
    reach: float = 0.1  #: how far closest points that face the same way are looked for


@dataclass(frozen=True)
class LandmarkConfig:
    """Which landmarks are left out or reported (`maps.landmarks`); lengths are of sqrt(area).

    Gains and misfits are mean |log ratios| of distances between landmarks on the two surfaces.
    """

    fewest_judged: int = 6  #: fewer pairs cannot outvote one of them
    distance_vertices: int = 1500  #: of the graphs that distances are measured on; their spacing is 0.026
    short: float = 0.1  #: added to both distances of a ratio: what strain and sampling may change of short ones
    max_misfit: float = 0.7  #: |log ratio| that counts as simply wrong: a factor of two
    min_gain: float = 0.12  #: misfit by which a given place must lose against the best one
    gain_of_typical: float = 2.2  #: the same, of the pairs' typical misfit
    min_exchange_gain: float = 0.1  #: gain of two exchanged pairs; correct ones of alike bodies lose 0.05 or more
    min_distance: float = 0.25  #: shorter corrections are left to the strain of the finished map
    tip_reach: float = 0.15  #: a tip: nowhere within this is it farther from the other landmarks on average
    tip_slack: float = 0.03  #: by more than this
    detour: float = 0.2  #: by how much ways to a given place may be longer through the best one, of the same limb
    max_suspects: float = 1 / 3  #: share of accused pairs above which it is not known which are right
    one_of: int = 100  #: of so many pairs one is set aside before the others are judged again
    unrelated: float = 0.32  #: typical misfit above which it is not known; shuffled pairs 0.36 to 0.53, animals to 0.26
    slip_by_distances: float = 1.14  #: cost with accused pairs, of that without, of slips; correct ones to 1.09
    slip_by_sides: float = 1.05  #: the same of pairs that sides accuse; exchanged ears have 1.04 to 1.19
    confirmed: float = 0.03  #: a pair that the map without it misses by less is taken back
    side_rise: float = 0.2  #: by how much the agreement around two pairs rises when exchanged ones go back; 0.3 or more
    side_agreed: float = 0.8  #: what the agreement must be then
    side_disagreed: float = 0.1  #: what it is at most before: 14 of 1200 correct sets are accused, 95 without this
    side_min_gain: float = -0.03  #: what an exchange of mirror images gains at least by distances; -0.02 to 0.4
    side_apart: float = 0.05  #: nearer landmarks turn about each other by how exactly they were put
    posed: float = 0.5  #: log ratio of distances from which on a triple says little about the sense of all landmarks
    flat: float = 0.02  #: mean product of turns below which landmarks lie too flat to have a sense; others 0.03 to 0.2
    mirrored: float = -0.2  #: agreement of all below which landmarks are mirrored; correct ones from 0.45 on
    mirrored_cost: float = 1.3  #: cost of mirrored ones, of that without landmarks; correct crossed arms 1.02
    exchange_distance: float = 0.08  #: how far shapes alone may put a landmark from the one it is exchanged with
    as_good: float = 1.15  #: cost, of the best one's, up to which another placement is as good; turned limbs from 1.06
    strain_vertices: int = 300  #: graph of the strain of landmarks: one landmark's surroundings are coarse
    strain_stiffness: float = 1e-4  #: of the energy there
    strain_smoothing: float = 1e-3  #: of differentials there
    strain_ridge: float = 1e-7  #: tangential hold of every vertex, so that there is one solution without landmarks
    fewest_strained: int = 10  #: fewer pairs are not judged by strain
    strained: float = 0.05  #: displacement of a pair let go from which on it strains the map
    strained_of_next: float = 1.5  #: the same, of the largest of the others: shapes that differ strain many pairs
    dissimilar: float = 0.12  #: typical misfit from which on strain of one pair says nothing


@dataclass(frozen=True)
class ProjectionConfig:
    """Projection of a fitted mesh, and removal of its folds; lengths are of sqrt(area), areas shares of the surface."""

    min_cosine: float = 0.15  #: smaller cosines between a point's normal and its own: on the wrong side of a thin part
    landmark_tolerance: float = 1e-12  #: a landmark is met when it is missed by less
    landmark_steps: int = 12  #: few suffice: the surface is nearly flat around a landmark
    landmark_normal_weight: float = 0.002  #: of the first step, which keeps to one side of a thin part
    rings: tuple[int, ...] = (1, 2, 3, 5, 8)  #: rings of triangles around small folds that are relaxed, round by round
    sweeps: int = 10  #: averages over neighbours before a patch is projected again
    min_gain: float = 0.02  #: share of the flipped triangles that a round must remove for another one
    min_part: float = 1e-3  #: folded area of a part that is flattened
    max_folded: float = 0.02  #: folded area in all, above which the map is wrong and nothing is flattened
    part_distance: float = 0.02  #: folded pieces closer than this, along edges of an even mesh, are one part
    growths: tuple[float, ...] = (1.1, 1.5, 2.0)  #: radii of the ball, in those of the part's image; the first fit wins
    margin: float = 1.15  #: radius of the source's disc, in those of the ball
    max_disc: float = 0.5  #: share of either surface's vertices in a disc
    min_unfolded: float = 0.5  #: share of the fold that must disappear
    max_move: float = 0.05  #: vertices that move farther count as displaced
    max_displaced: float = 5.0  #: displaced area in units of the folded area (fins and ears: 0 to 1.7; limbs: 25 to 45)
    disc_steps: int = 50  #: steps in which landmarks of a disc move to their places


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
    graph, data, search, refit, coincidence, landmarks, projection
        Numbers of the parts of the method.
    """

    coarse_vertices: int = 1500
    source_vertices: int = 15_000
    coarse: Stage = Stage(10, (5e-3, 5e-5), 1e-3, momentum=0.6)
    stiff_coarse: Stage = Stage(10, (5e-2, 2e-4), 1e-2, momentum=0.6)
    fine: Stage = Stage(8, (2e-4, 2e-5), 1e-4, momentum=0.8, patience=12, factored=4)
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
    data: DataConfig = DataConfig()
    search: SearchConfig = SearchConfig()
    refit: RefitConfig = RefitConfig()
    coincidence: CoincidenceConfig = CoincidenceConfig()
    landmarks: LandmarkConfig = LandmarkConfig()
    projection: ProjectionConfig = ProjectionConfig()

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
