"""Find which parts and loose pieces of a character the target has itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from cagemap.character.doubled_pieces import doubled_meshes, doubled_pieces, pieces_in_surface
from cagemap.character.own_parts import pairs_of_one_kind
from cagemap.character.values import Part
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.parts import extract_faces, numbers_on_part, passenger_word
from cagemap.mesh.topology import face_components
from cagemap.numerics.arrays import IndexArray, members_of


@dataclass(frozen=True, eq=False)
class ComparedParts:
    """Parts and loose pieces of a character that the target has itself."""

    counterparts: list[list[Part]]  # for each own piece, then part, of the target: those of its kind, placed
    doubles_of_parts: list[Part]  # placed parts, all of whose faces have a counterpart in own parts
    doubles_of_pieces: list[Part]  # placed parts, all of whose faces have a counterpart in own pieces
    faces: IndexArray  # of the loose pieces, those that the target does not have


def compare_parts(
    placed: Sequence[Part],
    pieces: Part,
    placed_pieces: Part,
    own_pieces: Sequence[Part],
    own_parts: Sequence[Part],
    point_map: PointMap,
) -> ComparedParts:
    """Find which parts and loose pieces of a character the target has, by names and places.

    ``placed``: the character's parts beside its body, placed on the target.
    ``pieces``: loose pieces of its body, as given and as placed on the target.
    ``own_pieces``, ``own_parts``: loose pieces of the target's body, and the target's parts beside it.
    """
    named = named_pieces(pieces.mesh)
    groups = [
        (name, np.sort(np.concatenate([faces for one, faces in named if one == name])))
        for name in dict.fromkeys(name for name, _ in named)
    ]
    candidates = [*placed, *(part_of_faces(placed_pieces, faces, name) for name, faces in groups)]
    count, loose, own = len(placed), len(own_pieces), [*own_pieces, *own_parts]
    of_carried, of_own = ([part.mesh for part in parts] for parts in (candidates, own))
    # Whole parts are compared with whole parts, others piece by piece. A piece of one comparison hides none of another.
    doubled = [
        (row + start, number + own_start, faces)
        for start, end, own_start, own_end, compare in (
            (count, None, 0, loose, doubled_pieces),
            (count, None, loose, None, doubled_pieces),
            (0, count, 0, loose, doubled_pieces),
            (0, count, loose, None, partial(doubled_meshes, surface=point_map.target)),
        )
        for row, number, faces in compare(of_carried[start:end], of_own[own_start:own_end])
    ]
    pairs = pairs_of_one_kind(candidates, own, doubled)
    counterparts = [list[Part]() for _ in own]
    for row, number, faces in pairs:
        whole = len(faces) == candidates[row].mesh.n_faces
        counterparts[number].append(candidates[row] if whole else part_of_faces(candidates[row], faces))

    def doubles(numbers: range) -> list[Part]:
        """Placed parts, all of whose faces have a counterpart in own pieces or parts of these numbers."""
        has_counterpart = [np.zeros(part.mesh.n_faces, dtype=bool) for part in placed]
        for row, number, faces in pairs:
            if row < count and number in numbers:
                has_counterpart[row][faces] = True
        return [part for part, found in zip(placed, has_counterpart, strict=True) if found.all()]

    found = [groups[row - count][1][faces] for row, _, faces in pairs if row >= count]
    found += pieces_in_surface(pieces.mesh, placed_pieces.mesh, point_map) if groups else []
    faces = np.setdiff1d(np.arange(pieces.mesh.n_faces), np.concatenate([np.zeros(0, dtype=np.int64), *found]))
    return ComparedParts(counterparts, doubles(range(loose, len(own))), doubles(range(loose)), faces)


def named_pieces(mesh: ControlMesh) -> list[tuple[str, IndexArray]]:
    """Passenger's name, or '', and faces of every connected piece."""
    return [(_passenger_name(mesh, faces), faces) for faces in members_of(face_components(mesh))]


def _passenger_name(mesh: ControlMesh, faces: IndexArray) -> str:
    """The first name with a `passenger_word` of the faces' materials, groups and objects; '' without one."""
    partitions = [(numbers[faces], names) for _, numbers, names in mesh.partitions[::-1] if numbers is not None]
    stated = (names[number] for numbers, names in partitions for number in np.unique(numbers[numbers >= 0]))
    return next(filter(passenger_word, stated), "")


def part_of_faces(part: Part, faces: IndexArray, name: str | None = None) -> Part:
    """Some faces of a part, with the values of their vertices and corners."""
    mesh = part.mesh
    taken = extract_faces(mesh, faces)
    number = numbers_on_part(taken, mesh)
    rows = np.zeros(taken.n_vertices, dtype=np.int64)
    rows[number[number >= 0]] = np.flatnonzero(number >= 0)
    corners = np.isin(mesh.corner_faces, faces)
    return Part(
        part.name if name is None else name,
        taken,
        None if part.weights is None else part.weights[rows],
        {name: offsets[rows] for name, offsets in part.shapes.items()},
        None if part.normals is None else part.normals[corners],
        {name: offsets[corners] for name, offsets in part.shape_normals.items()},
        None if part.colors is None else part.colors[corners],
    )
