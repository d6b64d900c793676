"""Parts of a mesh (objects, groups, materials, connected pieces): find, extract and join them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.mesh.control_mesh import NO_UV, ControlMesh, UvSet
from cagemap.mesh.faces import face_areas, keep_faces
from cagemap.mesh.topology import face_components
from cagemap.numerics.arrays import FloatArray, IndexArray, box_diagonal, members_of, offsets_of, places_of

PART_KINDS = ("object", "group", "material", "component")
LARGEST = "largest"
MIN_SHARE_OF_FACES = 0.5  # least faces of `largest_part`, of the most of a body's piece: no ground planes
# Least diagonal of the bounding box of the body, divided by that of the whole mesh: at least 0.77 for whole bodies,
# 0.25 for the head of a body that is deleted under the clothes (docs/lab/characters.md).
MIN_BODY_EXTENT = 0.5
# Words in the names of passengers, parts that are moved with the body, by the word for all of one kind. The first kind
# that a name has counts: "TopTeeth" are teeth, "dress_shoes" shoes. With _END words count only at the end of a word or
# before a plural s: "panther" and "hatchling" name no passengers.
_END = r"(?=s?(?-i:(?![a-z])))"
_PASSENGER_WORDS = {
    "glasses": f"glasses{_END}|goggle",
    "lash": "lash",
    "brow": "brow(?!(?-i:n))",
    "accessory": f"accessor|eye.?patch|necklace|bracelet|earring|backpack|bag{_END}",
    "eye": "eye",
    "teeth": f"teeth|tooth|gum{_END}",
    "tongue": "tongue",
    "beard": "beard|moustache",
    "hair": f"(?<!c)hair|(?-i:(?<![a-zA-Z])w|W)ig{_END}",
    "shoe": "shoe|boot|sandal|sneaker|slipper",
    "sock": "sock|stocking",
    "glove": "glove",
    "hat": f"helmet|hat{_END}|cap{_END}",
    "trouser": f"trouser|legging|(?:pant|jean){_END}|shorts(?-i:(?![a-z]))",
    "skirt": "skirt",
    "shirt": f"shirt|blouse|sweater|hoodie|top{_END}",
    "jacket": f"jacket|coat{_END}",
    "belt": "belt",
    "scarf": "scarf",
    "cape": f"cloak|cape{_END}",
    "armor": "armou?r",
    "weapon": "weapon|sword",
    "suit": "suit|dress|outfit|garment|cloth",
}


@dataclass(frozen=True, eq=False)
class Part:
    """Some faces of a mesh."""

    kind: str  #: one of `PART_KINDS`
    #: as in the file; a component has the name of its object, group or material if all its faces, and no other
    #: component, have that name; else its number
    name: str
    faces: IndexArray  #: (k,)

    @property
    def title(self) -> str:
        """Unique name ``KIND:NAME`` of the part."""
        return f"{self.kind}:{self.name}"


def list_parts(mesh: ControlMesh, *, pieces: bool = True) -> tuple[Part, ...]:
    """Named objects, groups and materials, then components if ``pieces``; each in file order."""
    parts = []
    for kind, numbers, names in mesh.partitions:
        if numbers is not None:
            parts += [Part(kind, name, np.flatnonzero(numbers == number)) for number, name in enumerate(names) if name]
    return (*(part for part in parts if len(part.faces)), *(connected_parts(mesh) if pieces else ()))


def connected_parts(mesh: ControlMesh) -> tuple[Part, ...]:
    """Connected components, named as described in `Part`."""
    labels = face_components(mesh)
    pieces = members_of(labels)
    names = [str(number) for number in range(len(pieces))]
    for _, numbers, words in reversed(mesh.partitions):
        if numbers is None:
            continue
        common_names = [
            words[numbers[faces[0]]] if np.all(numbers[faces] == numbers[faces[0]]) else "" for faces in pieces
        ]
        counts = Counter(common_names)
        names = [word if word and counts[word] == 1 else name for word, name in zip(common_names, names, strict=True)]
    while repeated := {name for name, count in Counter(names).items() if count > 1}:  # "1" may be an object's name
        names = [str(number) if name in repeated else name for number, name in enumerate(names)]
    return tuple(Part("component", name, faces) for name, faces in zip(names, pieces, strict=True))


def passenger_word(name: str) -> str:
    """The word for clothes, hair, eyes or equipment in a part's name, one for all of a kind; '' without one."""
    found = (word for word, pattern in _PASSENGER_WORDS.items() if re.search(pattern, name, re.IGNORECASE))
    return next(found, "")


def largest_part(mesh: ControlMesh) -> Part:
    """The connected piece of largest area (`body_areas`), among pieces with enough faces (`MIN_SHARE_OF_FACES`)."""
    pieces, areas = connected_parts(mesh), body_areas(mesh, face_components(mesh), face_areas(mesh))
    sizes = np.array([len(piece.faces) for piece in pieces])
    least = MIN_SHARE_OF_FACES * sizes[areas > 0.0].max(initial=0)
    return pieces[int(np.where(sizes >= least, areas, -1.0).argmax())]


def body_areas(mesh: ControlMesh, labels: IndexArray, of_faces: FloatArray) -> FloatArray:
    """(k,) area of each connected piece; 0 for `passenger_pieces`, if another piece can be the body.

    The largest other piece must span `MIN_BODY_EXTENT` of the mesh. ``labels`` and ``of_faces`` (m,) are the piece and
    the area of each face.
    """
    areas, named = np.bincount(labels, of_faces), passenger_pieces(mesh, labels, of_faces)
    others = np.where(named, 0.0, areas)
    if named.any() and others.any():
        corners = mesh.positions[mesh.face_indices]
        of_largest = corners[labels[mesh.corner_faces] == others.argmax()]
        if box_diagonal(of_largest) >= MIN_BODY_EXTENT * box_diagonal(corners):
            return np.asarray(others)
    return np.asarray(areas)


def passenger_pieces(mesh: ControlMesh, labels: IndexArray, of_faces: FloatArray) -> NDArray[np.bool_]:
    """(k,) whether at least half of a piece's area is named as a passenger, from pieces and areas (m,) of faces."""
    of_passengers = np.bincount(labels, of_faces * _faces_of_passengers(mesh))
    return np.asarray((of_passengers > 0) & (of_passengers >= 0.5 * np.bincount(labels, of_faces)))


def _faces_of_passengers(mesh: ControlMesh) -> NDArray[np.bool_]:
    """(m,) whether a face's object or group has a passenger's name; its material, if no object or group has one."""
    found = np.zeros(mesh.n_faces, dtype=bool)
    for kind, numbers, names in mesh.partitions:
        if numbers is not None and not (kind == "material" and found.any()):
            found |= np.array([*(passenger_word(name) != "" for name in names), False])[numbers]  # -1: no name
    return found


def find_part(mesh: ControlMesh, name: str) -> Part:
    """Part by name, ``KIND:NAME`` or ``largest``, for `extract_faces`; ParameterError unless exactly one matches."""
    parts = list_parts(mesh)
    if name == LARGEST:
        return largest_part(mesh)
    matching = [part for part in _groups_as_one(parts, name) if name in (part.name, part.title)]
    # A USD object is named by its whole path; its end is accepted too, and accents in both forms of Unicode.
    matching = matching or [part for part in parts if part.name.endswith(f"/{name}")]
    composed = normalize("NFC", name)
    matching = matching or [p for p in parts if composed in (normalize("NFC", p.name), normalize("NFC", p.title))]
    different = {part.faces.tobytes() for part in matching}
    if len(different) > 1:
        titles = ", ".join(part.title for part in matching)
        raise ParameterError(f"{mesh.name}: expected one part named {name!r}, got several, {titles}. Name one.")
    if not matching:
        known = ", ".join(dict.fromkeys(part.title for part in parts[:12]))
        raise ParameterError(
            f"{mesh.name}: expected a part named {name!r}, there is none. It has {known}"
            f"{', ...' if len(parts) > 12 else ''}; `cagemap check` lists all."
        )
    return matching[0]


def _groups_as_one(parts: tuple[Part, ...], name: str) -> list[Part]:
    """Parts, with all groups of the name merged; OBJ's ``g one two`` belongs to both names."""
    wanted = name.removeprefix("group:")
    groups = [p for p in parts if p.kind == "group" and (p.name == wanted or wanted in p.name.split())]
    if not groups:
        return list(parts)
    merged = Part("group", wanted, np.unique(np.concatenate([part.faces for part in groups])))
    kept = [part for part in parts if part not in groups]
    return [*(part for part in kept if part.kind == "object"), merged, *(p for p in kept if p.kind != "object")]


def extract_faces(mesh: ControlMesh, faces: IndexArray) -> ControlMesh:
    """Return some faces as a mesh without unused vertices and UVs, with file numbers; a UV set of theirs is in use."""
    kept = keep_faces(mesh, faces)
    if len(faces) < mesh.n_faces:
        kept = _with_own_uv_set(kept)
    vertices, indices = np.unique(kept.face_indices, return_inverse=True)
    number = places_of(vertices, mesh.n_vertices)
    corners = kept.corner_vertices
    inside = None if corners is None else number[corners] >= 0
    uvs, uv_indices = kept.uvs, kept.uv_indices
    if uvs is not None and uv_indices is not None:
        uvs, uv_indices = _used(uvs, uv_indices)
    file_vertices, file_faces = mesh.file_numbers
    return replace(
        kept,
        positions=kept.positions[vertices],
        face_indices=indices.astype(np.int64),
        uvs=uvs,
        uv_indices=uv_indices,
        uv_sets=tuple(UvSet(uv_set.name, *_used(uv_set.uvs, uv_set.uv_indices)) for uv_set in kept.uv_sets),
        vertex_colors=None if kept.vertex_colors is None else kept.vertex_colors[vertices],
        crease_edges=None if kept.crease_edges is None else number[kept.crease_edges],
        corner_vertices=None if corners is None else number[corners[inside]],
        corner_sharpness=None if kept.corner_sharpness is None else kept.corner_sharpness[inside],
        **_own_scheme(kept),
        file_vertices=file_vertices[vertices],
        file_copies=renumbered_copies(mesh.file_copies, number),
        file_faces=file_faces[faces],
    )


def _with_own_uv_set(mesh: ControlMesh) -> ControlMesh:
    """The mesh, using its first UV set with coordinates other than `NO_UV`; unchanged if it has none."""
    if mesh.uvs is None:
        return mesh
    names = (one.name for one in mesh.all_uv_sets if np.any(one.uvs[one.uv_indices] != NO_UV))
    return mesh.with_uv_set(next(names, mesh.uv_name))


def renumbered_copies(copies: IndexArray | None, number: IndexArray) -> IndexArray | None:
    """``file_copies`` in new vertex numbers (n,), -1 for removed vertices; None if no copy is left."""
    if copies is None:
        return None
    moved = np.column_stack([number[copies[:, 0]], copies[:, 1]])
    moved = moved[moved[:, 0] >= 0]
    return moved if len(moved) else None


def numbers_on_part(part: ControlMesh, mesh: ControlMesh) -> IndexArray:
    """(n,) vertex of the part for every vertex of the mesh, -1 if absent; the part may be the whole mesh, welded."""
    file_numbers, _ = mesh.file_numbers
    number = np.full(int(file_numbers.max()) + 1, -1, dtype=np.int64)
    # In reverse, so that the first copy of a split vertex is kept.
    number[part.file_numbers[0][::-1]] = np.arange(part.n_vertices)[::-1]
    if part.file_copies is not None:
        welded, copies = part.file_copies[part.file_copies[:, 1] < len(number)].T
        number[copies] = welded
    return number[file_numbers]


def part_of_corners(mesh: ControlMesh, parts: Sequence[Part]) -> IndexArray:
    """(c,) part of every face corner, the last one if several share its face; -1 for none."""
    of_face = np.full(mesh.n_faces, -1, dtype=np.int64)
    for number, part in enumerate(parts):
        of_face[part.faces] = number
    return of_face[mesh.corner_faces]


def _own_scheme(part: ControlMesh) -> dict[str, Any]:
    """The scheme of a part's objects as arguments of `ControlMesh`, if they have the same one; else none."""
    objects = () if part.face_objects is None or not part.object_schemes else np.unique(part.face_objects).tolist()
    schemes = {part.object_schemes[number] for number in objects}
    return {"scheme": schemes.pop(), "object_schemes": ()} if len(schemes) == 1 else {}


def _used(values: FloatArray, indices: IndexArray) -> tuple[FloatArray, IndexArray]:
    used, renumbered = np.unique(indices, return_inverse=True)
    return values[used], renumbered.astype(np.int64)


def join_meshes(meshes: Sequence[ControlMesh]) -> ControlMesh:
    """Join meshes into one, with the vertices and faces of each in turn.

    Up axis, scheme and name are the first mesh's. Materials, objects, groups and UV sets of the same name are merged.
    Where a mesh lacks a UV set, all its corners get `NO_UV`, so that nothing is baked onto it.
    """
    vertices = np.cumsum([0, *(mesh.n_vertices for mesh in meshes)])[:-1]
    faces = np.cumsum([0, *(mesh.n_faces for mesh in meshes)])[:-1]

    def concatenate(field: str, shifts: IndexArray = 0 * vertices) -> NDArray[Any] | None:
        """Concatenate the meshes' arrays that are not None, with shifts added; None if all are None."""
        arrays = [(getattr(mesh, field), shift) for mesh, shift in zip(meshes, shifts, strict=True)]
        shifted = [array + shift for array, shift in arrays if array is not None]
        return np.concatenate(shifted) if shifted else None

    uv_sets, labels = _uv_sets(meshes), _joined_labels(meshes)
    colored = any(mesh.vertex_colors is not None for mesh in meshes)
    colors = (np.full((m.n_vertices, 3), np.nan) if m.vertex_colors is None else m.vertex_colors for m in meshes)
    numbered = [name for name in ("file_vertices", "file_faces") if all(getattr(m, name) is not None for m in meshes)]
    file_numbers: dict[str, Any] = {name: concatenate(name) for name in numbered}
    joined = ControlMesh(
        np.concatenate([mesh.positions for mesh in meshes]),
        offsets_of(np.concatenate([mesh.face_sizes for mesh in meshes])),
        np.concatenate([mesh.face_indices + start for mesh, start in zip(meshes, vertices, strict=True)]),
        uv_sets=tuple(uv_sets),
        **labels,
        material_colors=_material_colors(meshes, labels["material_names"]),
        vertex_colors=np.concatenate(list(colors)) if colored else None,
        crease_edges=concatenate("crease_edges", vertices),
        crease_sharpness=concatenate("crease_sharpness"),
        corner_vertices=concatenate("corner_vertices", vertices),
        corner_sharpness=concatenate("corner_sharpness"),
        hole_faces=concatenate("hole_faces", faces),
        **file_numbers,
        file_copies=concatenate("file_copies", np.column_stack([vertices, 0 * vertices])),
        upright=meshes[0].upright,
        scheme=meshes[0].scheme,
        name=meshes[0].name,
    )
    return joined.with_uv_set(uv_sets[0].name) if uv_sets else joined


def _uv_sets(meshes: Sequence[ControlMesh]) -> list[UvSet]:
    """UV sets of the joined mesh, by name; the first mesh's set in use comes first."""
    known = [{uv_set.name: uv_set for uv_set in mesh.all_uv_sets} for mesh in meshes]
    result = []
    for name in dict.fromkeys(name for sets_by_name in known for name in sets_by_name):
        bare = [UvSet(name, np.array([NO_UV]), np.zeros(len(mesh.face_indices), dtype=np.int64)) for mesh in meshes]
        sets = [sets_by_name.get(name, blank) for sets_by_name, blank in zip(known, bare, strict=True)]
        starts = np.cumsum([0, *(len(uv_set.uvs) for uv_set in sets)])[:-1]
        values = np.concatenate([uv_set.uvs for uv_set in sets])
        indices = np.concatenate([uv_set.uv_indices + start for uv_set, start in zip(sets, starts, strict=True)])
        result.append(UvSet(name, values, indices))
    return result


def _joined_labels(meshes: Sequence[ControlMesh]) -> dict[str, Any]:
    """Objects, groups and materials of the joined mesh, as arguments of `ControlMesh`; missing names are ''."""
    labels: dict[str, Any] = {}
    for parts in zip(*(mesh.partitions for mesh in meshes), strict=True):
        kind, names, numbers = parts[0][0], dict[str, int](), []
        for mesh, (_, of_face, mesh_names) in zip(meshes, parts, strict=True):
            if of_face is None:
                of_face, mesh_names = np.zeros(mesh.n_faces, dtype=np.int64), ("",)
            numbers.append(
                np.array([names.setdefault(name, len(names)) for name in mesh_names], dtype=np.int64)[of_face]
            )
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
