"""Match the built-in pair and bake the pony's texture for the deer: deer.png."""

import cagemap
from cagemap.example import example_pair

pair = example_pair(1024)
target = cagemap.prepare_surface(pair.target, level=3)
source = cagemap.prepare_surface(pair.source, level=3)

result = cagemap.match(target, source, pair.landmarks)
print(result.quality.summary())

texture = cagemap.bake(result, pair.texture, size=1024)
cagemap.write_image("deer.png", texture)
