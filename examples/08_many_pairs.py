"""Prepare every model once, match all ordered pairs, and print a table."""

from itertools import permutations

import cagemap
from cagemap.example import example_pair

pair = example_pair(64)
models = {"deer": pair.target, "pony": pair.source}
surfaces = {name: cagemap.prepare_surface(mesh, level=2) for name, mesh in models.items()}

print("target  source  folded %  source left out %")
for target, source in permutations(surfaces, 2):
    landmarks = pair.landmarks if target == "deer" else pair.landmarks.reversed()
    result = cagemap.match(surfaces[target], surfaces[source], landmarks)
    cagemap.write_result(f"{source}__{target}", result)
    quality = result.quality
    left_out = 100 * (1 - quality.coverage)
    print(f"{target:6}  {source:6}  {100 * quality.flipped_area:8.2f}  {left_out:17.2f}")
