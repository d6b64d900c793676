"""Numbers that decide how a fitted mesh is projected and its folds removed."""

from __future__ import annotations

# Closest points

# A projected point whose normal makes a smaller cosine with its own is on the wrong side, or far from the source.
LEAST_COSINE = 0.15

# Small folds

# Rings of triangles around the folds that are relaxed and projected with them, round by round.
RINGS = (1, 2, 3, 5, 8)
# Averages over neighbours before a patch is projected again.
SWEEPS = 10
# Share of the flipped triangles that a round must mend for another one to be worth it.
LEAST_MENDED = 0.02

# Whole parts

# Least share of the target's area that is folded in a part for it to be laid out.
LEAST_SHARE = 1e-3
# A map that folds over more than this in all has lost its way, and no part of it is worth the time.
MOST_FOLDED = 0.02
# Folded pieces that are less apart than this, of sqrt(area) and along edges of an even mesh, are one part.
APART = 0.02
# Radii of the ball, in those of the folded part's image: the first that does is taken.
GROWTHS = (1.1, 1.5, 2.0)
# The source's disc reaches this much farther than the ball.
MARGIN = 1.15
# Largest share of either surface that a disc may be.
LARGEST = 0.5
# Share of the fold that has to go.
LEAST_UNFOLDED = 0.5
# A limb is thrown that moves so far, of sqrt(area), and how much area may, of what is folded: fins, ears and toes took
# 0 to 1.7 times the fold's area along in nine pairs, four limbs 25 to 45 times.
THROWN, MOST_THROWN = 0.05, 5.0
# Steps in which landmarks move to their places.
STEPS = 50
# A landmark is met when it is missed by less, of sqrt(area); a few steps do, the surface is nearly flat there.
MET, MEETING_STEPS = 1e-12, 12
# Normal weight of the first projection that keeps to one side of a thin part.
FACING = 0.002
