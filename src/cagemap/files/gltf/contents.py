"""What a glTF or FBX file holds and what is done with it, in a few lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.character.bones import humanoid_joints
from cagemap.character.roles import find_body, passenger_word
from cagemap.files.gltf.animations import animation_lengths, animation_names
from cagemap.files.gltf.binary import NGONS
from cagemap.files.gltf.character import humanoid_bones
from cagemap.files.gltf.entries import Document, image_bytes
from cagemap.files.gltf.parts import Scene
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import texture_slots
from cagemap.files.text import whole_characters
from cagemap.mesh.mesh_report import first_few


@dataclass(frozen=True)
class Contents:
    """What a glTF or FBX file holds.

    Attributes
    ----------
    body : str
        The mesh that `cagemap.character.roles.find_body` finds.
    passengers : tuple of str
        All other meshes.
    vertices, stored : int
        Vertices after welding, and in the file.
    joints : int
    influences : int
        Joints that move a vertex, at most.
    humanoid : int
        Joints whose names are those of humanoid bones, in a VRM's table or by `humanoid_joints`.
    shapes : tuple of str
    textures : tuple of str
        Material, slot and format.
    animations : tuple of (str, float)
        Name and seconds.
    extensions : tuple of str
        Those that are kept as they are.
    welded : tuple of str
        What was welded, a line for each mesh.
    """

    body: str
    passengers: tuple[str, ...]
    vertices: int
    stored: int
    joints: int
    influences: int
    humanoid: int
    shapes: tuple[str, ...]
    textures: tuple[str, ...]
    animations: tuple[tuple[str, float], ...]
    extensions: tuple[str, ...]
    welded: tuple[str, ...]

    @property
    def is_character(self) -> bool:
        """Whether it has a skeleton, or clothes, eyes and such by their names."""
        return bool(self.joints or any(map(passenger_word, self.passengers)))

    def __str__(self) -> str:
        bones = f", {self.humanoid} of them named as humanoid bones" if self.humanoid else ""
        moving = [f"{name} ({seconds:.3g} s)" for name, seconds in self.animations]
        joints = f"{self.joints} joints{bones}, at most {self.influences} a vertex" if self.joints else ""
        welded = f"{self.vertices}, made of {self.stored} in the file" if self.stored > self.vertices else ""
        rows = (
            ("body", self.body, "is matched"),
            ("passengers", _listed(self.passengers), "ride on the body"),
            ("skeleton", joints, "is carried, with its weights"),
            ("shapes", _listed(self.shapes), "are carried"),
            ("textures", _listed(self.textures), "are baked for the other body"),
            ("animations", _listed(moving), "are retargeted"),
            ("extensions", _listed(self.extensions), "are kept as they are"),
            ("vertices", welded, "copies along seams are welded"),
        )
        lines = [f"    {name:<12}{held}: {done}" for name, held, done in rows if held]
        return "\n".join(["  holds, and what `cagemap rig` does with it", *lines])


def _listed(names: tuple[str, ...] | list[str]) -> str:
    return f"{len(names)} ({first_few(names)})" if names else ""


def contents_of(scene: Scene) -> Contents:
    """What a file holds.

    Raises
    ------
    FormatError
        If names, animations or textures of its document are damaged.
    """
    document = scene.document
    parts = [one.part for one in scene.parts]
    body = find_body(parts)
    rig = None if scene.joints is None else scene.joints.rig
    weights = [part.weights for part in parts if part.weights is not None]
    named = [name for name in document.entries("extensionsUsed") if isinstance(name, str) and name != NGONS]
    return Contents(
        body=body.name,
        passengers=tuple(part.name for part in parts if part is not body),
        vertices=sum(part.mesh.n_vertices for part in parts),
        stored=sum(one.stored for one in scene.parts),
        joints=0 if rig is None else len(rig.names),
        influences=max((int(np.diff(table.indptr).max()) for table in weights), default=0),
        humanoid=len(humanoid_bones(document) or ({} if rig is None else humanoid_joints(rig))),
        shapes=tuple(dict.fromkeys(name for part in parts for name in part.shapes)),
        textures=_textures(document),
        animations=tuple(zip(animation_names(document), animation_lengths(document), strict=True)),
        extensions=tuple(map(whole_characters, named)),
        welded=tuple(note for one in scene.parts for note in one.notes),
    )


def _textures(document: Document) -> tuple[str, ...]:
    """Every slot that has a texture."""
    found = []
    for number, name in enumerate(material_names(document)):
        for slot, holder in texture_slots(document.entry("materials", number)):
            texture = document.entry("textures", holder["index"], f"materials {number}")
            source = texture.get("source")
            suffix = "" if source is None else f" ({image_bytes(document, source)[1][1:]})"
            found.append(f"{name} {slot.removesuffix('Texture')}{suffix}")
    return tuple(found)
