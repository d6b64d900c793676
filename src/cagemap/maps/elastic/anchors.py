"""Points of a graph that are held or pulled: its vertices, or points of its mesh's triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.geometry.points import SurfacePoints
from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.pair import vertices_at
from cagemap.mesh.cage_points import CagePoints
from cagemap.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Anchors(CagePoints):
    """Points of the mesh of a level, or vertices of a graph, that are held or pulled."""

    @classmethod
    def on_mesh(cls, mesh: TriangleSurface, points: SurfacePoints) -> Anchors:
        """Points of the finest surface as points of a coarser level's mesh; vertices of both stay vertices."""
        vertices = vertices_at(points)
        anchors = cls.of_vertices(vertices)
        between = np.flatnonzero((vertices < 0) | (vertices >= mesh.n))
        if len(between):
            near = SurfacePoints.nearest(mesh, points.positions[between], points.normals[between], normal_weight=0.01)
            anchors.corners[between], anchors.weights[between] = near.corners, near.barycentric
        return anchors

    def hold(
        self, blocks: FloatArray, right: FloatArray, positions: FloatArray, places: FloatArray, weight: float
    ) -> None:
        """Put the term ``weight |sum_k b_k x_k - y|^2`` of every point into a data term (n, 3, 3), (n, 3).

        A vertex has no other term. Between vertices the residual r = y - sum_k b_k x_k is asked of each corner with
        weight b_k, as in `cagemap.maps.elastic.data.pull_by_source`: an upper bound, equal at the current positions.
        """
        at_vertex = self.weights[:, 0] == 1.0
        held = self.corners[at_vertex, 0]
        blocks[held] = weight * np.eye(3)
        right[held] = weight * places[at_vertex]
        between = self.at(np.flatnonzero(~at_vertex))
        moved = places[~at_vertex] - between.of(positions)
        between.pull(blocks, right, positions, np.tile(weight * np.eye(3), (len(moved), 1, 1)), weight * moved)

    def pull(
        self, blocks: FloatArray, right: FloatArray, positions: FloatArray, pulls: FloatArray, forces: FloatArray
    ) -> None:
        """Add the term ``(sum_k b_k x_k - y)^T B (sum_k b_k x_k - y)`` of every point to a data term, by its corners.

        Parameters
        ----------
        blocks, right, positions : (n, 3, 3), (n, 3), (n, 3) float64
        pulls : (p, 3, 3) float64
            B of every point.
        forces : (p, 3) float64
            B (y - sum_k b_k x_k).
        """
        at_corners = np.einsum("pab,pkb->pka", pulls, positions[self.corners]) + forces[:, None]
        np.add.at(blocks, self.corners, self.weights[:, :, None, None] * pulls[:, None])
        np.add.at(right, self.corners, self.weights[:, :, None] * at_corners)
