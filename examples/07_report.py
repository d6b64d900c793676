"""Write a RESULT folder and one page with pictures and words about the map: report.html."""

import cagemap
from cagemap.example import example_pair

pair = example_pair(512)
target = cagemap.prepare_surface(pair.target, level=2)
source = cagemap.prepare_surface(pair.source, level=2)
result = cagemap.match(target, source, pair.landmarks)

cagemap.write_result("RESULT", result)
baked = cagemap.bake(result, pair.texture, size=512)
read = cagemap.read_result("RESULT")  # what `cagemap report RESULT` starts from
cagemap.write_report("report.html", read, texture=pair.texture, baked=baked)
