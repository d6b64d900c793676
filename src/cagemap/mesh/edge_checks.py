"""Edges of a control mesh that more than two faces share, and openings so small that nobody meant them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.mesh_report import Problem, first_few
from cagemap.mesh.topology import EdgeTable
from cagemap.numerics.arrays import FloatArray, IndexArray

# An edge this short beside those around it is two vertices that should be one.
_TINY = 0.01
# A loop that encloses less than this share of its length squared is a slit; a square hole has 1/16.
_SLIT = 0.004
# Openings that are accidents have few edges.
_FEW_EDGES = 8


def edge_manifold_problem(mesh: ControlMesh, edges: EdgeTable, numbers: IndexArray) -> Problem | None:
    """Edges of more than two faces, with the remedy that fits them: faces to delete, edges to collapse or to split.

    Parameters
    ----------
    mesh : ControlMesh
    edges : EdgeTable
        Of the mesh.
    numbers : (m,) int64
        The file's number of every face.
    """
    bad = edges.face_counts > 2
    if not bad.any():
        return None
    extra = extra_faces(mesh, edges)
    left = bad & (edges.face_counts - _counts_of(mesh, edges, extra) > 2)
    tiny = left & _tiny_edges(mesh, edges)
    split = left & ~tiny
    remedies = []
    if extra.any():
        faces = numbers[np.flatnonzero(extra)]
        remedies.append(f"Delete face(s) {first_few(faces.tolist())}, which hang on such edges alone.")
    if tiny.any():
        remedies.append(
            f"Merge the two vertices of edge(s) {_pairs(edges, tiny)}, which are almost at the same place; splitting "
            "there would leave a slit."
        )
    if split.any():
        at = np.unique(mesh.corner_faces[split[edges.corner_edges]])
        remedies.append(
            f"At edge(s) {_pairs(edges, split)} delete the inner ones of faces {first_few(numbers[at].tolist())}, or "
            "split the edge so that each sheet has its own."
        )
    return Problem(
        "non-manifold edges",
        f"expected one or two faces at every edge, got {int(bad.sum())} edge(s) with up to {edges.face_counts.max()}, "
        "between vertices",
        tuple((a, b) for a, b in edges.vertices[bad].tolist()),
        " ".join(remedies),
    )


def extra_faces(mesh: ControlMesh, edges: EdgeTable) -> NDArray[np.bool_]:
    """(m,) whether a face is joined to others by edges of more than two faces only, and no hole opens without it.

    Such are walls inside a closed surface and fins that stand out of one.
    """
    counts = edges.face_counts[edges.corner_edges]
    bad, inner = counts > 2, counts == 2
    starts = mesh.face_offsets[:-1]
    extra = np.logical_or.reduceat(bad, starts) & ~np.logical_or.reduceat(inner, starts)
    # Where too many faces would go, none of them is the culprit for certain.
    opened = (edges.face_counts > 2) & (edges.face_counts - _counts_of(mesh, edges, extra) < 2)
    return extra & ~np.logical_or.reduceat(opened[edges.corner_edges], starts)


def slit_notes(mesh: ControlMesh, loops: tuple[IndexArray, ...] | None) -> tuple[str, ...]:
    """Sentences about boundary loops that look like accidents: thin slits and holes much smaller than faces.

    A mesh may have boundaries, so this is no problem of its own.
    """
    notes = []
    for loop in loops or ():
        if len(loop) <= _FEW_EDGES and _is_accident(mesh, loop):
            notes.append(
                f"the boundary has a slit of {len(loop)} edges at vertices {first_few(loop.tolist())}. If it is not "
                "meant, merge its vertices by distance or fill it."
            )
    return tuple(notes)


def _is_accident(mesh: ControlMesh, loop: IndexArray) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        points = mesh.positions[loop] - mesh.positions[loop].mean(axis=0)
        following = np.roll(points, -1, axis=0)
        length = np.linalg.norm(following - points, axis=1).sum()
        area = np.linalg.norm(np.cross(points, following).sum(axis=0)) / 2
        tails, heads = mesh.positions[mesh.face_indices], mesh.positions[mesh.face_indices[mesh.next_corners]]
        usual = len(loop) * np.median(np.linalg.norm(heads - tails, axis=1))
        return bool(area <= _SLIT * length**2 or length <= _TINY * usual)


def _counts_of(mesh: ControlMesh, edges: EdgeTable, faces: NDArray[np.bool_]) -> IndexArray:
    """(e,) how many of some faces lie at every edge."""
    corners = faces[mesh.corner_faces]
    return np.bincount(edges.corner_edges[corners], minlength=len(edges.vertices)).astype(np.int64)


def _tiny_edges(mesh: ControlMesh, edges: EdgeTable) -> NDArray[np.bool_]:
    """(e,) edges much shorter than the longest edges of their faces."""
    with np.errstate(over="ignore", invalid="ignore"):
        ends = mesh.positions[edges.vertices]
        lengths: FloatArray = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        longest = np.maximum.reduceat(lengths[edges.corner_edges], mesh.face_offsets[:-1])
        around = np.zeros(len(lengths))
        np.maximum.at(around, edges.corner_edges, longest[mesh.corner_faces])
        return lengths <= _TINY * around


def _pairs(edges: EdgeTable, chosen: NDArray[np.bool_]) -> str:
    return first_few(tuple(pair) for pair in edges.vertices[chosen].tolist())
