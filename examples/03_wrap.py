"""Give the deer's control mesh the shape of the pony: deer_as_pony.obj."""

import cagemap
from cagemap.example import example_pair
from cagemap.wrap import wrap

pair = example_pair(64)
target = cagemap.prepare_surface(pair.target, level=3)
source = cagemap.prepare_surface(pair.source, level=3)
result = cagemap.match(target, source, pair.landmarks)

wrapped = wrap(target.refinement, result.point_map)
print(f"mean distance to the pony: {100 * wrapped.distance.mean():.3f} % of its size")
print("folded faces:", len(wrapped.folded))
cagemap.write_mesh("deer_as_pony.obj", wrapped.mesh)
