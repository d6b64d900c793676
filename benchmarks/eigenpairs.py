"""``python -m benchmarks.eigenpairs [--level 5] [--count 300]``: `cagemap.eigenpairs` against SciPy's `eigsh`.

One mesh, one run; ``OPENBLAS_NUM_THREADS=1`` makes processor seconds comparable where others use the machine.
"""

from __future__ import annotations

import argparse
import os
import time

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh

from benchmarks.speed.data import BASIS_CAGE
from cagemap.files.meshes.formats import read_mesh
from cagemap.operators import stiffness, vertex_areas
from cagemap.spectral import residual_norms
from cagemap.spectral.mesh_eigenpairs import eigenpairs
from cagemap.subdivision import refine

ACCURACY = 1e-5


def main() -> None:
    """Print a table of two rows."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.eigenpairs", description=__doc__)
    parser.add_argument("--level", type=int, default=5, help="of the cow: 105k vertices at 4, 421k at 5")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--tolerance", type=float, default=1e-7, help="of eigsh, for the inverted problem")
    arguments = parser.parse_args()
    finest = refine(read_mesh(BASIS_CAGE), arguments.level).finest
    mesh, count = (finest.positions, finest.faces), arguments.count
    weights, areas = stiffness(*mesh), vertex_areas(*mesh)
    mass, shift = sparse.csc_array(sparse.diags_array(areas)), -4 * np.pi / areas.sum()
    eigenpairs((mesh[0][:3], [[0, 1, 2]]), 1)  # compile
    print(f"{len(areas)} vertices, {count} pairs, load average {os.getloadavg()[0]:.1f}\n")
    print("| | wall s | processor s | largest residual |\n| --- | --- | --- | --- |", flush=True)
    seconds = []
    for name, call in (
        ("cagemap.eigenpairs", lambda: eigenpairs(mesh, count, ACCURACY)),
        (
            f"scipy eigsh, tol {arguments.tolerance:g}",
            lambda: eigsh(sparse.csc_array(weights), count, mass, sigma=shift, tol=arguments.tolerance),
        ),
    ):
        wall, processor = time.perf_counter(), time.process_time()
        found = call()
        seconds.append((time.perf_counter() - wall, time.process_time() - processor))
        values, vectors = (found.values, found.vectors) if name.startswith("cagemap") else found
        worst = max(
            residual_norms(values[[i]], weights @ vectors[:, [i]], areas[:, None] * vectors[:, [i]], areas)[0]
            for i in range(count)
        )
        print(f"| {name} | {seconds[-1][0]:.1f} | {seconds[-1][1]:.1f} | {worst:.1e} |", flush=True)
    print(f"\nTimes faster: {seconds[1][0] / seconds[0][0]:.1f} wall, {seconds[1][1] / seconds[0][1]:.1f} processor")


if __name__ == "__main__":
    main()
