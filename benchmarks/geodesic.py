"""Errors along the surface, as the literature measures them: the heat method on the operators that are there.

Crane, Weischedel and Wardetzky 2013: heat flows for a short time, its normalised gradient is that of the distance.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from benchmarks.truth import Truth
from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.point_map import PointMap
from cagemap.numerics.factorization import factor
from cagemap.operators.laplacian import stiffness, vertex_areas

# Judged vertices and right sides at a time: each costs two solves on the source.
SAMPLES, BATCH = 300, 50


def geodesic_errors(found: PointMap, truth: Truth, samples: int = SAMPLES) -> np.ndarray:
    """(s,) distances on the source, of sqrt(area), between the map's and the true images of some target vertices."""
    known = np.flatnonzero(truth.known)
    chosen = known[np.unique(np.linspace(0, len(known) - 1, min(samples, len(known))).astype(int))]
    true_images, images = truth.on(found.source).at(chosen), found.images.at(chosen)
    solver = HeatDistances(found.source)
    errors = np.empty(len(chosen))
    for start in range(0, len(chosen), BATCH):
        rows = np.arange(start, min(start + BATCH, len(chosen)))
        distances = solver.from_weights(true_images.at(rows).matrix().toarray().T)
        at = images.at(rows)
        errors[rows] = np.einsum("mk,mkm->m", at.barycentric, distances[at.corners])
    straight = np.linalg.norm(images.positions - true_images.positions, axis=1)
    return np.maximum(errors, straight)  # no way along the surface is shorter; near the source the method rounds


class HeatDistances:
    """Distances on one surface, two factorisations for all sources."""

    def __init__(self, surface: TriangleSurface) -> None:
        positions, self.triangles = surface.positions, surface.triangles
        self.n = surface.n
        laplacian = sparse.csc_array(stiffness(positions, self.triangles))
        areas = vertex_areas(positions, self.triangles)
        corners = positions[self.triangles]
        edges = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]  # opposite corners 0, 1, 2
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        double = np.linalg.norm(normals, axis=1)
        # Gradient of the hat function of every corner; degenerate triangles have none.
        turned = np.cross(normals[:, None], edges)
        self.gradients = turned / np.maximum(double**2, 1e-30)[:, None, None]
        self.areas = 0.5 * double
        length = float(np.linalg.norm(edges, axis=2).mean())
        self.heat = factor(sparse.csc_array(sparse.diags_array(areas) + length**2 * laplacian))
        self.poisson = factor(sparse.csc_array(laplacian + 1e-9 * sparse.diags_array(areas)))

    def from_weights(self, weights: np.ndarray) -> np.ndarray:
        """(n, q) distances from q points given as columns of weights of vertices (n, q)."""
        heat = np.asarray(self.heat.solve(np.ascontiguousarray(weights)))
        distances = np.empty_like(heat)
        divergences = np.zeros_like(heat)
        for q in range(heat.shape[1]):
            gradient = np.einsum("tk,tkd->td", heat[self.triangles, q], self.gradients)
            unit = -gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-300)
            flows = self.areas[:, None] * np.einsum("tkd,td->tk", self.gradients, unit)
            divergences[:, q] = np.bincount(self.triangles.ravel(), flows.ravel(), minlength=self.n)
        distances = np.asarray(self.poisson.solve(divergences))
        return distances - np.einsum("nq,nq->q", weights, distances)
