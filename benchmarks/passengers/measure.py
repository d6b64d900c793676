"""How well a passenger sits on a body: distance to the true one, what is inside, what comes through, roundness."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache

import numba
import numpy as np

from benchmarks.accuracy.data import DATA
from benchmarks.riding.scenes import body
from cagemap.files.meshes.obj import read_obj
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.parts import connected_parts
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.closest_points import build_tree, closest_points
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import surface_area, vertex_normals

FOLDER = DATA / "characters" / "passengers"
PARTS = (
    "shirt", "trousers", "skirt", "shoes", "hat", "suit", "eyes",
    "teeth", "tongue", "eyelashes", "eyebrows", "hair", "hair_short",
)  # fmt: skip
NEAR = 0.02  # of sqrt(area): body and garment further apart are not of the same place


@dataclass(frozen=True)
class Figures:
    """A passenger on a body; lengths in hundredths of sqrt(area of the body).

    Attributes
    ----------
    mean, p95 : float
        From its vertices to the true passenger's surface.
    inside : int
        Vertices within the body, by winding number.
    deepest : float
    through : int or None
        Hidden vertices of the body outside the garment; known of bodies of the base topology.
    oval : float or None
        Of the eyes: largest change of a radius relative to the given eye's, up to size.
    """

    mean: float
    p95: float
    inside: int
    deepest: float
    through: int | None
    oval: float | None


@cache
def part(name: str, identity: str) -> ControlMesh:
    """One of the passengers of known truth."""
    return read_obj(FOLDER / f"{name}_{identity}.obj")


@cache
def surface(cage: str, identity: str) -> TriangleSurface:
    """The body as the file has it, at unit area."""
    control = body(cage, identity)
    triangles = cage_triangles(control)[0]
    scale = 1.0 / float(np.sqrt(surface_area(control.positions, triangles)))
    return TriangleSurface(scale * control.positions, triangles, scale)


def judge(name: str, positions: FloatArray, given: str, cage: str, identity: str) -> Figures:
    """A passenger at positions (n, 3), carried from identity ``given``, on a body."""
    on, true = surface(cage, identity), part(name, identity)
    triangles, places = cage_triangles(true)[0], positions * on.scale
    away = 100 * closest_points(build_tree(true.positions * on.scale, triangles), places)[2]
    inside = winding(on.positions, on.triangles, places) > 0.5
    depth = 100 * closest_points(on.tree, places)[2][inside]
    hidden = json.loads((FOLDER / "parts.json").read_text())[name].get("body_vertices_hidden", [])
    through = _through(on, np.array(hidden), places, triangles) if len(hidden) and cage == "base" else None
    oval = _oval(part(name, given), positions) if name == "eyes" else None
    worst = float(depth.max(initial=0.0))
    return Figures(float(away.mean()), float(np.quantile(away, 0.95)), int(inside.sum()), worst, through, oval)


def _through(on: TriangleSurface, hidden: IndexArray, places: FloatArray, triangles: IndexArray) -> int:
    """Vertices of the body above the nearest point of a garment that faces as they do, its hems left out."""
    edges = np.sort(np.concatenate([triangles[:, [1, 2]], triangles[:, [2, 0]], triangles[:, [0, 1]]]), axis=1)
    distinct, number, counts = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    open_edges = (counts == 1)[number.ravel()].reshape(3, -1).T
    hems = np.zeros(len(places), dtype=bool)
    hems[distinct[counts == 1]] = True
    triangle, inside, distance = closest_points(build_tree(places, triangles), on.positions[hidden])
    corners, normals = triangles[triangle], vertex_normals(places, triangles)
    at_hem = ((inside < 1e-6) & open_edges[triangle]).any(axis=1) | ((inside > 1 - 1e-6) & hems[corners]).any(axis=1)
    feet, upward = (np.einsum("nc,ncd->nd", inside, of[corners]) for of in (places, normals))
    height = np.einsum("nd,nd->n", on.positions[hidden] - feet, upward)
    facing = np.einsum("nd,nd->n", on.vertex_normals[hidden], upward) > 0
    return int(np.count_nonzero((height > 0) & facing & ~at_hem & (distance < NEAR)))


def _oval(given: ControlMesh, positions: FloatArray) -> float:
    """Largest change of a distance from the centre, relative to the mean change, over the pieces."""
    worst = 0.0
    for piece in connected_parts(given):
        own = np.unique(np.concatenate([given.face(face) for face in piece.faces]))
        radii = [np.linalg.norm(of[own] - of[own].mean(axis=0), axis=1) for of in (given.positions, positions)]
        kept = radii[0] > 0.5 * radii[0].max()
        ratio = radii[1][kept] / radii[0][kept]
        worst = max(worst, float(np.abs(ratio / ratio.mean() - 1.0).max()))
    return worst


@numba.njit(parallel=True, cache=True, fastmath=True)
def winding(positions, triangles, points):  # type: ignore[no-untyped-def]
    """(m,) winding numbers of a closed surface around points (van Oosterom and Strackee 1983)."""
    turns = np.zeros(len(points))
    for i in numba.prange(len(points)):
        total, x, y, z = 0.0, points[i, 0], points[i, 1], points[i, 2]
        for t in range(len(triangles)):
            u, v, w = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            ax, ay, az = positions[u, 0] - x, positions[u, 1] - y, positions[u, 2] - z
            bx, by, bz = positions[v, 0] - x, positions[v, 1] - y, positions[v, 2] - z
            cx, cy, cz = positions[w, 0] - x, positions[w, 1] - y, positions[w, 2] - z
            la = np.sqrt(ax * ax + ay * ay + az * az)
            lb = np.sqrt(bx * bx + by * by + bz * bz)
            lc = np.sqrt(cx * cx + cy * cy + cz * cz)
            volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
            rest = la * lb * lc + (ax * bx + ay * by + az * bz) * lc
            rest += (bx * cx + by * cy + bz * cz) * la + (cx * ax + cy * ay + cz * az) * lb
            total += np.arctan2(volume, rest)
        turns[i] = total / (2 * np.pi)
    return turns
