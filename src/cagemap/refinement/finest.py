"""The finest level as a mesh of its own, for files and other programs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import keep_faces
from cagemap.numerics.arrays import IndexArray
from cagemap.refinement.refinement import Refinement


def finest_mesh(refinement: Refinement) -> ControlMesh:
    """Finest level with its UVs, materials, objects and groups, without creases and without holes.

    What is linear over the control mesh and no shape, such as vertex colours, is left out.
    """
    finest, control = refinement.finest, refinement.control
    if finest.faces is None or refinement.n_levels == 0:
        return control

    def of_parents(values: IndexArray | None) -> IndexArray | None:
        return None if values is None else values[finest.face_parents]

    mesh = replace(
        control,
        positions=finest.positions,
        face_offsets=np.arange(0, finest.faces.size + 1, finest.faces.shape[1]),
        face_indices=finest.faces.ravel(),
        uvs=finest.uvs,
        uv_indices=None if finest.uv_indices is None else finest.uv_indices.ravel(),
        face_materials=of_parents(control.face_materials),
        face_objects=of_parents(control.face_objects),
        face_groups=of_parents(control.face_groups),
        vertex_colors=None,
        crease_edges=None,
        crease_sharpness=None,
        corner_vertices=None,
        corner_sharpness=None,
        hole_faces=None,
        scheme=None,
    )
    holes = refinement.holes(refinement.n_levels)
    return keep_faces(mesh, np.flatnonzero(~holes)) if holes.any() else mesh
