"""Parts of a file: those that can be opened, the open one, and the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cagemap.errors import CagemapError, ParameterError
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.parts import (
    PART_KINDS,
    Part,
    extract_faces,
    find_part,
    largest_part,
    list_parts,
    numbers_on_part,
    part_of_corners,
)
from cagemap.mesh.topology import face_components, face_pieces
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.subdivision import default_scheme, level_triangles, refine
from cagemap.surface.triangle_surface import TriangleSurface

# Largest parts that the page lists; the command line lists all.
MAX_PART_CHOICES = 60
# A file of so many connected pieces is a scan, whose pieces are not listed.
_MIN_SCAN_PIECES = 200
# Of parts that are not open, drawn in grey.
_MAX_GREY_VERTICES = 40_000


@dataclass(frozen=True)
class PartChoices:
    """Parts of a file that can be opened."""

    # names for `cagemap match --part`, sorted by number of faces, largest first; empty for a file of one part
    titles: tuple[str, ...] = ()
    faces: tuple[int, ...] = ()  # number of faces of each
    opened: str | None = None  # the open part; None: the whole file
    whole: bool = True  # whether the whole file can be opened too


NO_PARTS = PartChoices()


@dataclass(frozen=True, eq=False)
class OtherParts:
    """Triangles of a file's parts that are not open, in its units."""

    positions: FloatArray
    normals: FloatArray
    triangles: IndexArray


@dataclass(frozen=True, eq=False)
class SelectedPart:
    """The part of a file that is opened."""

    mesh: ControlMesh
    vertex_of: IndexArray  # (n,) its vertex for each of the file's vertices, -1 for those of other parts
    other_faces: IndexArray  # (k,) faces of the file that are not in the part
    part_choices: PartChoices


def select_part(mesh: ControlMesh, name: str | None, *, plain: bool) -> SelectedPart:
    """Select a part; by default the whole file or the largest of several pieces.

    ``name``: see `cagemap.mesh.parts.find_part`.
    ``plain``: the mesh is not subdivided; small pieces may then be left out.
    ParameterError if there is no such part, or it has several subdivision schemes.
    """
    n_pieces = 1 + int(face_components(mesh).max(initial=0))
    whole = (n_pieces == 1 and not mesh.object_schemes) or plain
    listed = _listed_parts(mesh, n_pieces)
    if name is None and not whole:
        name = largest_part(mesh).title
    part = None if name is None else find_part(mesh, name)
    if part is not None:  # the listed part of the same faces may have another name
        part = next((other for other in listed if np.array_equal(other.faces, part.faces)), part)
    titles, sizes = tuple(other.title for other in listed), tuple(len(other.faces) for other in listed)
    if part is not None and len(part.faces) == mesh.n_faces:
        part = None
    if part is not None and part.title not in titles:
        titles, sizes = (part.title, *titles), (len(part.faces), *sizes)
    choices = PartChoices(titles, sizes, None if part is None else part.title, whole or part is None)
    if part is None:
        return SelectedPart(mesh, np.arange(mesh.n_vertices), np.zeros(0, dtype=np.int64), choices)
    # With the scheme of the whole file, even if all faces of the part are triangles.
    part_mesh = extract_faces(replace(mesh, scheme=default_scheme(mesh)), part.faces)
    if part_mesh.object_schemes:
        raise ParameterError(
            f"{mesh.name}, {part.title}: expected a part that is subdivided in one way, got several. Choose one of its "
            "objects."
        )
    other_faces = np.setdiff1d(np.arange(mesh.n_faces), part.faces)
    return SelectedPart(part_mesh, numbers_on_part(part_mesh, mesh), other_faces, choices)


def other_parts_surface(mesh: ControlMesh, faces: IndexArray, level: int) -> OtherParts | None:
    """Surface of faces that are not open, subdivided if possible; None without faces."""
    if not len(faces):
        return None
    others = extract_faces(replace(mesh, object_schemes=()), faces)
    while level > 0 and others.n_vertices * 4**level > _MAX_GREY_VERTICES:
        level -= 1
    positions, triangles = others.positions, cage_triangles(others)[0]
    if level > 0:
        try:
            refined = refine(others, level)
            positions, triangles = refined.finest.positions, level_triangles(refined, level)
        except CagemapError:  # these parts need not be valid meshes
            pass
    return OtherParts(positions, TriangleSurface(positions, triangles, 1.0).vertex_normals, triangles)


def _listed_parts(mesh: ControlMesh, n_pieces: int) -> tuple[Part, ...]:
    """Connected parts of a mesh by decreasing number of faces, without duplicates and without the whole mesh."""
    all_parts = list_parts(mesh, pieces=1 < n_pieces < _MIN_SCAN_PIECES)
    parts: list[Part] = []
    for kind in PART_KINDS:
        of_kind = [part for part in all_parts if part.kind == kind]
        parts += in_one_piece(mesh, of_kind) if of_kind and kind != "component" else of_kind
    distinct: dict[bytes, Part] = {}
    for part in parts:
        if len(part.faces) < mesh.n_faces:
            distinct.setdefault(part.faces.tobytes(), part)
    largest = sorted(distinct.values(), key=lambda part: (-len(part.faces), PART_KINDS.index(part.kind)))
    return tuple(largest[:MAX_PART_CHOICES])


def in_one_piece(mesh: ControlMesh, parts: Sequence[Part]) -> tuple[Part, ...]:
    """The parts that are connected; parts must not overlap."""
    of_corner = part_of_corners(mesh, parts) + 1
    # One node for every pair of a vertex and a part around it.
    nodes, corners = np.unique(mesh.face_indices * (len(parts) + 1) + of_corner, return_inverse=True)
    labels = face_pieces(mesh, corners, len(nodes))
    return tuple(part for part in parts if len(part.faces) and (labels[part.faces] == labels[part.faces[0]]).all())
