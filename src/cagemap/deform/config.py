"""Numbers that decide a deformation: of its start by ZoomOut, and of the fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.kinds import Config
from cagemap.spectral.zoomout import ZoomOutSchedule


@dataclass(frozen=True)
class Stage(Config):
    """One run of `cagemap.deform.energy.minimise`; lengths are of sqrt(area)."""

    iterations: int
    #: Weight alpha of the energy against the data, first and last; it falls geometrically over the first ``ramp`` of
    #: the iterations. sqrt(alpha) is the length below which the energy outweighs the data.
    stiffness: tuple[float, float]
    smoothing: float  #: epsilon of the energy; its square root is the length over which differentials are smoothed
    ramp: float = 0.7  #: share of the iterations in which the stiffness falls
    momentum: float = 0.0  #: each iteration adds this share of its step once more, the last one does not
    patience: int = 0  #: most extra iterations, at the last stiffness, while `max_bounded` is exceeded
    factored: int = 1  #: iterations from one factorisation of the matrix to the next; those between reuse its factors
    max_bounded: float = 0.005  #: share of vertices whose differentials may be bounded (folded or flat) at the end
    gradient_steps: int = 4  #: conjugate gradient steps of an iteration that reuses factors
    tolerance: float = 1e-9  #: relative residual at which these steps end early
    max_unsolved: float = 0.5  #: relative residual above which the matrix is factored anew

    RANGES: ClassVar = {"iterations": (1, np.inf), "factored": (1, np.inf), "ramp": (0, 1), "momentum": (0, 1)}

    def ramped(self) -> FloatArray:
        """(iterations + patience,) stiffness alpha of every iteration."""
        first, last = self.stiffness
        # With a ramp of 0 the second iteration has the last stiffness.
        steps = np.minimum(np.arange(self.iterations + self.patience) / max(self.ramp * self.iterations, 1e-9), 1.0)
        return np.asarray(first * (last / first) ** steps)


@dataclass(frozen=True, repr=False)
class StartConfig(Config):
    """Starts of the elastic fit by ZoomOut (`deform.multi_start`), from landmarks and from a fit's closest points."""

    search_vertices: int = 3000  #: least number of vertices of the target's deformed and the source's searched level
    source_search_vertices: int = 0  #: the same number for the source, where it differs; 0: as for the target
    zoomout: ZoomOutSchedule = ZoomOutSchedule()
    samples: int = 3000  #: source vertices that ZoomOut searches; it takes twice the number of coarse vertices
    curve_points: int = 40  #: points of a curve at which its landmark coordinate is 1
    trusted_functions: tuple[int, ...] = (8, 20)  #: numbers of functions that a fit determines; each gives one start
    growth: float = 1.5  #: factor by which ZoomOut from a fit raises the number of functions
    last_functions: int = 100  #: number of functions at which it ends
    normal_length: float = 0.1  #: length of a unit normal in the search of a fit's closest points, of sqrt(area)

    RANGES: ClassVar = {"samples": (1, np.inf)}


@dataclass(frozen=True)
class GraphConfig(Config):
    """The elastic graph of a mesh, its clusters, and differentials that fold or flatten a surface."""

    min_weight: float = 1e-2  #: least weight of an edge, as a share of the median; cotangents may be negative
    min_cell: float = 0.3  #: a piece of a cell with a smaller share of the mean cell's area joins a neighbour
    joining_rounds: int = 4  #: rounds of joining; in the first, two tiny pieces may join each other
    neighbours: int = 6  #: coarse vertices whose affine extrapolations are blended at a finer vertex
    cell_counts: tuple[float, float] = (0.85, 1.2)  #: least and most cells, as shares of the number asked for
    cell_rounds: int = 8  #: most widths of a cell that are tried for it
    flat: float = 0.2  #: a differential flattens the surface if its two tangential stretches have a smaller ratio
    min_stretch: float = 0.3  #: least singular value of a bounded differential, as a share of its largest

    # A larger ``min_cell`` calls nearly all cells too small; they would be joined until a few are left.
    RANGES: ClassVar = {"min_cell": (0, 0.5), "neighbours": (1, np.inf), "cell_rounds": (1, np.inf)}


@dataclass(frozen=True)
class DataConfig(Config):
    """Data terms; lengths are of sqrt(area)."""

    samples: float = 2.0  #: source samples per vertex of the target's mesh; more change nothing
    received_smoothing: float = 0.005  #: length over which received area is smoothed; less than a finger's width
    received: tuple[float, float] = (0.25, 0.5)  #: shares of its area received, with no and with full data term
    #: distance from a source sample to its image there and back, at which it has a quarter of its weight
    inside_trip: float = 0.006
    outside_trips: float = 6.0  #: round trip of a quarter of the weight outside, in sqrt(alpha): it may yet arrive
    uncovered: float = 0.02  #: largest distance from an open surface that counts; beyond its boundary is no misfit
    curve_share: int = 6  #: at most one in so many coarse vertices lies on curves
    min_curve_points: int = 6  #: coarse vertices that a curve needs to bend
    shared_gap: float = 0.03  #: a place that a fit leaves farther from the other surface has no counterpart there
    at_boundary: float = 1e-4  #: a place so near to the other surface has a counterpart, also at that one's boundary


@dataclass(frozen=True)
class SearchConfig(Config):
    """Search over several starts (docs/lab/elastic.md, docs/lab/poses.md); lengths of sqrt(area), costs relative."""

    # Fits from two starts that landmarks give, and from further starts if these two fits disagree
    max_start_distance: float = 0.004  #: the fits disagree if their coarse placements are farther apart, on average
    max_limb_rotation: float = 0.48  #: or if a limb is rotated by more, in radians
    limb_area: float = 0.02  #: share of the area that counts as a limb; less than a forearm and its hand
    min_coarse_distance: float = 0.001  #: coarse placements at a larger mean distance are both refined
    max_refined: int = 3  #: coarse placements that are refined from one start, and candidates of the fine stage
    max_cost: float = 1.5  #: factor of the cheapest cost; coarse placements and limb assignments above it are dropped
    part_distance: float = 0.02  #: where two placements are farther apart, either one may be better
    part_area: float = 5e-4  #: least share of the area of a part that is taken from another placement
    #: two placements count as equally good if the larger cost is at most this factor times the smaller one; maps that
    #: differ in the rotation of a limb have ratios from 1.06
    max_equal_cost: float = 1.15
    part_rings: int = 3  #: rings of edges around a part over which its cost fades
    # Starts from limbs and rotations, on a small graph
    small_graph_vertices: int = 400  #: vertices of the graph on which all starts are tried
    small_graph_stage: Stage = Stage(14, (1.0, 2e-4), 1e-2, momentum=0.6)  #: its stage: first nearly rigid, then soft
    min_start_distance: float = 0.03  #: starts at a smaller mean distance are one
    min_answer_distance: float = 0.08  #: placements at a larger mean distance are two answers
    max_coarse: int = 4  #: candidates of the coarse stage if no limbs are assigned
    max_assigned: int = 2  #: assignments of limbs that reach the coarse stage
    max_finish_cost: float = 2.5  #: a candidate that costs more times the best one is not finished
    mirrored_starts: int = 4  #: starts on the mirror image that are fitted; the nearest ones
    turned_penalty: float = 1.1  #: cost factor of a start rotated about the vertical; files mostly agree on the front
    tilted_penalty: float = 1.3  #: the same of other rotations; files nearly always agree on up
    max_unit_ratio: float = 4.0  #: files of parts whose sizes have a larger ratio are in different units
    part_patches: int = 8  #: patches of a whole on which a part is placed
    limb_height: float = 0.1  #: least height of a limb's tip over its pass; fingers reach 0.07, feet start at 0.12
    fewest_points: int = 4  #: limbs and landmarks that an assignment needs
    fewest_of_part: int = 3  #: the same for a part, whose other limbs may be cut off
    max_limbs: int = 7  #: most limbs that are assigned; the most prominent ones
    max_assignments: int = 10  #: assignments that get a start
    max_fitted_assignments: int = 5  #: of these, assignments that are fitted: those with the cheapest starts
    girth_weight: float = 0.5  #: weight of log ratios of girths, against those of lengths
    girth_part: float = 0.7  #: share of a limb's length, from its tip, over which its girth is measured
    tip_height: float = 0.01  #: least height of a tip over its pass; ears have 0.01 to 0.05, feet 0.1 to 0.3
    max_tip_distance: float = 0.2  #: tips of two surfaces that a fit leaves nearer to each other correspond
    min_tip_miss: float = 0.02  #: a placement that leaves all of them nearer is not refitted
    min_landmark_distance: float = 0.05  #: a tip nearer to a landmark is not used
    same_kind_cost: float = 1e-4  #: bodies whose fit costs less are of one kind; no later stage improves them
    max_one_way_cost: float = 4e-4  #: from this cost on, without landmarks, the reverse problem is searched too


@dataclass(frozen=True)
class RefitConfig(Config):
    """Refit in the source's pose, and the average with the inverse (docs/lab/elastic.md); lengths are of sqrt(area)."""

    min_pose_difference: float = 0.3  #: mean rotation, in radians, above which two poses differ
    stage: Stage = Stage(5, (0.1, 0.1), 1e-3)  #: stage of the rotations: stiffness of the limbs against the placement
    joint_rounds: int = 2  #: rounds in which joints are found
    min_stiffness: float = 0.02  #: least weight of an edge at a joint, as a share of its own
    max_folded_frame: float = 0.005  #: `match_next` discards a map that folds a larger share of the area
    smoothing: float = 0.02  #: length over which the gradient of rotations and the shifts to the inverse are smoothed
    start_smoothing: float = 0.1  #: length over which the coarse stage's shifts of a placement are smoothed
    gap: float = 0.01  #: distance from the inverse's mesh at which a vertex has a quarter of its weight
    normal_weight: float = 0.02  #: length of a unit normal in the search on that mesh


@dataclass(frozen=True)
class CoincidenceConfig(Config):
    """Test whether two surfaces coincide (`maps.coincidence`); lengths are in units of sqrt(source area)."""

    mean_gap: float = 0.003  #: largest mean distance of vertices from the other mesh
    max_gap: float = (
        0.01  #: largest distance of the share `min_share` of them; one body has up to 0.0085, two from 0.048 on
    )
    max_distance: float = 0.03  #: a point farther from the other surface is not on it
    #: largest mean distance, of sqrt(target area): eyes have up to 0.21, a chair in metres at one in millimetres 0.33
    max_gap_of_target: float = 0.25
    min_share: float = 0.95  #: least share of the target that is on the source, of what is not beyond its boundary
    min_within_boundary: float = 0.8  #: least share of the target that is not in front of a hole of the source
    max_clothes_cover: float = 0.6  #: clothes cover less of the source, 0.34 to 0.5; a second body covers 0.81
    search_radius: float = 0.1  #: of closest points that face the same way
    # Motions
    moved_gap: float = 0.001  #: largest mean distance of a moved target; another shape, 4 % longer, can have 0.0029
    max_moment_change: float = 0.05  #: largest relative difference of the deviations along principal axes
    min_axis_ratio: float = 1.05  #: least ratio of deviations along two principal axes; equal ones cannot be told apart
    settling_rounds: int = 30  #: closest points and the best similarity in turn
    settling_samples: int = 500  #: face centres of the target in it
    max_distance_ratio: float = 0.95  #: they end where the mean distance falls by less than this factor


@dataclass(frozen=True)
class LandmarkConfig(Config):
    """Landmarks left out or reported; lengths of sqrt(area), misfits and gains are mean |log ratios| of distances."""

    # Distances between landmarks
    fewest_judged: int = 6  #: fewer pairs are not judged; they cannot outvote one
    distance_vertices: int = 1500  #: vertices of the graphs on which distances are measured; their spacing is 0.026
    added_distance: float = 0.1  #: added to both distances of a ratio, since strain and sampling change short ones
    max_misfit: float = 0.7  #: larger |log ratios| count as this; a factor of two
    min_gain: float = 0.12  #: a given place is wrong if the best place has a misfit smaller by this
    gain_of_typical: float = 2.2  #: the same difference in units of the typical misfit
    min_exchange_gain: float = 0.1  #: two pairs are exchanged if that gains more
    min_distance: float = 0.25  #: nearer corrections are left to the strain of the finished map
    tip_reach: float = 0.15  #: at a tip no place within this distance is farther from the other landmarks
    tip_slack: float = 0.03  #: slack in this comparison
    detour: float = 0.2  #: a given and the best place are on one limb if the best one lengthens paths by at most this
    max_suspects: float = 1 / 3  #: with a larger share of suspects it is unknown which are right: none is left out
    one_of: int = 100  #: of so many pairs one is left out before the others are judged again
    max_typical_misfit: float = 0.32  #: with a larger typical misfit nothing is judged
    # What a fit says of suspected pairs
    slip_by_distances: float = 1.14  #: pairs are wrong if they raise the cost by this factor; correct ones reach 1.09
    slip_by_sides: float = 1.05  #: the same for pairs suspected by orientation; exchanged ears have 1.04 to 1.19
    max_confirmed_miss: float = 0.03  #: a suspected pair that the map before an update misses by less is kept
    # Orientation of landmark triples
    min_side_rise: float = 0.2  #: rise of the agreement around two exchanged pairs once exchanged back; 0.3 or more
    min_side_agreement: float = 0.8  #: least agreement after that
    max_side_agreement: float = 0.1  #: largest agreement before; it suspects 14 of 1200 correct sets, without it 95
    min_side_gain: float = -0.03  #: least gain in distances of an exchange of mirror images; they have -0.02 to 0.4
    min_side_distance: float = 0.05  #: nearer landmarks are not used; their orientation depends on exact placement
    max_triple_change: float = 0.5  #: a triple with a larger log ratio of distances says little about orientation
    min_orientation: float = 0.02  #: landmarks with a smaller mean product of orientations are too flat to judge
    mirrored_agreement: float = -0.2  #: landmarks with less are mirrored as a whole; correct ones have 0.45 or more
    min_mirrored_cost: float = 1.3  #: and only if they raise the cost by this factor; correct crossed arms have 1.02
    exchange_distance: float = 0.08  #: from a landmark's place in a fit without it to the landmark it is exchanged with
    # Strain of single pairs
    strain_vertices: int = 300  #: vertices of the graph; the surroundings of a landmark are coarse
    strain_stiffness: float = 1e-4  #: stiffness of its energy
    strain_smoothing: float = 1e-3  #: smoothing of its differentials
    strain_ridge: float = 1e-7  #: weight that holds vertices tangentially, for a unique solution without landmarks
    fewest_strained: int = 10  #: fewer pairs are not judged by strain
    min_strain: float = 0.05  #: a pair that moves farther when it is released strains the map
    min_strain_of_next: float = 1.5  #: and this many times as far as any other; unlike shapes strain many pairs
    max_strain_misfit: float = 0.12  #: with a larger typical misfit the strain of one pair says nothing


@dataclass(frozen=True)
class ProjectionConfig(Config):
    """Projection of a fitted mesh, and removal of its folds; lengths are of sqrt(area), areas shares of the surface."""

    min_cosine: float = 0.15  #: a closest point with a smaller cosine of normals is on the wrong side of a thin part
    landmark_tolerance: float = 1e-12  #: a landmark is met if it is missed by less
    landmark_steps: int = 12  #: most steps to a landmark; few suffice, since the surface is nearly flat there
    landmark_normal_weight: float = 0.002  #: weight of normals in the first step, to keep to one side of a thin part
    rings: tuple[int, ...] = (1, 2, 3, 5, 8)  #: rings of triangles around small folds that are relaxed, by round
    sweeps: int = 10  #: averages over neighbours between two projections of a patch
    min_gain: float = 0.02  #: a further round needs the last one to remove this share of the flipped triangles
    min_part: float = 1e-3  #: least folded area of a part that is flattened
    max_folded: float = 0.02  #: with a larger folded area the map is wrong, and nothing is flattened
    part_distance: float = 0.02  #: folded pieces nearer than this, along edges of an even mesh, are one part
    growths: tuple[float, ...] = (1.1, 1.5, 2.0)  #: radii of the ball around a part, in its image's, tried in turn
    margin: float = 1.15  #: radius of the source's disc, in those of the ball
    max_disc: float = 0.5  #: largest share of either surface's vertices in a disc
    min_unfolded: float = 0.5  #: least share of the fold that must disappear
    max_move: float = 0.05  #: vertices that move farther are displaced
    max_displaced: float = 5.0  #: largest displaced area, in folded areas; fins and ears have 0 to 1.7, limbs 25 to 45
    disc_steps: int = 50  #: steps in which landmarks in a disc move to their places


@dataclass(frozen=True, repr=False)
class ElasticConfig(Config):
    """Parameters of the fit; the defaults are the measured ones (docs/lab/fit_experiments.md)."""

    coarse_vertices: int = 1500  #: size of the coarse graph
    source_vertices: int = 15_000  #: vertices from which on a level of the source is fine enough to fit to
    coarse: Stage = Stage(10, (5e-3, 5e-5), 1e-3, momentum=0.6)
    stiff_coarse: Stage = Stage(10, (5e-2, 2e-4), 1e-2, momentum=0.6)  #: instead of `coarse` where both starts agree
    fine: Stage = Stage(8, (2e-4, 2e-5), 1e-4, momentum=0.8, patience=12, factored=4)
    landmark_start: Stage = Stage(20, (1.0, 1.0), 1e-3)  #: from the landmarks alone, smoothed as the next stage
    normal_weight: float = 0.03  #: closest points count position and this length times the normal
    fine_normal_weight: float = 0.01  #: the same in the fine stage, and where landmarks are moved to a coarser mesh
    projection_normal_weights: tuple[float, float] = (0.002, 0.02)  #: in the last projection, see `facing_points`
    landmark_weight: float = 1e2  #: of a landmark, against a data weight of 1 for the whole surface
    curve_weight: float = 1.0  #: of a curve, by its length in sqrt(area), against the same
    cost_stiffness: float = 1e-3  #: stiffness alpha at which placements are compared
    stretch_weight: float = 3e-3  #: of the variance of log stretches, where placements of open surfaces are compared
    response: Stage = Stage(8, (2e-4, 2e-4), 1e-2, momentum=0.6)  #: change of a map that is there by new landmarks
    # Numbers of the parts of the method
    graph: GraphConfig = GraphConfig()
    data: DataConfig = DataConfig()
    search: SearchConfig = SearchConfig()
    refit: RefitConfig = RefitConfig()
    coincidence: CoincidenceConfig = CoincidenceConfig()
    landmarks: LandmarkConfig = LandmarkConfig()
    projection: ProjectionConfig = ProjectionConfig()

    RANGES: ClassVar = {"coarse_vertices": (4, np.inf)}
