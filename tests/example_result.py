"""A small result without a match: a box onto itself, turned, so that tests of files, pages and commands are quick."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from examples.shapes import cube

from cagemap.basis import BasisConfig, Surface
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import QualityFigures
from cagemap.maps.result import MatchResult, SpectralMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.refinement import CatmullClark, refine


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


def identity_result(level: int = 3) -> MatchResult:
    """Target and source are the same cube, the target twice as large; every vertex maps to itself."""
    target, source = (
        Surface(refine(textured_cube(name, scale), level, CatmullClark()), BasisConfig(count=5))
        for name, scale in (("large.obj", 2.0), ("small.obj", 1.0))
    )
    vertices = np.array([0, 3, 5, 6])
    places = target.triangles(level), source.triangles(level)
    split, n = places[1].triangles, places[0].n
    triangle = np.zeros(n, np.int64)
    triangle[split.ravel()] = np.repeat(np.arange(len(split)), 3)
    barycentric = (split[triangle] == np.arange(n)[:, None]).astype(np.float64)
    quality = {
        "flipped_area": 0.001,
        "coverage": 1.0,
        "dirichlet": 1.0,
        "aspect_ratio_percentiles": {"50": 1.0},
        "trusted_area": 1.0,
    }
    return MatchResult(
        target,
        source,
        Landmarks(("a <b>", "c", "d", "e"), vertices, vertices, "large.obj", "small.obj"),
        PointMap.from_arrays(*places, triangle, barycentric),
        QualityFigures.of_summary(quality, np.zeros(4), np.ones(n)),
        {"map": 1.5, "write": 0.25},
        known_spectral=SpectralMap(np.eye(5), np.arange(5.0), np.arange(5.0)),
        provenance={
            "peak_memory_bytes": 3 * 2**29,
            "notes": ["made for other poses"],
            "parameters": {"k": 5},
            "inputs": {"target": {"file": "large.obj", "sha256": "0" * 64}},
        },
    )
