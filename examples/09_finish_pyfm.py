"""One functional map of pyFM finished twice: by ZoomOut there, by the elastic fit here (pip install pyfmaps)."""

import time

import numpy as np
from pyFM.functional import FunctionalMapping
from pyFM.mesh import TriMesh

import cagemap
from cagemap import research
from cagemap.example import example_pair

example = example_pair(64)
source = research.prepare(example.source, level=2)
x, y, z = example.source.positions.T
shape = np.column_stack([1.3 * x + 0.2 * y**2, 0.8 * y + 0.1 * z, 0.9 * z])  # another pony
target = research.prepare(example.source.with_positions(shape), level=2)
truth = np.arange(len(target.vertices))  # vertex i is vertex i
marks = example.landmarks.source[::3]

meshes = [TriMesh(s.vertices, s.finest_triangles.triangles, area_normalize=True) for s in (source, target)]
model = FunctionalMapping(*meshes)  # its mesh1 is our source, its mesh2 our target
model.preprocess(n_descr=100, landmarks=np.column_stack([marks, marks]), subsample_step=5, k_process=150)
model.fit(K=(35, 35), w_descr=1e-1, w_lap=1e-3, w_dcomm=1)
first, psi1, psi2 = model.FM_12, model.mesh2.eigenvectors, model.mesh1.eigenvectors

start = time.perf_counter()
theirs = model.get_p2p(FM=model.zoomout_refine(nit=23, step=5))  # a source vertex for every target vertex
seconds = [time.perf_counter() - start]

start = time.perf_counter()
pair = research.make_pair(target, source, np.column_stack([marks, marks]))
ours = research.elastic(pair, research.from_bases(pair, first, psi1, psi2))
seconds.append(time.perf_counter() - start)

for name, found, took in zip(("ZoomOut", "elastic"), (theirs, ours), seconds, strict=True):
    error = 100 * cagemap.geodesic_error(research.point_map(pair, found), truth).mean()
    print(f"{name}: mean geodesic error x100 {error:.2f}, {took:.1f} s")
