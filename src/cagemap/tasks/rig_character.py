"""`cagemap rig`: rig, texture, dress and animate a body like a character, and write one file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cagemap.character.passenger_pieces import PassengerKind
from cagemap.character.poses import pose_at
from cagemap.character.roles import find_body
from cagemap.character.values import Character, Part, skinned_positions
from cagemap.errors import FormatError, ParameterError
from cagemap.files.atomic import all_or_nothing, check_outputs
from cagemap.files.gltf.character import character_of, read_animations
from cagemap.files.gltf.document import GLTF_SUFFIXES, SCENE_SUFFIXES, read_document, write_document
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.material_images import (
    MaterialImage,
    material_images,
    png_bytes,
    read_material_image,
    with_copied_materials,
)
from cagemap.files.gltf.parts import Scene, read_scene
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import with_materials_of
from cagemap.files.gltf.write import character_glb
from cagemap.files.images.image import Image
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.files.meshes.formats import read_mesh, read_whole, referred_files
from cagemap.files.usd.character import write_usd_character
from cagemap.files.usd.convert import document_and_character
from cagemap.files.usd.space import similar_space
from cagemap.files.usd.stages import USD_SUFFIXES, is_usd, usd_modules
from cagemap.maps.hypotheses.confidence import SURE
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import CagePoints, NamedPoints, on_cage
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.curves import Curves
from cagemap.mesh.faces import face_centres
from cagemap.mesh.landmarks import Landmarks, check_landmarks
from cagemap.mesh.mesh_report import count_noun
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.report import CarriedData, CarriedShape, Passenger, Pose, Weights, check_page_path, write_report
from cagemap.surface.triangles import fan_triangles
from cagemap.tasks.carry_arrays import carry_values
from cagemap.tasks.carry_character import CarriedCharacter, carry_character, nearest, with_part
from cagemap.tasks.progress import Outcome, Stages
from cagemap.tasks.requests.options import comma_words
from cagemap.tasks.requests.rig import RigRequest
from cagemap.transfer import Transfer, bake_texture, prepare_transfer, pull_back_faces, tile_cells, unwrap
from cagemap.transfer.vectors import bake_normal_map

_DOUBT = "the bodies may be matched wrongly: look at the result, and give --landmarks where it is wrong"


def run_rig(request: RigRequest, stages: Stages) -> Outcome:
    """Carry a whole character to another body and write one file; returns a summary and warnings."""
    _require_paths(request)
    stages("read")
    document, given_source = read_body(request.like)
    assert document is not None  # `_require_paths` refuses meshes alone
    source = character_of(document) if is_usd(request.like) else given_source
    body_document, target = read_body(request.body)
    to, of = body_in(target, request.body_part, request.body), body_in(source, request.like_part, request.like)
    landmarks = _landmarks(request, (to, of), (target, given_source))
    keeps = request.keep_textures or of.mesh.face_materials is None
    laid_out = to.mesh if keeps or of.mesh.uvs is None else _in_one_square(to.mesh)
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
        stages=stages,
    )
    stages("textures")
    dressed, document = _with_own_materials(carried, document, body_document, body=keeps)
    baked, notes = _Images(), list[str]()
    if not request.keep_textures and not (keeps and of.mesh.vertex_colors is None):
        dressed = replace(dressed, parts=(_colored(carried, dressed.parts[0], of), *dressed.parts[1:]))
    if not keeps:
        dressed, document, baked, notes = _textured(
            replace(carried, character=dressed), source, of, document, request.size
        )
    elif request.size is not None:
        notes.append(f"--size is not used: {of.name} of {request.like} has no material whose textures could be baked")
    stages("write")
    rigged_document = character_glb(dressed, document, {slot: png_bytes(image) for slot, (_, image) in baked.items()})
    if request.report is not None:
        stages("report")
    with all_or_nothing():
        inputs = request.body, request.like
        notes += write_character(request.output, dressed, rigged_document, inputs, force=request.force)
        if request.report is not None:
            _write_report(request.report, carried, source, of, baked, force=request.force)
    confidence = carried.result.confidence
    doubt = [] if confidence is None or confidence.verdict == SURE else [_DOUBT]
    return _summary(request, dressed), [*carried.notes, *notes, *doubt]


def _require_paths(request: RigRequest) -> None:
    if request.keep_textures and request.size is not None:
        raise ParameterError(
            "--size: expected without --keep-textures, which bakes no textures. Leave one of them out."
        )
    _require_suffix(request.like, "the character", (*SCENE_SUFFIXES, *USD_SUFFIXES), "Export it as GLB")
    require_output(request.output)
    inputs = [request.body, request.like, *([] if request.landmarks is None else [request.landmarks])]
    outputs = [request.output, *([] if request.report is None else [request.report])]
    if request.report is not None:
        check_page_path(request.report)
    check_outputs(outputs, inputs, force=request.force)


def require_output(path: Path) -> None:
    """Refuse a file name that `write_character` cannot write."""
    _require_suffix(path, "the file to write", (*GLTF_SUFFIXES, *USD_SUFFIXES), "Name it .glb")
    if is_usd(path):
        usd_modules()


def _require_suffix(path: Path, what: str, suffixes: tuple[str, ...], remedy: str) -> None:
    if path.suffix.lower() not in suffixes:
        raise FormatError(f"{path}: expected {what} as {', '.join(suffixes)}, got '{path.suffix}'. {remedy}.")


def write_character(
    path: Path, character: Character, document: Document, inputs: Sequence[Path], *, force: bool
) -> list[str]:
    """Write a character as glTF, or as USD in the space of the first input if that is USD; returns notes.

    ``document``: of the character, by `character_glb`.
    ``inputs``: files that it was made from; their images are not replaced.
    """
    scene = _readable_scene(document, character)
    if is_usd(path):
        space = similar_space(inputs[0]) if is_usd(inputs[0]) else None
        kept = {file.resolve() for one in inputs for file in referred_files(one)}
        return write_usd_character(path, character, scene, space=space, kept=kept, force=force)
    write_document(path, document, force=force)
    return []


def read_body(path: Path) -> tuple[Document | None, Character]:
    """A glTF, FBX or USD file as document and character, in metres with Y up; another file's mesh as a character."""
    if is_usd(path):
        return document_and_character(path)
    if path.suffix.lower() in SCENE_SUFFIXES:
        document = read_document(path)
        return document, character_of(document)
    return None, Character((Part(path.stem, read_mesh(path)),))


def body_in(character: Character, name: str | None, path: Path) -> Part:
    """The body of a file's character; errors name the file."""
    try:
        return find_body(character.parts, name)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None


def _with_mesh(character: Character, part: Part, mesh: ControlMesh) -> tuple[Character, Part]:
    """The character with a part's mesh replaced, and the new part."""
    new_part = replace(part, mesh=mesh)
    return with_part(character, part, new_part), new_part


def _landmarks(request: RigRequest, bodies: tuple[Part, Part], characters: tuple[Character, Character]) -> Landmarks:
    """Landmarks and curves of the files' meshes as points of the two bodies.

    ``characters``: as `read_body` reads them.
    """
    if request.landmarks is None:
        return Landmarks.none()
    meshes = read_whole(request.body), read_whole(request.like)
    given, _ = read_landmarks(request.landmarks, request.body, request.like)
    check_landmarks(given, *meshes)
    (target, source), files = bodies, (request.body, request.like)
    places = [character_positions(*side) for side in zip(files, meshes, characters, strict=True)]
    points = (
        points_on_body(given.target_points, places[0], target),
        points_on_body(given.source_points, places[1], source),
    )
    curves = (
        replace(given.curves.target, points=points_on_body(given.curves.target.points, places[0], target)),
        replace(given.curves.source, points=points_on_body(given.curves.source.points, places[1], source)),
    )
    landmarks = Landmarks.of_points(given.names, *points, given.target_name, given.source_name)
    return replace(landmarks, curves=Curves(given.curves.names, *curves))


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


def _in_one_square(mesh: ControlMesh) -> ControlMesh:
    """A mesh with UVs in the unit square, as glTF needs: unwrapped, or with its tiles side by side.

    The UVs in tiles are kept as a second set, further sets follow.
    """
    if mesh.uvs is None or mesh.uv_indices is None:
        return unwrap(mesh)
    corners, faces = fan_triangles(mesh.face_offsets, np.arange(len(mesh.face_indices)))
    cells = np.zeros((mesh.n_faces, 2))
    cells[faces] = tile_cells(mesh.uvs[mesh.uv_indices[corners]])
    tiles, number = np.unique(cells, axis=0, return_inverse=True)
    if not tiles.any():
        return mesh
    side = int(np.ceil(np.sqrt(len(tiles))))
    shift = np.column_stack([np.arange(len(tiles)) % side, np.arange(len(tiles)) // side]) - tiles
    of_corner = np.repeat(number.ravel(), mesh.face_sizes)
    keys, indices = np.unique(np.column_stack([mesh.uv_indices, of_corner]), axis=0, return_inverse=True)
    before = UvSet(mesh.uv_name, mesh.uvs, mesh.uv_indices), *mesh.uv_sets
    others = tuple(replace(one, name=f"TEXCOORD_{number}") for number, one in enumerate(before, 1))
    packed = mesh.with_uvs((mesh.uvs[keys[:, 0]] + shift[keys[:, 1]]) / side, indices.ravel().astype(np.int64))
    return replace(packed, uv_name="TEXCOORD_0", uv_sets=others)


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


def _with_own_materials(
    carried: CarriedCharacter, document: Document, given: Document | None, *, body: bool
) -> tuple[Character, Document]:
    """The character and document with own materials of the target's parts; ``body``: of its body too."""
    parts = list(carried.character.parts)
    own_parts = range(0 if body else 1, len(parts) - len(carried.passengers))
    known = () if given is None else material_names(given)
    names = dict.fromkeys(name for number in own_parts for name in parts[number].mesh.material_names if name in known)
    if given is None or not names:
        return carried.character, document
    document, new = with_materials_of(document, given, list(names))
    for number in own_parts:
        mesh = parts[number].mesh
        words = tuple(new.get(name, name) for name in mesh.material_names)
        parts[number] = replace(parts[number], mesh=replace(mesh, material_names=words))
    return replace(carried.character, parts=tuple(parts)), document


# An image of the character's body, and the image baked into the target body's layout; by material and slot.
_Images = dict[tuple[str, str], tuple[Image, Image]]


def _textured(
    carried: CarriedCharacter, source: Character, of: Part, document: Document, size: int | None
) -> tuple[Character, Document, _Images, list[str]]:
    """Character and document with the source body's materials, their baked images, and notes."""
    result, (body, *others) = carried.result, carried.character.parts
    source_mesh = of.mesh
    assert source_mesh.face_materials is not None
    notes = []
    others_use = {name for part in source.parts if part is not of for name in part.mesh.material_names}
    copies = {name: f"{name} {of.name}" if name in others_use else name for name in source_mesh.material_names if name}
    if body.mesh.material_names and any(body.mesh.material_names):
        notes.append(
            f"the body's own materials ({', '.join(body.mesh.material_names)}) give way to the character's; "
            "--keep-textures keeps them"
        )
    transfer = _transfer(result, result.source.control)
    mesh = replace(
        body.mesh,
        face_materials=_carried_materials(result, transfer, body.mesh),
        material_names=tuple(copies.get(name, name) for name in source_mesh.material_names),
        material_colors=source_mesh.material_colors,
    )
    images = {}
    for name, copy in copies.items():
        for material_image in material_images(document, name):
            images[copy, material_image.slot] = _baked(material_image, document, result, size)
    dressed = replace(carried.character, parts=(replace(body, mesh=mesh), *others))
    return dressed, with_copied_materials(document, list(copies.items())), images, notes


def _colored(carried: CarriedCharacter, body: Part, of: Part) -> Part:
    """The body with the source body's vertex colours, or without: glTF multiplies them with the texture."""
    result, colors = carried.result, of.mesh.vertex_colors
    if colors is not None:
        colors = np.asarray(carry_values(result, colors[carried.rows[1]], "vertices"))
        colors = colors[nearest(result.target.control.positions, body.mesh.positions)]
    return replace(body, mesh=replace(body.mesh, vertex_colors=colors))


def _transfer(result: MatchResult, source: ControlMesh, uvs: FloatArray | None = None) -> Transfer:
    """The match prepared for bakes, with other texture coordinates of the source."""
    level, target = result.source.refinement.finest, result.target.refinement
    if uvs is not None and source.uv_indices is not None:
        layout = uvs, source.uv_indices.reshape(level.n_faces, -1)
        level = replace(level, lay=lambda: layout)
    return prepare_transfer(target.finest, level, result.point_map, result.masks, target.holes(target.n_levels))


def _carried_materials(result: MatchResult, transfer: Transfer, mesh: ControlMesh) -> IndexArray:
    """Carried material of every face of the body; unmatched pieces take the nearest face's material."""
    matched, source = result.target.control, result.source.control
    assert source.face_materials is not None
    materials = pull_back_faces(transfer, source.face_materials, n_target_faces=matched.n_faces)
    return np.asarray(materials[nearest(face_centres(matched), face_centres(mesh))])


def _baked(found: MaterialImage, document: Document, result: MatchResult, size: int | None) -> tuple[Image, Image]:
    image = read_material_image(document, found)
    source = result.source.control.with_uv_set(found.uv_set)
    assert source.uvs is not None
    pixels, uvs = found.repeating(image.pixels, found.on_image(source.uvs))
    transfer = _transfer(result, source, uvs)
    height, width = image.size if size is None else (size, size)
    bake = bake_normal_map if found.is_normal_map and pixels.shape[2] >= 3 else bake_texture
    return image, replace(image, pixels=bake(transfer, pixels, size=(height, width)), channel_names=())


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
    path: Path,
    carried: CarriedCharacter,
    source: Character,
    of: Part,
    baked: _Images,
    *,
    force: bool,
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
            CarriedShape(name, offsets[rows[1]], body.shapes[name][rows[0]]) for name, offsets in of.shapes.items()
        ),
        passengers=tuple(
            Passenger(source_part.name, source_part.mesh, carried_part.mesh)
            for source_part, carried_part in zip(carried.passengers, dressed, strict=True)
        ),
        poses=tuple(_poses(source, character, (of, body), (rows[1], rows[0]))),
    )
    colors = next((images for (_, slot), images in baked.items() if slot == "baseColorTexture"), None)
    pictures = (None, None) if colors is None else (colors[0].pixels, colors[1].pixels)
    write_report(path, result, texture=pictures[0], baked=pictures[1], carried=shown, force=force)


def _poses(
    source: Character, made: Character, bodies: tuple[Part, Part], rows: tuple[IndexArray, IndexArray]
) -> Iterator[Pose]:
    """Poses of both bodies at a quarter, half and three quarters of the first animation."""
    if source.rig is None or made.rig is None or not source.animations or not source.animations[0].tracks:
        return
    pair = source.animations[0], made.animations[0]
    end = max(float(track.times[-1]) for track in pair[0].tracks)
    for share in (0.25, 0.5, 0.75):
        both = [
            skinned_positions(body, rig, pose_at(rig, animation, share * end))[body_rows]
            for body, rig, animation, body_rows in zip(bodies, (source.rig, made.rig), pair, rows, strict=True)
        ]
        yield Pose(f"{pair[0].name}, {share * end:.2g} s", both[0], both[1])


def _summary(request: RigRequest, character: Character) -> str:
    body, *others = character.parts
    lines = [f"wrote {request.output}: {request.body.name} like {request.like.name}"]
    if character.rig is not None:
        tracks = f", {count_noun(len(character.animations), 'animation')}" if character.animations else ""
        lines.append(f"  {count_noun(len(character.rig.names), 'joint')}{tracks}")
    shapes = f", {count_noun(len(body.shapes), 'shape')}" if body.shapes else ""
    lines.append(f"  body: {count_noun(body.mesh.n_vertices, 'vertex')}{shapes}")
    if others:
        lines.append(f"  with it: {', '.join(part.name for part in others)}")
    if request.report is not None:
        lines.append(f"Open {request.report} in a browser.")
    return "\n".join(lines)
