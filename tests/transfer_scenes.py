"""Small flat and closed surfaces with texture coordinates, for the tests of transfer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from examples.shapes import cube

from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.refinement import Level


def plane(columns: int, rows: int, uv: Callable[[np.ndarray], np.ndarray] = lambda points: points) -> Level:
    """The unit square in the plane z = 0, in quads; texture coordinates are a function of x and y."""
    x, y = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    points = np.column_stack([x.ravel(), y.ravel()])
    first = (np.arange(columns) + (columns + 1) * np.arange(rows)[:, None]).ravel()
    faces = np.column_stack([first, first + 1, first + columns + 2, first + columns + 1])
    positions = np.column_stack([points, np.zeros(len(points))])
    return Level(positions, faces, np.arange(len(faces))).with_uvs(uv(points), faces)


def identity_map(level: Level) -> PointMap:
    """Every vertex to itself, as a corner of the last triangle that has it."""
    assert level.faces is not None
    surface = TriangleSurface.from_faces(level.positions, level.faces)
    return PointMap.from_vertices(surface, surface, np.arange(surface.n))


def plane_map(target: Level, columns: int, rows: int, warp: Callable[[np.ndarray], np.ndarray]) -> PointMap:
    """Target vertices to the points ``warp(x, y)`` of ``plane(columns, rows)``."""
    points = np.clip(warp(target.positions[:, :2]), 0, 1)
    cell = np.minimum((points * (columns, rows)).astype(np.int64), (columns - 1, rows - 1))
    fx, fy = (points * (columns, rows) - cell).T
    upper = fy > fx  # quad corners 0, 1, 2, 3 are (0, 0), (1, 0), (1, 1), (0, 1)
    low = np.column_stack([1 - fx, fx - fy, fy])
    high = np.column_stack([1 - fy, fx, fy - fx])
    source = plane(columns, rows)
    surfaces = (TriangleSurface.from_faces(level.positions, level.faces) for level in (target, source))
    triangle = 2 * (cell[:, 0] + columns * cell[:, 1]) + upper
    return PointMap.from_arrays(*surfaces, triangle, np.where(upper[:, None], high, low))


def crossed_cube() -> ControlMesh:
    """A cube whose six faces fill a 3 x 2 grid of the unit square, edge to edge: every edge is a seam."""
    shape = cube()
    cells = np.array([(column, row) for row in range(2) for column in range(3)], dtype=float)
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float)
    uvs = ((cells[:, None] + square) / (3, 2)).reshape(-1, 2)
    return shape.with_uvs(uvs, np.arange(24))


def face_texture(colors: np.ndarray, cell: int) -> np.ndarray:
    """(2 cell, 3 cell, c) texture that gives the six faces of ``crossed_cube`` their colours."""
    grid = colors.reshape(2, 3, -1)[::-1]  # row 0 of the image is the top
    return grid.repeat(cell, axis=0).repeat(cell, axis=1)


def spectrum(image: np.ndarray, size: int) -> np.ndarray:
    """Amplitudes of the frequencies that an image of ``size`` texels can hold."""
    window = np.hanning(len(image))[:, None] * np.hanning(len(image))
    whole = np.abs(np.fft.fftshift(np.fft.fft2((image - 0.5) * window))) * (size / len(image)) ** 2
    low = (len(image) - size) // 2 + (len(image) % 2 != size % 2)
    return whole[low : low + size, low : low + size]
