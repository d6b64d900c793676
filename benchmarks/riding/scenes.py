"""Bodies with rigs made for the purpose: many joints, skinning weights, joints inside limbs, a shape, a bumpy skin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from benchmarks.accuracy.data import DATA
from cagemap.files.meshes.obj import read_obj
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.surface.triangles import normalize_rows, vertex_normals

JOINTS = 60
INFLUENCES = 4


def body(cage: str, identity: str) -> ControlMesh:
    """One of the bodies of known truth."""
    return read_obj(DATA / "humans" / f"{cage}_{identity}.obj")


def spread(points: FloatArray, count: int) -> IndexArray:
    """(count,) points far from each other, one after the other."""
    chosen = [0]
    distance = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def skin_of(control: ControlMesh) -> FloatArray:
    """(n, joints) weights that fall with the distance to 60 spread places; at most four a vertex, rows sum to 1."""
    points = control.positions
    places = points[spread(points, JOINTS)]
    distance, nearest = cKDTree(places).query(points, k=INFLUENCES)
    width = np.median(distance[:, 0])
    weights = np.exp(-0.5 * (distance / width) ** 2)
    weights[:, 1:] *= weights[:, 1:] > 0.02 * weights[:, :1]
    skin = np.zeros((len(points), JOINTS))
    np.put_along_axis(skin, nearest, weights / weights.sum(axis=1, keepdims=True), axis=1)
    return skin


def inner_places(control: ControlMesh, count: int) -> IndexArray:
    """(count, 2) control vertices across limbs from each other: half-way between them lies a joint, in any identity."""
    split = cage_triangles(control)[0]
    normals = vertex_normals(control.positions, split)
    tree = cKDTree(control.positions)
    size = np.ptp(control.positions, axis=0).max()
    pairs = []
    for start in spread(control.positions, 6 * count):
        steps = np.linspace(0.005, 0.12, 60)[:, None] * size
        ray = control.positions[start] - steps * normals[start]
        distance, other = tree.query(ray)
        across = np.einsum("sd,d->s", normals[other], normals[start]) < -0.8
        hit = np.flatnonzero(across & (distance < 0.01 * size))
        if len(hit):
            pairs.append((int(start), int(other[hit[distance[hit].argmin()]])))
        if len(pairs) == count:
            break
    return np.array(pairs)


def normal_image(size: int, steep: float = 1.0) -> NDArray[np.uint8]:
    """(size, size, 3) tangent-space normals of a skin with bumps of some 16 and 64 texels; green up.

    They lean by 14 degrees on average, and by 34 where they are three times as steep.
    """
    rng = np.random.default_rng(0)
    heights = np.zeros((size, size))
    for width, depth in ((4.0, 0.7), (16.0, 3.5)):
        rough = ndimage.gaussian_filter(rng.standard_normal((size, size)), width, mode="wrap")
        heights += steep * depth * rough / rough.std()
    slopes = [ndimage.sobel(heights, axis=axis, mode="wrap") / 8 for axis in (1, 0)]
    normals = normalize_rows(np.stack([-slopes[0], slopes[1], np.ones_like(heights)], axis=2).reshape(-1, 3))
    return np.rint((0.5 * normals + 0.5) * 255).astype(np.uint8).reshape(size, size, 3)
