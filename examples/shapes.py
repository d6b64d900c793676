"""Small named control meshes for tests, examples and documentation. All are oriented outwards."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from cagemap.errors import ParameterError
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray

Cell = tuple[int, int, int]


def _at_least(name: str, value: int, least: int) -> None:
    if value < least:
        raise ParameterError(f"{name}: expected at least {least}, got {value}")


def cube() -> ControlMesh:
    """The cube [-1, 1]^3: 8 vertices of valence 3, 6 quads."""
    return voxels([(0, 0, 0)], name="cube").with_positions(2.0 * voxels([(0, 0, 0)]).positions)


def tetrahedron() -> ControlMesh:
    """The regular tetrahedron: 4 vertices of valence 3, 4 triangles."""
    positions = [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]
    return ControlMesh.from_faces(positions, [(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)], name="tetrahedron")


def icosahedron() -> ControlMesh:
    """The regular icosahedron: 12 vertices of valence 5, 20 triangles."""
    golden = (1 + np.sqrt(5)) / 2
    ring = [(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)]
    positions = np.array([np.roll(point, turn) for turn in range(3) for point in ring])
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    near = np.abs(distance - 2) < 1e-9
    faces = []
    for a in range(12):
        for b in range(a + 1, 12):
            for c in range(b + 1, 12):
                if near[a, b] and near[b, c] and near[a, c]:
                    outward = np.linalg.det(positions[[a, b, c]]) > 0
                    faces.append((a, b, c) if outward else (a, c, b))
    return ControlMesh.from_faces(positions, faces, name="icosahedron")


def torus(n: int = 8, m: int = 5, *, radius: float = 2.0, tube: float = 0.8) -> ControlMesh:
    """A torus of n x m quads, all valences 4: n around the axis, m around the tube (each at least 3)."""
    _at_least("n", n, 3)
    _at_least("m", m, 3)
    u, v = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(m) / m, indexing="ij")
    ring = radius + tube * np.cos(v)
    positions = np.stack([ring * np.cos(u), ring * np.sin(u), tube * np.sin(v)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    right, up = (i + 1) % n, (j + 1) % m
    faces = np.stack([i * m + j, right * m + j, right * m + up, i * m + up], axis=-1).reshape(-1, 4)
    return _uniform(positions, faces, "torus")


def grid(n: int = 4, m: int = 3) -> ControlMesh:
    """A flat open grid of n x m unit quads in the plane z = 0."""
    _at_least("n", n, 1)
    _at_least("m", m, 1)
    x, y = np.meshgrid(np.arange(n + 1), np.arange(m + 1), indexing="ij")
    positions = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3).astype(np.float64)
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    corner = i * (m + 1) + j
    faces = np.stack([corner, corner + m + 1, corner + m + 2, corner + 1], axis=-1).reshape(-1, 4)
    return _uniform(positions, faces, "grid")


def disk(valence: int = 5) -> ControlMesh:
    """An open disk of ``valence`` quads around vertex 0, slightly domed; its boundary has single-face vertices."""
    _at_least("valence", valence, 3)
    spokes = np.arange(valence)
    spoke, corner = 1 + spokes, 1 + valence + spokes
    faces = np.column_stack([np.zeros(valence, dtype=np.int64), spoke, corner, np.roll(spoke, -1)])
    angle = 2 * np.pi * spokes / valence
    inner = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(valence)])
    half = angle + np.pi / valence
    outer = np.column_stack([1.5 * np.cos(half), 1.5 * np.sin(half), np.full(valence, -0.3)])
    return _uniform(np.concatenate([[[0.0, 0.0, 0.4]], inner, outer]), faces, f"disk of valence {valence}")


def poles(valence: int = 5) -> ControlMesh:
    """A closed sphere of quads whose vertices 0 and 1 have the given valence; all others have 3 or 4."""
    _at_least("valence", valence, 3)
    k = 2 * valence
    top, bottom = 2 + np.arange(k), 2 + k + np.arange(k)
    even = np.arange(0, k, 2)
    caps = [
        np.column_stack([np.zeros(valence, dtype=np.int64), top[even], top[even + 1], top[(even + 2) % k]]),
        np.column_stack([np.ones(valence, dtype=np.int64), bottom[(even + 2) % k], bottom[even + 1], bottom[even]]),
    ]
    band = np.column_stack([bottom, np.roll(bottom, -1), np.roll(top, -1), top])
    angle = 2 * np.pi * np.arange(k) / k
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.full(k, 0.5)])
    positions = np.concatenate([[[0, 0, 1.0], [0, 0, -1.0]], ring, ring * [1, 1, -1]])
    return _uniform(positions, np.concatenate([*caps, band]), f"poles of valence {valence}")


def bipyramid(valence: int = 5) -> ControlMesh:
    """A closed sphere of triangles whose vertices 0 and 1 have the given valence; all others have 4."""
    _at_least("valence", valence, 3)
    ring = 2 + np.arange(valence)
    after = np.roll(ring, -1)
    zero, one = np.zeros(valence, dtype=np.int64), np.ones(valence, dtype=np.int64)
    faces = np.concatenate([np.column_stack([zero, ring, after]), np.column_stack([one, after, ring])])
    angle = 2 * np.pi * np.arange(valence) / valence
    equator = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(valence)])
    return _uniform(np.concatenate([[[0, 0, 1.0], [0, 0, -1.0]], equator]), faces, f"bipyramid of valence {valence}")


def pyramid() -> ControlMesh:
    """A square pyramid: four triangles and a quad."""
    positions = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (0, 0, 1.2)]
    return ControlMesh.from_faces(positions, [(3, 2, 1, 0), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)], name="pyramid")


def creature() -> ControlMesh:
    """A mirror-symmetric four-legged creature of extruded cubes (left is +x, up +y, front +z), closed, genus 0."""
    body = [(x, y, z) for x in (-1, 0, 1) for y in (2, 3) for z in range(6)]
    legs = [(x, y, z) for x in (-1, 1) for y in (0, 1) for z in (0, 5)]
    neck = [(0, 4, 5), (0, 5, 5)]
    head = [(x, 6, z) for x in (-1, 0, 1) for z in (5, 6)] + [(0, 6, 7)]
    ears = [(x, 7, 5) for x in (-1, 1)]
    tail = [(0, 3, -1), (0, 3, -2)]
    return voxels(body + legs + neck + head + ears + tail, name="creature")


def voxels(cells: Iterable[Cell], *, name: str = "voxels") -> ControlMesh:
    """Surface of a union of unit cubes centred on integer points; cubes must touch in whole faces to stay manifold."""
    solid = np.unique(np.array(list(cells), dtype=np.int64), axis=0)
    filled = {tuple(cell) for cell in solid.tolist()}
    quads: list[IndexArray] = []
    for axis in range(3):
        for sign in (-1, 1):
            normal = np.zeros(3, dtype=np.int64)
            normal[axis] = sign
            first, second = np.roll(np.eye(3, dtype=np.int64), -axis - 1, axis=0)[:2]
            turn = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])[::sign]
            offsets = normal + turn[:, :1] * first + turn[:, 1:] * second
            exposed = [cell for cell in solid if tuple((cell + normal).tolist()) not in filled]
            quads.extend(2 * cell + offsets for cell in exposed)
    corners = np.array(quads)
    positions, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return _uniform(positions / 2.0, faces.reshape(-1, 4), name)


def triangulated(mesh: ControlMesh) -> ControlMesh:
    """The same vertices with every face cut into a fan of triangles; UVs follow."""
    counts = mesh.face_sizes - 2
    first = np.repeat(mesh.face_offsets[:-1], counts)
    step = np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
    corners = np.column_stack([first, first + step + 1, first + step + 2]).ravel()
    cut = _uniform(mesh.positions, mesh.face_indices[corners].reshape(-1, 3), mesh.name)
    return cut if mesh.uv_indices is None else cut.with_uvs(mesh.uvs, mesh.uv_indices[corners])


def _uniform(positions: FloatArray, faces: IndexArray, name: str) -> ControlMesh:
    offsets = np.arange(0, faces.size + 1, faces.shape[1], dtype=np.int64)
    return ControlMesh(np.asarray(positions, dtype=np.float64), offsets, faces.astype(np.int64).ravel(), name=name)
