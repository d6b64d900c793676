"""The control net that is fitted: one level of the target, its rest shape and its checks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cagemap.deform.energy import ElasticEnergy
from cagemap.deform.graph import ElasticGraph, mesh_graph
from cagemap.errors import ParameterError
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.subdivision import Refinement, finest_mesh, level_triangles
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import triangle_normals
from cagemap.wrap.config import NetConfig


@dataclass(frozen=True, eq=False)
class ControlNet:
    """One level of a surface as a net of control points, with its rest shape."""

    refinement: Refinement
    level: int  # of the net; below the finest
    mesh: ControlMesh  # the net, at rest
    # Rest shape at unit area of the surface. Weights are cotangents times edge lengths (times their mean), so that
    # the energy has a similar weight against squared distances for small and large faces
    graph: ElasticGraph
    energy: ElasticEnergy
    # (m,) Where every face's triangles of the finest level begin: those of one face follow those of the face before
    first_triangles: IndexArray

    def surface(self, positions: FloatArray) -> FloatArray:
        """(n_f, 3) finest vertices of the surface over a net (n_l, 3)."""
        return self.refinement.prolong(positions, self.level, self.refinement.n_levels)


def level_mesh(refinement: Refinement, level: int) -> ControlMesh:
    """A level as a mesh with UVs, materials and groups; level 0 is the control mesh.

    Raises ParameterError if the level is not 0 and the mesh has hole faces, which the level's mesh would lack.
    """
    if level and refinement.holes(level).any():
        raise ParameterError(
            f"{refinement.control.name}: has hole faces, so that only level 0 can be a net. Give level 0."
        )
    return finest_mesh(replace(refinement, matrices=refinement.matrices[:level], levels=refinement.levels[: level + 1]))


def control_net(refinement: Refinement, level: int, scale: float, config: NetConfig = NetConfig()) -> ControlNet:
    """Prepare a level of the target for fitting."""
    mesh = level_mesh(refinement, level)
    net = TriangleSurface(scale * mesh.positions, level_triangles(refinement, level), scale)
    faces = refinement.levels[level].faces
    graph = mesh_graph(net, net.triangles if faces is None else faces)
    lengths2 = np.einsum("ed,ed->e", graph.edges, graph.edges)
    graph = replace(
        graph, weights=graph.weights * (lengths2 / lengths2.mean()) ** config.weight_power * lengths2.mean()
    )
    energy = ElasticEnergy.build(graph, config.smoothing)
    finest = refinement.finest
    steps = refinement.n_levels - level
    face = finest.face_parents if level == 0 else np.arange(finest.n_faces) // 4**steps
    per_face = len(level_triangles(refinement, refinement.n_levels)) // finest.n_faces
    first = per_face * np.searchsorted(face, np.arange(mesh.n_faces))
    return ControlNet(refinement, level, mesh, graph, energy, first)


def folded_faces(net: ControlNet, positions: FloatArray) -> NDArray[np.bool_]:
    """(m,) faces of the net whose mean normal is turned against the refined surface that they control."""
    refinement, corner = net.refinement, positions[net.mesh.face_indices]
    fine = triangle_normals(net.surface(positions), level_triangles(refinement, refinement.n_levels))
    sums = np.add.reduceat(fine, net.first_triangles, axis=0)
    normals = np.add.reduceat(np.cross(corner, corner[net.mesh.next_corners]), net.mesh.face_offsets[:-1], axis=0)
    return np.asarray(np.einsum("md,md->m", normals, sums) <= 0)


def face_aspects(mesh: ControlMesh, positions: FloatArray) -> FloatArray:
    """(m,) longest edge of every face divided by its shortest."""
    corner = positions[mesh.face_indices]
    lengths = np.linalg.norm(corner[mesh.next_corners] - corner, axis=1)
    begin = mesh.face_offsets[:-1]
    return np.asarray(np.maximum.reduceat(lengths, begin) / np.maximum(np.minimum.reduceat(lengths, begin), 1e-300))
