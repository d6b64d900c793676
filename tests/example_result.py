"""A small result without a match: a box onto itself, turned, so that tests of files, pages and commands are quick."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cagemap.files.result import Result, Side
from cagemap.mesh import ControlMesh, cube
from cagemap.refinement import CatmullClark, refine, triangles


def textured_cube(name: str, scale: float = 1.0) -> ControlMesh:
    """A cube whose faces are laid out in a 3 x 2 grid."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    cells = [((face % 3), (face // 3)) for face in range(6)]
    uvs = np.concatenate([(corners * 0.9 + 0.05 + cell) / [3, 2] for cell in cells])
    control = cube()
    return replace(
        control,
        positions=control.positions * scale,
        uvs=uvs,
        uv_indices=np.arange(24),
        face_materials=np.arange(6) % 2,
        material_names=("red", "unknown"),
        material_colors=np.array([[0.8, 0.05, 0.05], [np.nan] * 3]),
        name=name,
    )


def identity_result(level: int = 3, **changes: Any) -> Result:
    """Target and source are the same cube, the target twice as large; every vertex maps to itself."""
    sides = []
    for name, scale in (("large.obj", 2.0), ("small.obj", 1.0)):
        control = textured_cube(name, scale)
        finest = refine(control, level, CatmullClark()).finest
        assert finest.faces is not None
        landmarks = np.array([0, 3, 5, 6])
        sides.append(Side(control, CatmullClark(), level, finest.positions, finest.faces, np.arange(5.0), landmarks))
    split = triangles(sides[1].faces)
    n = len(sides[0].vertices)
    triangle = np.zeros(n, np.int64)
    triangle[split.ravel()] = np.repeat(np.arange(len(split)), 3)
    barycentric = (split[triangle] == np.arange(n)[:, None]).astype(np.float64)
    quality = {
        "landmark_error_mean": 0.0,
        "landmark_error_worst": 0.0,
        "flipped_area": 0.001,
        "coverage": 1.0,
        "dirichlet": 1.0,
        "aspect_ratio_percentiles": {"50": 1.0},
        "trusted_area": 1.0,
        "warnings": [],
    }
    result = Result(
        target=sides[0],
        source=sides[1],
        source_triangles=split,
        triangle=triangle,
        barycentric=barycentric,
        functional_map=np.eye(5),
        trust=np.ones(n),
        landmark_errors=np.zeros(4),
        landmark_names=("a <b>", "c", "d", "e"),
        manifest={
            "quality": quality,
            "timings": {"map": 1.5, "write": 0.25},
            "peak_memory_bytes": 3 * 2**29,
            "notes": ["made for other poses"],
            "parameters": {"k": 5},
            "inputs": {"target": {"file": "large.obj", "sha256": "0" * 64}},
        },
    )
    return replace(result, **changes)
