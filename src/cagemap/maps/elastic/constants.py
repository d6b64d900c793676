"""Numbers that decide an elastic map and that nobody needed to set so far; `config` has those that are set."""

from __future__ import annotations

# Where the fit starts

# Source vertices that a start is sought among: twice as many as there are vertices to start.
START_SAMPLES = 3000
# What a fit makes of a start: basis functions trusted of it, the factor by which spectral upsampling of its match lets
# their number grow, and where it ends.
TRUSTED_FUNCTIONS = (8, 20)
FURTHER_GROWTH = 1.5
LAST_FUNCTIONS = 100
# Source points that it is matched with, and how far apart, of sqrt(area), opposite normals count there.
PLACES = 3000
NORMAL_LENGTH = 0.1

# Where it ends

# Mean distance, of sqrt(area), of the coarse fits from the landmarks and from the spectral map above which it is not
# known which way limbs turn, so that further starts are tried. Unposed bodies measured 0.002 to 0.004.
DOUBTFUL = 0.004
# Mean distance of two coarse fits from which on both are finished, and how many are at most.
ENDS_APART = 0.001
MOST_ENDS = 3
# One that costs this many times the cheapest is not.
HOPELESS_END = 1.5

# Two finished ends that are this far apart, of sqrt(area), may each be better somewhere. Parts of less area than that
# share are left alone; what lies within so many rings of edges around a part counts for it, and fades.
PARTS_APART = 0.02
LEAST_PART = 5e-4
PART_RINGS = 3

# Mean turn, in radians, of a fit's vertices against that of all from which on poses differ: bodies that stand alike had
# 0.13 to 0.18, striding, sitting and crouching ones 0.43 to 0.86.
POSES_DIFFER = 0.3

# Share of the area, less than a forearm and its hand, and its least turn from which on a limb is posed otherwise:
# bodies that stand alike had 0.25 to 0.41, animals of other species up to 0.88, one bent elbow 0.54.
LIMB = 0.02
LIMB_POSED = 0.48

# The target in the source's pose: what it weighs that limbs stay rigid, against an end that shows the pose (its square
# root is a length of sqrt(area), 1 loses hands); smoothing of its differentials, see `Stage`; how often joints are
# looked for, over which length, of sqrt(area), the least weight of their edges, and rounds of rotations and places each
# time; and how often the target is posed and fitted.
POSING_STIFFNESS = 0.1
POSING_SMOOTHING = 1e-3
JOINTS_FOUND = 2
JOINT_SMOOTHING = 0.02
LOOSEST = 0.02
POSING_ROUNDS = 5
POSES_FOUND = 2

# The mean with the inverse of the reversed fit: length, of sqrt(area), of its smoothing; distance from the inverse's
# mesh at which a vertex counts a quarter; and how far apart opposite normals are where the inverse is read.
INVERSE_SMOOTHING = 0.02
INVERSE_GAP = 0.01
INVERSE_FACING = 0.02
# The mean is left alone where more than this share of the target's area lies further than so much, of sqrt(area), from
# all that comes back: two bodies in poses had 0.001 and 0.006, a whole onto a part of itself 0.001, 0.05 and 0.1.
INVERSE_FAR = 0.03
INVERSE_LOST = 0.03

# What it lies on

# Vertices from which a level of the source is fine enough to lie on while fitting.
SHEET_VERTICES = 15_000

# What pulls

# Vertices of the source that pull at the target, per vertex of the target's mesh: more of them change nothing.
PULLERS = 2.0

# One in so many coarse vertices may be a curve's, all curves together, but each has as many as it needs to bend.
CURVE_SHARE = 6
FEWEST_OF_CURVE = 6

# What does not pull

# Length over which received area is smoothed, of sqrt(area): less than a finger's width.
SMOOTHING_LENGTH = 0.005
# Received area, of a vertex's own, up to which it does not pull, and from which it pulls fully.
NONE, FULL = 0.25, 0.5
# Lengths of round trips at which the weight is a quarter. Where the source lies outside the target, the target may not
# have reached it yet: sqrt(alpha), the length below which the energy outweighs the data, times this is forgiven.
INSIDE_TRIP = 0.006
OUTSIDE_TRIPS = 6.0

# Length of a round trip at which a source point that pulls at a coarse vertex counts a quarter, of sqrt(area): legs may
# be that much longer. The share of such a pull that is towards the point, not its plane.
CLUSTER_TRIP = 0.4
SLIDING_SHARE = 0.3

# The energy

# Cotangent weights may be negative; the energy wants positive ones: at least this share of the median.
LEAST_WEIGHT = 1e-2
# How far apart, in units of a cluster's size, opposite normals are.
NORMAL_SPREAD = 1.0
# Pieces of cells with less than this share of the mean piece's area are joined to a neighbour, in some rounds: two tiny
# ones may join each other first.
TINY = 0.3
JOINING_ROUNDS = 4
# Ratio of a map's two stretches in the tangent plane below which it flattens the surface.
FLAT = 0.2
# Such a map gets all three singular values up to this share of its largest.
LEAST_STRETCH = 0.3

# The iterations

# Alternations of positions and differentials from the landmarks alone.
LANDMARK_ITERATIONS = 20
# Conjugate gradients with the factors of an earlier iteration, see `Stage.factored`, and the share of the residual at
# which they stop before: without one, they divide by zero once nothing is left of it.
GRADIENTS = 4
SOLVED = 1e-9
# alpha at which coarse fits from different starts are compared.
COST_STIFFNESS = 1e-3
# Root mean square distance, of sqrt(area), within which the deformed mesh lies on the source as well as flat triangles
# can: 3e-6 to 1e-5 between cages of one shape, 4e-5 and more between shapes. There alpha doubles in every iteration,
# as long as it keeps lying, up to where the coarse stages begin.
LYING = 2e-5
STIFFENING = 2.0
STIFFEST = 5e-2
# Share of the vertices with bounded differentials above which a stage goes on.
UNSETTLED = 0.005
