"""Carry a character to another body: weights, shapes, skeleton, animations and passengers."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.character.doubled_pieces import doubled_pieces, pieces_in_surface
from cagemap.character.normals import with_shape_normals
from cagemap.character.own_parts import parts_of_one_kind, with_nearest_values
from cagemap.character.passenger_pieces import PassengerKind
from cagemap.character.passengers import carried_parts, hidden_passenger
from cagemap.character.retarget import retarget_all
from cagemap.character.roles import find_body
from cagemap.character.skeleton import carry_rig, prop_joints
from cagemap.character.values import Character, Part
from cagemap.errors import ParameterError
from cagemap.maps.result import MatchResult
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.mesh_report import count_noun, first_few
from cagemap.mesh.parts import extract_faces, join_meshes, numbers_on_part, passenger_word
from cagemap.mesh.repairs import RepairedMesh
from cagemap.mesh.topology import face_components
from cagemap.numerics.arrays import FloatArray, IndexArray, members_of
from cagemap.tasks.bodies import Bodies, body_shapes, match_bodies
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

    ``target``: its body gets the source's rig and animations, and keeps its own shapes: of two with one name, the
        target's; its other parts stay, with weights and shapes by `with_nearest_values`.
    ``bodies``: names of the target's and of the source's body; by default `find_body` finds them.
    ``passengers``: names of the source's other parts to carry; by default all of which the target has no other part of
        the same kind, see `parts_of_one_kind`.
    ``kinds``: see `carry_passengers`.
    ``influences``: most joints per vertex of the body; None for all.
    ``taken``: names already in use, such as those of joints: another part of the target with one gets '(own)'.
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
    loose = _loose_pieces(matched)
    pieces, counterparts, left_out_notes = _pieces_to_carry(matched, [*loose, *others], named=set(kinds or ()))
    notes += left_out_notes
    to_carry = [*chosen, *([] if pieces is None else [pieces])]
    stages("passengers")
    placed = dict(zip(to_carry, carried_parts(matched.shown_map, to_carry, kinds=kinds), strict=True))  # on the target
    if others:
        placed |= zip(declined, carried_parts(matched.shown_map, declined), strict=True)
    candidates = [placed[part] for part in (*chosen, *declined) if part in placed]
    same_kind = parts_of_one_kind(candidates, others)
    if passengers is None:
        has_own = {*chain.from_iterable(same_kind)}
        doubled = [part for part in chosen if placed[part] in has_own and part.name not in (kinds or ())]
        notes += _declined_note([part.name for part in doubled])
        to_carry = [part for part in to_carry if part not in doubled]
        notes += _doubled_passengers(target_body, loose, [placed[part] for part in chosen if part not in doubled])
    for part in to_carry:
        if (kinds or {}).get(part.name) == "rigid":
            notes += hidden_passenger(result.point_map, part.mesh, placed[part].mesh.positions)
    stages("weights and shapes")
    weights, shapes = _body_weights(matched, influences), body_shapes(matched)
    # Other parts move like the body, whose own shapes stay.
    skin = matched.skin(weights, {name: target_body.shapes.get(name, offsets) for name, offsets in shapes.items()})
    for listed, parts in zip(counterparts[len(loose) :], same_kind, strict=True):
        listed += parts
    if weights is not None:
        counterparts = [[part for part in parts if part.weights is not None] for parts in counterparts]
    own = with_nearest_values([*loose, *others], skin, counterparts, result.point_map.target, influences)
    body = replace(target_body, name=source_body.name, weights=weights, shapes=shapes)
    body = _with_values_of(body, own[: len(loose)], matched.ready[0].vertex_of < 0)
    body = replace(body, shapes={**body.shapes, **target_body.shapes})
    extras = own[len(loose) :]
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
        places = prop_joints(source.rig, placed.items())
        of_body = np.zeros(0) if source_body.weights is None else source_body.weights.indices
        rig = carry_rig(result.point_map, source.rig, {j: place for j, place in places.items() if j not in of_body})
        animations, posed_otherwise = retarget_all(source.animations, source.rig, rig)
        if posed_otherwise:
            notes.append(
                "the body stands in another pose than the character: animations are adapted to the pose of the body"
            )
    character = Character((body, *extras, *(placed[part] for part in to_carry)), rig, animations)
    return CarriedCharacter(character, result, (matched.rows(0), matched.rows(1)), tuple(to_carry), tuple(notes))


def _body_weights(bodies: Bodies, influences: int | None) -> sparse.csr_array | None:
    """Weights of the source's body at the given target's vertices."""
    weights = bodies.given[1].weights
    if weights is None:
        return None
    carried = carry_weights(bodies.result, weights[bodies.rows(1)].toarray(), influences=influences)
    return sparse.csr_array(bodies.on_target(carried))


def _with_values_of(body: Part, pieces: Sequence[Part], unmatched: NDArray[np.bool_]) -> Part:
    """A body with weights and shapes of some of its pieces, at its unmatched vertices (n,)."""
    rows, sizes = np.arange(body.mesh.n_vertices), [body.mesh.n_vertices, *(piece.mesh.n_vertices for piece in pieces)]
    for piece, start in zip(pieces, np.cumsum(sizes[:-1]), strict=True):
        number = numbers_on_part(piece.mesh, body.mesh)
        rows = np.where((number >= 0) & unmatched, number + start, rows)
    weights, shapes = body.weights, dict[str, FloatArray]()
    if weights is not None:
        of_pieces = [piece.weights for piece in pieces if piece.weights is not None]
        weights = sparse.vstack([weights, *of_pieces], format="csr")[rows]
    for name, offsets in body.shapes.items():
        others = [piece.shapes.get(name, np.zeros((piece.mesh.n_vertices, 3))) for piece in pieces]
        shapes[name] = np.concatenate([offsets, *others])[rows]
    return replace(body, weights=weights, shapes=shapes)


def _loose_pieces(bodies: Bodies) -> list[Part]:
    """Connected unmatched pieces of the target's body, without values."""
    unmatched = _set_aside(Part("", bodies.given[0].mesh), bodies.ready[0])
    if unmatched is None:
        return []
    return [_part_of_faces(unmatched, faces) for faces in members_of(face_components(unmatched.mesh))]


def _pieces_to_carry(
    bodies: Bodies, own: Sequence[Part], named: Collection[str]
) -> tuple[Part | None, list[list[Part]], list[str]]:
    """Unmatched pieces of the source's body to carry; for each own part those that it stands for, placed; and notes.

    ``own``: the target's loose pieces, and its parts beside its body.
    ``named``: names of passengers; pieces with one of these names are all carried.
    """
    pieces, counterparts = _set_aside(bodies.given[1], bodies.ready[1]), [list[Part]() for _ in own]
    if pieces is None or pieces.name in named:
        return pieces, counterparts, []
    (placed,) = carried_parts(bodies.shown_map, [pieces])
    ends = np.cumsum([part.mesh.n_faces for part in own])
    pairs = doubled_pieces(placed.mesh, join_meshes([part.mesh for part in own])) if own else []
    for faces, own_faces in pairs:
        counterparts[int(np.searchsorted(ends, own_faces[0], side="right"))].append(_part_of_faces(placed, faces))
    in_surface = pieces_in_surface(pieces.mesh, placed.mesh, bodies.result.point_map)
    found = [*in_surface, *(faces for faces, _ in pairs)]
    if not found:
        return pieces, counterparts, []
    doubled = {int(faces[0]): faces for faces in found}.values()  # each piece once
    sizes = first_few([count_noun(len(faces), "face") for faces in doubled])
    target, source = bodies.given
    note = (
        f"{count_noun(len(doubled), 'piece')} of {source.mesh.name} ({sizes}) not carried, since {target.mesh.name} "
        f"has its own there: to carry all, name {pieces.name!r} (rig: --rigid, --cloth), or make one an object"
    )
    left = np.setdiff1d(np.arange(pieces.mesh.n_faces), np.concatenate(found))
    return _part_of_faces(pieces, left) if len(left) else None, counterparts, [note]


def _doubled_passengers(body: Part, loose: Sequence[Part], dressed: Sequence[Part]) -> list[str]:
    """A note on carried parts at whose place the mesh of the target's body has ``loose`` pieces."""
    if not loose:
        return []
    own, doubled = join_meshes([piece.mesh for piece in loose]), list[str]()
    for part in dressed:
        pairs = doubled_pieces(part.mesh, own)
        doubled += [part.name] if sum(len(faces) for faces, _ in pairs) == part.mesh.n_faces else []
    text = "has own pieces at the same place. To leave out the character's, name the others by --passengers"
    return [f"{', '.join(doubled)}: the mesh of {body.mesh.name} {text}"] if doubled else []


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
