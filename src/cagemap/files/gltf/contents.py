"""What a glTF file holds, in a few lines: meshes, skeleton, shapes, textures, animations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cagemap.files.gltf.animations import animation_lengths, animation_names
from cagemap.files.gltf.character import humanoid_bones
from cagemap.files.gltf.document import read_document
from cagemap.files.gltf.entries import Document, image_bytes
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import texture_slots
from cagemap.files.text import whole_characters
from cagemap.mesh.faces import face_areas
from cagemap.mesh.mesh_report import first_few


@dataclass(frozen=True)
class Contents:
    """What a glTF file holds.

    Attributes
    ----------
    body : str
        The mesh of the largest area.
    passengers : tuple of str
        All other meshes.
    vertices, stored : int
        Vertices after welding, and in the file.
    joints : int
    influences : int
        Joints that move a vertex, at most.
    humanoid : int
        Bones that a VRM names.
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

    def __str__(self) -> str:
        bones = f", {self.humanoid} of them named as humanoid bones" if self.humanoid else ""
        moving = [f"{name} ({seconds:.3g} s)" for name, seconds in self.animations]
        split = self.stored - self.vertices
        rows = {
            "body": self.body + (", the largest surface" if self.passengers else ""),
            "passengers": _listed(self.passengers),
            "skeleton": f"{self.joints} joints{bones}, at most {self.influences} a vertex" if self.joints else "",
            "shapes": _listed(self.shapes),
            "textures": _listed(self.textures),
            "animations": _listed(moving),
            "kept as it is": _listed(self.extensions),
            "vertices": f"{self.vertices}, made of {self.stored} in the file: copies along seams are welded"
            if split
            else "",
        }
        return "\n".join(["  holds", *(f"    {name:<15}{said}" for name, said in rows.items() if said)])


def _listed(names: tuple[str, ...] | list[str]) -> str:
    return f"{len(names)}: {first_few(names)}" if names else ""


def read_contents(path: str | Path) -> Contents:
    """What a glTF file holds.

    Raises
    ------
    FormatError
        If it cannot be read.
    """
    document = read_document(path)
    scene = read_scene(document)
    parts = [one.part for one in scene.parts]
    body = int(np.argmax([face_areas(part.mesh).sum() for part in parts]))
    weights = [part.weights for part in parts if part.weights is not None]
    used = [whole_characters(name) for name in document.entries("extensionsUsed") if isinstance(name, str)]
    return Contents(
        body=parts[body].name,
        passengers=tuple(part.name for number, part in enumerate(parts) if number != body),
        vertices=sum(part.mesh.n_vertices for part in parts),
        stored=sum(one.stored for one in scene.parts),
        joints=0 if scene.joints is None else len(scene.joints.rig.names),
        influences=max((int(np.diff(table.indptr).max()) for table in weights), default=0),
        humanoid=len(humanoid_bones(document)),
        shapes=tuple(dict.fromkeys(name for part in parts for name in part.shapes)),
        textures=_textures(document),
        animations=tuple(zip(animation_names(document), animation_lengths(document), strict=True)),
        extensions=tuple(used),
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
