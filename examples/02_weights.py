"""Carry skinning weights of the pony's control vertices to the deer's: deer_weights.csv."""

import numpy as np

import cagemap
from cagemap.example import example_pair

pair = example_pair(64)
target = cagemap.prepare_surface(pair.target, level=2)
source = cagemap.prepare_surface(pair.source, level=2)
result = cagemap.match(target, source, pair.landmarks)

# Two joints that share the pony from tail to nose; a rig has a column for each joint.
along = pair.source.positions[:, 2]
front = (along - along.min()) / np.ptp(along)
weights = np.column_stack([front, 1.0 - front])

carried = cagemap.carry_weights(result, weights)
print("vertices, joints:", carried.shape, "sums:", carried.sum(axis=1).min().round(9))
np.savetxt("deer_weights.csv", carried, delimiter=",", header="front,back", comments="")
