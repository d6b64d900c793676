"""``python -m benchmarks.blender PYTHON``: refined points of our USD files against Blender's, whose package is ``bpy``.

PYTHON is an interpreter of an environment of its own that has bpy; ours and Blender's need not fit together.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from examples.shapes import creature, cube, grid
from scipy.spatial import cKDTree

from cagemap.files.usd.read import read_usd
from cagemap.files.usd.write import write_usd
from cagemap.mesh import CatmullClark, ControlMesh
from cagemap.subdivision import refine

LEVEL = 3
IN_BLENDER = """
import sys, bpy, numpy
print('bpy', bpy.app.version_string)
for path in sys.argv[2:]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=path, import_subdivision=True)
    (thing,) = [thing for thing in bpy.data.objects if thing.type == 'MESH']
    (subdivision,) = [modifier for modifier in thing.modifiers if modifier.type == 'SUBSURF']
    subdivision.levels, subdivision.use_limit_surface = int(sys.argv[1]), False
    mesh = thing.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    points = numpy.empty(3 * len(mesh.vertices), dtype=numpy.float32)
    mesh.vertices.foreach_get('co', points)
    numpy.save(path + '.npy', points.reshape(-1, 3))
"""


def _creased(mesh: ControlMesh) -> ControlMesh:
    edges = np.column_stack([mesh.face_indices, mesh.face_indices[mesh.next_corners]])
    edges = np.unique(np.sort(edges, axis=1), axis=0)[::5]
    return mesh.with_creases(edges, np.resize([0.9, 2.5, 10.0], len(edges)))


def main() -> None:
    """Write five assets, let Blender refine them, and compare."""
    smooth = CatmullClark("edge_only")
    assets = {
        "smooth": replace(creature(), scheme=smooth),
        "creased": replace(_creased(creature()), scheme=smooth),
        "corners": replace(cube().with_corners([0, 3], [1.5, 10.0]), scheme=smooth),
        "round boundary": replace(grid(3, 4), scheme=smooth),
        "sharp boundary": replace(grid(3, 4), scheme=CatmullClark("edge_and_corner")),
    }
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{name.replace(' ', '_')}.usda" for name in assets]
        for file, mesh in zip(files, assets.values(), strict=True):
            write_usd(file, mesh)
        command = [sys.argv[1], "-c", IN_BLENDER, str(LEVEL), *map(str, files)]
        told = subprocess.run(command, check=True, capture_output=True, text=True, env={"PATH": "/usr/bin:/bin"})
        print(next(line for line in told.stdout.splitlines() if line.startswith("bpy")))
        for name, file in zip(assets, files, strict=True):
            theirs = np.load(f"{file}.npy").astype(np.float64)
            ours = refine(read_usd(file), LEVEL).finest.positions
            # The two number refined points differently: each has its own next to one of the other's.
            apart = max(cKDTree(a).query(b)[0].max() for a, b in ((ours, theirs), (theirs, ours)))
            size = np.ptp(ours, axis=0).max()
            print(f"{name}: {len(theirs)} and {len(ours)} points, {apart:.1e} apart, size {size:.1f}")


if __name__ == "__main__":
    main()
