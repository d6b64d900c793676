"""Carry a character to another body: weights, shapes, skeleton, animations and passengers."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from scipy import sparse

from cagemap.character.doubled_pieces import PairedFaces, doubled_pieces, pieces_in_surface
from cagemap.character.normals import with_shape_normals
from cagemap.character.own_parts import (
    average_rows,
    limit_influences,
    nearest_rows,
    parts_of_one_kind,
    with_nearest_values,
)
from cagemap.character.passenger_pieces import PassengerKind
from cagemap.character.passengers import CarriedPassenger, carried_parts, carry_passengers, hidden_passenger
from cagemap.character.retarget import retarget_all
from cagemap.character.roles import find_body
from cagemap.character.skeleton import carry_rig, prop_joints
from cagemap.character.values import Character, Part
from cagemap.errors import ParameterError
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.mesh_report import count_noun, first_few
from cagemap.mesh.parts import extract_faces, join_meshes, numbers_on_part, passenger_word
from cagemap.mesh.repairs import RepairedMesh
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.tasks.bodies import Bodies, body_shapes, match_bodies, rigid_pieces
from cagemap.tasks.carry_arrays import carry_weights
from cagemap.tasks.progress import Stages


@dataclass(frozen=True, eq=False)
class CarriedCharacter:
    """A character on another body, with its match and notes."""

    character: Character  # In the target's file units. Its first part is the target's body, named like the source's.
    result: MatchResult = field(repr=False)  # from the target's body to the source's
    # (n,) and (m,) for every control vertex of the matched target and source, a vertex of the body's part as given
    rows: tuple[IndexArray, IndexArray] = field(repr=False)
    # parts of the source, in the order of the last parts of ``character``; with pieces of the source's body that could
    # not be matched
    passengers: tuple[Part, ...] = field(repr=False)
    notes: tuple[str, ...] = ()


def carry_character(
    target: Character,
    source: Character,
    landmarks: Landmarks | None = None,
    *,
    bodies: tuple[str | None, str | None] = (None, None),
    passengers: Sequence[str] | None = None,
    kinds: Mapping[str, PassengerKind] | None = None,
    influences: int | None = 4,
    taken: Collection[str] = (),
    stages: Stages | None = None,
) -> CarriedCharacter:
    """Rig and dress a body like a character.

    ``target``: its body gets the source's rig and animations, and keeps its own shapes, also against shapes of the same
        name; its other parts stay, with weights and shapes by `with_nearest_values`.
    ``bodies``: names of the target's and of the source's body; by default `find_body` finds them.
    ``passengers``: names of the source's other parts to carry; by default all of which the target has no other part of
        the same kind, see `parts_of_one_kind`.
    ``kinds``: see `carry_passengers`.
    ``influences``: most joints per vertex of the body; None for all.
    ``taken``: names that no other part of the target keeps, such as those of joints.
    """
    stages = Stages() if stages is None else stages
    target_body, source_body = find_body(target.parts, bodies[0]), find_body(source.parts, bodies[1])
    chosen, notes = _select_passengers(source, source_body, target, target_body, passengers)
    declined = [part for part in source.parts if part not in (*chosen, source_body)]
    names = [part.name for part in chosen]
    _require_passengers(kinds or (), [*names, _name_of_pieces(source_body)], [part.name for part in declined])
    matched = match_bodies(target_body, source_body, landmarks or Landmarks.none(), stages)
    result = matched.result
    notes += matched.notes
    notes += [f"{one.mesh.name}: {sentence}" for one in matched.ready for sentence in one.repairs.sentences_of_body()]
    others = [part for part in target.parts if part is not target_body]
    pieces, counterparts, left_out_notes = _pieces_to_carry(matched, others, named=set(kinds or ()))
    notes += left_out_notes
    to_carry = [*chosen, *([] if pieces is None else [pieces])]
    stages("weights and shapes")
    rigid = rigid_pieces(matched)
    weights, shapes = _body_weights(matched, counterparts, rigid, influences), body_shapes(matched, rigid)
    for name, offsets in counterparts.shapes.items():
        shapes[name][counterparts.vertices] = offsets
    body = replace(target_body, name=source_body.name, weights=weights, shapes={**shapes, **target_body.shapes})
    stages("passengers")
    dressed = carried_parts(result, to_carry, kinds=kinds)
    left_out = carried_parts(result, declined if others else [])
    same_kind = parts_of_one_kind([*dressed[: len(chosen)], *left_out], others)
    if passengers is None:
        has_own = {*chain.from_iterable(same_kind)}
        doubled = [part.name for part in dressed[: len(chosen)] if part in has_own and part.name not in (kinds or ())]
        if doubled:
            notes += _declined_note(doubled)
            to_carry, dressed = ([part for part in side if part.name not in doubled] for side in (to_carry, dressed))
        notes += _doubled_passengers(matched, dressed[: len(chosen) - len(doubled)])
    for part, one in zip(to_carry, dressed, strict=True):
        if (kinds or {}).get(part.name) == "rigid":
            notes += hidden_passenger(result.point_map, part.mesh, one.mesh.positions)
    if weights is not None:
        same_kind = [[part for part in parts if part.weights is not None] for parts in same_kind]
    skin = matched.skin(weights, {name: body.shapes[name] for name in shapes})
    extras = with_nearest_values(others, skin, same_kind, result.point_map.target, influences)
    taken = {*taken, *(part.name for part in (body, *to_carry))}
    extras = [replace(part, name=f"{part.name} (own)") if part.name in taken else part for part in extras]
    body = with_shape_normals(body, [name for name in source_body.shape_normals if name not in target_body.shapes])
    rig, animations = None, source.animations  # without a skeleton, those of blend shapes
    if source.rig is not None:
        stages("skeleton and animations")
        if weights is None:
            notes.append(
                f"{source_body.name} has no weights, so the body does not move with the skeleton: export the character "
                "with the weights of its body, or choose a part that has weights as the body (rig: --like-part)"
            )
        places = prop_joints(source.rig, [*zip(to_carry, dressed, strict=True), *zip(declined, left_out, strict=False)])
        of_body = np.zeros(0) if source_body.weights is None else source_body.weights.indices
        rig = carry_rig(result.point_map, source.rig, {j: place for j, place in places.items() if j not in of_body})
        animations, posed_otherwise = retarget_all(source.animations, source.rig, rig)
        if posed_otherwise:
            notes.append(
                "the body stands in another pose than the character: animations are adapted to the pose of the body"
            )
    character = Character((body, *extras, *dressed), rig, animations)
    return CarriedCharacter(character, result, (matched.rows(0), matched.rows(1)), tuple(to_carry), tuple(notes))


def _body_weights(
    bodies: Bodies, counterparts: _Counterparts, rigid: Sequence[IndexArray], influences: int | None
) -> sparse.csr_array | None:
    weights = bodies.given[1].weights
    if weights is None:
        return None
    carried = carry_weights(bodies.result, weights[bodies.rows(1)].toarray(), influences=influences)
    table = average_rows(bodies.on_target(carried), rigid, influences)
    if counterparts.weights is not None:
        table[counterparts.vertices] = limit_influences(counterparts.weights.toarray(), influences)
    return sparse.csr_array(table)


@dataclass(frozen=True, eq=False)
class _Counterparts:
    """Vertices in loose pieces of the target's body, with weights and shapes of the same pieces of the source's."""

    vertices: IndexArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # (k,) of the target's body
    weights: sparse.csr_array | None = None  # (k, j)
    shapes: dict[str, FloatArray] = field(default_factory=dict)  # (k, 3) each


def _pieces_to_carry(
    bodies: Bodies, others: Sequence[Part], named: Collection[str]
) -> tuple[Part | None, _Counterparts, list[str]]:
    """The unmatched pieces of the source's body but those that the target has too; values of these; and notes.

    ``others``: the target's parts beside its body.
    ``named``: names of passengers; pieces with one of these names are all carried.
    """
    unmatched, pieces = (_set_aside(part, ready) for part, ready in zip(bodies.given, bodies.ready, strict=True))
    own = [part.mesh for part in (*([] if unmatched is None else [unmatched]), *others)]
    if pieces is None or pieces.name in named:
        return pieces, _Counterparts(), []
    mesh = pieces.mesh
    (carried,) = carry_passengers(bodies.result, [mesh])
    placed = mesh.with_positions(carried.positions)
    pairs = doubled_pieces(placed, join_meshes(own)) if own else []
    found = [*pieces_in_surface(mesh, placed, bodies.result.point_map), *(faces for faces, _ in pairs)]
    if not found:
        return pieces, _Counterparts(), []
    doubled = {int(faces[0]): faces for faces in found}.values()  # each piece once
    sizes = first_few([count_noun(len(faces), "face") for faces in doubled])
    target, source = bodies.given
    note = (
        f"{count_noun(len(doubled), 'piece')} of {source.mesh.name} ({sizes}) not carried, since {target.mesh.name} "
        f"has its own there: to carry all, name {pieces.name!r} (rig: --rigid, --cloth), or make one an object"
    )
    left = np.setdiff1d(np.arange(mesh.n_faces), np.concatenate(found))
    counterparts = _Counterparts()
    if unmatched is not None:
        counterparts = _values_of_pairs(bodies, unmatched.mesh, pieces, carried, pairs)
    return _part_of_faces(pieces, left) if len(left) else None, counterparts, [note]


def _values_of_pairs(
    bodies: Bodies, own: ControlMesh, pieces: Part, carried: CarriedPassenger, pairs: Sequence[PairedFaces]
) -> _Counterparts:
    """Values of the source's pieces at the nearest vertices of the target's.

    ``own``: unmatched pieces of the target's body.
    ``pairs``: faces of ``pieces``, and of ``own`` and further meshes.
    """
    on_own = numbers_on_part(own, bodies.given[0].mesh)
    vertices, rows = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for faces, own_faces in pairs:
        if own_faces[0] < own.n_faces:
            of_own, of_piece = (
                np.unique(mesh.face_indices[np.isin(mesh.corner_faces, of_pair)])
                for mesh, of_pair in ((own, own_faces), (pieces.mesh, faces))
            )
            vertices.append(np.flatnonzero(np.isin(on_own, of_own) & (bodies.ready[0].vertex_of < 0)))
            places = bodies.given[0].mesh.positions[vertices[-1]]
            rows.append(of_piece[nearest_rows(carried.positions[of_piece], places)])
    taken = np.concatenate(rows)
    return _Counterparts(
        np.concatenate(vertices),
        None if pieces.weights is None else pieces.weights[taken],
        {name: carried.carry_offsets(offsets)[taken] for name, offsets in pieces.shapes.items()},
    )


def _doubled_passengers(bodies: Bodies, dressed: Sequence[Part]) -> list[str]:
    """A note on carried parts at whose place the mesh of the target's body has pieces."""
    own = _set_aside(bodies.given[0], bodies.ready[0])
    if own is None:
        return []
    doubled = []
    for part in dressed:
        pairs = doubled_pieces(part.mesh, own.mesh)
        doubled += [part.name] if sum(len(faces) for faces, _ in pairs) == part.mesh.n_faces else []
    text = "has own pieces at the same place. To leave out the character's, name the others by --passengers"
    return [f"{', '.join(doubled)}: the mesh of {bodies.given[0].mesh.name} {text}"] if doubled else []


def _set_aside(body: Part, ready: RepairedMesh) -> Part | None:
    """Unmatched pieces of a body's mesh as a separate part; None without any."""
    mesh = body.mesh
    kept = np.maximum.reduceat(ready.vertex_of[mesh.face_indices], mesh.face_offsets[:-1]) >= 0
    if kept.all():
        return None
    pieces = _part_of_faces(body, np.flatnonzero(~kept))
    name = _name_of_pieces(body)
    return replace(pieces, name=name, mesh=replace(pieces.mesh, name=name))


def _name_of_pieces(body: Part) -> str:
    """Name of the passenger that the unmatched pieces of a body's mesh become."""
    return f"{body.name} pieces"


def _part_of_faces(body: Part, faces: IndexArray) -> Part:
    """Some faces of a part, with the values of their vertices and corners."""
    mesh = body.mesh
    taken = extract_faces(mesh, faces)
    number = numbers_on_part(taken, mesh)
    rows = np.zeros(taken.n_vertices, dtype=np.int64)
    rows[number[number >= 0]] = np.flatnonzero(number >= 0)
    corners = np.isin(mesh.corner_faces, faces)
    return Part(
        body.name,
        taken,
        None if body.weights is None else body.weights[rows],
        {name: offsets[rows] for name, offsets in body.shapes.items()},
        None if body.normals is None else body.normals[corners],
        {name: offsets[corners] for name, offsets in body.shape_normals.items()},
        None if body.colors is None else body.colors[corners],
    )


def with_part(character: Character, part: Part, made: Part) -> Character:
    """A character with ``part`` replaced by ``made``."""
    return replace(character, parts=tuple(made if candidate is part else candidate for candidate in character.parts))


def _select_passengers(
    source: Character, source_body: Part, target: Character, target_body: Part, names: Sequence[str] | None
) -> tuple[list[Part], list[str]]:
    """Passengers to carry, and notes about the other parts."""
    candidates = [part for part in source.parts if part is not source_body]
    if names is not None:
        known = {part.name for part in candidates}
        missing = [name for name in names if name not in known]
        if missing:
            raise ParameterError(
                f"passengers: expected names of parts of the character ({', '.join(sorted(known)) or 'it has none'}), "
                f"got {', '.join(missing)}"
            )
        return [part for part in candidates if part.name in names], []
    roles = {passenger_word(part.name) for part in target.parts if part is not target_body} - {""}
    declined = [part.name for part in candidates if passenger_word(part.name) in roles]
    return [part for part in candidates if part.name not in declined], _declined_note(declined)


def _declined_note(names: Sequence[str]) -> list[str]:
    note = "the body has its own and keeps them; name them as passengers to carry them"
    return [f"{', '.join(names)}: {note}"] if names else []


def _require_passengers(names: Iterable[str], known: Sequence[str], declined: Collection[str]) -> None:
    """Refuse a kind for a passenger that is not carried, before the match."""
    for name in names:
        if name in declined:
            raise ParameterError(
                f"{name}: has a kind but is not carried, since the body has its own or it is not among the passengers. "
                "Name it as a passenger too (rig: --passengers)."
            )
        if name not in known:
            raise ParameterError(f"{name}: expected one of the passengers, {', '.join(known)} (rig: --rigid, --cloth)")
