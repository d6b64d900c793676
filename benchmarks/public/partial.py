"""``python -m benchmarks.public.partial FAUST_R FOLDER --holes N``: parts of FAUST_r's test bodies in PFAUST's layout.

Around random vertices all within a distance along edges is cut out, or with ``--plane SHARE`` all on one side of a
random plane, so that about this share of the area is left; the largest piece left is a part. ``FOLDER`` has
whole bodies in ``off`` and ``corres``, parts in ``partial_off`` and ``partial_corr``, and in ``masks`` which points of
the template a part has, as the published sets PFAUST-M and PFAUST-H (Bracha et al. 2024), which are cut elsewhere.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from benchmarks.public.sets import PART_FOLDER, PART_POINTS, SETS
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.mesh import ControlMesh
from cagemap.surface.triangles import triangle_areas

# Radius of a hole, of sqrt(area).
RADIUS = 0.08


def cut(positions: np.ndarray, triangles: np.ndarray, holes: int, seed: int) -> np.ndarray:
    """(n,) which vertices of a body are left, in one piece, with no triangle of removed ones."""
    n, size = len(positions), np.sqrt(triangle_areas(positions, triangles).sum())
    ends = np.vstack([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    lengths = np.linalg.norm(positions[ends[:, 0]] - positions[ends[:, 1]], axis=1)
    graph = sparse.csr_array((lengths, ends.T), shape=(n, n)).maximum(sparse.csr_array((lengths, ends.T[::-1]), (n, n)))
    centres = np.random.default_rng(seed).choice(n, holes, replace=False)
    away = dijkstra(graph, indices=centres, limit=RADIUS * size, min_only=True)
    return largest_piece(np.isinf(away), triangles)


def cut_by_plane(positions: np.ndarray, triangles: np.ndarray, share: float, seed: int) -> np.ndarray:
    """(n,) which vertices are left on one side of a random plane that leaves about such a share of the area."""
    direction = np.random.default_rng(seed).standard_normal(3)
    heights, areas = positions @ direction, triangle_areas(positions, triangles)
    middles = heights[triangles].mean(axis=1)
    order = np.argsort(middles)
    level = middles[order][np.searchsorted(np.cumsum(areas[order]), (1.0 - share) * areas.sum())]
    return largest_piece(heights > level, triangles)


def largest_piece(left: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n,) which of the vertices that are left (n,) are in the largest connected piece of their triangles."""
    n, whole = len(left), triangles[left[triangles].all(axis=1)]
    links = sparse.csr_array((np.ones(2 * len(whole)), (whole[:, [0, 1]].ravel(), whole[:, [1, 2]].ravel())), (n, n))
    _, pieces = connected_components(links, directed=False)
    used = np.unique(whole)
    largest = np.bincount(pieces[used]).argmax()
    return np.isin(np.arange(n), used[pieces[used] == largest])


def write_part(root: Path, shape: str, mesh: ControlMesh, known: np.ndarray, kept: np.ndarray) -> None:
    """A whole body, its part of some vertices (n,), and the template's points on both, whose vertices are ``known``."""
    triangles = mesh.face_indices.reshape(-1, 3)
    number = np.cumsum(kept) - 1
    part = ControlMesh.from_faces(mesh.positions[kept], number[triangles[kept[triangles].all(axis=1)]], name=shape)
    for folder in ("off", "corres", PART_FOLDER, PART_POINTS, "masks"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    write_mesh(root / "off" / f"{shape}.off", mesh, force=True)
    write_mesh(root / PART_FOLDER / f"{shape}.off", part, force=True)
    np.savetxt(root / "corres" / f"{shape}.vts", known + 1, fmt="%d")
    np.savetxt(root / "masks" / f"{shape}.vts", kept[known], fmt="%d")
    np.savetxt(root / PART_POINTS / f"{shape}.vts", number[known[kept[known]]] + 1, fmt="%d")


def main(given: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.public.partial", description=__doc__)
    parser.add_argument("faust_r", type=Path, help="where FAUST_r was unpacked")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--holes", type=int, default=4, help="4 as in PFAUST-M, 13 as in PFAUST-H")
    parser.add_argument("--plane", type=float, help="share of the area that a plane leaves, instead of holes")
    arguments = parser.parse_args(given)
    public = SETS["faust_r"]
    for seed, (shape, path) in enumerate(public.shapes(arguments.faust_r).items()):
        mesh = read_mesh(path)
        known = public.marks(arguments.faust_r, shape, mesh).points.corners[:, 0]
        triangles = mesh.face_indices.reshape(-1, 3)
        if arguments.plane is None:
            kept = cut(mesh.positions, triangles, arguments.holes, seed)
        else:
            kept = cut_by_plane(mesh.positions, triangles, arguments.plane, seed)
        write_part(arguments.folder, shape, mesh, known, kept)


if __name__ == "__main__":
    main()
