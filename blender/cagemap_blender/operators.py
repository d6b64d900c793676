"""The buttons."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector

from . import copies, reading, transfers, writing
from .client import RefusedError
from .reading import sides
from .work import WORKER, Work, matching, pair_digest, show_answer


class CAGEMAP_OT_match(Work, bpy.types.Operator):
    """Find the map between source and target, with the landmarks that both have; shown as colours."""

    bl_idname = "cagemap.match"
    bl_label = "Match"

    def requests(self, context):
        """Match again, also what is matched already."""
        WORKER.matched = ("", "")
        message = yield from matching(context)
        writing.show_in_views(context, "VERTEX")
        return message


class CAGEMAP_OT_transfer(Work, bpy.types.Operator):
    """Give the target what is chosen above; matches first if needed."""

    bl_idname = "cagemap.transfer"
    bl_label = "Transfer"

    what: bpy.props.EnumProperty(items=transfers.ITEMS, options={"ENUM_FLAG"}, default={"TEXTURES"}, name="Transfer")

    def requests(self, context):
        """One transfer after another; all are computed before the first is written."""
        if not self.what:
            raise RefusedError("Choose what to transfer.")
        yield from matching(context)
        writers = []
        for kind in transfers.KINDS:
            if kind.identifier in self.what:
                writers.append((yield from kind.requests(context)))
        return ", ".join([write(context) for write in writers]) + " transferred"


class CAGEMAP_OT_wrap(Work, bpy.types.Operator):
    """Give the target the shape and place of the source, as a shape key."""

    bl_idname = "cagemap.wrap"
    bl_label = "Wrap"

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
    """Rig the target like the source: a copy of its armature that fits, skin weights, selected clothes."""

    bl_idname = "cagemap.rig"
    bl_label = "Rig Like"

    def requests(self, context):
        """Bones, weights, clothes."""
        target, source = sides(context)
        armature = reading.armature_of(source)
        if armature is None:
            raise RefusedError(f"{source.name} has no armature: add one, or choose another source.")
        own = reading.armature_of(target)
        if own is not None:
            raise RefusedError(f"{target.name} is rigged already, by {own.name}. Remove its Armature modifier first.")
        key = writing.identity(armature)
        yield from matching(context)
        _, source = sides(context)  # other objects after Undo
        armature = writing.require_existing(bpy.data.objects, key)
        reading.require_no_edit_mode(armature)
        with reading.enable_objects(context, armature):
            pass
        bones, matrix = armature.data.bones, reading.world(armature)
        matrix[:3, 3] -= reading.world(source)[:3, 3]
        number = {bone.name: row for row, bone in enumerate(bones)}
        reply = yield (
            "rig",
            {
                "names": list(number),
                "parents": np.array([number[bone.parent.name] if bone.parent else -1 for bone in bones]),
                "matrices": np.array([matrix @ np.array(bone.matrix_local) for bone in bones]),
                "tails": reading.in_frame(armature, np.array([bone.tail_local for bone in bones]), source),
            },
        )
        write_weights = yield from transfers.transfer_weights(context)
        write_clothes = None
        if transfers.selected_garments(context):
            write_clothes = yield from transfers.transfer_clothes(context)
        target, source = sides(context)
        armature = writing.require_existing(bpy.data.objects, key)
        modifier = next((m for m in source.modifiers if m.type == "ARMATURE" and m.object), None)
        if modifier is None:
            raise RefusedError(f"{source.name} was changed while cagemap computed. Press the button again.")
        messages = [write_weights(context)]  # may be refused: before the armature is copied
        rig = copies.copy_armature(context, armature, target, source, reply["matrices"], reply["tails"])
        copies.bind(target, rig, template=modifier)
        if write_clothes is not None:
            messages.append(write_clothes(context))
        note = ""
        if reply["is_posed"] and reading.is_animated(armature):
            note = f". {target.name} stands in another pose than {source.name}: actions are not adapted to it"
        return f"{target.name} is rigged by {rig.name}: {', '.join(messages)}{note}"


class CAGEMAP_OT_landmark(Work, bpy.types.Operator):
    """Put an empty on the target, at the 3D cursor, and one on the source where the map leads; drag them."""

    bl_idname = "cagemap.landmark"
    bl_label = "Add Landmark"

    def requests(self, context):
        """The place on the source."""
        yield from matching(context)
        target, _ = sides(context)
        reply = yield "image", {"place": list(context.scene.cursor.location - target.matrix_world.translation)}
        target, source = sides(context)
        known = reading.landmarks(target) | reading.landmarks(source)
        name = next(f"landmark {n}" for n in range(1, len(known) + 2) if f"landmark {n}" not in known)
        size = 0.02 * max(target.dimensions)
        for object_, place in ((target, reply["target"]), (source, reply["source"])):
            empty = bpy.data.objects.new(name, None)
            context.collection.objects.link(empty)
            empty.empty_display_type, empty.empty_display_size, empty.show_in_front = "SPHERE", size, True
            empty.parent, empty.matrix_parent_inverse = object_, object_.matrix_world.inverted()
            empty.location = object_.matrix_world.translation + Vector(place)
        yield from following(context)
        return f"{name}: drag one of its two empties, and the map follows"


def following(context):
    """Update the map for the landmarks as they are now; the message about it."""
    arguments = reading.match_arguments(context)
    matched = pair_digest(arguments)
    if not WORKER.has_match or WORKER.matched[0] != matched[0]:
        raise RefusedError("The two objects are not matched as they are now. Press Match.")
    if WORKER.matched == matched:
        return context.scene.cagemap.message
    names = [object_.name for object_ in sides(context)]
    reply = yield "update", {name: arguments[name] for name in ("target_points", "source_points")}
    WORKER.matched = matched
    if [object_.name for object_ in sides(context)] != names:
        raise RefusedError("Other objects were chosen. Press Match.")
    return show_answer(context, reply)


class CAGEMAP_OT_follow(Work, bpy.types.Operator):
    """Let the map follow the landmarks as they are now; much faster than matching again."""

    bl_idname = "cagemap.follow"
    bl_label = "Follow Landmarks"

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
