"""Levels as meshes of their own, for files and other programs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.faces import keep_faces, labels_of
from cagemap.numerics.arrays import FloatArray
from cagemap.subdivision.refinement import Refinement, refine
from cagemap.surface.triangles import fan_triangles


def finest_mesh(refinement: Refinement) -> ControlMesh:
    """Finest level with all its UV sets, colours, materials, objects and groups, without creases and without holes.

    Vertex colours are refined as positions are, as USD's primvars at vertices are.
    """
    finest, control = refinement.finest, refinement.control
    if finest.faces is None or refinement.n_levels == 0:
        return control
    mesh = replace(
        control,
        positions=finest.positions,
        face_offsets=np.arange(0, finest.faces.size + 1, finest.faces.shape[1]),
        face_indices=finest.faces.ravel(),
        uvs=finest.uvs,
        uv_indices=None if finest.uv_indices is None else finest.uv_indices.ravel(),
        **labels_of(control, finest.face_parents),
        uv_sets=tuple(_refined(refinement, uv_set) for uv_set in control.uv_sets),
        vertex_colors=_colors(refinement),
        crease_edges=None,
        crease_sharpness=None,
        corner_vertices=None,
        corner_sharpness=None,
        hole_faces=None,
        file_vertices=None,
        file_faces=None,
        file_copies=None,
        scheme=None,
    )
    holes = refinement.holes(refinement.n_levels)
    return keep_faces(mesh, np.flatnonzero(~holes)) if holes.any() else mesh


def _refined(refinement: Refinement, uv_set: UvSet) -> UvSet:
    """An inactive UV set, refined as the active one."""
    alone = replace(refinement.control, uvs=uv_set.uvs, uv_indices=uv_set.uv_indices, uv_sets=())
    finest = refine(alone, refinement.n_levels, refinement.scheme).finest
    assert finest.uvs is not None
    assert finest.uv_indices is not None
    return UvSet(uv_set.name, finest.uvs, finest.uv_indices.ravel())


def _colors(refinement: Refinement) -> FloatArray | None:
    """Colours of the finest vertices; None where some control vertices have none."""
    colors = refinement.control.vertex_colors
    if colors is None or not np.isfinite(colors).all():
        return None
    return np.clip(refinement.prolong(colors, 0, refinement.n_levels), 0.0, 1.0)


def truncated(refinement: Refinement, level: int) -> Refinement:
    """The levels from 0 to this one; polygons of level 0, if it is the last, are split into fans."""
    found, control = refinement.up_to(level), refinement.control
    last = found.levels[-1]
    if last.faces is not None:
        return found
    split, parents = fan_triangles(control.face_offsets, control.face_indices)
    fans = replace(last, faces=split, face_parents=parents)
    if control.uvs is not None and control.uv_indices is not None:
        fans = fans.with_uvs(control.uvs, fan_triangles(control.face_offsets, control.uv_indices)[0])
    return replace(found, levels=(*found.levels[:-1], fans))
