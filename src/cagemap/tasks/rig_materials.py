"""Materials of a rigged character: of both bodies, with baked images, vertex colours and the body's UV layout."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.character.own_parts import nearest_rows
from cagemap.character.values import Character, Part
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.primitives import material_names
from cagemap.files.gltf.textures import (
    MaterialImage,
    material_images,
    read_material_image,
    with_copied_materials,
    with_materials_of,
)
from cagemap.files.images.image import Image
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.faces import face_centres
from cagemap.numerics.arrays import IndexArray, decode_srgb
from cagemap.surface.triangles import fan_triangles
from cagemap.tasks.bake_tiles import target_overlap_warnings
from cagemap.tasks.carry_arrays import carry_values
from cagemap.tasks.carry_character import CarriedCharacter
from cagemap.transfer import Transfer, bake_texture, prepare_transfer, pull_back_faces, tile_cells, transfer_of, unwrap
from cagemap.transfer.vectors import bake_normal_map


def with_own_materials(
    carried: CarriedCharacter, document: Document, given: Document | None, *, body: bool
) -> tuple[Character, Document]:
    """The character and document with the target's own materials on its parts; ``body``: on its body too."""
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
BakedImages = dict[tuple[str, str], tuple[Image, Image]]


def with_baked_materials(
    carried: CarriedCharacter, source: Character, of: Part, document: Document, size: int | None
) -> tuple[Character, Document, BakedImages, list[str]]:
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
    transfer = transfer_of(result)
    mesh = replace(
        body.mesh,
        face_materials=_carried_materials(result, transfer, body.mesh),
        material_names=tuple(copies.get(name, name) for name in source_mesh.material_names),
        material_colors=source_mesh.material_colors,
    )
    images, uv_sets = {}, {one.name for one in result.source.control.all_uv_sets}
    for name, copy in copies.items():
        for found in material_images(document, name):
            if found.uv_set in uv_sets:
                images[copy, found.slot] = _bake_image(found, document, result, size)
            else:
                notes.append(f"{name}: its {found.slot} is left out: {of.name} has no UV set {found.uv_set}")
    notes += target_overlap_warnings(result.target.control) if images else []
    dressed = replace(carried.character, parts=(replace(body, mesh=mesh), *others))
    return dressed, with_copied_materials(document, list(copies.items()), images), images, notes


def with_carried_colors(carried: CarriedCharacter, body: Part, of: Part) -> Part:
    """The body with the source body's vertex colours, or without: glTF multiplies them with the texture."""
    result, colors = carried.result, of.mesh.vertex_colors
    if colors is None:
        return replace(body, mesh=replace(body.mesh, vertex_colors=None), colors=None)
    opacity = np.ones(of.mesh.n_vertices)
    if of.colors is not None:
        opacity[of.mesh.face_indices] = of.colors[:, 3]
    table = np.column_stack([colors, opacity])[carried.rows[1]]
    table = np.asarray(carry_values(result, table, "vertices"))
    table = table[nearest_rows(result.target.control.positions, body.mesh.positions)]
    linear = np.column_stack([decode_srgb(table[:, :3].clip(0.0, 1.0)), table[:, 3].clip(0.0, 1.0)])
    corners = linear[body.mesh.face_indices] if (opacity < 1.0).any() else None
    return replace(body, mesh=replace(body.mesh, vertex_colors=table[:, :3]), colors=corners)


def _carried_materials(result: MatchResult, transfer: Transfer, mesh: ControlMesh) -> IndexArray:
    """Carried material of every face of the body; unmatched pieces take the nearest face's material."""
    matched, source = result.target.control, result.source.control
    assert source.face_materials is not None
    materials = pull_back_faces(transfer, source.face_materials, n_target_faces=matched.n_faces)
    return np.asarray(materials[nearest_rows(face_centres(matched), face_centres(mesh))])


def _bake_image(found: MaterialImage, document: Document, result: MatchResult, size: int | None) -> tuple[Image, Image]:
    image = read_material_image(document, found)
    source = result.source.control.with_uv_set(found.uv_set)
    assert source.uvs is not None
    assert source.uv_indices is not None
    pixels, uvs = found.repeating(image.pixels, found.on_image(source.uvs))
    level, target = result.source.refinement.finest, result.target.refinement
    layout = uvs, source.uv_indices.reshape(level.n_faces, -1)
    level, holes = replace(level, lay=lambda: layout), target.holes(target.finest_level)
    transfer = prepare_transfer(target.finest, level, result.point_map, result.masks, holes)
    height, width = image.size if size is None else (size, size)
    bake = bake_normal_map if found.is_normal_map and pixels.shape[2] >= 3 else bake_texture
    return image, replace(image, pixels=bake(transfer, pixels, size=(height, width)), channel_names=())


def with_uvs_in_unit_square(mesh: ControlMesh) -> ControlMesh:
    """A mesh with UVs in the unit square, as glTF needs: unwrapped, or with its tiles side by side.

    The UVs in tiles are kept as a second set, before further sets.
    """
    if mesh.uvs is None or mesh.uv_indices is None or not mesh.has_layout:
        return unwrap(mesh)
    corners, faces = fan_triangles(mesh.face_offsets, np.arange(len(mesh.face_indices)))
    cells = np.zeros((mesh.n_faces, 2))
    cells[faces] = tile_cells(mesh.uvs[mesh.uv_indices[corners]])
    tiles, tile_of_face = np.unique(cells, axis=0, return_inverse=True)
    if not tiles.any():
        return mesh
    side = int(np.ceil(np.sqrt(len(tiles))))
    shift = np.column_stack([np.arange(len(tiles)) % side, np.arange(len(tiles)) // side]) - tiles
    of_corner = np.repeat(tile_of_face.ravel(), mesh.face_sizes)
    keys, indices = np.unique(np.column_stack([mesh.uv_indices, of_corner]), axis=0, return_inverse=True)
    before = UvSet(mesh.uv_name, mesh.uvs, mesh.uv_indices), *mesh.uv_sets
    others = tuple(replace(one, name=f"TEXCOORD_{number}") for number, one in enumerate(before, 1))
    packed = mesh.with_uvs((mesh.uvs[keys[:, 0]] + shift[keys[:, 1]]) / side, indices.ravel().astype(np.int64))
    return replace(packed, uv_name="TEXCOORD_0", uv_sets=others)
