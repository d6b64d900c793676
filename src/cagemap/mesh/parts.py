"""Parts of a mesh (objects, groups, materials, connected pieces): find, extract, pair and join them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from cagemap.errors import ParameterError
from cagemap.mesh.control_mesh import NO_UV, ControlMesh, UvSet
from cagemap.mesh.faces import keep_faces
from cagemap.mesh.topology import face_components, face_pieces
from cagemap.numerics.arrays import FloatArray, IndexArray, offsets_of

KINDS = ("object", "group", "material", "component")
LARGEST = "largest"
Values = TypeVar("Values", FloatArray, IndexArray)


@dataclass(frozen=True, eq=False)
class Part:
    """Some faces of a mesh."""

    kind: str  #: one of `KINDS`
    #: as in the file; a component has the name of its object, group or material, where all its faces have the same and
    #: no other component has it, else its number
    name: str
    faces: IndexArray  #: (k,)

    @property
    def title(self) -> str:
        """How to ask for the part where other kinds have the same name."""
        return f"{self.kind}:{self.name}"


def list_parts(mesh: ControlMesh, *, pieces: bool = True) -> tuple[Part, ...]:
    """Objects, groups and materials with a name, then components unless told not to; each in file order."""
    parts = []
    for kind, numbers, names in mesh.partitions:
        if numbers is not None:
            parts += [Part(kind, name, np.flatnonzero(numbers == number)) for number, name in enumerate(names) if name]
    return (*(part for part in parts if len(part.faces)), *(connected_parts(mesh) if pieces else ()))


def connected_parts(mesh: ControlMesh) -> tuple[Part, ...]:
    """Connected pieces, named by what their faces are named by."""
    labels = face_components(mesh)
    pieces = _members(labels)
    names = [str(number) for number in range(len(pieces))]
    for _, numbers, words in reversed(mesh.partitions):
        if numbers is None:
            continue
        own = [words[numbers[faces[0]]] if np.all(numbers[faces] == numbers[faces[0]]) else "" for faces in pieces]
        counts = Counter(own)
        names = [word if word and counts[word] == 1 else name for word, name in zip(own, names, strict=True)]
    return tuple(Part("component", name, faces) for name, faces in zip(names, pieces, strict=True))


def _members(labels: IndexArray) -> list[IndexArray]:
    """Indices of every label, from 0 on, ascending."""
    if not len(labels):
        return []
    return np.split(np.argsort(labels, kind="stable"), np.cumsum(np.bincount(labels))[:-1])


def material_pieces(mesh: ControlMesh) -> tuple[Part, ...]:
    """Faces of every named material, split into numbered parts where they are not connected."""
    return tuple(
        piece for part in list_parts(mesh) if part.kind == "material" for piece in connected_pieces(mesh, part)
    )


def connected_pieces(mesh: ControlMesh, part: Part) -> tuple[Part, ...]:
    """A part, split into numbered parts where it is not connected."""
    found = [part.faces[piece] for piece in _members(face_components(keep_faces(mesh, part.faces)))]
    names = [part.name] if len(found) == 1 else [f"{part.name} {number}" for number in range(len(found))]
    return tuple(Part(part.kind, name, faces) for name, faces in zip(names, found, strict=True))


def find_part(mesh: ControlMesh, name: str) -> Part:
    """The part of that name, ``KIND:NAME`` or ``largest``; ParameterError if there is none, or several."""
    parts = list_parts(mesh)
    if name == LARGEST:
        return max(connected_parts(mesh), key=lambda part: len(part.faces))
    found = [part for part in _groups_as_one(parts, name) if name in (part.name, part.title)]
    # A USD object is named by its whole path; the end of it will do.
    found = found or [part for part in parts if part.name.endswith(f"/{name}")]
    different = {part.faces.tobytes() for part in found}
    if len(different) > 1:
        titles = ", ".join(part.title for part in found)
        raise ParameterError(
            f"{mesh.name}: expected one part named {name!r}, got several: {titles}. Name one of these."
        )
    if not found:
        known = ", ".join(dict.fromkeys(part.title for part in parts[:12]))
        raise ParameterError(
            f"{mesh.name}: expected a part named {name!r}, there is none. It has {known}"
            f"{', ...' if len(parts) > 12 else ''}; `cagemap check` lists all."
        )
    return found[0]


def _groups_as_one(parts: tuple[Part, ...], name: str) -> list[Part]:
    """Parts, with all groups of the name as one; OBJ's ``g one two`` is a group of both names."""
    wanted = name.removeprefix("group:")
    meant = [p for p in parts if p.kind == "group" and (p.name == wanted or wanted in p.name.split())]
    if not meant:
        return list(parts)
    one = Part("group", wanted, np.unique(np.concatenate([part.faces for part in meant])))
    kept = [part for part in parts if part not in meant]
    return [*(part for part in kept if part.kind == "object"), one, *(p for p in kept if p.kind != "object")]


def extract_faces(mesh: ControlMesh, faces: IndexArray) -> ControlMesh:
    """Return some faces as a mesh of their own, without unused vertices and UVs.

    ``file_vertices`` and ``file_faces`` of the result say which they were.
    """
    kept = keep_faces(mesh, faces)
    vertices, indices = np.unique(kept.face_indices, return_inverse=True)
    number = np.full(mesh.n_vertices, -1, dtype=np.int64)
    number[vertices] = np.arange(len(vertices))
    corners = kept.corner_vertices
    inside = None if corners is None else number[corners] >= 0
    uvs, uv_indices = kept.uvs, kept.uv_indices
    if uvs is not None and uv_indices is not None:
        uvs, uv_indices = _used(uvs, uv_indices)
    earlier = (mesh.file_vertices, mesh.file_faces)
    return replace(
        kept,
        positions=kept.positions[vertices],
        face_indices=indices.astype(np.int64),
        uvs=uvs,
        uv_indices=uv_indices,
        uv_sets=tuple(UvSet(one.name, *_used(one.uvs, one.uv_indices)) for one in kept.uv_sets),
        vertex_colors=None if kept.vertex_colors is None else kept.vertex_colors[vertices],
        crease_edges=None if kept.crease_edges is None else number[kept.crease_edges],
        corner_vertices=None if corners is None else number[corners[inside]],
        corner_sharpness=None if kept.corner_sharpness is None else kept.corner_sharpness[inside],
        **_own_scheme(kept),
        file_vertices=vertices if earlier[0] is None else earlier[0][vertices],
        file_copies=renumbered_copies(mesh.file_copies, number),
        file_faces=np.asarray(faces) if earlier[1] is None else earlier[1][faces],
    )


def renumbered_copies(copies: IndexArray | None, number: IndexArray) -> IndexArray | None:
    """``file_copies`` in new vertex numbers (n,), -1 for those that are gone; None if none is left."""
    if copies is None:
        return None
    moved = np.column_stack([number[copies[:, 0]], copies[:, 1]])
    moved = moved[moved[:, 0] >= 0]
    return moved if len(moved) else None


def numbers_on_part(part: ControlMesh, mesh: ControlMesh) -> IndexArray:
    """(n,) number of every vertex of a mesh on a part that `extract_faces` took of it, -1 where there is none."""
    assert part.file_vertices is not None
    own = np.arange(mesh.n_vertices) if mesh.file_vertices is None else mesh.file_vertices
    number = np.full(int(own.max()) + 1, -1, dtype=np.int64)
    number[part.file_vertices] = np.arange(part.n_vertices)
    return number[own]


def in_one_piece(mesh: ControlMesh, parts: Sequence[Part]) -> tuple[Part, ...]:
    """Those of the parts, which share no face, that are connected."""
    of_face = np.full(mesh.n_faces, len(parts), dtype=np.int64)
    for number, part in enumerate(parts):
        of_face[part.faces] = number
    # A vertex counts once for every part that it borders on.
    nodes, corners = np.unique(mesh.face_indices * (len(parts) + 1) + of_face[mesh.corner_faces], return_inverse=True)
    labels = face_pieces(mesh, corners, len(nodes))
    return tuple(part for part in parts if len(part.faces) and (labels[part.faces] == labels[part.faces[0]]).all())


def _own_scheme(part: ControlMesh) -> dict[str, Any]:
    """How a part is subdivided, where the objects of its file differ in it."""
    objects = () if part.face_objects is None or not part.object_schemes else np.unique(part.face_objects).tolist()
    own = {part.object_schemes[number] for number in objects}
    return {"scheme": own.pop(), "object_schemes": ()} if len(own) == 1 else {}


def _used(values: FloatArray, indices: IndexArray) -> tuple[FloatArray, IndexArray]:
    used, renumbered = np.unique(indices, return_inverse=True)
    return values[used], renumbered.astype(np.int64)


def pair_parts(
    target: ControlMesh,
    source: ControlMesh,
    landmarks: IndexArray,
    pieces: tuple[Sequence[Part], Sequence[Part]] | None = None,
) -> tuple[tuple[tuple[Part, Part], ...], tuple[Part, ...], tuple[Part, ...]]:
    """Pair the pieces of two meshes: by landmarks on both, then by name, then the last of both.

    ``landmarks`` (p, 2) are target and source vertices; ``pieces`` what is paired, connected parts by default. Numbers
    are no names. Returns the pairs, the larger target piece first, and what is left alone of target and source.
    """
    of_target, of_source = pieces or (connected_parts(target), connected_parts(source))
    mine = sorted(of_target, key=lambda part: -len(part.faces))
    theirs = list(of_source)
    votes = np.zeros((len(mine), len(theirs)), dtype=np.int64)
    ends = np.column_stack([_owners(target, mine)[landmarks[:, 0]], _owners(source, theirs)[landmarks[:, 1]]])
    np.add.at(votes, tuple(ends[(ends >= 0).all(axis=1)].T), 1)
    most_votes = np.argsort(-votes, axis=None, kind="stable")[: np.count_nonzero(votes)]
    candidates = [divmod(number, len(theirs)) for number in most_votes.tolist()]
    candidates += [
        (row, column)
        for row, part in enumerate(mine)
        if not part.name.rpartition(" ")[2].isdigit()
        for column, other in enumerate(theirs)
        if part.name.rpartition("/")[2] == other.name.rpartition("/")[2]
    ]
    chosen: dict[int, int] = {}
    for row, column in candidates:
        if row not in chosen and column not in chosen.values():
            chosen[row] = column
    left = [row for row in range(len(mine)) if row not in chosen]
    right = [column for column in range(len(theirs)) if column not in chosen.values()]
    if len(left) == len(right) == 1:
        chosen[left[0]] = right[0]
    return (
        tuple((mine[row], theirs[chosen[row]]) for row in sorted(chosen)),
        tuple(part for row, part in enumerate(mine) if row not in chosen),
        tuple(part for column, part in enumerate(theirs) if column not in chosen.values()),
    )


def _owners(mesh: ControlMesh, parts: list[Part]) -> IndexArray:
    """(n,) part of every vertex, the last of those that share it; -1 for none."""
    of_face = np.full(mesh.n_faces, -1, dtype=np.int64)
    for number, part in enumerate(parts):
        of_face[part.faces] = number
    owners = np.full(mesh.n_vertices, -1, dtype=np.int64)
    np.maximum.at(owners, mesh.face_indices, of_face[mesh.corner_faces])
    return owners


def join_meshes(meshes: Sequence[ControlMesh]) -> ControlMesh:
    """One mesh of several pieces; vertices and faces of each in turn.

    Names that several meshes have, of materials, objects, groups or UV sets, become one. Where a mesh lacks a UV set,
    all its corners have `NO_UV`, so that nothing is baked onto it.
    """
    vertices = np.cumsum([0, *(mesh.n_vertices for mesh in meshes)])[:-1]
    faces = np.cumsum([0, *(mesh.n_faces for mesh in meshes)])[:-1]
    sizes = np.concatenate([mesh.face_sizes for mesh in meshes])
    uv_sets = _uv_sets(meshes)
    labels = _joined_labels(meshes)
    joined = ControlMesh(
        np.concatenate([mesh.positions for mesh in meshes]),
        offsets_of(sizes),
        _shifted([mesh.face_indices for mesh in meshes], vertices),
        uv_sets=tuple(uv_sets[1:]),
        **labels,
        material_colors=_material_colors(meshes, labels["material_names"]),
        vertex_colors=_vertex_colors(meshes),
        crease_edges=_known([mesh.crease_edges for mesh in meshes], vertices),
        crease_sharpness=_known([mesh.crease_sharpness for mesh in meshes]),
        corner_vertices=_known([mesh.corner_vertices for mesh in meshes], vertices),
        corner_sharpness=_known([mesh.corner_sharpness for mesh in meshes]),
        hole_faces=_known([mesh.hole_faces for mesh in meshes], faces),
        file_vertices=_file_numbers([mesh.file_vertices for mesh in meshes]),
        file_faces=_file_numbers([mesh.file_faces for mesh in meshes]),
        file_copies=_known([mesh.file_copies for mesh in meshes], np.column_stack([vertices, 0 * vertices])),
        scheme=meshes[0].scheme,
        name=meshes[0].name,
    )
    if not uv_sets:
        return joined
    return replace(joined, uvs=uv_sets[0].uvs, uv_indices=uv_sets[0].uv_indices, uv_name=uv_sets[0].name)


def _shifted(arrays: Sequence[IndexArray], starts: IndexArray) -> IndexArray:
    return np.concatenate([array + start for array, start in zip(arrays, starts, strict=True)])


def _known(arrays: Sequence[Values | None], shifts: IndexArray | None = None) -> Values | None:
    """Those that are there, joined; None if there is none."""
    shifts = np.zeros(len(arrays), dtype=np.int64) if shifts is None else shifts
    known = [array + shift for array, shift in zip(arrays, shifts, strict=True) if array is not None]
    return np.concatenate(known) if known else None


def _file_numbers(numbers: Sequence[IndexArray | None]) -> IndexArray | None:
    """Numbers in the file, if all meshes are parts of one."""
    return None if any(array is None for array in numbers) else _known(numbers)


def _uv_sets(meshes: Sequence[ControlMesh]) -> list[UvSet]:
    """All UV sets by name, the one in use first."""
    known = [{uv_set.name: uv_set for uv_set in mesh.all_uv_sets} for mesh in meshes]
    result = []
    for name in dict.fromkeys(name for own in known for name in own):
        bare = [UvSet(name, np.array([NO_UV]), np.zeros(len(mesh.face_indices), dtype=np.int64)) for mesh in meshes]
        sets = [own.get(name, other) for own, other in zip(known, bare, strict=True)]
        starts = np.cumsum([0, *(len(uv_set.uvs) for uv_set in sets)])[:-1]
        values = np.concatenate([uv_set.uvs for uv_set in sets])
        result.append(UvSet(name, values, _shifted([uv_set.uv_indices for uv_set in sets], starts)))
    return result


def _joined_labels(meshes: Sequence[ControlMesh]) -> dict[str, Any]:
    """Objects, groups and materials by name, as arguments of `ControlMesh`; faces without one get the name ''."""
    labels: dict[str, Any] = {}
    for parts in zip(*(mesh.partitions for mesh in meshes), strict=True):
        kind, names, numbers = parts[0][0], dict[str, int](), []
        for mesh, (_, of_face, own) in zip(meshes, parts, strict=True):
            if of_face is None:
                of_face, own = np.zeros(mesh.n_faces, dtype=np.int64), ("",)
            numbers.append(np.array([names.setdefault(name, len(names)) for name in own], dtype=np.int64)[of_face])
        known = any(of_face is not None for _, of_face, _ in parts)
        labels[f"face_{kind}s"] = np.concatenate(numbers) if known else None
        labels[f"{kind}_names"] = tuple(names) if known else ()
    return labels


def _material_colors(meshes: Sequence[ControlMesh], names: tuple[str, ...]) -> FloatArray | None:
    if not names:
        return None
    known = {
        name: color
        for mesh in reversed(meshes)
        if mesh.material_colors is not None
        for name, color in zip(mesh.material_names, mesh.material_colors, strict=True)
    }
    return np.array([known.get(name, np.full(3, np.nan)) for name in names])


def _vertex_colors(meshes: Sequence[ControlMesh]) -> FloatArray | None:
    if all(mesh.vertex_colors is None for mesh in meshes):
        return None
    return np.concatenate(
        [np.full((m.n_vertices, 3), np.nan) if m.vertex_colors is None else m.vertex_colors for m in meshes]
    )
