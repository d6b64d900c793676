"""pyFM's functional map with ZoomOut, run by an interpreter that has pyFM; knows nothing of cagemap.

``PYTHON pyfm_worker.py INPUT.npz OUTPUT.npz BUDGET``: input holds vertices and triangles of source (mesh1) and target
(mesh2) and landmark pairs; output the map and the seconds of every stage. ZoomOut stops after BUDGET seconds; the steps
left out are charged what the last one cost.
"""

import sys
import time

import numpy as np
from pyFM.functional import FunctionalMapping
from pyFM.mesh import TriMesh
from pyFM.refine.zoomout import zoomout_iteration

FIT, LAST, STEP = 35, 150, 5


def main() -> None:
    given, answer, budget = np.load(sys.argv[1]), sys.argv[2], float(sys.argv[3])
    seconds = {}

    def mark(stage: str, start: float) -> None:
        seconds[stage] = time.perf_counter() - start

    start = time.perf_counter()
    source, target = (
        TriMesh(given[f"{side}_vertices"], given[f"{side}_triangles"], area_normalize=True, center=False)
        for side in ("source", "target")
    )
    model = FunctionalMapping(source, target)
    model.preprocess(n_descr=100, descr_type="WKS", landmarks=given["landmarks"], subsample_step=5, k_process=200)
    mark("eigenvectors and descriptors", start)
    start = time.perf_counter()
    model.fit(K=(FIT, FIT), w_descr=1e-1, w_lap=1e-3, w_dcomm=1, verbose=False)
    mark("fit", start)

    start = time.perf_counter()
    functional_map, steps, last = model.FM_12, 0, 0.0
    wanted = (LAST - FIT) // STEP
    while steps < wanted and (steps == 0 or time.perf_counter() - start + last < budget):
        begin = time.perf_counter()
        functional_map = zoomout_iteration(
            functional_map, model.mesh1.eigenvectors, model.mesh2.eigenvectors, step=STEP, A2=model.mesh2.A
        )
        last = time.perf_counter() - begin
        steps += 1
    mark("ZoomOut", start)
    seconds["ZoomOut, extrapolated"] = (wanted - steps) * last
    start = time.perf_counter()
    match = model.get_p2p(FM=functional_map)
    mark("point map", start)
    np.savez(answer, match=match, steps=steps, wanted=wanted, stages=list(seconds), seconds=list(seconds.values()))


main()
