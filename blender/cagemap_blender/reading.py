"""What the scene gives: control meshes, landmarks, groups, shapes and images as arrays.

Places are in the frame of an object of the pair: the world's axes and units, from that object's origin. So an object
that is moved stays matched.
"""

from __future__ import annotations

import hashlib
import re
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .client import RefusedError

_UV_SMOOTH = {
    "NONE": "all",
    "PRESERVE_CORNERS": "corners_only",
    "PRESERVE_CORNERS_AND_JUNCTIONS": "corners_plus1",
    "PRESERVE_CORNERS_JUNCTIONS_AND_CONCAVE": "corners_plus2",
    "PRESERVE_BOUNDARIES": "boundaries",
    "SMOOTH_ALL": "none",
}
_BOUNDARY = {"PRESERVE_CORNERS": "edge_and_corner", "ALL": "edge_only"}
_CAGE_MODIFIERS = ("SUBSURF", "MULTIRES")
# Modifiers that make other vertices, but near those of the control mesh: they also suit a garment that is moved.
_LOCAL_MODIFIERS = ("SOLIDIFY", "BEVEL", "TRIANGULATE", "EDGE_SPLIT", "DECIMATE", "WELD", "WIREFRAME", "MASK", "REMESH")
# Attributes that are no painted colours: the map itself.
MAP_COLORS = "cagemap"


def chosen_pair(context):
    """Target and source that are chosen in the panel."""
    settings = context.scene.cagemap
    for role in ("source", "target"):
        object_ = getattr(settings, role)
        if object_ is None or object_.name not in context.scene.objects:
            raise RefusedError(f"Choose a mesh as {role}.")
    if settings.target.data == settings.source.data:
        raise RefusedError("Target and source are the same mesh. Choose two.")
    return settings.target, settings.source


def object_in_edit_mode(context):
    """The first of target and source whose mesh is in Edit Mode, or None."""
    return next((object_ for object_ in chosen_pair(context) if object_.data.is_editmode), None)


def require_no_edit_mode(object_):
    """Refuse Edit Mode: there modifiers are not evaluated, and what is edited is not in the object yet."""
    if object_.mode == "EDIT" or (object_.type == "MESH" and object_.data.is_editmode):
        raise RefusedError(f"{object_.name} is in Edit Mode. Leave it (Tab), and press the button again.")


def sides(context):
    """Target and source, evaluated and outside Edit Mode."""
    target, source = chosen_pair(context)
    for object_ in (target, source):
        require_no_edit_mode(object_)
    if target.library or target.data.library:
        raise RefusedError(
            f"{target.name} is linked from another file, where nothing can be written. "
            "Make it local with its data (Object > Relations > Make Local)."
        )
    empties = [child for child in (*target.children, *source.children) if child.type == "EMPTY"]
    with enable_objects(context, target, source, *empties):
        pass  # places of disabled objects are those of now
    for role, object_ in (("target", target), ("source", source)):
        if not object_.data.vertices:
            raise RefusedError(f"{object_.name} has no vertices. Choose another {role}.")
    return target, source


def world(object_):
    """(4, 4) from the object's space to the world."""
    return np.array(object_.matrix_world, dtype=np.float64)


def in_frame(object_, places, of):
    """Places (n, 3) of an object's space in the frame of an object of the pair."""
    matrix = world(object_)
    return places @ matrix[:3, :3].T + (matrix[:3, 3] - world(of)[:3, 3])


def from_frame(object_, places, of):
    """Places (n, 3) in the frame of an object of the pair in the space of an object."""
    matrix = world(object_)
    return (places - (matrix[:3, 3] - world(of)[:3, 3])) @ np.linalg.inv(matrix[:3, :3]).T


def numbers(collection, name, width=1, kind=np.float32):
    """(n, width) or (n,) values of a property of everything in a collection."""
    values = np.empty(width * len(collection), dtype=kind)
    collection.foreach_get(name, values)
    return values.reshape(-1, width) if width > 1 else values


def coordinates(points):
    """(n, 3) float64 places of vertices or of a shape key's points."""
    return numbers(points, "co", 3).astype(np.float64)


def rest_positions(object_):
    """(n, 3) control vertices in the object's space, without shape keys and pose."""
    keys = object_.data.shape_keys
    return coordinates(keys.reference_key.data if keys else object_.data.vertices)


def mesh_arrays(context, object_, of=None):
    """The control mesh as `worker.control_mesh` takes it; ``of`` is the object of the pair that a garment sits on."""
    require_control_mesh(context, object_, allowed=_LOCAL_MODIFIERS if of else ())
    mesh = object_.data
    sizes, vertices = (
        numbers(mesh.polygons, "loop_total", kind=np.int32),
        numbers(mesh.loops, "vertex_index", kind=np.int32),
    )
    loops = np.arange(len(vertices))
    if np.linalg.det(world(object_)) < 0:  # a mirrored object shows its faces from the other side
        starts = np.repeat(np.cumsum(sizes) - sizes, sizes)
        loops = 2 * starts + np.repeat(sizes, sizes) - 1 - loops
    return {
        "name": object_.name,
        "positions": in_frame(object_, rest_positions(object_), of or object_),
        "sizes": sizes.astype(np.int64),
        "corners": vertices[loops].astype(np.int64),
        "loops": loops.astype(np.int64),
        **_subdivision(object_),
    }


def _subdivision(object_):
    """Scheme, options and creases as the modifier has them; a mesh without one is its own surface."""
    modifier = cage_modifier(object_)
    none = np.zeros((0, 2), dtype=np.int64), np.zeros(0)
    if modifier is None:
        return {"scheme": "none", "options": {}, "creases": none, "sharp_corners": none}
    simple = getattr(modifier, "subdivision_type", "CATMULL_CLARK") == "SIMPLE"
    subdivision = {
        "scheme": "bilinear" if simple else "catmull-clark",
        "options": {
            "boundary": _BOUNDARY[modifier.boundary_smooth],
            "uv_interpolation": _UV_SMOOTH[modifier.uv_smooth],
        },
        "creases": none,
        "sharp_corners": none,
    }
    if modifier.use_creases:
        mesh = object_.data
        edges = numbers(mesh.edges, "vertices", 2, np.int32).astype(np.int64)
        creased, sharp = _sharpness(mesh, "crease_edge"), _sharpness(mesh, "crease_vert")
        subdivision["creases"] = edges[np.flatnonzero(creased)], creased[creased > 0]
        subdivision["sharp_corners"] = np.flatnonzero(sharp), sharp[sharp > 0]
    return subdivision


def _sharpness(mesh, name):
    """Sharpness by edge or vertex: 10 c^2 of Blender's crease c."""
    attribute = mesh.attributes.get(name)
    return np.zeros(0) if attribute is None else 10.0 * numbers(attribute.data, "value").astype(np.float64) ** 2


def cage_modifier(object_):
    """The modifier that subdivides an object, None where none that is shown does."""
    return next((m for m in object_.modifiers if m.type in _CAGE_MODIFIERS and m.show_viewport), None)


@contextmanager
def enable_objects(context, *objects):
    """Let Blender evaluate objects: it leaves out those that are disabled in viewports, or whose collections are."""
    context.view_layer.update()
    scene_objects = context.scene.collection.objects
    disabled = [object_ for object_ in objects if not object_.visible_get()]
    hidden = [object_.hide_viewport for object_ in disabled]
    linked = [object_ for object_ in disabled if object_ not in scene_objects.values()]
    for object_ in disabled:
        object_.hide_viewport = False
    for object_ in linked:
        scene_objects.link(object_)
    if disabled:
        context.view_layer.update()
    try:
        yield
    finally:
        for object_, was_hidden in zip(disabled, hidden, strict=True):
            object_.hide_viewport = was_hidden
        for object_ in linked:
            scene_objects.unlink(object_)


def require_control_mesh(context, object_, allowed=()):
    """Refuse an object whose modifiers, but for those of allowed types, make other vertices before the subdivision."""
    require_no_edit_mode(object_)
    stack = list(object_.modifiers)
    subdivides = cage_modifier(object_)
    before = stack if subdivides is None else stack[: stack.index(subdivides)]
    before = [m for m in before if m.show_viewport and m.type not in allowed]
    shown = [m.show_viewport for m in stack]
    try:
        for modifier in stack:
            modifier.show_viewport = modifier in before
        with enable_objects(context, object_):
            mesh, own = object_.evaluated_get(context.evaluated_depsgraph_get()).data, object_.data
            same = (len(mesh.vertices), len(mesh.polygons)) == (len(own.vertices), len(own.polygons))
    finally:
        for modifier, on in zip(stack, shown, strict=True):
            modifier.show_viewport = on
    if not same:
        names = ", ".join(modifier.name for modifier in before)
        raise RefusedError(f"{object_.name}: its modifiers ({names}) add or remove vertices. Apply or hide them first.")


def plain_name(name):
    """A name without the number that Blender appends to names that are taken."""
    return re.sub(r"\.\d{3,}$", "", name)


def landmarks(object_):
    """Empties that are children of an object: lists by name."""
    empties = {}
    for child in object_.children:
        if child.type == "EMPTY":
            empties.setdefault(plain_name(child.name), []).append(child)
    return empties


def landmark_points(target, source):
    """Places of the landmarks of target and of source in their frames, by name.

    Raises
    ------
    RefusedError
        Several landmarks of an object have a name that the other one has too.
    """
    empties, points = {object_: landmarks(object_) for object_ in (target, source)}, []
    for object_, other in ((target, source), (source, target)):
        # Rounded, so that places stay exactly the same where object and landmarks are moved together.
        step, single = 1e-5 * np.ptp(rest_positions(object_) @ world(object_)[:3, :3].T, axis=0).max(), {}
        for name, children in empties[object_].items():
            if len(children) == 1:
                place = np.array(children[0].matrix_world.translation - object_.matrix_world.translation)
                single[name] = (step * np.rint(place / step)).tolist()
            elif name in empties[other]:
                raise RefusedError(f"{object_.name}: more than one landmark is called {name}. Rename or delete one.")
        points.append(single)
    return points


def match_arguments(context):
    """Arguments of `worker.Session.match`."""
    target, source = sides(context)
    target_points, source_points = landmark_points(target, source)
    return {
        "target": mesh_arrays(context, target),
        "source": mesh_arrays(context, source),
        "target_points": target_points,
        "source_points": source_points,
        "vertices": context.scene.cagemap.vertices,
    }


def digest(value):
    """A text that differs where arguments do."""
    hasher = hashlib.sha256()

    def add(one: Any) -> None:
        if isinstance(one, dict):
            for name in sorted(one):
                hasher.update(name.encode())
                add(one[name])
        elif isinstance(one, tuple):
            for part in one:
                add(part)
        else:
            hasher.update(one.tobytes() if isinstance(one, np.ndarray) else repr(one).encode())

    add(value)
    return hasher.hexdigest()


def vertex_groups(object_):
    """Weights (n,) of every vertex group, by name."""
    table = np.zeros((len(object_.vertex_groups), len(object_.data.vertices)))
    for vertex in object_.data.vertices:
        for element in vertex.groups:
            if element.group < len(table):  # else its group was removed
                table[element.group, vertex.index] = element.weight
    return {group.name: table[group.index] for group in object_.vertex_groups}


def armature_of(object_):
    """The first armature that deforms an object, or None."""
    return next((m.object for m in object_.modifiers if m.type == "ARMATURE" and m.object), None)


def is_animated(object_):
    """Whether an object has actions, also in its NLA tracks."""
    animation = object_.animation_data
    return animation is not None and bool(animation.action or animation.nla_tracks)


def bone_names(object_):
    """Names of the bones that deform an object: their groups are skin weights, all others are plain values."""
    armatures = [m.object for m in object_.modifiers if m.type == "ARMATURE" and m.object]
    return {bone.name for armature in armatures for bone in armature.data.bones if bone.use_deform}


def shape_offsets(object_):
    """Offsets (n, 3) of shape keys in the world's axes, by name."""
    keys, turn = object_.data.shape_keys, world(object_)[:3, :3]
    return {
        key.name: (coordinates(key.data) - coordinates(key.relative_key.data)) @ turn.T
        for key in (keys.key_blocks if keys else ())
        if key != keys.reference_key
    }


def masked_offsets(object_):
    """Offsets (n, 3) of shape keys where their vertex groups let them act, by name."""
    offsets, groups = shape_offsets(object_), vertex_groups(object_)
    for name, rows in offsets.items():
        group = object_.data.shape_keys.key_blocks[name].vertex_group
        if group in groups:
            rows *= groups[group][:, None]
    return offsets


def uv_layers(object_):
    """UVs (c, 2) of every layer by name."""
    return {layer.name: numbers(layer.uv, "vector", 2).astype(np.float64) for layer in object_.data.uv_layers}


def color_attributes(object_):
    """Colours (n, 4) of vertices or (c, 4) of face corners by name, with their domain and type."""
    return {
        one.name: (numbers(one.data, "color", 4).astype(np.float64), one.domain, one.data_type)
        for one in object_.data.color_attributes
        if one.name != MAP_COLORS
    }


def pixels_of(image):
    """Pixels (h, w, 4) of an image, row 0 at the top: of 8 bits where it has no more; of tiles by UDIM number."""
    if image.source == "TILED" and len(image.tiles) > 1:
        return {tile.number: _tile_pixels(image, tile.number) for tile in image.tiles}
    if image.source in ("SEQUENCE", "MOVIE"):
        raise RefusedError(f"{image.name} is a sequence or movie. Choose a single image.")
    width, height = image.size
    if not width or not height:
        name = Path(image.filepath).name
        raise RefusedError(f"{image.name}: its file {name} is missing. Find it, or remove its node.")
    values = np.empty(width * height * 4, dtype=np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(height, width, 4)[::-1]
    return np.ascontiguousarray(values) if image.is_float else np.rint(255 * values).astype(np.uint8)


def _tile_pixels(image, number):
    """Pixels of one tile, from its file: Blender gives those of the first tile only."""
    path = Path(bpy.path.abspath(image.filepath).replace("<UDIM>", str(number)))
    packed = next((one.packed_file for one in image.packed_files if one.tile_number == number), None)
    if image.is_dirty or not (packed or path.is_file()):
        raise RefusedError(f"{image.name}: the file of tile {number} is missing. Save the image with its tiles first.")
    with tempfile.TemporaryDirectory() as folder:
        if packed:
            path = Path(folder, f"tile{path.suffix}")  # an image that was never saved has no name
            path.write_bytes(packed.data)
        tile = bpy.data.images.load(str(path))
        try:
            tile.colorspace_settings.name = image.colorspace_settings.name
            return pixels_of(tile)
        finally:
            bpy.data.images.remove(tile)
