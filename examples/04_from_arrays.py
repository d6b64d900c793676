"""Match two meshes that are arrays of vertices and faces, without a file."""

import numpy as np

import cagemap
from cagemap.example import example_pair


def as_arrays(mesh):
    """Positions (n, 3) and a list of faces, as other programs have them."""
    return mesh.positions, [mesh.face(i) for i in range(mesh.n_faces)]


pair = example_pair(64)
meshes = [cagemap.ControlMesh.from_faces(*as_arrays(mesh)) for mesh in (pair.target, pair.source)]
target, source = (cagemap.prepare_surface(mesh, level=2) for mesh in meshes)

# Vertex numbers of both meshes, 0-based: eleven pairs of points.
names = [f"point {i}" for i in range(11)]
landmarks = cagemap.Landmarks(names, pair.landmarks.target[:11], pair.landmarks.source[:11])
result = cagemap.match(target, source, landmarks)

# For every vertex of the subdivided target: a triangle of the source, three weights.
print(result.point_map.triangle.shape, result.point_map.barycentric.shape)
heights = source.refinement.finest.positions[:, 1]
carried = result.point_map.pull_back(heights)
print("heights of the pony on the deer:", np.round([carried.min(), carried.max()], 2))
