"""`cagemap rig`: rig, texture, dress and animate a body like a character, and write one file."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.character.passenger_pieces import PassengerKind
from cagemap.character.poses import example_times, fit_rotation_and_scale, pose_at
from cagemap.character.roles import find_body
from cagemap.character.values import Character, Part, skinned_positions
from cagemap.errors import ParameterError, values_of
from cagemap.files.atomic import all_or_nothing, check_outputs
from cagemap.files.gltf.character import character_of, read_animations, with_starts_at_zero
from cagemap.files.gltf.document import GLTF_SUFFIXES, SCENE_SUFFIXES, read_document, write_document
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.expressions import with_scaled_lengths
from cagemap.files.gltf.nodes import read_nodes
from cagemap.files.gltf.parts import Scene, read_scene
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import with_materials_of
from cagemap.files.gltf.write import character_glb
from cagemap.files.images.image import png_bytes
from cagemap.files.inner_texture import color_image, material_document
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.files.meshes.formats import read_mesh, read_whole, referred_files
from cagemap.files.result.manifest import doubt_message
from cagemap.files.text import require_suffix
from cagemap.files.usd.character import write_usd_character
from cagemap.files.usd.convert import document_and_character
from cagemap.files.usd.space import similar_space
from cagemap.files.usd.stages import USD_SUFFIXES, is_usd, usd_modules
from cagemap.mesh import ControlMesh, Plain
from cagemap.mesh.cage_points import CagePoints, NamedPoints, on_cage
from cagemap.mesh.checks import check_mesh
from cagemap.mesh.curves import Curve, CurvePair
from cagemap.mesh.landmarks import Landmarks, check_landmarks
from cagemap.mesh.mesh_report import count_noun, first_few
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.report import CarriedData, CarriedItem, Weights, check_page_path, write_report
from cagemap.tasks.carry_character import CarriedCharacter, carry_character, with_part, with_shape_weights
from cagemap.tasks.match_summary import body_warnings
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.options import comma_words, files_read
from cagemap.tasks.requests.rig import RigRequest
from cagemap.tasks.rig_checks import pose_warning, size_warning, split_body_warning, up_warning
from cagemap.tasks.rig_materials import (
    BakedImages,
    with_baked_materials,
    with_carried_colors,
    with_own_materials,
    with_uvs_in_unit_square,
)

_log = logging.getLogger(__name__)


def run_rig(request: RigRequest, stages: Stages) -> SummaryAndWarnings:
    """Carry a whole character to another body and write one file; returns a summary and warnings."""
    _require_paths(request)
    stages("read")
    document, given_source = read_body(request.like)
    assert document is not None  # `_require_paths` refuses meshes alone
    without_skin = given_source.rig is None
    source = character_of(document, props=True) if is_usd(request.like) or without_skin else given_source
    body_document, target = read_body(request.body)
    to, of = (
        character_body(target, request.body_part, request.body),
        character_body(source, request.like_part, request.like),
    )
    bodies = (request.body, target, to), (request.like, source, of)
    notes = [note for path, character, body in bodies for note in split_body_warning(path, character, body)]
    notes += pose_warning(*bodies[0])
    landmarks, landmark_notes = _landmarks(request, (to, of), (target, given_source))
    keeps = request.keep_textures or of.mesh.face_materials is None
    laid_out = to.mesh
    if not keeps and of.mesh.uvs is not None and document.json.get("images"):
        if not to.mesh.has_layout:
            stages("unwrap")
        laid_out = with_uvs_in_unit_square(to.mesh)
    target, to = _with_mesh(target, to, replace(laid_out, name=request.body.name))
    source, of = _with_mesh(source, of, replace(of.mesh, name=request.like.name))
    carried = carry_character(
        target,
        source,
        landmarks,
        bodies=(to.name, of.name),
        passengers=_names(request.passengers),
        kinds=_kinds(request),
        influences=request.influences or None,
        taken=set(read_nodes(document).names) - {part.name for part in source.parts},
        subdivided=is_usd(request.output),
        answer=request.answer,
        stages=stages,
    )
    notes += landmark_notes
    if of.weights is None and not without_skin:
        notes.append(
            f"{of.name} has no weights, so the body does not move with the skeleton: export the character with the "
            "weights of its body, or choose a part that has weights as the body (rig: --like-part)"
        )
    notes += carried.notes
    stages("textures")
    dressed, document = with_own_materials(carried, document, body_document, body=keeps)
    baked = BakedImages()
    bare = to.mesh.face_materials is None and of.mesh.vertex_colors is not None and not request.keep_textures
    if bare or not keeps:
        dressed = replace(dressed, parts=(with_carried_colors(carried, dressed.parts[0], of), *dressed.parts[1:]))
    if not keeps:
        dressed, document, baked, baking_notes = with_baked_materials(
            replace(carried, character=dressed), source, of, document, request.size
        )
        notes += baking_notes
    elif request.size is not None:
        notes.append(f"--size is not used: {of.name} of {request.like} has no material whose textures could be baked")
    if source.rig is not None and dressed.rig is not None:
        pairs = {joint: joint for joint in range(len(source.rig.names))}
        document = with_scaled_lengths(document, fit_rotation_and_scale(source.rig, dressed.rig, pairs)[1])
    stages("write")
    images = {slot: png_bytes(image) for slot, (_, image) in baked.items()}
    pieces_of = {part.name: of.name for part in carried.passengers if part not in source.parts}
    for part in dressed.parts[1 : len(dressed.parts) - len(carried.passengers)]:  # own parts that got shapes
        giver = max(source.parts, key=lambda one: len(one.shapes.keys() & part.shapes.keys()))
        if giver.shapes.keys() & part.shapes.keys():
            pieces_of[part.name] = giver.name
    dressed = with_shape_weights(dressed, source, pieces_of)
    rigged_document = character_glb(dressed, document, images, pieces_of)
    if request.report is not None:
        stages("report")
    with all_or_nothing():
        inputs = request.body, request.like
        notes += write_character(request.output, dressed, rigged_document, inputs, force=request.force)
        if request.report is not None:
            _write_report(request.report, carried, source, of, baked, force=request.force)
    stages.record(_figures(dressed) | {"trusted_area": carried.result.quality.trusted_area})
    notes += body_warnings(carried.result)
    if not doubt_message(carried.result.manifest):
        notes += up_warning(carried.result.point_map, request.body)
    notes += size_warning(carried.result, request.body, request.like)
    return _summary(request, dressed), notes


def _require_paths(request: RigRequest) -> None:
    if request.keep_textures and request.size is not None:
        raise ParameterError(
            "--size: expected without --keep-textures, which bakes no textures. Leave one of them out."
        )
    require_suffix(request.like, (*SCENE_SUFFIXES, *USD_SUFFIXES), "a character file", "Export it as GLB.")
    require_output(request.output)
    outputs = [request.output, *([] if request.report is None else [request.report])]
    if request.report is not None:
        check_page_path(request.report)
    check_outputs(outputs, files_read(request, "report"), force=request.force)


def require_output(path: Path) -> None:
    """Refuse a file name that `write_character` cannot write."""
    require_suffix(path, (*GLTF_SUFFIXES, *USD_SUFFIXES), remedy="Name it .glb.")
    if is_usd(path):
        usd_modules()


def write_character(
    path: Path, character: Character, document: Document, inputs: Sequence[Path], *, force: bool
) -> list[str]:
    """Write a character as glTF, or as USD in the space of the first input if that is USD; returns notes.

    In glTF every animation is moved to start at 0.

    ``document``: of the character, by `character_glb`.
    ``inputs``: files that it was made from; their images are not replaced.
    """
    scene = _readable_scene(document, character)
    if is_usd(path):
        space = similar_space(inputs[0]) if is_usd(inputs[0]) else None
        kept = {file.resolve() for one in inputs for file in referred_files(one)}
        return write_usd_character(path, character, scene, space=space, kept=kept, force=force)
    document, starts = with_starts_at_zero(document)
    write_document(path, document, force=force)
    notes = []
    if starts:
        late = first_few([f"{name} (from {start:.3g} s)" for name, start in starts.items()])
        notes.append(f"animations moved to start at 0 in {path.name}, as programs expect: {late}")
    is_vrm = bool({"VRM", "VRMC_vrm"} & set(document.json.get("extensions", ())))
    if path.suffix.lower() == ".vrm" and not is_vrm:
        notes.append(f"{path} has no VRM data, since {inputs[-1]} has none: programs for VRM refuse it. Name it .glb")
    return notes


def read_body(path: Path) -> tuple[Document | None, Character]:
    """A glTF, FBX or USD file as document and character, in metres with Y up; another file as images and mesh."""
    if is_usd(path):
        return document_and_character(path)
    if path.suffix.lower() in SCENE_SUFFIXES:
        document = read_document(path)
        return document, character_of(document)
    mesh = read_mesh(path)
    if problems := check_mesh(mesh).problems:  # a plain mesh is repaired
        kinds = ", ".join(problem.kind for problem in problems)
        _log.warning(
            "%s: matched as a plain mesh, since it is no control mesh: %s; `cagemap check` says where", path, kinds
        )
        mesh = replace(mesh, scheme=Plain())
    part = Part(path.stem, mesh)
    return _document_of_images(path, part), Character((part,))


def _document_of_images(path: Path, part: Part) -> Document | None:
    """A glTF document of an OBJ or PLY file: its mesh, and its materials with images; None without images."""
    materials, mesh = material_document(path, part.mesh), part.mesh
    if materials is None:
        return None
    known = material_names(materials)
    names = [name for name in mesh.material_names if name in known and color_image(materials, name) is not None]
    if not names:
        return None
    bare = replace(mesh, face_materials=None, material_names=(), material_colors=None)
    return with_materials_of(character_glb(Character((replace(part, mesh=bare),))), materials, names)[0]


def character_body(character: Character, name: str | None, path: Path) -> Part:
    """The body of a file's character; errors name the file."""
    with values_of(path):
        return find_body(character.parts, name)


def _with_mesh(character: Character, part: Part, mesh: ControlMesh) -> tuple[Character, Part]:
    """The character with a part's mesh replaced, and the new part."""
    new_part = replace(part, mesh=mesh)
    return with_part(character, part, new_part), new_part


def _landmarks(
    request: RigRequest, bodies: tuple[Part, Part], characters: tuple[Character, Character]
) -> tuple[Landmarks, tuple[str, ...]]:
    """Landmarks and curves of the files' meshes as points of the two bodies; and notes.

    ``characters``: as `read_body` reads them.
    """
    if request.landmarks is None:
        return Landmarks.none(), ()
    meshes = read_whole(request.body), read_whole(request.like)
    given, notes = read_landmarks(request.landmarks, request.body, request.like)
    check_landmarks(given, *meshes)
    files = request.body, request.like
    places = [character_positions(*side) for side in zip(files, meshes, characters, strict=True)]

    def on_bodies(target: CagePoints, source: CagePoints) -> list[CagePoints]:
        return [points_on_body(*side) for side in zip((target, source), places, bodies, strict=True)]

    points = on_bodies(given.target_points, given.source_points)
    curves = []
    for pair in given.curves:
        target, source = on_bodies(*pair.points)
        curves.append(CurvePair(pair.name, Curve(target, pair.target.closed), Curve(source, pair.source.closed)))
    names = given.target_name, given.source_name
    return Landmarks.of_points(given.names, points[0], points[1], *names, tuple(curves)), notes


def points_on_body(points: CagePoints, places: FloatArray, body: Part) -> CagePoints:
    """Points of a file's mesh, whose vertices are at ``places``, as the closest points of a body."""
    count = len(points.corners)
    names, vertices = tuple(f"point {row}" for row in range(count)), np.full(count, -1, dtype=np.int64)
    return on_cage(NamedPoints(names, vertices, points.of(places)), body.mesh)


def character_positions(path: Path, mesh: ControlMesh, character: Character) -> FloatArray:
    """(n, 3) vertex positions of a mesh file in the space of `read_body`: USD in the bind pose, in metres with Y up.

    ``character``: as `read_body` reads the file.
    """
    if not is_usd(path):
        return mesh.positions
    return np.concatenate([part.mesh.positions for part in character.parts])


def _names(words: str | None) -> list[str] | None:
    return None if words is None else [] if words == "none" else comma_words(words)


def _kinds(request: RigRequest) -> dict[str, PassengerKind]:
    rigid, cloth = _names(request.rigid) or [], _names(request.cloth) or []
    both = [name for name in rigid if name in cloth]
    if both:
        raise ParameterError(
            f"--rigid and --cloth: expected each passenger in one of them, got {', '.join(both)} twice"
        )
    kinds: dict[str, PassengerKind] = dict.fromkeys(rigid, "rigid")
    return kinds | dict.fromkeys(cloth, "cloth")


def _readable_scene(document: Document, character: Character) -> Scene:
    """A document as a scene; requires that all parts and animations of the character can be read back."""
    scene = read_scene(document)
    read_animations(scene)
    names = {one.part.name for one in scene.parts}
    missing = [part.name for part in character.parts if part.name not in names]
    if missing:
        raise AssertionError(f"parts that cannot be read back: {missing}")
    return scene


def _write_report(
    path: Path, carried: CarriedCharacter, source: Character, of: Part, baked: BakedImages, *, force: bool
) -> None:
    """Write a page with both dressed bodies, and poses of the first animation."""
    character, result = carried.character, carried.result
    body, dressed = character.parts[0], character.parts[len(character.parts) - len(carried.passengers) :]
    rows = carried.rows
    weights = None
    if of.weights is not None and body.weights is not None:
        weights = Weights(of.weights[rows[1]].toarray(), body.weights[rows[0]].toarray())
    shown = CarriedData(
        weights=weights,
        shapes=tuple(
            CarriedItem(name, offsets[rows[1]], body.shapes[name][rows[0]]) for name, offsets in of.shapes.items()
        ),
        passengers=tuple(
            CarriedItem(source_part.name, source_part.mesh, carried_part.mesh)
            for source_part, carried_part in zip(carried.passengers, dressed, strict=True)
        ),
        poses=tuple(_poses(source, character, (of, body), (rows[1], rows[0]))),
    )
    colors = next((images for (_, slot), images in baked.items() if slot == "baseColorTexture"), None)
    pictures = (None, None) if colors is None else (colors[0].pixels, colors[1].pixels)
    write_report(path, result, texture=pictures[0], baked=pictures[1], carried=shown, force=force)


def _poses(
    source: Character, made: Character, bodies: tuple[Part, Part], rows: tuple[IndexArray, IndexArray]
) -> Iterator[CarriedItem[FloatArray]]:
    """Poses of both bodies at a quarter, half and three quarters of the first animation, by the time from its start."""
    if source.rig is None or made.rig is None or not source.animations or not source.animations[0].tracks:
        return
    pair = source.animations[0], made.animations[0]
    start, times = example_times(pair[0])
    for time in times:
        both = [
            skinned_positions(body, rig, pose_at(rig, animation, time))[body_rows]
            for body, rig, animation, body_rows in zip(bodies, (source.rig, made.rig), pair, rows, strict=True)
        ]
        yield CarriedItem(f"{pair[0].name}, {time - start:.3g} s", both[0], both[1])


def _figures(character: Character) -> dict[str, Any]:
    """Figures of a character whose first part is its body."""
    body, *others = character.parts
    return {
        "vertices": body.mesh.n_vertices,
        "joints": 0 if character.rig is None else len(character.rig.names),
        "animations": [animation.name for animation in character.animations],
        "shapes": list(body.shapes),
        "passengers": [part.name for part in others],
    }


def _summary(request: RigRequest, character: Character) -> str:
    body, *others = character.parts
    lines = [f"wrote {request.output}: {request.body.name} like {request.like.name}"]
    counts = [] if character.rig is None else [count_noun(len(character.rig.names), "joint")]
    counts += [count_noun(len(character.animations), "animation")] if character.animations else []
    lines += [f"  {', '.join(counts)}"] if counts else []
    shapes = f", {count_noun(len(body.shapes), 'shape')}" if body.shapes else ""
    lines.append(f"  body: {count_noun(body.mesh.n_vertices, 'vertex')}{shapes}")
    if others:
        lines.append(f"  with it: {', '.join(part.name for part in others)}")
    if request.report is not None:
        lines.append(f"Open {request.report} in a browser.")
    return "\n".join(lines)
