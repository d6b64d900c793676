"""A functional map by the paper's equations, with a descriptor of one's own."""

import numpy as np

from cagemap import research
from cagemap.example import example_pair
from cagemap.spectral import BasisConfig

pair = example_pair(64)
basis = BasisConfig(schedule=(40, 20))
target = research.prepare(pair.target, level=1, basis=basis)
source = research.prepare(pair.source, level=1, basis=basis)
problem = research.make_pair(target, source, pair.landmarks)

columns = []
for surface in (target, source):
    height = surface.refinement.finest.positions[:, 1]
    height = (height - height.mean()) / height.std()
    columns.append(surface.basis.project(np.column_stack([height, height**2]), level=1))

constraints = research.gather_constraints(problem).with_descriptors(*columns)
matrix = research.functional_map(problem, constraints)  # eqs. 13-16
found = research.point_map(problem, matrix)
print("functional map:", matrix.shape)
result = research.result_of_map(problem, found)
print(f"landmarks missed by {100 * result.landmark_errors.mean():.1f} % of the size on average")
