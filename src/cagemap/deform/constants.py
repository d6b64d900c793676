"""Numbers of the spectral starts (`cagemap.deform.starts`)."""

from __future__ import annotations

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
# Points of a curve on which its coordinate is 1.
CURVE_POINTS = 40
