"""Meshes, weights, shapes and skeletons of glTF and FBX files, welded at seams; a list of a file's contents."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cagemap.character.bones import humanoid_joints
from cagemap.character.joints import Skeleton, tails_of
from cagemap.character.roles import find_body
from cagemap.character.values import Rig
from cagemap.errors import FormatError
from cagemap.files.gltf.binary import NGONS
from cagemap.files.gltf.character import animation_lengths, animation_names, humanoid_bones
from cagemap.files.gltf.document import GLTF_SUFFIXES, read_document
from cagemap.files.gltf.entries import Document, image_bytes
from cagemap.files.gltf.parts import Scene, read_scene
from cagemap.files.gltf.primitives import join_offsets, material_names
from cagemap.files.gltf.textures import image_number, texture_slots
from cagemap.files.text import whole_characters
from cagemap.mesh import ControlMesh
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.parts import join_meshes, passenger_word
from cagemap.numerics.arrays import FloatArray

_log = logging.getLogger(__name__)


def read_gltf(path: str | Path) -> ControlMesh:
    """Read the meshes of a ``.glb``, ``.gltf``, ``.vrm`` or ``.fbx`` file as one, in the bind pose in world space.

    Mesh nodes become objects. Vertices that the file splits at seams are welded. They are numbered as by
    `cagemap.files.gltf.character.read_character`, one part after the other. The scheme is ``none``: triangles of glTF
    are the surface itself.
    """
    scene = read_scene(read_document(path))
    for read_part in scene.parts:
        for note in read_part.notes:
            _log.info("%s: %s", path, note)
    return scene_mesh(scene)


def scene_mesh(scene: Scene) -> ControlMesh:
    """All meshes of a scene joined into one, with an object for each."""
    parts = [read_part.part for read_part in scene.parts]
    faces = (np.zeros(part.mesh.n_faces, dtype=np.int64) for part in parts)
    objects = [replace(p.mesh, face_objects=f, object_names=(p.name,)) for p, f in zip(parts, faces, strict=True)]
    joined = join_meshes(objects) if len(parts) > 1 else parts[0].mesh
    return replace(joined, name=scene.document.file.name, file_vertices=None, file_faces=None, file_copies=None)


def left_out_of_gltf(document: Document) -> list[str]:
    """What `read_gltf` leaves out of a document: weights, blend shapes, skins, animations, images of materials."""
    numbers = range(len(document.entries("meshes")))
    primitives = [one for k in numbers for one in document.entries("primitives", document.entry("meshes", k))]
    materials = {one["material"] for one in primitives if "material" in one}
    skins = bool(document.entries("skins"))
    held = {
        "skinning weights": skins,
        "blend shapes": any(document.entries("targets", one) for one in primitives),
        "skeleton": skins,
        "animations": bool(document.entries("animations")),
        "images of materials": any(any(texture_slots(document.entry("materials", one))) for one in materials),
    }
    return [name for name, is_there in held.items() if is_there]


def gltf_weights(path: str | Path) -> FloatArray:
    """Weights (n, j) of the joints of `gltf_skeleton` at the vertices of `read_gltf`; 0 on unskinned meshes."""
    scene, rig = _read_rigged_scene(path)
    tables = [
        np.zeros((read_part.part.mesh.n_vertices, len(rig.names)))
        if read_part.part.weights is None
        else read_part.part.weights.toarray()
        for read_part in scene.parts
    ]
    return np.concatenate(tables)


def gltf_shapes(path: str | Path) -> dict[str, FloatArray]:
    """Offsets (n, 3) of blend shapes by name, at the vertices of `read_gltf`; equal names are merged."""
    parts = [read_part.part for read_part in read_scene(read_document(path)).parts]
    return join_offsets([part.shapes for part in parts], [part.mesh.n_vertices for part in parts])


def gltf_skeleton(path: str | Path) -> Skeleton:
    """Joints of all skins in the bind pose; the tail of a joint is at its children."""
    rig = _read_rigged_scene(path)[1]
    parents = tuple(rig.names[parent] if parent >= 0 else "" for parent in rig.parents)
    axes = rig.bind[:, :3, :3] / np.linalg.norm(rig.bind[:, :3, :3], axis=2, keepdims=True)
    return Skeleton(rig.names, parents, rig.heads, tails_of(rig.heads, rig.parents), axes)


def _read_rigged_scene(path: str | Path) -> tuple[Scene, Rig]:
    scene = read_scene(read_document(path))
    if scene.joints is None:
        raise FormatError(f"{path}: expected a mesh with a skin, got none. Export it with its rig.")
    return scene, scene.joints.rig


@dataclass(frozen=True)
class Contents:
    """Summary of a glTF or FBX file."""

    body: str  # the body mesh, by `cagemap.character.roles.find_body`
    passengers: tuple[str, ...]  # all other meshes
    vertices: int  # number of vertices after welding
    stored: int  # number of vertices in a glTF file; 0 for other formats
    joints: int
    body_has_weights: bool
    influences: int  # largest number of joints with weights at a vertex
    humanoid: int  # joints that are humanoid bones, by the table of a VRM or by `humanoid_joints`
    shapes: tuple[str, ...]
    textures: tuple[str, ...]  # material, slot and format
    animations: tuple[tuple[str, float], ...]  # name and seconds
    extensions: tuple[str, ...]  # extensions that are kept unchanged
    welded: tuple[str, ...]  # notes on welded vertices, one for each mesh

    @property
    def is_character(self) -> bool:
        """Whether it has a skeleton, or meshes named as clothes, eyes or the like."""
        return bool(self.joints or any(map(passenger_word, self.passengers)))

    def __str__(self) -> str:
        bones = f", {self.humanoid} of them named as humanoid bones" if self.humanoid else ""
        moving = [f"{name} ({seconds:.3g} s)" for name, seconds in self.animations]
        joints = f"{self.joints} joints{bones}, at most {self.influences} a vertex" if self.joints else ""
        welded = f"{self.vertices}, made of {self.stored} in the file" if self.stored > self.vertices else ""
        skeleton = "is carried, with its weights"
        if not self.body_has_weights:
            skeleton = f"is carried, but {self.body} has no weights, so the body does not move with it"
        rows = (
            ("body", self.body, "is matched"),
            ("passengers", _count_and_names(self.passengers), "ride on the body"),
            ("skeleton", joints, skeleton),
            ("shapes", _count_and_names(self.shapes), "are carried"),
            ("textures", _count_and_names(self.textures), "are baked for the other body"),
            ("animations", _count_and_names(moving), "are retargeted"),
            ("extensions", _count_and_names(self.extensions), "are kept"),
            ("vertices", welded, "copies along seams are welded, so that later vertices have other numbers here"),
        )
        lines = [f"    {name:<12}{held}: {done}" for name, held, done in rows if held]
        return "\n".join(["  holds, and what `cagemap rig` does with it", *lines])


def _count_and_names(names: tuple[str, ...] | list[str]) -> str:
    return f"{len(names)} ({first_few(names)})" if names else ""


def contents_of(scene: Scene) -> Contents:
    """The summary of a file's scene."""
    document = scene.document
    is_gltf = document.file.suffix.lower() in GLTF_SUFFIXES  # in FBX and USD files corners have normals, not vertices
    parts = [read_part.part for read_part in scene.parts]
    body = find_body(parts)
    rig = None if scene.joints is None else scene.joints.rig
    weights = [part.weights for part in parts if part.weights is not None]
    named = [name for name in document.entries("extensionsUsed") if isinstance(name, str) and name != NGONS]
    return Contents(
        body=body.name,
        passengers=tuple(part.name for part in parts if part is not body),
        vertices=sum(part.mesh.n_vertices for part in parts),
        stored=sum(read_part.stored for read_part in scene.parts) if is_gltf else 0,
        joints=0 if rig is None else len(rig.names),
        body_has_weights=body.weights is not None,
        influences=max((int(np.diff(table.indptr).max()) for table in weights), default=0),
        humanoid=len(humanoid_bones(document) or ({} if rig is None else humanoid_joints(rig))),
        shapes=tuple(dict.fromkeys(name for part in parts for name in part.shapes)),
        textures=_textures(document),
        animations=tuple(zip(animation_names(document), animation_lengths(document), strict=True)),
        extensions=tuple(map(whole_characters, named)),
        welded=tuple(note for read_part in scene.parts for note in read_part.notes),
    )


def _image_form(document: Document, image: int) -> str:
    """The format of an image, or that it cannot be read: a match does not need it."""
    try:
        return image_bytes(document, image)[1].removeprefix(".")
    except FormatError:
        uri = str(document.entry("images", image).get("uri", "data:"))
        return "cannot be read" if uri.startswith("data:") else f"cannot be read: {uri}"


def _textures(document: Document) -> tuple[str, ...]:
    """Material, slot and format of every texture."""
    textures = []
    for number, name in enumerate(material_names(document)):
        for slot, holder in texture_slots(document.entry("materials", number)):
            where = f"materials {number}"
            source = image_number(document, document.entry("textures", holder["index"], where), where)
            form = "" if source is None else f" ({_image_form(document, source)})"
            textures.append(f"{name} {slot.removesuffix('Texture')}{form}")
    return tuple(textures)
