"""Carry a character to another body: weights, shapes, skeleton, animations and passengers."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cagemap.character.body_frames import SignedDistances
from cagemap.character.normals import with_shape_normals
from cagemap.character.own_parts import with_nearest_values
from cagemap.character.passenger_pieces import PassengerKind
from cagemap.character.passengers import MAX_BODY_DISTANCE, carry_passengers, hidden_passenger
from cagemap.character.retarget import retarget_all
from cagemap.character.roles import find_body
from cagemap.character.skeleton import carry_rig, prop_joints
from cagemap.character.values import Character, Part
from cagemap.errors import ParameterError
from cagemap.maps.result import MatchResult
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.mesh_report import count_noun, first_few
from cagemap.mesh.parts import extract_faces, numbers_on_part, passenger_word
from cagemap.mesh.topology import face_components
from cagemap.numerics.arrays import FloatArray, IndexArray, offsets_of
from cagemap.tasks.bodies import Bodies, body_shapes, match_bodies
from cagemap.tasks.carry_arrays import carry_weights
from cagemap.tasks.compared_parts import compare_parts, named_pieces, part_of_faces
from cagemap.tasks.progress import Stages

_DISTANCE_SAMPLES = 500  # vertices of a part, to measure its distance from the body


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
    subdivided: bool = False,
    answer: int = 0,
    stages: Stages | None = None,
) -> CarriedCharacter:
    """Rig and dress a body like a character.

    ``target``: its body gets the source's rig and animations, and keeps its own shapes: of two with one name, the
        target's; its other parts stay, with weights and shapes by `with_nearest_values`.
    ``bodies``: names of the target's and of the source's body; by default `find_body` finds them.
    ``passengers``: names of the source's other parts to carry; by default all of which the target has no other part of
        the same kind, see `compare_parts`. If it has parts or loose pieces to compare, all are placed, so that a rigid
        group has one motion, with or without its other parts.
    ``kinds``: see `carry_passengers`.
    ``influences``: most joints per vertex of the body; None for all.
    ``taken``: names already in use, such as those of joints: another part of the target with one gets '(own)'.
    ``subdivided``: whether programs show the body with the subdivision scheme that its mesh states, as from USD.
    ``answer``: see `match_bodies`.
    """
    stages, kinds = Stages() if stages is None else stages, kinds or {}
    target_body, source_body = find_body(target.parts, bodies[0]), find_body(source.parts, bodies[1])
    chosen, notes = _select_passengers(source, source_body, target, target_body, passengers)
    declined = [part for part in source.parts if part not in (*chosen, source_body)]
    names = [part.name for part in chosen]
    _require_passengers(kinds, [*names, _name_of_pieces(source_body)], [part.name for part in declined])
    matched = match_bodies(target_body, source_body, landmarks or Landmarks.none(), stages, source.rig, answer)
    result = matched.result
    notes += matched.notes
    notes += [f"{one.mesh.name}: {sentence}" for one in matched.ready for sentence in one.repairs.sentences_of_body()]
    # Weights of the rig that is replaced are left out.
    others = [replace(part, weights=None) for part in target.parts if part is not target_body]
    unmatched, pieces = _set_aside(matched, 0).mesh, _set_aside(matched, 1)
    loose = [Part(name, extract_faces(unmatched, faces)) for name, faces in named_pieces(unmatched)]
    to_carry = [*chosen, pieces] if pieces.mesh.n_faces else chosen
    stages("passengers")
    to_place = [*to_carry, *(declined if loose or others else [])]
    shown = result.point_map if subdivided and target_body.mesh.scheme is not None else matched.flat_map
    carried = dict(zip(to_place, carry_passengers(shown, [part.mesh for part in to_place], kinds=kinds), strict=True))
    placed = {part: one.placed(part) for part, one in carried.items()}  # on the target
    compared = compare_parts(
        [placed[part] for part in to_place if part is not pieces],
        pieces,
        placed.get(pieces, pieces),
        loose,
        others,
        result.point_map,
    )
    if pieces.name not in kinds and len(compared.faces) < pieces.mesh.n_faces:
        notes.append(_left_out_note(matched, pieces, compared.faces))
        to_carry.remove(pieces)
        if len(compared.faces):
            to_carry.append(part_of_faces(pieces, compared.faces))
            placed[to_carry[-1]] = part_of_faces(placed[pieces], compared.faces)
    if passengers is None:
        doubled = [part for part in chosen if placed[part] in compared.doubles_of_parts and part.name not in kinds]
        notes += _declined_note([part.name for part in doubled])
        to_carry = [part for part in to_carry if part not in doubled]
        notes += _doubled_note(target_body, [one.name for one in to_carry if placed[one] in compared.doubles_of_pieces])
    notes += _far_note(source_body, {one: carried[one].distance for one in to_carry if one in carried}, pieces)
    for part in to_carry:
        if kinds.get(part.name) == "rigid":
            notes += hidden_passenger(result.point_map, part.mesh, placed[part].mesh.positions)
    stages("weights and shapes")
    weights, shapes = _body_weights(matched, influences), body_shapes(matched)
    # Other parts move like the body, whose own shapes stay.
    skin = matched.skin(weights, {name: target_body.shapes.get(name, offsets) for name, offsets in shapes.items()})
    counterparts = compared.counterparts
    if weights is not None:
        counterparts = [[part for part in parts if part.weights is not None] for parts in counterparts]
    own = with_nearest_values([*loose, *others], skin, counterparts, result.point_map.target, influences)
    notes += [] if weights is None else _far_own_note(target_body, others, result)
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
    rows, starts = np.arange(body.mesh.n_vertices), offsets_of([part.mesh.n_vertices for part in (body, *pieces)])
    for piece, start in zip(pieces, starts[1:-1], strict=True):
        number = numbers_on_part(piece.mesh, body.mesh)
        rows = np.where((number >= 0) & unmatched, number + start, rows)
    weights, shapes = body.weights, dict[str, FloatArray]()
    if weights is not None:
        of_pieces = [piece.weights for piece in pieces if piece.weights is not None]
        weights = sparse.vstack([weights, *of_pieces], format="csr")[rows]
    for name in dict.fromkeys(chain(body.shapes, *(piece.shapes for piece in pieces))):
        offsets = [part.shapes.get(name, np.zeros((part.mesh.n_vertices, 3))) for part in (body, *pieces)]
        shapes[name] = np.concatenate(offsets)[rows]
    return replace(body, weights=weights, shapes=shapes)


def _left_out_note(bodies: Bodies, pieces: Part, kept: IndexArray) -> str:
    """A note on connected pieces whose faces are not ``kept``."""
    labels = face_components(pieces.mesh)
    faces = np.bincount(np.delete(labels, kept))
    sizes = [count_noun(int(size), "face") for size in faces[faces > 0]]
    target, source = bodies.given
    return (
        f"{count_noun(len(sizes), 'piece')} of {source.mesh.name} ({first_few(sizes)}) not carried, since "
        f"{target.mesh.name} has its own there or of this kind: to carry all, name {pieces.name!r} (rig: --rigid, "
        "--cloth), or make one an object"
    )


def _doubled_note(body: Part, names: Sequence[str]) -> list[str]:
    text = "has own pieces of this kind or place. To leave out the character's, name the others by --passengers"
    return [f"{', '.join(names)}: the mesh of {body.mesh.name} {text}"] if names else []


def _far_note(body: Part, distances: Mapping[Part, float], pieces: Part) -> list[str]:
    """A note on passengers far from the character's body, such as those of a second character.

    ``pieces``: the passenger that --passengers cannot leave out.
    """
    others = {part: distance for part, distance in distances.items() if part is not pieces}
    leave_out = "; to leave them out, name others by --passengers, or export this character alone"
    guess = ". Their places on the other body are guesses" + (leave_out if _far_parts(body, others) else "")
    return [text + guess for text in _far_parts(body, distances)]


def _far_own_note(body: Part, others: Sequence[Part], result: MatchResult) -> list[str]:
    """A note on other parts of the target that are far from its body, such as a second figure."""
    surface, distances = result.point_map.target, dict[Part, float]()
    for part in others:
        points = surface.scale * part.mesh.positions[:: 1 + part.mesh.n_vertices // _DISTANCE_SAMPLES]
        distances[part] = float(np.abs(SignedDistances.of(surface, points).heights).mean())
    remedy = f". They move with it; delete those that do not belong to it from {body.mesh.name}"
    return [text + remedy for text in _far_parts(body, distances)]


def _far_parts(body: Part, distances: Mapping[Part, float]) -> list[str]:
    """Which parts are far from a body by their distances, in a sentence; none if no part is."""
    far = [f"{part.name} {distance:.1f}" for part, distance in distances.items() if distance > MAX_BODY_DISTANCE]
    return [f"far from {body.name}, in body sizes: {', '.join(far)}"] if far else []


def _set_aside(bodies: Bodies, side: int) -> Part:
    """Unmatched pieces of the mesh of a body (0: target, 1: source) as a separate part; without faces if all match."""
    body, mesh = bodies.given[side], bodies.given[side].mesh
    matched = np.maximum.reduceat(bodies.ready[side].vertex_of[mesh.face_indices], mesh.face_offsets[:-1]) >= 0
    pieces = part_of_faces(body, np.flatnonzero(~matched), _name_of_pieces(body))
    return replace(pieces, mesh=replace(pieces.mesh, name=pieces.name))


def _name_of_pieces(body: Part) -> str:
    """Name of the passenger that the unmatched pieces of a body's mesh become."""
    return f"{body.name} pieces"


def with_part(character: Character, part: Part, made: Part) -> Character:
    """A character with ``part`` replaced by ``made``."""
    return replace(character, parts=tuple(made if candidate is part else candidate for candidate in character.parts))


def with_shape_weights(character: Character, source: Character, pieces_of: Mapping[str, str]) -> Character:
    """A character with the source's weights of shapes, its own first; ``pieces_of``: with those of another part."""
    stated = {part.name: part.shape_weights for part in source.parts if part.shapes}
    givers = {name: giver for name, giver in pieces_of.items() if name not in stated}
    given = [stated.get(givers.get(part.name, part.name), {}) for part in character.parts]
    parts = [
        replace(p, shape_weights={**new, **p.shape_weights}) for p, new in zip(character.parts, given, strict=True)
    ]
    animations = []
    for one in character.animations:
        copies = [replace(t, part=name) for name, giver in givers.items() for t in one.shape_tracks if t.part == giver]
        animations.append(replace(one, shape_tracks=(*one.shape_tracks, *copies)))
    return replace(character, parts=tuple(parts), animations=tuple(animations))


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
