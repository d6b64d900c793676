"""Match two meshes that are arrays of vertices and faces, without a file."""

import numpy as np

import cagemap
from cagemap.example import example_pair


def as_arrays(mesh):
    """Vertices (n, 3) and a list of faces, as other programs have them."""
    return mesh.positions, [mesh.face(i) for i in range(mesh.n_faces)]


pair = example_pair(64)
deer, pony = as_arrays(pair.target), as_arrays(pair.source)
target, source = cagemap.prepare_surfaces(deer, pony, levels=(2, 2))

# One row for each landmark: its vertex on the deer and its vertex on the pony, 0-based.
landmarks = np.column_stack([pair.landmarks.target, pair.landmarks.source])
result = cagemap.match(target, source, landmarks)

# For every vertex of the subdivided target: a triangle of the source, three weights.
print(result.point_map.triangle.shape, result.point_map.barycentric.shape)
heights = source.refinement.finest.positions[:, 1]
carried = result.point_map.pull_back(heights)
print("heights of the pony on the deer:", np.round([carried.min(), carried.max()], 2))
