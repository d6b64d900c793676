"""Move a landmark and bend the map that is there, without a new match."""

from dataclasses import replace

import numpy as np

import cagemap
from cagemap.example import example_pair

pair = example_pair(64)
target = cagemap.prepare_surface(pair.target, level=2)
source = cagemap.prepare_surface(pair.source, level=2)
result = cagemap.match(target, source, pair.landmarks)

# Send the landmark of the left eye to a neighbour of the vertex where it was.
eye = pair.landmarks.names.index("eye_L")
moved = pair.landmarks.source.copy()
faces = [pair.source.face(i) for i in range(pair.source.n_faces)]
moved[eye] = next(face[0] for face in faces if moved[eye] in face[1:])
landmarks = replace(pair.landmarks, source=moved)

updated = cagemap.update_match(result, landmarks)
shift = updated.point_map.images.positions - result.point_map.images.positions
lengths = np.linalg.norm(shift, axis=1)
print(f"{np.mean(lengths > 1e-3):.0%} of the vertices moved, the farthest {lengths.max():.3f}")
