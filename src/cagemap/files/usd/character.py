"""Writer of USD for whole characters: skeleton, animations, meshes, materials, images."""

from __future__ import annotations

import struct
import tempfile
import zipfile
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.character.values import Character, Part, Rig
from cagemap.files.atomic import atomic_path, write_whole
from cagemap.files.gltf.binary import NGONS
from cagemap.files.gltf.character import transform_track
from cagemap.files.gltf.geometry import uv_sets_in_order
from cagemap.files.gltf.nodes import moved_nodes
from cagemap.files.gltf.parts import Scene, transform_part
from cagemap.files.gltf.primitives import material_names
from cagemap.files.ownership import mark
from cagemap.files.usd.materials import WRITTEN, uv_primvar, write_materials
from cagemap.files.usd.prims import faces_by_name
from cagemap.files.usd.skeleton import SKELETON, write_rig
from cagemap.files.usd.space import StageSpace, to_metres
from cagemap.files.usd.stages import identifiers, open_stage, pxr
from cagemap.files.usd.write import check_usd_path, export_layer, new_stage
from cagemap.files.usd.write_mesh import (
    write_blend_shapes,
    write_subsets,
    write_topology,
    write_uvs,
    write_weights,
)
from cagemap.mesh import Plain
from cagemap.mesh.faces import cage_triangles
from cagemap.surface.triangles import vertex_normals

# Extensions of glTF that are written or hold nothing of the character; contents of others.
_HELD = {NGONS, "KHR_mesh_quantization", *WRITTEN}
_CONTENTS = {
    "VRM": " (humanoid bones, expressions, spring bones)",
    "VRMC_vrm": " (humanoid bones, expressions)",
    "VRMC_springBone": " (spring bones)",
}

# Tag of the extra field that aligns the members of a package.
_PADDING_ID = 0x1986


def write_usd_character(
    path: str | Path,
    character: Character,
    scene: Scene,
    *,
    space: StageSpace | None = None,
    kept: Collection[Path] = (),
    force: bool = False,
) -> list[str]:
    """Write a character as USD: a layer with images in its folder, or a package (``.usdz``); returns notes.

    Notes say what USD has no place for.

    ``scene``: the same character as a glTF document: its materials and images are written.
    ``character``: in metres with Y up, as ``scene``.
    ``space``: to write it in, whose transform is a similarity without a mirror; default: metres with Y up.
    ``kept``: resolved paths of files that no image replaces, such as images of the character's file.
    """
    file = Path(path)
    check_usd_path(file, package=True)
    character = character if space is None else _to_space(character, space)
    stage = new_stage(space or StageSpace("Y", 1.0), "SkelRoot")
    used = {name: None for part in character.parts for name in _materials(part)}
    surfaces = write_materials(stage, scene.document, list(used), file, kept)
    rig = character.rig
    if rig is None and any(part.shapes for part in character.parts):  # a skeleton holds the weights of shapes
        rig = Rig(("root",), np.array([-1]), np.eye(4)[None], np.eye(4)[None])
    notes = [*_left_out(scene), *surfaces.notes]
    if any(part.mesh.vertex_colors is not None and _materials(part) for part in character.parts):
        notes.append("vertex colours are written as displayColor, which the materials do not use")
    if any(part.shape_normals for part in character.parts):
        notes.append("normals of blend shapes are left out; programs compute them")
    if rig is not None:
        notes += write_rig(stage, rig, character.animations, character.parts)
    sizes, numbers = {}, material_names(scene.document)
    labels = identifiers((part.name for part in character.parts), ("skeleton", "animations", "materials"))
    for label, part in zip(labels, character.parts, strict=True):
        prim = _write_part(stage, f"/Asset/{label}", part, surfaces.materials, skinned=character.rig is not None)
        prim.GetPrim().SetDisplayName(part.name)
        entries = (scene.document.entry("materials", numbers.index(name)) for name in _materials(part))
        prim.CreateDoubleSidedAttr(any(entry.get("doubleSided") for entry in entries))
        sizes[prim.GetPath().pathString] = part.mesh.n_vertices
    _save(stage.GetRootLayer(), file, surfaces.images, sizes, force=force)
    return notes


def _to_space(character: Character, space: StageSpace) -> Character:
    """A character in metres with Y up as one in a space, by a similarity without a mirror."""
    matrix = np.asarray(np.linalg.inv(to_metres(space)), dtype=np.float64)
    rig, animations = character.rig, character.animations
    if rig is not None:
        roots = rig.parents < 0
        local = np.where(roots[:, None, None], rig.local @ matrix, rig.local)
        rig = replace(rig, local=local, bind=rig.bind @ matrix)
        animations = tuple(
            replace(one, tracks=tuple(transform_track(t, matrix) if roots[t.joint] else t for t in one.tracks))
            for one in animations
        )
    parts = tuple(transform_part(part, matrix) for part in character.parts)
    return replace(character, parts=parts, rig=rig, animations=animations)


def _write_part(stage: Any, path: str, part: Part, materials: Mapping[str, Any], *, skinned: bool) -> Any:
    mesh, prim = part.mesh, pxr.UsdGeom.Mesh.Define(stage, path)
    write_topology(prim, mesh, part.colors)
    if mesh.scheme is None or isinstance(mesh.scheme, Plain):  # subdivision surfaces have normals of their own
        smooth = vertex_normals(mesh.positions, cage_triangles(mesh)[0])[mesh.face_indices]
        normals, interpolation = smooth if part.normals is None else part.normals, "faceVarying"
        of_vertices = np.zeros((mesh.n_vertices, 3))
        of_vertices[mesh.face_indices] = normals
        if np.allclose(of_vertices[mesh.face_indices], normals, atol=1e-4):
            normals, interpolation = of_vertices, "vertex"
        prim.CreateNormalsAttr(pxr.Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
        prim.SetNormalsInterpolation(interpolation)
    for number, uv_set in enumerate(uv_sets_in_order(mesh)):
        write_uvs(prim, uv_primvar(number), uv_set.uvs, uv_set.uv_indices)
    write_subsets(stage, prim, mesh, materials)
    skinned = skinned and part.weights is not None
    if skinned or part.shapes:
        pxr.UsdSkel.BindingAPI.Apply(prim.GetPrim()).CreateSkeletonRel().SetTargets([SKELETON])
    if skinned and part.weights is not None:
        write_weights(prim.GetPrim(), part.weights.toarray())
        pxr.UsdSkel.BindingAPI(prim).CreateGeomBindTransformAttr(pxr.Gf.Matrix4d(1.0))
    if part.shapes:
        write_blend_shapes(stage, prim.GetPrim(), part.shapes)
    return prim


def _materials(part: Part) -> list[str]:
    """Names of a part's materials that have faces."""
    return [name for name, _, color in faces_by_name(part.mesh) if color is not None]


def _left_out(scene: Scene) -> list[str]:
    """A note on what the glTF document has and USD has no place for."""
    document, names = scene.document, []
    extensions = map(str, document.entries("extensionsUsed"))
    names += [f"{word}{_CONTENTS.get(word, '')}" for word in extensions if word not in _HELD]
    names += ["cameras"] if document.entries("cameras") else []
    joints = set() if scene.joints is None else set(np.flatnonzero(scene.joints.joint_of >= 0).tolist())
    names += [f"the motion of {scene.nodes.names[node]}" for node in sorted(moved_nodes(document) - joints)]
    kinds = ("nodes", "meshes", "materials", "scenes")
    extras = [entry.get("extras") for kind in kinds for entry in document.entries(kind)]
    if any(set(one) - {"targetNames"} if isinstance(one, dict) else one for one in extras):
        names.append("extras")
    return [f"USD has no place for {', '.join(names)}: left out; a .glb keeps them"] if names else []


def _save(layer: Any, file: Path, images: Mapping[str, bytes], sizes: Mapping[str, int], *, force: bool) -> None:
    """Write layer and images, verified by the numbers of points of the meshes."""

    def is_whole(temporary: Path) -> bool:
        stage = open_stage(temporary)
        prims = (pxr.UsdGeom.Mesh(stage.GetPrimAtPath(path)) for path in sizes)
        return [len(prim.GetPointsAttr().Get()) for prim in prims] == list(sizes.values())

    if file.suffix.lower() != ".usdz":
        with atomic_path(file, force=force, verify=is_whole) as temporary:
            export_layer(layer, file, temporary)
            for name, data in images.items():
                write_whole(file.with_name(name), data)
        return
    with tempfile.TemporaryDirectory() as folder, atomic_path(file, force=force, verify=is_whole) as temporary:
        inside = Path(folder) / f"{file.stem}.usdc"
        export_layer(layer, file, inside)
        with temporary.open("wb") as stream, zipfile.ZipFile(stream, "w") as package:
            package.comment = mark().encode()
            for name, data in {inside.name: inside.read_bytes(), **images}.items():
                entry = zipfile.ZipInfo(name)
                # Content begins at a multiple of 64 bytes: an extra field fills the header of 30 bytes and the name.
                filled = -(stream.tell() + 34 + len(name.encode())) % 64
                entry.extra = struct.pack("<HH", _PADDING_ID, filled) + bytes(filled)
                package.writestr(entry, data)
