"""`cagemap face`: add ARKit's face shapes to a head."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.character.body_frames import BodyFrames
from cagemap.character.bones import humanoid_joints
from cagemap.character.own_parts import HAIRS, root_means, with_nearest_values
from cagemap.character.passenger_pieces import PIECES
from cagemap.character.self_collision import move_apart
from cagemap.character.values import Character, Part, Rig
from cagemap.errors import ParameterError
from cagemap.files.atomic import all_or_nothing, check_outputs
from cagemap.files.face_kit import ABSENT, kit_vertices, read_face_kit
from cagemap.files.gltf.write import character_glb
from cagemap.files.images.image import check_writable, write_image
from cagemap.files.landmarks.points import read_points
from cagemap.files.meshes.formats import read_whole
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import CagePoints, on_cage
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.parts import numbers_on_part, passenger_word
from cagemap.mesh.topology import vertex_pieces
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.pictures.camera import View, frame
from cagemap.pictures.render import Image, Model, Skin, render
from cagemap.surface.triangles import fan_triangles
from cagemap.tasks.bodies import Bodies, body_shapes, match_bodies, rigid_pieces
from cagemap.tasks.carry_character import with_part, with_shape_weights
from cagemap.tasks.compared_parts import part_of_faces
from cagemap.tasks.face_parts import Mouth, turn_lashes
from cagemap.tasks.match_summary import body_warnings
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.face import FaceRequest
from cagemap.tasks.requests.options import comma_words, files_read
from cagemap.tasks.rig_character import (
    character_body,
    character_positions,
    points_on_body,
    read_body,
    require_output,
    write_character,
)

# Least trusted share of a head's area: heads have 0.98 and more, a whole body 0.5.
_LEAST_TRUSTED_SHARE = 0.8
# Largest extent of a head over its smallest: heads have 1.3 to 1.5, bodies of people and animals with legs 2.9 to 4.5.
_MAX_HEAD_RATIO = 2.5
# Radius of eyeballs in units of sqrt(area) of the head; MakeHuman's have 0.04, drawn characters' are larger.
_EYES = replace(PIECES, max_radius=0.1)
_AROUND_EYES = ("eye", "brow", "cheekSquint")  # beginnings of names of shapes
_COLUMNS, _PIXELS = 9, 200
_VIEW = View("face", 15.0, 3.0)


def run_face(request: FaceRequest, stages: Stages) -> SummaryAndWarnings:
    """Add blend shapes to a head and write it; returns a summary and warnings."""
    _require_paths(request)
    stages("read")
    kit = read_face_kit()
    asked = kit if request.only is None else read_face_kit(_names(request.only))
    document, file_character = read_body(request.head)
    body = character_body(file_character, request.part, request.head)
    kept = [name for name in asked.shapes if name in body.shapes]
    vertices = _head_vertices(body, file_character.rig)
    head = body if vertices is None else _cut(body, vertices)
    extents = np.ptp(head.mesh.positions, axis=0)
    if head is body and request.landmarks is None and extents.max() > _MAX_HEAD_RATIO * extents.min():
        raise ParameterError(
            f"{request.head}: expected a head, but {body.name!r} has the proportions of a whole body. Give the head "
            "alone, a body with a skeleton whose bones are named, --part, or --landmarks if it is a head."
        )
    landmarks, notes = _landmarks(request, head, file_character)
    bodies = match_bodies(head, kit, landmarks, stages)
    trusted = bodies.result.quality.trusted_area
    if trusted < _LEAST_TRUSTED_SHARE:
        raise ParameterError(
            f"{request.head}: expected a head, but on {1.0 - trusted:.0%} of the part {body.name!r} the face's map "
            "cannot be trusted. Give the head alone, a body with a skeleton whose bones are named, --part or "
            "--landmarks."
        )
    stages("shapes")
    mouth, carried = Mouth.of(bodies), body_shapes(bodies)
    on_head = face_shapes(bodies, mouth, carried, [name for name in asked.shapes if name not in kept])
    shapes, own = _on_body(on_head, head, body), {name: head.shapes[name] for name in kept}
    amounts = dict.fromkeys(on_head, 1.0) | {name: _amount(own[name], carried[name]) for name in kept}
    others = _other_parts(file_character, body, bodies, mouth, on_head | own, amounts)
    character = with_part(file_character, body, replace(body, shapes={**body.shapes, **shapes}))
    for part, with_shapes in others:
        character = with_part(character, part, with_shapes)
    pieces_of = {part.name: body.name for part, _ in others if not part.shapes}
    character = with_shape_weights(character, file_character, pieces_of)
    notes += [*bodies.notes, *body_warnings(bodies.result, ("head", "built-in face"))]
    notes += [f"{', '.join(kept)}: {request.head.name} has its own and keeps them"] if kept else []
    stages.record({"part": body.name, "shapes": list(shapes), "trusted_area": trusted})
    stages("write")
    with all_or_nothing():
        made = character_glb(character, document, pieces_of=pieces_of)
        notes += write_character(request.output, character, made, [request.head], force=request.force)
        if request.sheet is not None:
            turn = BodyFrames(bodies.result.point_map).rotation
            write_image(request.sheet, contact_sheet(character, list(shapes), head, turn), force=request.force)
    absent = f"; there is no {ABSENT}" if request.only is None else ""
    along = f", moving along: {', '.join(part.name for part, _ in others)}" if others else ""
    return f"wrote {request.output}: {len(shapes)} face shapes on {body.name}{along}{absent}", notes


def _require_paths(request: FaceRequest) -> None:
    require_output(request.output)
    if request.sheet is not None:
        check_writable(request.sheet, np.dtype(np.uint8), 3)
    outputs = [request.output, *([] if request.sheet is None else [request.sheet])]
    check_outputs(outputs, files_read(request, "sheet"), force=request.force)


def _names(words: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(comma_words(words)))
    if not names:
        raise ParameterError("only: expected names of shapes with commas between them, such as jawOpen, got none")
    return names


def _head_vertices(body: Part, rig: Rig | None) -> IndexArray | None:
    """Vertices moved by head and neck; None without such joints or for a head alone."""
    if rig is None or body.weights is None:
        return None
    joint = humanoid_joints(rig)
    top = joint.get("neck", joint.get("head"))
    if top is None:
        return None
    below = np.zeros(len(rig.names), dtype=bool)
    for number, above in enumerate(rig.parents):
        below[number] = number == top or (above >= 0 and below[above])
    moved = np.asarray(body.weights[:, np.flatnonzero(below)].sum(axis=1)).ravel() >= 0.5
    return None if moved.all() or not moved.any() else np.flatnonzero(moved)


def _cut(body: Part, vertices: IndexArray) -> Part:
    """The part's faces whose vertices are all among ``vertices``."""
    inside = np.zeros(body.mesh.n_vertices, dtype=bool)
    inside[vertices] = True
    faces = np.flatnonzero(np.logical_and.reduceat(inside[body.mesh.face_indices], body.mesh.face_offsets[:-1]))
    if len(faces) == 0:
        raise ParameterError(f"part {body.name!r}: its neck and head joints move no whole face. Give the head alone.")
    return part_of_faces(body, faces)


def _landmarks(request: FaceRequest, head: Part, character: Character) -> tuple[Landmarks, list[str]]:
    """Landmarks from points of HEAD's file to the kit's points of the same names; and notes.

    ``character``: of HEAD's file.
    """
    if request.landmarks is None:
        return Landmarks.none(), []
    mesh = read_whole(request.head)
    points = read_points(request.landmarks, mesh)
    on_kit = CagePoints.of_vertices(np.array(kit_vertices(points.names), dtype=np.int64))
    on_head = points_on_body(on_cage(points, mesh), character_positions(request.head, mesh, character), head)
    names = ", ".join(curve.name for curve in points.curves)
    notes = [f"{request.landmarks}: curves are left out, since the built-in face has none: {names}"] if names else []
    return Landmarks.of_points(points.names, on_head, on_kit, mesh.name, "face"), notes


def face_shapes(
    bodies: Bodies, mouth: Mouth, carried: Mapping[str, FloatArray], names: Sequence[str]
) -> dict[str, FloatArray]:
    """Shapes of the built-in face on the head, by name, without new collisions.

    ``carried``: all shapes of the built-in face, by `body_shapes`.

    Eyeballs in its mesh stay: rigid pieces that shapes around the eyes, of all in the kit, move furthest. Upper teeth
    in its mesh stay too, lower ones follow the jaw.
    mouthClose corrects jawOpen: its collisions are those of both, and without jawOpen it stays as carried.
    """
    rows, mesh = bodies.rows(0), bodies.ready[0].mesh
    triangles = fan_triangles(mesh.face_offsets, mesh.face_indices)[0]
    forward, amounts = BodyFrames(bodies.result.point_map).rotation[2], dict.fromkeys(names, 1.0)
    shapes = {name: carried[name][rows] for name in names}
    for name in shapes.keys() - {"mouthClose"}:
        shapes[name] = move_apart(mesh.positions, mesh.positions + shapes[name], triangles, forward) - mesh.positions
    if shapes.keys() >= {"mouthClose", "jawOpen"}:
        opened = mesh.positions + shapes["jawOpen"]
        shapes["mouthClose"] = move_apart(mesh.positions, opened + shapes["mouthClose"], triangles, forward) - opened
    shapes = {name: bodies.on_target(offsets) for name, offsets in shapes.items()}
    places, loose = bodies.given[0].mesh.positions, bodies.ready[0].vertex_of < 0
    if loose.any():
        means = _root_means(bodies.given[0].mesh, loose, places[~loose])
        of_loose = {name: means @ offsets[loose] for name, offsets in shapes.items()}
        for name, offsets in turn_lashes(bodies, places[loose], means, of_loose, shapes, amounts).items():
            shapes[name][loose] = offsets
    for piece in rigid_pieces(bodies, _EYES):
        shifts = {name: np.linalg.norm(offsets[piece], axis=1).max() for name, offsets in carried.items()}
        if max(shifts, key=shifts.__getitem__).startswith(_AROUND_EYES):
            for offsets in shapes.values():
                offsets[piece] = 0.0
    in_mouth, of_mouth = mouth.shapes(bodies.given[0].mesh, amounts)
    in_mouth &= loose  # an island of the skin between UV seams is no tooth
    return {name: np.where(in_mouth[:, None], of_mouth.get(name, 0.0), offsets) for name, offsets in shapes.items()}


def _root_means(mesh: ControlMesh, rows: NDArray[np.bool_], skin: FloatArray) -> sparse.csr_array:
    """Means over the roots of some vertices (n,) of a mesh, see `root_means`; ``skin`` (k, 3) are vertices."""
    points = mesh.positions[rows]
    return root_means(points, vertex_pieces(mesh)[rows], np.asarray(cKDTree(skin).query(points)[0]))


def _amount(own: FloatArray, carried: FloatArray) -> float:
    """Weight at which the built-in face's shape is most like the head's own one; at least 0."""
    return max(0.0, float((own * carried).sum() / ((carried**2).sum() or 1.0)))


def _other_parts(
    character: Character,
    body: Part,
    bodies: Bodies,
    mouth: Mouth,
    shapes: Mapping[str, FloatArray],
    amounts: Mapping[str, float],
) -> list[tuple[Part, Part]]:
    """Lashes, brows, beards and what is in the mouth, as given and with the head's ``shapes`` that move them.

    ``amounts``: how much of its motion in the built-in face each shape has.
    """
    others = [part for part in character.parts if part is not body]
    hairs = [part for part in others if passenger_word(part.name) in HAIRS]
    surface, skin = bodies.result.point_map.target, bodies.skin(None, shapes)
    made = dict(zip(hairs, with_nearest_values(hairs, skin, [[] for _ in hairs], surface, None), strict=True))
    for part in others:
        if passenger_word(part.name) == "lash":
            new = {name: offsets for name, offsets in made[part].shapes.items() if name not in part.shapes}
            means = _root_means(part.mesh, np.ones(part.mesh.n_vertices, dtype=bool), skin.mesh.positions)
            new = turn_lashes(bodies, part.mesh.positions, means, new, skin.shapes, amounts)
            made[part] = replace(made[part], shapes=made[part].shapes | new)
        if part not in made:
            moved = {name: offsets for name, offsets in mouth.shapes(part.mesh, amounts)[1].items() if offsets.any()}
            made[part] = replace(part, shapes={**moved, **part.shapes})
    return [(part, made[part]) for part in others if made[part].shapes.keys() > part.shapes.keys()]


def _on_body(shapes: dict[str, FloatArray], head: Part, body: Part) -> dict[str, FloatArray]:
    """Shapes of a head as shapes of the whole body; 0 outside the head."""
    if head is body:
        return shapes
    number = numbers_on_part(head.mesh, body.mesh)
    return {name: np.where((number >= 0)[:, None], offsets[number], 0.0) for name, offsets in shapes.items()}


def contact_sheet(character: Character, shapes: Sequence[str], head: Part, turn: FloatArray) -> Image:
    """Pictures of shapes, in rows, after a picture of the face at rest.

    mouthClose corrects jawOpen and is shown with it.

    ``head``: the part that the camera frames.
    ``turn``: (3, 3) rotation of rows from a face with +Y up that looks to +Z. Returns (h, w, 3) uint8.
    """
    meshes = [part.mesh for part in character.parts]
    starts = np.cumsum([0, *(mesh.n_vertices for mesh in meshes)])
    triangles = np.concatenate(
        [fan_triangles(m.face_offsets, m.face_indices)[0] + start for m, start in zip(meshes, starts, strict=False)]
    )
    rest = np.concatenate([mesh.positions for mesh in meshes])
    camera = frame(head.mesh.positions @ turn.T, _VIEW, aspect=1.0)
    cells = []
    for shape in (None, *shapes):
        places = rest.copy()
        if shape is not None:
            names = ("jawOpen", shape) if shape == "mouthClose" else (shape,)
            for start, end, part in zip(starts, starts[1:], character.parts, strict=False):
                places[start:end] += sum(part.shapes.get(name, 0.0) for name in names)
        model = Model(places @ turn.T, triangles)
        cells.append(render(model, Skin(), camera, width=_PIXELS, height=_PIXELS, floor=False))
    blank = np.full_like(cells[0], 255)
    cells += [blank] * (-len(cells) % min(_COLUMNS, len(cells)))
    width = min(_COLUMNS, len(cells))
    return np.concatenate([np.concatenate(cells[i : i + width], axis=1) for i in range(0, len(cells), width)])
