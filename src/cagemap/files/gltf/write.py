"""Write control meshes and characters as glTF: new documents, or a given one with its meshes replaced."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.character.normals import move_vertices
from cagemap.character.values import Character, Part, Rig
from cagemap.errors import FormatError
from cagemap.files.atomic import write_whole
from cagemap.files.gltf.binary import NGONS, Binary, remove_unused
from cagemap.files.gltf.character import animation_entries, character_of
from cagemap.files.gltf.document import glb_bytes, read_document, write_document
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.expressions import ReplacedMesh, renumber_expressions
from cagemap.files.gltf.geometry import Z_TO_Y, is_z_up, mesh_entry
from cagemap.files.gltf.nodes import REST, decompose_transform, read_nodes, scale_signs
from cagemap.files.gltf.parts import Scene, read_scene, transform_part
from cagemap.files.gltf.primitives import material_names, node_shapes
from cagemap.files.gltf.read import left_out_of_gltf
from cagemap.files.gltf.textures import with_images
from cagemap.files.text import whole_characters
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import NO_UV, UvSet
from cagemap.mesh.faces import merged_corners
from cagemap.mesh.mesh_report import first_few
from cagemap.numerics.arrays import FloatArray

_log = logging.getLogger(__name__)


def write_glb(path: str | Path, mesh: ControlMesh, *, to_metres: FloatArray | None = None, force: bool = False) -> None:
    """Write a mesh as glTF: polygons as fans of triangles, a primitive for each material, split at UV seams.

    Positions are single precision in the mesh's own unit. Creases are not written; glTF has no place for them.

    ``to_metres``: (4, 4) transform of the node, for points as rows: from the mesh's space to metres with Y up, as glTF
    demands. Default: the mesh's up axis alone is turned.
    """
    if to_metres is None and is_z_up(mesh):
        to_metres = Z_TO_Y
    # Stored by columns for points as columns: the rows of a matrix for points as rows.
    placed = {} if to_metres is None else {"matrix": to_metres.ravel().tolist()}
    binary = Binary()
    count = 0 if mesh.face_materials is None else len(mesh.material_names)
    top: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "cagemap"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": mesh.name} | placed],
        "meshes": [mesh_entry(binary, Part(mesh.name, mesh), range(count))],
    }
    if count:
        top["materials"] = [material_entry(mesh, number) for number in range(count)]
    write_whole(path, glb_bytes(binary.document(top)), force=force)


def material_entry(mesh: ControlMesh, number: int) -> dict[str, Any]:
    """Entry of ``materials`` with a material's name and colour."""
    surface: dict[str, Any] = {"metallicFactor": 0.0}
    if mesh.material_colors is not None and np.isfinite(mesh.material_colors[number]).all():
        surface["baseColorFactor"] = [*np.clip(mesh.material_colors[number], 0.0, 1.0).tolist(), 1.0]
    return {"name": mesh.material_names[number], "pbrMetallicRoughness": surface}


_VARIANTS = "KHR_materials_variants"
# Tangents are not read either: programs compute them.
_READ_ATTRIBUTES = re.compile(r"POSITION|NORMAL|TANGENT|COLOR_0|TEXCOORD_\d+|(JOINTS|WEIGHTS)_[0-7]")
_EMPTY: dict[str, Any] = {
    "asset": {"version": "2.0", "generator": "cagemap"},
    "nodes": [],
    "meshes": [],
    "scene": 0,
    "scenes": [{"nodes": []}],
}
# Relative to the largest number of a transform: with a smaller change the document's transform stays.
_SAME_LOCAL = 1e-6


def character_glb(
    character: Character,
    materials_from: Document | None = None,
    images: Mapping[tuple[str, str], bytes] | None = None,
    pieces_of: Mapping[str, str] | None = None,
) -> Document:
    """A character as a glTF document, for `cagemap.files.gltf.document.write_document`.

    Parts, joints and animations replace those of the same names in a given document. Its other mesh nodes lose their
    meshes. Materials, textures, cameras, lights, extensions (VRM) and animations of other things are kept. Weights of
    blend shapes are those of the character alone (`Part.shape_weights`, `Animation.shape_tracks`).

    ``character``: positions and bind pose as read, in metres with Y up.
    ``images``: PNG or JPEG files by material and slot, such as ``("body", "baseColorTexture")``; other settings of a
        slot are kept.
    ``pieces_of``: names of parts that are new or get their first shapes, each with the name of the given part that it
        is a piece of. They get VRM's expressions of that part, new ones its first-person flags too.
    """
    empty = Document(_EMPTY, (), Path("new.glb"))
    scene = Scene(empty, read_nodes(empty), None, ())
    if materials_from is not None:
        scene = read_scene(materials_from, props=character.rig is not None)
    writer = _Made(scene, pieces_of or {})
    writer.rig(character.rig)
    for part in character.parts:
        writer.part(part, character.rig)
    writer.animations(character)
    return remove_unused(with_images(writer.document(), images or {}))


class _Made:
    """A given glTF document to which the rig, parts and animations of a character are added."""

    def __init__(self, scene: Scene, pieces_of: Mapping[str, str]) -> None:
        self._scene, self._pieces_of = scene, pieces_of
        self._binary = Binary(scene.document)
        self.top: dict[str, Any] = json.loads(json.dumps(scene.document.json))
        self._nodes: list[Any] = self.top.setdefault("nodes", [])
        self._meshes: list[Any] = self.top.setdefault("meshes", [])
        self._node_of_part = {one.part.name: one.node for one in scene.parts}
        self._node_of_joint = {name: node for node, name in enumerate(scene.nodes.names)}
        # mesh numbers in the given document
        self._mesh_of_node = {node: self._nodes[node].pop("mesh") for node in self._node_of_part.values()}
        self._nodes_of_parts: list[int] = []
        self._given_node: dict[int, int] = {}  # that a piece is of, by the node of the piece
        if not self.top.get("scenes"):  # without scenes, all roots are displayed
            roots = [int(node) for node in scene.nodes.order if scene.nodes.parents[node] < 0]
            self.top |= {"scene": 0, "scenes": [{"nodes": roots}]}
        self._roots: list[Any] = self.top["scenes"][self.top.get("scene", 0)].setdefault("nodes", [])
        for node in self._mesh_of_node:
            for name in ("skin", "weights"):
                self._nodes[node].pop(name, None)

    def rig(self, rig: Rig | None) -> None:
        """Set the joints' transforms and the skin that all parts share; nodes without a part keep their skins."""
        given = self.top.pop("skins", [])
        skinned = [node for node in self._nodes if node.get("skin") is not None]
        if rig is None:
            self.top |= {"skins": given} if skinned else {}
            return
        numbers: list[int] = []
        for joint, name in enumerate(rig.names):
            node = self._node_of_joint.get(name)
            parent = int(rig.parents[joint])
            if node is None:
                node = self._new_node({"name": name}, numbers[parent] if parent >= 0 else None)
            numbers.append(node)
            self._place(node, rig.local[joint])
        self._node_of_joint |= dict(zip(rig.names, numbers, strict=True))
        inverse = np.linalg.inv(rig.bind)
        inverse[:, :, 3] = [0.0, 0.0, 0.0, 1.0]
        number = self._binary.accessor(inverse.reshape(-1, 16).astype("<f4"))
        self.top["skins"] = [{"joints": numbers, "inverseBindMatrices": number}, *(given if skinned else ())]
        for entry in skinned:
            entry["skin"] += 1

    def part(self, part: Part, rig: Rig | None) -> None:
        """Add a part's mesh to its node."""
        node = self._node_of_part.get(part.name)
        has_shapes = node is not None and bool(node_shapes(self._scene.document, node))
        if node is None:
            node = self._new_node({"name": part.name}, None)
        if part.name in self._pieces_of and not has_shapes:
            self._given_node[node] = self._node_of_part[self._pieces_of[part.name]]
        skinned = part.weights is not None and rig is not None
        if not skinned:
            part = replace(part, weights=None)
            if node < len(self._scene.nodes.names):
                part = transform_part(part, np.asarray(np.linalg.inv(self._scene.nodes.world[node])))
        mesh_data = mesh_entry(self._binary, part, self._materials(part))
        given = node if node in self._mesh_of_node else self._given_node.get(node)
        if given is not None:
            self._copy_variants(part.name, self._mesh_of_node[given], mesh_data)
        entry = self._nodes[node]
        if skinned:
            entry["skin"] = 0
        entry["mesh"] = self._mesh_number(node, mesh_data)
        self._nodes_of_parts.append(node)

    def _copy_variants(self, name: str, number: int, made: dict[str, Any]) -> None:
        """Copy material variants of a given mesh to a new one, by material; warn of what its primitives lose."""
        document = self._scene.document
        lost: set[str] = set()
        variants: dict[Any, Any] = {}
        for primitive in document.entries("primitives", document.entry("meshes", number)):
            extensions = document.table(primitive, "extensions", name)
            lost |= {word for word in extensions if word not in (_VARIANTS, NGONS)}
            lost |= {word for word in primitive.get("attributes", {}) if not _READ_ATTRIBUTES.fullmatch(word)}
            if _VARIANTS in extensions:
                variants.setdefault(primitive.get("material"), extensions[_VARIANTS])
        for primitive in made["primitives"]:
            if primitive.get("material") in variants:
                stated = {_VARIANTS: variants[primitive.get("material")]}
                primitive["extensions"] = primitive.get("extensions", {}) | stated
        if lost:
            text = "%s: %s: %s are left out, which cagemap does not read"
            _log.warning(text, document.file, name, ", ".join(sorted(map(whole_characters, lost))))

    def _mesh_number(self, node: int, made: dict[str, Any]) -> int:
        """Add a mesh; one that only this node used is replaced, and keeps its name, extras and extensions."""
        number = self._mesh_of_node.get(node, -1)
        if [user for user, mesh in self._mesh_of_node.items() if mesh == number] != [node]:
            self._meshes.append(made)
            return len(self._meshes) - 1
        before = self._meshes[number]
        extras = before.get("extras")
        kept = (
            {name: value for name, value in extras.items() if name != "targetNames"} if isinstance(extras, dict) else {}
        )
        entry = {name: value for name, value in before.items() if name in ("name", "extensions")} | made
        if kept or "extras" in made:
            entry["extras"] = kept | made.get("extras", {})
        self._meshes[number] = entry
        return number

    def _materials(self, part: Part) -> list[int | None]:
        """Numbers of a part's materials in the document; missing ones are added."""
        names = material_names(self._scene.document)
        known = {name: number for number, name in enumerate(names)}
        entries: list[Any] = self.top.setdefault("materials", [])
        known |= {entry["name"]: number for number, entry in enumerate(entries) if number >= len(names)}
        numbers: list[int | None] = []
        for number, name in enumerate(part.mesh.material_names):
            if name and name not in known:
                entries.append(material_entry(part.mesh, number))
                known[name] = len(entries) - 1
            numbers.append(known.get(name))
        return numbers

    def animations(self, character: Character) -> None:
        """Replace the tracks of joints and blend shapes."""
        above = {} if self._scene.joints is None else dict(enumerate(self._scene.joints.above))
        joints = [] if character.rig is None else [self._node_of_joint[name] for name in character.rig.names]
        given = self._scene.document
        entries = animation_entries(self._binary, character, joints, self._nodes_of_parts, above, given)
        self.top.pop("animations", None)
        if entries:
            self.top["animations"] = entries

    def document(self) -> Document:
        """The finished document."""
        self._renumber_expressions()
        for name in ("materials", "meshes"):
            if not self.top.get(name):
                self.top.pop(name, None)
        return self._binary.document(self.top)

    def _renumber_expressions(self) -> None:
        """Have VRM's expressions refer to the meshes and shapes of now; warn of those that move none any more."""
        replaced = []
        pairs = [*((node, node) for node in self._mesh_of_node), *self._given_node.items()]
        for node, before in pairs:
            now = self._nodes[node].get("mesh")
            shapes = () if now is None else self._meshes[now].get("extras", {}).get("targetNames", ())
            shapes_before = node_shapes(self._scene.document, before)
            replaced.append(ReplacedMesh(before, self._mesh_of_node[before], node, now, shapes_before, shapes))
        if empty := renumber_expressions(self.top.get("extensions"), replaced):
            text = "%s: expressions that move no shape any more, since their meshes or shapes are not carried: %s"
            _log.warning(text, self._scene.document.file, whole_characters(first_few(empty)))

    def _new_node(self, entry: dict[str, Any], parent: int | None) -> int:
        self._nodes.append(entry)
        siblings = self._roots if parent is None else self._nodes[parent].setdefault("children", [])
        siblings.append(len(self._nodes) - 1)
        return len(self._nodes) - 1

    def _place(self, node: int, local: FloatArray) -> None:
        """Set a joint's transform if it differs from that of the document."""
        if node < len(self._scene.nodes.names):
            joints, nodes = self._scene.joints, self._scene.nodes
            above = np.eye(4) if joints is None else joints.above[node]
            local = local @ np.linalg.inv(above)
            # Tracks are those of `decompose_transform`.
            same_signs = (scale_signs(self._scene.document, node) > 0.0).all()
            if same_signs and np.abs(local - nodes.local[node]).max() <= _SAME_LOCAL * np.abs(local).max():
                return
        entry = self._nodes[node]
        for name in ("matrix", *REST):
            entry.pop(name, None)
        entry |= decompose_transform(local)


def write_glb_like(path: str | Path, mesh: ControlMesh, like: str | Path, *, force: bool = False) -> bool:
    """Write a mesh as ``.glb``, in place of the meshes of a glTF or FBX file if vertices and faces match.

    Positions and the UV set in use are those of the mesh. The file's materials, textures, skins, blend shapes,
    animations and extensions are kept then. A mesh that does not match is written alone, with a warning of
    what it lacks (`left_out_of_gltf`). Returns whether it matches.
    """
    try:
        document = read_document(like)
    except FormatError:  # removed or changed meanwhile
        write_glb(path, mesh, force=force)
        return False
    character = character_of(document)
    sizes = [part.mesh.n_vertices for part in character.parts]
    starts = np.cumsum([0, *sizes])
    faces = np.concatenate(
        [part.mesh.face_indices + start for part, start in zip(character.parts, starts[:-1], strict=True)]
    )
    if mesh.n_vertices != starts[-1] or not np.array_equal(mesh.face_indices, faces):
        if lost := left_out_of_gltf(document):
            text = "%s: other vertices or faces than %s: its %s are left out"
            _log.warning(text, path, like, ", ".join(lost))
        write_glb(path, mesh, force=force)
        return False
    places = np.split(mesh.positions, starts[1:-1])
    parts = tuple(move_vertices(part, own) for part, own in zip(character.parts, places, strict=True))
    if mesh.uvs is not None and mesh.uv_indices is not None:
        ends = np.cumsum([len(part.mesh.face_indices) for part in parts])
        uvs = np.split(mesh.uvs[mesh.uv_indices], ends[:-1])
        name = mesh.uv_name or "TEXCOORD_0"
        parts = tuple(_with_uvs(part, name, of_part) for part, of_part in zip(parts, uvs, strict=True))
    write_document(path, character_glb(replace(character, parts=parts), document), force=force)
    return True


def _with_uvs(part: Part, name: str, uvs: FloatArray) -> Part:
    """A part with texture coordinates (c, 2) of its corners in a UV set; unchanged if they are `NO_UV`."""
    if (uvs == NO_UV).all():
        return part
    mesh = part.mesh
    sets = {uv_set.name: uv_set for uv_set in mesh.all_uv_sets}
    sets[name] = UvSet(name, *merged_corners(mesh.face_indices, uvs))
    return replace(part, mesh=mesh.with_uv_sets([*sets.values()]))
