"""Materials: which images they use and how these are laid out; copies of them with baked images."""

from __future__ import annotations

from typing import Any, NamedTuple

import bpy
import numpy as np
from mathutils import Matrix

from .client import RefusedError
from .reading import numbers, uv_layers
from .writing import identity, short_name

# Node groups with such nodes are copied: they depend on the UV map.
_UV_NODES = ("TEX_IMAGE", "NORMAL_MAP")
# UVs that are so little outside of an image lie on it.
_UV_TOLERANCE = 1e-4


class ImageUse(NamedTuple):
    """An image node: names of the group nodes around it and its own; its image and layout."""

    path: tuple[str, ...]
    image: bpy.types.Image
    layer: str
    mapping: tuple[tuple[float, ...], ...]  # (2, 3), of the Mapping nodes
    normals: bool  # a normal map in tangent space

    @property
    def key(self) -> tuple[Any, ...]:
        """What is baked: equal for nodes that use an image alike."""
        return identity(self.image), self.layer, self.mapping, self.normals

    def mapped(self, uvs):
        """UVs (c, 2) of the layer after the Mapping nodes."""
        matrix = np.array(self.mapping)
        return uvs @ matrix[:, :2].T + matrix[:, 2]


def image_uses(object_, material):
    """Every use of an image by a material of an object.

    Raises
    ------
    RefusedError
        The layout or the way to a Normal Map node cannot be baked.
    """
    uses = []
    for node, groups in _image_nodes(material.node_tree if material else None):
        normals = _is_normal_map(material, node, groups)
        layer, matrix = _layout(object_, material, node, groups)
        plane = tuple(tuple(round(matrix[row][column], 6) for column in (0, 1, 3)) for row in (0, 1))
        (a, b, _), (c, d, _) = plane
        if normals and (b or c or a <= 0 or d <= 0):
            raise _refusal(material, node, "a normal map cannot be rotated or mirrored by a Mapping node. Apply it.")
        path = tuple(one.name for one in (*groups, node))
        use = ImageUse(path, node.image, layer, plane, normals)
        if node.extension != "REPEAT" and not _fills_image(object_, material, use):
            reason = "only images that repeat can be baked where UVs leave them."
            raise _refusal(material, node, f"{reason} Choose Repeat, or move the UVs onto the image.")
        uses.append(use)
    return uses


def _fills_image(object_, material, use):
    """Whether the UVs of all faces with a material lie on an image."""
    mesh, slots = object_.data, object_.material_slots
    chosen = [number for number, slot in enumerate(slots) if slot.material == material]
    faces = np.minimum(numbers(mesh.polygons, "material_index", kind=np.int32), len(slots) - 1)
    corners = np.repeat(np.isin(faces, chosen), numbers(mesh.polygons, "loop_total", kind=np.int32))
    uvs = use.mapped(uv_layers(object_)[use.layer])[corners]
    return use.image.source == "TILED" or bool((np.abs(uvs - 0.5) <= 0.5 + _UV_TOLERANCE).all())


def _image_nodes(tree, groups=()):
    """Linked image nodes of a node tree, each with the group nodes around it."""
    for node in tree.nodes if tree else ():
        if node.type == "TEX_IMAGE" and node.image and any(output.is_linked for output in node.outputs):
            yield node, groups
        elif node.type == "GROUP":
            yield from _image_nodes(node.node_tree, (*groups, node))


def _refusal(material, node, reason):
    return RefusedError(f"{material.name}, node {node.label or node.name}: {reason}")


def _links(socket):
    return [link for link in socket.links if not link.is_muted]


def _same_socket(sockets, socket):
    """The socket of a group node that belongs to one inside of its group, or the other way round."""
    return next(one for one in sockets if one.identifier == socket.identifier)


def _layout(object_, material, image, groups):
    """Name of the UV map that an image is laid over, and the (4, 4) matrix of the Mapping nodes between."""
    if image.projection != "FLAT":
        raise _refusal(material, image, "only flat projection can be baked. Choose Flat, or hide the material.")
    node, socket, matrix = image, image.inputs["Vector"], Matrix()
    while links := _links(socket):
        node, output = links[0].from_node, links[0].from_socket
        if node.type == "REROUTE" or (node.type == "MAPPING" and node.mute):
            socket = node.inputs[0]
        elif node.type == "GROUP_INPUT":
            node, groups = groups[-1], groups[:-1]
            socket = _same_socket(node.inputs, output)
        elif node.type == "MAPPING":
            matrix, socket = matrix @ _mapping(material, node), node.inputs["Vector"]
        elif node.type == "UVMAP":
            return _layer(object_, node.uv_map), matrix
        elif node.type == "ATTRIBUTE" and output.name == "Vector" and node.attribute_name in object_.data.uv_layers:
            return node.attribute_name, matrix
        elif node.type == "TEX_COORD" and output.name == "UV":
            return _layer(object_, ""), matrix
        else:
            raise _refusal(material, node, "an image that it lays out cannot be baked. Use a UV map.")
    if node.type == "MAPPING" and not node.mute:
        raise _refusal(material, node, "its Vector is not connected. Connect a UV map.")
    return _layer(object_, ""), matrix


def _mapping(material, node):
    """The (4, 4) matrix of a Mapping node."""
    inputs = [socket for socket in node.inputs if socket.name != "Vector"]
    if any(_links(socket) for socket in inputs) or node.vector_type == "NORMAL":
        raise _refusal(material, node, "only constant mappings of points can be baked. Remove it.")
    values = {socket.name: socket.default_value for socket in inputs}
    place, turn, scale = values.get("Location", (0.0, 0.0, 0.0)), values["Rotation"], values["Scale"]
    if node.vector_type == "VECTOR":
        place = (0.0, 0.0, 0.0)
    matrix = Matrix.LocRotScale(place, turn, scale)
    return matrix.inverted_safe() if node.vector_type == "TEXTURE" else matrix


def _layer(object_, name):
    """A UV map by name, or the one for rendering."""
    if name in object_.data.uv_layers:
        return name
    layer = next((layer for layer in object_.data.uv_layers if layer.active_render), None)
    if layer is None:
        raise RefusedError(f"{object_.name} has images but no UV map. Unwrap it first.")
    return layer.name


def _is_normal_map(material, image, groups):
    """Whether an image goes straight into a Normal Map node; refused if another node changes it first."""
    is_normals, seen, todo = False, set(), [(image.outputs["Color"], groups, None)]
    while todo:
        output, outer_groups, changer = todo.pop()
        if (output, outer_groups, changer is None) in seen:
            continue
        seen.add((output, outer_groups, changer is None))
        for link in _links(output):
            node = link.to_node
            if node.type == "NORMAL_MAP":
                if link.to_socket.name != "Color":
                    continue
                if changer is not None:
                    raise _refusal(
                        material,
                        changer,
                        "an image that it changes before a Normal Map node cannot be baked. Remove it.",
                    )
                if node.space != "TANGENT":
                    raise _refusal(material, node, "only normal maps in tangent space can be baked.")
                is_normals = True
            elif node.type == "REROUTE":
                todo.append((node.outputs[0], outer_groups, changer))
            elif node.type == "GROUP_OUTPUT":
                if outer_groups:
                    todo.append((_same_socket(outer_groups[-1].outputs, link.to_socket), outer_groups[:-1], changer))
            elif node.type == "GROUP":
                inner = [one for one in node.node_tree.nodes if one.type == "GROUP_INPUT"] if node.node_tree else []
                todo += [(_same_socket(one.outputs, link.to_socket), (*outer_groups, node), changer) for one in inner]
            else:
                outputs = [one for one in node.outputs if one.type != "SHADER"]
                todo += [(one, outer_groups, node if changer is None else changer) for one in outputs]
    return is_normals


def set_materials(target, source, faces, images):
    """Give the target's faces (m,) copies of the source's materials with baked images, by `ImageUse.key`."""
    slots, groups = {}, []
    for number, slot in enumerate(source.material_slots):
        if slot.material is None or number not in faces:
            continue
        name = short_name(f"{slot.material.name} on {target.name}")
        material = slot.material.copy()
        groups += _copy_groups(material.node_tree, target.name)
        for use in image_uses(source, slot.material):
            if use.key in images:
                _set_image(material.node_tree, use.path, images[use.key])
        slots[number] = _slot_of(target, name, material)
    kept = numbers(target.data.polygons, "material_index", kind=np.int32)
    choice = [slots.get(number, int(before)) for number, before in zip(faces.tolist(), kept, strict=True)]
    target.data.polygons.foreach_set("material_index", np.array(choice, dtype=np.int32))
    made = [*groups, *images.values()]
    while unused := _unused_copies():  # removing a group may leave its images and inner groups unused
        made = [one for one in made if one not in unused]
        bpy.data.batch_remove(unused)
    for one in made:
        one.name = one["cagemap_made"]
    target.data.update()


def _unused_copies():
    """Node groups and images of this file that this or an earlier run made and that nothing uses."""
    values = (*bpy.data.node_groups, *bpy.data.images)
    return [one for one in values if one.get("cagemap_made") and not one.users and not one.library]


def _copy_groups(tree, suffix):
    """Copy the groups of a node tree that depend on the UV map, and let its Normal Map nodes use the active one."""
    copies = []
    for node in tree.nodes if tree else ():
        if node.type == "NORMAL_MAP":
            node.uv_map = ""
        elif node.type == "GROUP" and _uses_uvs(node.node_tree):
            name = node.node_tree.name
            node.node_tree = node.node_tree.copy()
            node.node_tree["cagemap_made"] = short_name(f"{name} on {suffix}")
            copies += [node.node_tree, *_copy_groups(node.node_tree, suffix)]
    return copies


def _uses_uvs(tree):
    nodes = tree.nodes if tree else ()
    return any(node.type in _UV_NODES or (node.type == "GROUP" and _uses_uvs(node.node_tree)) for node in nodes)


def _set_image(tree, path, image):
    """Give the image node at a path a baked image, in the UV map for rendering."""
    *groups, name = path
    for group in groups:
        tree = tree.nodes[group].node_tree
    node = tree.nodes[name]
    node.image = image
    for link in list(node.inputs["Vector"].links):
        tree.links.remove(link)


def _slot_of(target, name, material):
    """Number of a slot with the material: that of an earlier run, or a new one."""
    material["cagemap_made"] = name
    own = [slot.material.get("cagemap_made") if slot.material else None for slot in target.material_slots]
    if name in own:
        before = target.material_slots[own.index(name)].material
        target.material_slots[own.index(name)].material = material
        if not before.users:
            bpy.data.materials.remove(before)
    else:
        target.data.materials.append(material)
        own.append(name)
    material.name = name
    return own.index(name)
