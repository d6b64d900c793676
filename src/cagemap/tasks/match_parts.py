"""`--part`: choose parts of two files to match, with their landmarks; repair plain meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cagemap.errors import ParameterError
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import Renumbering
from cagemap.mesh.checks import require_valid
from cagemap.mesh.faces import keep_faces
from cagemap.mesh.landmarks import Landmarks, check_landmarks
from cagemap.mesh.mesh_report import count_noun, first_few
from cagemap.mesh.parts import (
    Part,
    connected_parts,
    extract_faces,
    find_part,
    list_parts,
    numbers_on_part,
    part_of_corners,
)
from cagemap.mesh.plain import plain_mesh
from cagemap.mesh.repairs import RepairedMesh, unrepaired
from cagemap.mesh.schemes import Plain
from cagemap.mesh.topology import face_components, handle_count
from cagemap.numerics.arrays import IndexArray, members_of
from cagemap.numerics.threads import in_threads
from cagemap.subdivision import default_scheme

EACH = "each"
MATERIAL = "material"


@dataclass(frozen=True)
class PartInputs:
    """Two meshes to be matched, whole or parts of their files."""

    target: ControlMesh
    source: ControlMesh
    landmarks: Landmarks  # landmarks on both meshes, in their own numbering
    notes: tuple[str, ...] = ()  # repairs of plain meshes
    repairs: dict[str, dict[str, float]] = field(default_factory=dict)  # repairs in numbers, for a manifest, by side


def requested_parts(
    part: str | None, target_part: str | None, source_part: str | None
) -> tuple[str | None, str | None]:
    """Requested part of each side from `--part`, `--target-part` and `--source-part`.

    If one side has `EACH` (its pieces) or `MATERIAL` and the other none, the word holds for both.
    """
    words = target_part or part, source_part or part
    every = next((word for word in words if word in (EACH, MATERIAL)), None)
    return words[0] or every, words[1] or every


def select_parts(
    target: ControlMesh, source: ControlMesh, landmarks: Landmarks, target_part: str | None, source_part: str | None
) -> tuple[tuple[PartInputs, ...], tuple[str, ...]]:
    """Pairs of parts of two files to match, and notes about the other parts.

    ``target``, ``source``: as in their files.
    ``landmarks``: in the files' numbers.
    ``target_part``, ``source_part``: a part's name, ``largest``, ``each`` (connected pieces) or ``material``; None for
        the whole. See `requested_parts`.
    """
    # A part has the scheme of the whole file, even if all its faces are triangles.
    target, source = (replace(mesh, scheme=default_scheme(mesh)) for mesh in (target, source))
    if target_part is not None and source_part is not None and {target_part, source_part} & {EACH, MATERIAL}:
        return _select_all_parts(target, source, landmarks, (target_part, source_part))
    sides = [(target, target_part), (source, source_part)]
    parts = [None if name is None else find_part(mesh, name) for mesh, name in sides]
    inputs = _part_inputs(target, source, landmarks, *parts)
    notes = []
    left = len(landmarks) - len(inputs.landmarks)
    if left:
        notes.append(f"{left} of {len(landmarks)} landmarks lie on other parts and are left out")
    left = len(landmarks.curves) - len(inputs.landmarks.curves)
    if left:
        notes.append(f"{left} of {len(landmarks.curves)} curves lie on other parts and are left out")
    return (inputs,), tuple(notes)


def _select_all_parts(
    target: ControlMesh, source: ControlMesh, landmarks: Landmarks, words: tuple[str, str]
) -> tuple[tuple[PartInputs, ...], tuple[str, ...]]:
    target_pieces, source_pieces = _pieces(target, words[0]), _pieces(source, words[1])
    pairs, *unpaired = pair_parts(
        target,
        source,
        np.column_stack([landmarks.target_points.heaviest_corners, landmarks.source_points.heaviest_corners]),
        (target_pieces, source_pieces),
    )
    left = {
        side: first_few(f"{part.kind} {part.name} ({len(part.faces)} faces)" for part in parts)
        for side, parts in zip(("target", "source"), unpaired, strict=True)
        if parts
    }
    if not pairs:
        word = next(word for word in words if word in (EACH, MATERIAL))
        listed = ", ".join(f"in the {side} {names}" for side, names in left.items())
        raise ParameterError(
            f"--part {word}: expected parts that go together by name or by landmarks, found none: {listed}. Give "
            "objects or groups the same names in both files, or landmarks on each part."
        )
    notes = [
        f"left alone, since nothing goes with it by name or by landmarks: {names} of the {side}"
        for side, names in left.items()
    ]
    return tuple(_part_inputs(target, source, landmarks, *pair) for pair in pairs), tuple(notes)


def pair_parts(
    target: ControlMesh,
    source: ControlMesh,
    landmarks: IndexArray,
    pieces: tuple[Sequence[Part], Sequence[Part]] | None = None,
) -> tuple[tuple[tuple[Part, Part], ...], tuple[Part, ...], tuple[Part, ...]]:
    """Pair the pieces of two meshes by shared landmarks, then by name, then the only remaining ones.

    ``landmarks`` (p, 2) are target and source vertices; ``pieces`` are connected parts by default. A name whose last
    word is a number ("arm 2") is ignored. Also returns the unpaired pieces of target and source; larger target pieces
    come first.
    """
    of_target, of_source = pieces or (connected_parts(target), connected_parts(source))
    target_parts = sorted(of_target, key=lambda part: -len(part.faces))
    source_parts = list(of_source)
    votes = np.zeros((len(target_parts), len(source_parts)), dtype=np.int64)
    ends = np.column_stack(
        [_owners(target, target_parts)[landmarks[:, 0]], _owners(source, source_parts)[landmarks[:, 1]]]
    )
    np.add.at(votes, tuple(ends[(ends >= 0).all(axis=1)].T), 1)
    most_votes = np.argsort(-votes, axis=None, kind="stable")[: np.count_nonzero(votes)]
    candidates = [divmod(number, len(source_parts)) for number in most_votes.tolist()]
    candidates += [
        (row, column)
        for row, part in enumerate(target_parts)
        if not part.name.rpartition(" ")[2].isdigit()
        for column, source_part in enumerate(source_parts)
        if part.name.rpartition("/")[2] == source_part.name.rpartition("/")[2]
    ]
    chosen: dict[int, int] = {}
    for row, column in candidates:
        if row not in chosen and column not in chosen.values():
            chosen[row] = column
    unpaired_target = [row for row in range(len(target_parts)) if row not in chosen]
    unpaired_source = [column for column in range(len(source_parts)) if column not in chosen.values()]
    if len(unpaired_target) == len(unpaired_source) == 1:
        chosen[unpaired_target[0]] = unpaired_source[0]
    return (
        tuple((target_parts[row], source_parts[chosen[row]]) for row in sorted(chosen)),
        tuple(part for row, part in enumerate(target_parts) if row not in chosen),
        tuple(part for column, part in enumerate(source_parts) if column not in chosen.values()),
    )


def _owners(mesh: ControlMesh, parts: list[Part]) -> IndexArray:
    """(n,) number of the part that contains each vertex; the highest if several do, -1 if none does."""
    owners = np.full(mesh.n_vertices, -1, dtype=np.int64)
    np.maximum.at(owners, mesh.face_indices, part_of_corners(mesh, parts))
    return owners


def material_pieces(mesh: ControlMesh) -> tuple[Part, ...]:
    """One part per named material, split into numbered parts where not connected."""
    materials = [part for part in list_parts(mesh, pieces=False) if part.kind == "material"]
    return tuple(piece for part in materials for piece in _connected_pieces(mesh, part))


def _pieces(mesh: ControlMesh, word: str) -> tuple[Part, ...]:
    """Parts of a side to pair: all pieces, its materials' faces, or the pieces of the part ``word``."""
    if word == EACH:
        return connected_parts(mesh)
    return material_pieces(mesh) if word == MATERIAL else _connected_pieces(mesh, find_part(mesh, word))


def _connected_pieces(mesh: ControlMesh, part: Part) -> tuple[Part, ...]:
    """Split a part into numbered connected parts; a connected part keeps its name."""
    pieces = [part.faces[piece] for piece in members_of(face_components(keep_faces(mesh, part.faces)))]
    names = [part.name] if len(pieces) == 1 else [f"{part.name} {number}" for number in range(len(pieces))]
    return tuple(Part(part.kind, name, faces) for name, faces in zip(names, pieces, strict=True))


def _part_inputs(
    target: ControlMesh, source: ControlMesh, landmarks: Landmarks, target_part: Part | None, source_part: Part | None
) -> PartInputs:
    sides = [_extract_part(mesh, part) for mesh, part in ((target, target_part), (source, source_part))]
    for mesh, _ in sides:
        if mesh.object_schemes:
            words = ", ".join(
                f"{name} {scheme}" for name, scheme in zip(mesh.object_names, mesh.object_schemes, strict=True)
            )
            raise ParameterError(
                f"{mesh.name}: expected a part that is subdivided in one way, got {words}. Name one of these objects."
            )
    kept = landmarks.renumbered(*(renumbering for _, renumbering in sides))
    return PartInputs(sides[0][0], sides[1][0], kept)


def _extract_part(mesh: ControlMesh, part: Part | None) -> tuple[ControlMesh, Renumbering]:
    """A part as a mesh, and the renumbering from the whole's vertices to its vertices."""
    if part is None or len(part.faces) == mesh.n_faces:
        return mesh, lambda vertices: vertices
    taken = extract_faces(mesh, part.faces)
    return taken, numbers_on_part(taken, mesh).__getitem__


def ready_inputs(given: PartInputs) -> PartInputs:
    """Check two meshes and their landmarks, and repair plain meshes; notes name pieces set aside."""
    check_landmarks(given.landmarks, given.target, given.source)
    ready = dict(zip(("target", "source"), in_threads(ready_mesh, [given.target, given.source]), strict=True))
    plain = {side: prepared for side, prepared in ready.items() if isinstance(prepared.mesh.scheme, Plain)}
    meshes = [prepared.mesh for prepared in ready.values()]
    numbers = [prepared.vertex_of.__getitem__ for prepared in ready.values()]
    notes = [note for prepared in ready.values() for note in prepared.notes]
    repairs = {side: prepared.repairs.summary() for side, prepared in plain.items()}
    landmarks = given.landmarks.renumbered(*numbers)
    notes += lost_landmark_notes(given.landmarks, landmarks)
    if not plain:  # handles of a scan mean little
        notes += _handle_notes(*meshes)
    return PartInputs(meshes[0], meshes[1], landmarks, tuple(notes), repairs)


def lost_landmark_notes(given: Landmarks, kept: Landmarks) -> list[str]:
    """Notes on landmarks and curves that are not among those ``kept`` on the matched pieces."""
    counts = ("landmarks", len(given), len(kept)), ("curves", len(given.curves), len(kept.curves))
    return [
        f"{before - after} of {before} {what} lie on pieces that are set aside and are left out"
        for what, before, after in counts
        if after < before
    ]


def _handle_notes(*meshes: ControlMesh) -> list[str]:
    """A note if numbers of handles differ, so that no map is one to one."""
    counts = [handle_count(mesh) for mesh in meshes]
    if counts[0] == counts[1]:
        return []
    (one, a), (other, b) = zip((mesh.name for mesh in meshes), counts, strict=True)
    return [
        f"{one} has {count_noun(a, 'handle')}, {other} {b}: no map is one to one, this one tears or folds somewhere"
    ]


def ready_mesh(mesh: ControlMesh) -> RepairedMesh:
    """A checked cage, or a repaired plain mesh."""
    ready = plain_mesh(mesh) if isinstance(mesh.scheme, Plain) else unrepaired(mesh)
    require_valid(ready.mesh)
    return ready
