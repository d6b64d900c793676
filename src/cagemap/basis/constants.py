"""Every number that decides a basis, with its meaning; sizes of pieces that only decide speed stay where they are used.

Relative errors and residuals have no unit; rows are vertices of a level, pairs are eigenpairs.
"""

from __future__ import annotations

# --- Which level computes what (construction, schedule)

# Pairs computed below the start of a band, to see which of them the prolonged basis has already.
OVERLAP = 12
# The relative eigenvalue error of pair j at a level with n vertices is about (j / (c n))^3, c between these two on all
# surfaces measured: simple plump ones have the larger, bodies with fingers the smaller.
REACH = 0.5
LEAST_REACH = 0.14
# How far below the last good pair, as a share, a level may stop in order to end at a wide gap.
GAP_SEARCH = 0.25
# Relative gap below which eigenvalues count as one repeated eigenvalue, whose eigenvectors may be rotated.
CLUSTER = 1e-4
# Condition of the Gram matrix above which functions of different levels nearly repeat each other: a warning.
ILL_CONDITIONED = 100.0
# Convergence of the pairs of a fixed schedule, whose eigenvalues are wrong by a thousand times that and more on coarse
# levels; from here on the Krylov space is kept in single precision.
FIXED_ACCURACY = 1e-5
# Largest relative error of its eigenvalues on levels that start from the pairs of the level below: near what single
# precision resolves, so that residuals are at most twice those of a level computed from nothing to the above.
FIXED_GUESS = 1e-4
# Of every random block: any fixed number makes the basis reproducible.
SEED = 2019
KRYLOV_SEED = 20190708  # SGP 2019 opened on that day

# --- Levels that start from the pairs of the level below (construction, guess)

# Levels with more rows do, if those are good to this relative error (safety included) and reach half this many places
# beyond what is wanted.
GUESS_ROWS = 12_000
GUESS_ERROR = 5e-1
GUARDS = 30
# How many pairs below a window take part in its Rayleigh-Ritz step, in widths of the window; all where the tolerance is
# below this.
BELOW = 1
TIGHT = 1e-3
# Share of the tolerance that unfinished iterations may take.
GUESS_SHARE = 0.25
# Single precision disturbs eigenvectors by 1e-6, and Rayleigh quotients taken of them in double by its square.
SINGLE_TOLERANCE = 1e-6
# Accuracy up to which double precision is tried where single fails.
NEARLY_DOUBLE = 1e-4
# Below this the values found in single precision, good to 1e-5 for the lowest, are taken once more in double.
QUOTIENT_TOLERANCE = 1e-4
# Pairs just outside of the ones wanted: those below are iterated too, those above searched for a gap.
NEAR = 8
# Share of the tolerance from which on a pair gets a direction of its own if others need one, and most in one round.
NEARLY_GOOD = 0.3
MOST_ADDED = 96
# The largest error may grow a little from round to round as pairs change places, not more.
DIVERGED = 10.0
# Rounds of Rayleigh-Ritz after which a guess was not good enough.
MOST_ROUNDS = 10
# Most pairs that a guess may lack, columns of the block that looks for them, and its inverse iterations.
MOST_MISSED = 8
STRANGERS = 24
SEARCH_STEPS = 6

# --- Levels that start from nothing (eigen, lanczos)

# Up to this many rows a dense solve is faster than an iteration, up to the second where much of the spectrum is wanted.
DENSE_ROWS = 800
LARGEST_DENSE_ROWS = 5_000
# Relative eigenvalue of a coarse mass matrix below which a direction is one that subdivision maps to zero.
RANK = 1e-13
# Convergence from which on a Krylov space in single precision is exact enough: it disturbs eigenvalues by under 1e-5.
SINGLE_STORAGE = 1e-5
# Places that are tried where a factorisation does not tell its inertia.
PLACES = 3
# Pairs computed beyond those asked for, among which a gap is sought to count the eigenvalues below it.
EXTRA_PAIRS = 8
# Residual that is enough for pairs which only have to be told from their neighbours.
LOOSE = 1e-2
# Columns of a first block that is mixed from the pairs of the level below.
START_COLUMNS = 16
# Inverse squared condition of a block that one Cholesky QR leaves orthonormal enough for a Krylov basis, and that of
# one which has lost a direction.
WELL_CONDITIONED = 1e-6
DEPENDENT_BLOCK = 1e-14
# Smallest eigenvalue of the Gram matrix of unit columns below which one of them is no direction of its own, and the
# part of a new direction that must be new.
DEPENDENT_COLUMNS = 1e-5
NEW_SHARE = 1e-4

# --- How far pairs are from the finest level (error_estimate, smoothing)

# What a prediction leaves out: unfinished iterations, and all levels finer than the next. On bodies with badly shaped
# faces it was up to 3.1 times too low.
SAFETY = 3.0
# A sample may miss pairs on badly resolved parts, whose errors are several times those of their neighbours.
SAMPLE_SAFETY = 2.0
SAMPLES = 32
# Rows of the next level times pairs: below the first all pairs are predicted at once, above the second never.
CHEAP_WORK = 4_000_000
MUCH_WORK = 20_000_000
# Chebyshev steps of a prediction, and the condition of the scaled stiffness matrix on what the coarser level cannot
# represent.
PREDICTION_STEPS = 4
CONDITION = 20.0
# Steps of the Lanczos iteration that bounds its largest eigenvalue.
BOUND_STEPS = 20
