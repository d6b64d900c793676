"""The buttons."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector

from . import copies, reading, writing
from .client import RefusedError
from .materials import image_uses, set_materials
from .reading import sides
from .work import WORKER, Work, matching, pair_digest, show_answer

TRANSFERS = (
    (
        "TEXTURES",
        "Materials and Textures",
        "Copies of the source's materials, their images baked into the target's UVs",
    ),
    ("WEIGHTS", "Vertex Groups", "Groups of bones as skin weights, others as plain values"),
    ("SHAPES", "Shape Keys", "All shape keys of the source"),
    ("UVS", "UV Maps", "The source's UV maps, so that its images fit the target as they are"),
    ("COLORS", "Colour Attributes", "Painted vertex colours"),
    ("CLOTHES", "Clothes", "Copies of the other selected meshes, which sit on the source, on the target"),
)


class CAGEMAP_OT_match(Work, bpy.types.Operator):
    """Find the map between source and target, with the landmarks that both have, and show it as colours."""

    bl_idname = "cagemap.match"
    bl_label = "Match"
    bl_description = "Find the map between source and target, with the landmarks that both have; shown as colours"

    def requests(self, context):
        """Match again, also what is matched already."""
        WORKER.matched = ("", "")
        said = yield from matching(context)
        writing.show_in_views(context, "VERTEX")
        return said


class CAGEMAP_OT_transfer(Work, bpy.types.Operator):
    """Give the target what the source has, along the map."""

    bl_idname = "cagemap.transfer"
    bl_label = "Transfer"
    bl_description = "Give the target what is chosen above; matches first where that is not done yet"

    what: bpy.props.EnumProperty(items=TRANSFERS, options={"ENUM_FLAG"}, default={"TEXTURES"}, name="Transfer")

    def requests(self, context):
        """One transfer after another; nothing is written before all are computed."""
        carriers = {
            "TEXTURES": _textures,
            "WEIGHTS": _weights,
            "SHAPES": _shapes,
            "UVS": _uvs,
            "COLORS": _colors,
            "CLOTHES": _clothes,
        }
        if not self.what:
            raise RefusedError("Choose what to transfer.")
        yield from matching(context)
        written = []
        for name, carry in carriers.items():
            if name in self.what:
                written.append((yield from carry(context)))
        return ", ".join([write(context) for write in written]) + " transferred"


def counted(things, what):
    """How many there are, in words."""
    return f"{len(things)} {what}{'s' * (len(things) != 1)}"


def _textures(context):
    """Materials and images; what writes them."""
    target, source = sides(context)
    if not any(slot.material for slot in source.material_slots):
        raise RefusedError(f"{source.name} has no materials.")
    size, images, names = context.scene.cagemap.size, {}, {}
    uvs = reading.uv_layers(source)
    for use in (use for slot in source.material_slots for use in image_uses(source, slot.material)):
        if use.key in names:
            continue
        pixels, number = reading.pixels_of(use.image), sum(key[0] == use.image.name for key in names) + 1
        first = next(iter(pixels.values())) if isinstance(pixels, dict) else pixels
        names[use.key] = f"{use.image.name} {number}" if number > 1 else use.image.name
        images[names[use.key]] = {
            "name": names[use.key],
            "pixels": pixels,
            "size": (size, size) if size else first.shape[:2],
            "uvs": use.mapped(uvs[use.layer]),
            "normals": use.normals,
        }
    baked = {}
    if images:
        layer = next((layer for layer in target.data.uv_layers if layer.active_render), None)
        if layer is None:
            raise RefusedError(f"{target.name} has no UV map to bake into. Unwrap it, or transfer UV Maps instead.")
        uvs = reading.uv_layers(target)[layer.name]
        baked = (yield "bake", {"images": list(images.values()), "target_uvs": uvs})["images"]
        target, source = sides(context)
    last = max(len(source.material_slots) - 1, 0)  # which Blender shows where a face says a slot that is gone
    numbers = np.minimum(reading.numbers(source.data.polygons, "material_index", kind=np.int32), last)
    found = yield "materials", {"materials": numbers.astype(np.int64)}

    def write(context):
        target, source = sides(context)
        made = {
            key: writing.new_image(f"{name} on {target.name}", baked[name], bpy.data.images[key[0]])
            for key, name in names.items()
        }
        set_materials(target, source, found["materials"], made)
        for object_ in (target, source):
            writing.hide_map(object_)
        writing.show_in_views(context, "TEXTURE")
        return counted(made, "image")

    return write


def _weights(context):
    """Vertex groups; what writes them."""
    target, source = sides(context)
    groups, bones = reading.vertex_groups(source), reading.bone_names(source)
    if not groups:
        raise RefusedError(f"{source.name} has no vertex groups.")
    writing.require_free(target, "vertex group", groups)
    skin = [name for name in groups if name in bones]
    found = {}
    if skin:
        table = (yield "weights", {"weights": np.column_stack([groups[name] for name in skin])})["weights"]
        found = dict(zip(skin, table.T, strict=True))
    others = {name: groups[name] for name in groups if name not in found}
    found |= (yield "values", {"vertices": others, "corners": {}})["vertices"]

    def write(context):
        writing.set_groups(sides(context)[0], found)
        return counted(found, "vertex group")

    return write


def _named(kind, read, request, write_reply):
    """Transfer of values that have names: ``request`` asks the worker for them, ``write_reply`` writes them."""

    def carry(context):
        target, source = sides(context)
        given = read(source)
        if not given:
            raise RefusedError(f"{source.name} has no {kind}s.")
        writing.require_free(target, kind, given)
        reply = yield request(given)

        def write(context):
            write_reply(sides(context)[0], reply, given)
            return counted(given, kind)

        return write

    return carry


def _color_request(colors):
    """Colours by their domain."""
    vertices, corners = (
        {name: values for name, (values, own, _) in colors.items() if own == domain} for domain in ("POINT", "CORNER")
    )
    return "values", {"vertices": vertices, "corners": corners}


def _set_colors(target, reply, colors):
    """Colour attributes with the domains and types of the source's."""
    values = reply["vertices"] | reply["corners"]
    writing.set_colors(target, {name: (values[name], *colors[name][1:]) for name in values})


_shapes = _named(
    "shape key",
    reading.shape_offsets,
    lambda offsets: ("shapes", {"shapes": offsets}),
    lambda target, reply, _: writing.set_shapes(target, reply["shapes"]),
)
_uvs = _named(
    "UV map",
    reading.uv_layers,
    lambda layers: ("values", {"vertices": {}, "corners": layers}),
    lambda target, reply, _: writing.set_uvs(target, reply["corners"]),
)
_colors = _named("colour attribute", reading.color_attributes, _color_request, _set_colors)


def _clothes(context):
    """Selected meshes that sit on the source; what writes copies of them."""
    _, source = sides(context)
    garments = _garments(context)
    if not garments:
        raise RefusedError("Select the clothes as well: meshes other than source and target.")
    names = [garment.name for garment in garments]
    meshes = [reading.mesh_arrays(context, garment, of=source) for garment in garments]
    shapes = [reading.shape_offsets(garment) for garment in garments]
    reply = yield "clothes", {"meshes": meshes, "shapes": shapes}

    def write(context):
        target, source = sides(context)
        made = {
            bpy.data.objects[name]: copies.copy_garment(context, bpy.data.objects[name], target, source, *arrays)
            for name, *arrays in zip(names, reply["positions"], reply["shapes"], strict=True)
        }
        notes = copies.fit_modifiers(made, target, source)
        return counted(names, "garment") + (f" (removed, to be bound again: {', '.join(notes)})" if notes else "")

    return write


def _garments(context):
    """Selected meshes other than the pair and than copies that an earlier run made for the target."""
    pair = sides(context)
    return [
        object_
        for object_ in context.scene.objects
        if object_.select_get()
        and object_.type == "MESH"
        and object_ not in pair
        and not object_.get("cagemap_copy", "").endswith(f" on {pair[0].name}")
    ]


class CAGEMAP_OT_wrap(Work, bpy.types.Operator):
    """Give the target the shape of the source, as a shape key."""

    bl_idname = "cagemap.wrap"
    bl_label = "Wrap"
    bl_description = "Give the target the shape and place of the source, as a shape key"

    def requests(self, context):
        """The wrapped cage."""
        yield from matching(context)
        positions = (yield "wrap", {})["positions"]
        target, source = sides(context)
        writing.require_rows(target, len(positions))
        name = writing.short_name(f"wrapped {source.name}")
        writing.set_positions(target, {name: reading.from_frame(target, positions, source)})
        target.data.shape_keys.key_blocks[name].value = 1.0
        return f"{target.name} has the shape key {name}"


class CAGEMAP_OT_rig(Work, bpy.types.Operator):
    """Rig the target like the source: skeleton, skin weights, and the selected clothes."""

    bl_idname = "cagemap.rig"
    bl_label = "Rig Like"
    bl_description = "Rig the target like the source: a copy of its armature that fits, skin weights, selected clothes"

    def requests(self, context):
        """Bones, weights, clothes."""
        target, source = sides(context)
        armature = reading.armature_of(source)
        if armature is None:
            raise RefusedError(f"{source.name} has no armature: add one, or choose another source.")
        own = reading.armature_of(target)
        if own is not None:
            raise RefusedError(f"{target.name} is rigged already, by {own.name}. Remove its Armature modifier first.")
        yield from matching(context)
        _, source = sides(context)  # others after Undo
        armature = reading.armature_of(source)
        if armature is None:
            raise RefusedError(f"{source.name} lost its armature meanwhile. Press the button again.")
        bones, matrix = armature.data.bones, reading.world(armature)
        matrix[:3, 3] -= reading.world(source)[:3, 3]
        number = {bone.name: row for row, bone in enumerate(bones)}
        found = yield (
            "rig",
            {
                "names": list(number),
                "parents": np.array([number[bone.parent.name] if bone.parent else -1 for bone in bones]),
                "matrices": np.array([matrix @ np.array(bone.matrix_local) for bone in bones]),
                "tails": reading.in_frame(armature, np.array([bone.tail_local for bone in bones]), source),
            },
        )
        writers = [(yield from _weights(context))]
        if _garments(context):
            writers.append((yield from _clothes(context)))
        target, source = sides(context)
        armature = reading.armature_of(source)
        made = copies.copy_armature(context, armature, target, source, found["matrices"], found["tails"])
        copies.bind(target, made)
        said = [write(context) for write in writers]
        return f"{target.name} is rigged by {made.name}: {', '.join(said)}"


class CAGEMAP_OT_landmark(Work, bpy.types.Operator):
    """Add a landmark: an empty on the target at the 3D cursor, and one where the map leads it; drag them."""

    bl_idname = "cagemap.landmark"
    bl_label = "Add Landmark"
    bl_description = (
        "Put an empty on the target, at the 3D cursor, and one on the source where the map leads; drag them"
    )

    def requests(self, context):
        """The place on the source."""
        yield from matching(context)
        target, _ = sides(context)
        found = yield "image", {"place": list(context.scene.cursor.location - target.matrix_world.translation)}
        target, source = sides(context)
        known = reading.landmarks(target) | reading.landmarks(source)
        name = next(f"landmark {n}" for n in range(1, len(known) + 2) if f"landmark {n}" not in known)
        size = 0.02 * max(target.dimensions)
        for thing, where in ((target, found["target"]), (source, found["source"])):
            empty = bpy.data.objects.new(name, None)
            context.collection.objects.link(empty)
            empty.empty_display_type, empty.empty_display_size, empty.show_in_front = "SPHERE", size, True
            empty.parent, empty.matrix_parent_inverse = thing, thing.matrix_world.inverted()
            empty.location = thing.matrix_world.translation + Vector(where)
        yield from following(context)
        return f"{name}: drag one of its two empties, and the map follows"


def following(context):
    """Requests that let a finished map follow the landmarks as they are now; the sentences about it."""
    arguments = reading.match_arguments(context)
    asked = pair_digest(arguments)
    if not WORKER.has_match or WORKER.matched[0] != asked[0]:
        raise RefusedError("The two objects are not matched as they are now. Press Match.")
    if WORKER.matched == asked:
        return context.scene.cagemap.said
    names = [object_.name for object_ in sides(context)]
    found = yield "update", {name: arguments[name] for name in ("target_points", "source_points")}
    WORKER.matched = asked
    if [object_.name for object_ in sides(context)] != names:
        raise RefusedError("Other objects were chosen. Press Match.")
    return show_answer(context, found)


class CAGEMAP_OT_follow(Work, bpy.types.Operator):
    """Let the map follow the landmarks as they are now."""

    bl_idname = "cagemap.follow"
    bl_label = "Follow Landmarks"
    bl_description = "Let the map follow the landmarks as they are now; much faster than matching again"

    def requests(self, context):
        """The moved map."""
        return (yield from following(context))


CLASSES = (
    CAGEMAP_OT_match,
    CAGEMAP_OT_transfer,
    CAGEMAP_OT_wrap,
    CAGEMAP_OT_rig,
    CAGEMAP_OT_landmark,
    CAGEMAP_OT_follow,
)
