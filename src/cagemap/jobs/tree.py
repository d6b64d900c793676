"""Minimum spanning tree of a collection by shape difference, for the fewest matches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import pdist, squareform

from cagemap.errors import CagemapError, FormatError, InvalidMeshError
from cagemap.files.meshes.formats import read_whole
from cagemap.jobs.job_schema import Asset
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles, face_areas
from cagemap.numerics.arrays import FloatArray

DISTANCE_COUNT = 4000
QUANTILE_COUNT = 200


def spanning_tree(assets: Sequence[Asset]) -> list[tuple[str, str]]:
    """Source and target of every match along the spanning tree, both directions of every edge."""
    signatures = []
    for asset in assets:
        try:
            signatures.append(shape_distribution(read_whole(asset.file)))
        except CagemapError as error:
            raise FormatError(f"{asset.name}: a spanning tree needs every mesh, and this one: {error}") from error
    # SciPy takes a length of 0 as no edge.
    lengths = squareform(pdist(np.array(signatures), "cityblock")) + 1.0
    np.fill_diagonal(lengths, 0.0)
    edges = minimum_spanning_tree(lengths).tocoo()
    pairs = []
    for i, j in sorted(zip(edges.row.tolist(), edges.col.tolist(), strict=True)):
        pairs += [(assets[i].name, assets[j].name), (assets[j].name, assets[i].name)]
    return pairs


def shape_distribution(mesh: ControlMesh) -> FloatArray:
    """(q,) quantiles of distances of random surface points over sqrt(area): D2 of Osada et al. 2002.

    Invariant to position, rotation and scale, and nearly to connectivity.
    """
    triangles, faces = cage_triangles(mesh)
    areas = face_areas(mesh)
    if not areas.sum() > 0:
        raise InvalidMeshError(f"{mesh.name}: expected faces with an area, got none. Export the mesh again.")
    share = (areas / np.maximum(mesh.face_sizes - 2, 1))[faces]
    random = np.random.default_rng(20020107)
    sampled = random.choice(len(triangles), size=(2, DISTANCE_COUNT), p=share / share.sum())
    u, v = np.sqrt(random.random((2, 2, DISTANCE_COUNT, 1)))[0], random.random((2, DISTANCE_COUNT, 1))
    a, b, c = (mesh.positions[triangles[sampled, k]] for k in range(3))
    points = (1 - u) * a + u * (1 - v) * b + u * v * c
    distances = np.linalg.norm(points[0] - points[1], axis=1) / np.sqrt(areas.sum())
    return np.quantile(distances, (np.arange(QUANTILE_COUNT) + 0.5) / QUANTILE_COUNT)
