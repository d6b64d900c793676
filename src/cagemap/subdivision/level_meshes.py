"""Levels as meshes of their own, and refinements cut off at a level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.faces import keep_faces, labels_of
from cagemap.subdivision.refinement import Refinement, refine
from cagemap.surface.triangles import fan_triangles


def finest_mesh(refinement: Refinement) -> ControlMesh:
    """Finest level as a mesh with all UV sets, colours and labels, without creases and holes."""
    finest, control = refinement.finest, refinement.control
    if finest.faces is None or refinement.n_levels == 0:
        return control
    colors = control.vertex_colors
    colors = None if colors is None or not np.isfinite(colors).all() else colors  # some vertices have none
    mesh = replace(
        control.without_sharpness(),
        positions=finest.positions,
        face_offsets=np.arange(0, finest.faces.size + 1, finest.faces.shape[1]),
        face_indices=finest.faces.ravel(),
        uvs=finest.uvs,
        uv_indices=None if finest.uv_indices is None else finest.uv_indices.ravel(),
        **labels_of(control, finest.face_parents),
        uv_sets=tuple(_refined_uvs(refinement, uv_set) for uv_set in control.uv_sets),
        vertex_colors=None if colors is None else np.clip(refinement.prolong(colors, 0, refinement.n_levels), 0.0, 1.0),
        hole_faces=None,
        file_vertices=None,
        file_faces=None,
        file_copies=None,
        scheme=None,
    )
    holes = refinement.holes(refinement.n_levels)
    return keep_faces(mesh, np.flatnonzero(~holes)) if holes.any() else mesh


def _refined_uvs(refinement: Refinement, uv_set: UvSet) -> UvSet:
    """Refine a UV set that is not in use."""
    alone = replace(refinement.control, uvs=uv_set.uvs, uv_indices=uv_set.uv_indices, uv_sets=())
    finest = refine(alone, refinement.n_levels, refinement.scheme).finest
    assert finest.uvs is not None
    assert finest.uv_indices is not None
    return UvSet(uv_set.name, finest.uvs, finest.uv_indices.ravel())


def truncate_refinement(refinement: Refinement, level: int) -> Refinement:
    """Levels 0 to ``level``; if only level 0 is left, its polygons are split into fans."""
    shortened, control = refinement.up_to(level), refinement.control
    last = shortened.levels[-1]
    if last.faces is not None:
        return shortened
    split, parents = fan_triangles(control.face_offsets, control.face_indices)
    fans = replace(last, faces=split, face_parents=parents)
    if control.uvs is not None and control.uv_indices is not None:
        fans = fans.with_uvs(control.uvs, fan_triangles(control.face_offsets, control.uv_indices)[0])
    return replace(shortened, levels=(fans,))
