"""Parts of a file: those that can be opened, the opened one, and the rest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cagemap.errors import CagemapError, ParameterError
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.parts import (
    KINDS,
    Part,
    connected_parts,
    extract,
    find_part,
    in_one_piece,
    list_parts,
    numbers_on_part,
)
from cagemap.mesh.topology import face_components
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.subdivision import default_scheme, level_triangles, refine
from cagemap.surface.triangle_surface import TriangleSurface

# Parts that are offered; a file of more has its largest ones on the page, and all of them on the command line.
MOST_OFFERED = 60
# Connected pieces of a scan are specks rather than parts from this many on.
_SPECKS = 200
# Vertices that are drawn of what is left alone.
_MOST_DRAWN = 40_000


@dataclass(frozen=True)
class Offer:
    """Parts of a file that can be opened.

    Attributes
    ----------
    titles : tuple of str
        As `cagemap match --part` takes them and `cagemap check` lists them, the largest first; empty where there is
        nothing to choose from.
    faces : tuple of int
        How many each has.
    opened : str or None
        The one that is open; None: the whole file.
    whole : bool
        Whether the whole file can be opened too.
    """

    titles: tuple[str, ...] = ()
    faces: tuple[int, ...] = ()
    opened: str | None = None
    whole: bool = True


NOTHING = Offer()


@dataclass(frozen=True, eq=False)
class Rest:
    """What of a file is left alone: triangles, in its units."""

    positions: FloatArray
    normals: FloatArray
    triangles: IndexArray


@dataclass(frozen=True, eq=False)
class Taken:
    """A part of a file, ready to be opened.

    Attributes
    ----------
    mesh : ControlMesh
    vertex_of : (n,) int64
        Its vertex for each of the file's, -1 where the part has it not.
    left : (k,) int64
        Faces of the file that are not of the part.
    offer : Offer
    """

    mesh: ControlMesh
    vertex_of: IndexArray
    left: IndexArray
    offer: Offer


def take_part(mesh: ControlMesh, name: str | None, *, plain: bool) -> Taken:
    """The part of that name; without one the whole file or, where it has several pieces, its largest.

    Parameters
    ----------
    mesh : ControlMesh
        As in its file.
    name : str or None
        See `cagemap.mesh.parts.find_part`.
    plain : bool
        The mesh is taken as it is, so that its smaller pieces may be set aside.

    Raises
    ------
    ParameterError
        If there is no such part, or it is to be subdivided in several ways.
    """
    count = 1 + int(face_components(mesh).max(initial=0))
    whole = (count == 1 and not mesh.object_schemes) or plain
    offered = _offered(mesh, count)
    if name is None and not whole:
        name = max(connected_parts(mesh), key=lambda part: len(part.faces)).title
    part = None if name is None else find_part(mesh, name)
    if part is not None:  # as it is offered, where it is so under another name
        part = next((one for one in offered if np.array_equal(one.faces, part.faces)), part)
    titles, sizes = tuple(one.title for one in offered), tuple(len(one.faces) for one in offered)
    if part is not None and len(part.faces) == mesh.n_faces:
        part = None
    if part is not None and part.title not in titles:
        titles, sizes = (part.title, *titles), (len(part.faces), *sizes)
    offer = Offer(titles, sizes, None if part is None else part.title, whole or part is None)
    if part is None:
        return Taken(mesh, np.arange(mesh.n_vertices), np.zeros(0, dtype=np.int64), offer)
    # A part is subdivided as the whole file is, also where all its faces happen to be triangles.
    taken = extract(replace(mesh, scheme=default_scheme(mesh)), part.faces)
    if taken.object_schemes:
        raise ParameterError(
            f"{mesh.name}, {part.title}: expected a part that is subdivided in one way, got several. Choose one of its "
            "objects."
        )
    left = np.setdiff1d(np.arange(mesh.n_faces), part.faces)
    return Taken(taken, numbers_on_part(taken, mesh), left, offer)


def rest_of(mesh: ControlMesh, faces: IndexArray, level: int) -> Rest | None:
    """What is left alone of a file, subdivided as the part beside it where it can be."""
    if not len(faces):
        return None
    left = extract(replace(mesh, object_schemes=()), faces)
    while level > 0 and left.n_vertices * 4**level > _MOST_DRAWN:
        level -= 1
    positions, triangles = left.positions, cage_triangles(left)[0]
    if level > 0:
        try:
            refined = refine(left, level)
            positions, triangles = refined.finest.positions, level_triangles(refined, level)
        except CagemapError:  # nobody asked for it to be a good mesh
            pass
    return Rest(positions, TriangleSurface(positions, triangles, 1.0).vertex_normals, triangles)


def _offered(mesh: ControlMesh, count: int) -> tuple[Part, ...]:
    """Parts in one piece that are not all of it, the largest first; of those with the same faces the first one.

    Parameters
    ----------
    mesh : ControlMesh
    count : int
        Of its connected pieces.
    """
    named = list_parts(mesh, pieces=1 < count < _SPECKS)
    parts: list[Part] = []
    for kind in KINDS:
        found = [part for part in named if part.kind == kind]
        parts += in_one_piece(mesh, found) if found and kind != "component" else found
    different: dict[bytes, Part] = {}
    for part in parts:
        if len(part.faces) < mesh.n_faces:
            different.setdefault(part.faces.tobytes(), part)
    largest = sorted(different.values(), key=lambda part: (-len(part.faces), KINDS.index(part.kind)))
    return tuple(largest[:MOST_OFFERED])
