"""Copies of objects for the target: garments and armatures."""

from __future__ import annotations

from contextlib import contextmanager

import bpy
import numpy as np

from .reading import armature_of, from_frame, world
from .writing import require_rows, short_name

# Modifiers that keep every vertex's place from when they were bound, and the property that says whether they are bound.
_BOUND = {
    "SURFACE_DEFORM": "is_bound",
    "MESH_DEFORM": "is_bound",
    "LAPLACIANDEFORM": "is_bind",
    "CORRECTIVE_SMOOTH": "is_bind",
}
# Options of an Armature modifier that change how bones deform.
_ARMATURE_OPTIONS = (
    "use_deform_preserve_volume",
    "use_bone_envelopes",
    "use_vertex_groups",
    "vertex_group",
    "invert_vertex_group",
)


def copy_garment(context, garment, target, source, positions, offsets):
    """A copy of a garment in the target's collections, with positions (n, 3) in the target's frame."""
    require_rows(garment, len(positions))
    name = short_name(f"{garment.name} on {target.name}")
    _remove_copy(name)
    copy = garment.copy()
    copy.data = garment.data.copy()
    copy.name = copy["cagemap_copy"] = name
    for collection in target.users_collection:
        collection.objects.link(copy)
    copy.parent = None
    copy.matrix_world = moved_matrix(garment, target, source)
    context.view_layer.update()
    places, turn = from_frame(copy, positions, target), np.linalg.inv(world(copy)[:3, :3])
    copy.data.vertices.foreach_set("co", places.astype(np.float32).ravel())
    keys = copy.data.shape_keys
    for key in keys.key_blocks if keys else ():
        shape = places + _offset_of(key, offsets) @ turn.T
        key.data.foreach_set("co", shape.astype(np.float32).ravel())
    copy.data.update()
    return copy


def _offset_of(key, offsets, seen=()):
    """Offset (n, 3) or 0 of a shape key from the basis: its own from its relative key, and that key's."""
    if key.name not in offsets or key.name in seen:
        return np.zeros(3)
    return offsets[key.name] + _offset_of(key.relative_key, offsets, (*seen, key.name))


def _remove_copy(name):
    """Remove the copy that an earlier run made, if it still has its name."""
    object_ = bpy.data.objects.get(name)
    if object_ is not None and object_.get("cagemap_copy") == name:
        mesh = object_.data
        bpy.data.objects.remove(object_)
        if not mesh.users:
            bpy.data.meshes.remove(mesh)


def fit_modifiers(copies, target, source):
    """Let copies of garments, by garment, refer to the target and its armature; names of modifiers to bind again."""
    removed, armatures = [], (armature_of(source), armature_of(target))
    pairs = ((source, target), armatures, (source.data.shape_keys, target.data.shape_keys))
    replacements = {old: new for old, new in pairs if old and new} | copies
    for garment, copy in copies.items():
        for modifier in list(copy.modifiers):
            bound = modifier.type in _BOUND and getattr(modifier, _BOUND[modifier.type])
            if bound:
                removed.append(f"{modifier.name} of {copy.name}")
            if bound or (modifier.type == "ARMATURE" and armatures[1] is None):
                copy.modifiers.remove(modifier)
        redirect(copy, replacements)
        _copy_parent(copy, garment, replacements.get(garment.parent))
        if armatures[1] is not None and copy.parent_type != "BONE":
            bind(copy, armatures[1])
    return removed


def find_unweighted(copies, armature):
    """Names of copies of garments that an armature does not move: neither weights nor a bone as parent."""
    bones = set(armature.data.bones.keys()) if armature else set()
    return [
        copy.name
        for copy in copies
        if armature and copy.parent_type != "BONE" and not bones.intersection(copy.vertex_groups.keys())
    ]


def _copy_parent(copy, garment, parent):
    """Parent a copy, where it stands, to what replaces the garment's parent: eyes stay on the head's bone."""
    if parent is None or garment.parent_type not in ("OBJECT", "BONE"):
        return
    matrix = copy.matrix_world.copy()
    copy.parent, copy.parent_type, copy.parent_bone = parent, garment.parent_type, garment.parent_bone
    copy.matrix_world = matrix


def moved_matrix(object_, target, source):
    """The object's matrix, moved as the target stands from the source."""
    matrix = object_.matrix_world.copy()
    matrix.translation += target.matrix_world.translation - source.matrix_world.translation
    return matrix


def redirect(object_, replacements):
    """Replace the objects that modifiers, constraints and drivers of a copied object refer to."""
    bones = object_.pose.bones if object_.pose else ()
    constraints = [*object_.constraints, *(constraint for bone in bones for constraint in bone.constraints)]
    for owner in (*object_.modifiers, *constraints):
        for part in (owner, *getattr(owner, "targets", ())):
            for one in part.bl_rna.properties:
                if one.type == "POINTER" and not one.is_readonly and getattr(part, one.identifier) in replacements:
                    setattr(part, one.identifier, replacements[getattr(part, one.identifier)])
    for owner in (object_, object_.data, getattr(object_.data, "shape_keys", None)):
        for curve in owner.animation_data.drivers if owner and owner.animation_data else ():
            for target in (target for variable in curve.driver.variables for target in variable.targets):
                if target.id in replacements:
                    target.id = replacements[target.id]


def copy_armature(context, armature, target, source, matrices, tails):
    """A copy of an armature with bones at matrices (j, 4, 4) and tails (j, 3) in the target's frame."""
    copy = armature.copy()
    copy.data = armature.data.copy()
    copy.name = short_name(f"{armature.name} on {target.name}")
    copy.parent = None  # what moves the source is not to move the target
    for collection in target.users_collection:
        collection.objects.link(copy)
    copy.matrix_world = moved_matrix(armature, target, source)
    redirect(copy, {armature: copy, armature.data: copy.data, source: target})
    with _editable(context, copy):
        _place_bones(
            copy, matrices[:, :3], from_frame(copy, matrices[:, :3, 3], target), from_frame(copy, tails, target)
        )
    return copy


@contextmanager
def _editable(context, object_):
    """Show an object and make it active: only such objects have an Edit Mode."""
    scene_collection = context.scene.collection
    active, hidden = context.view_layer.objects.active, object_.hide_viewport
    linked = object_.name in scene_collection.objects
    object_.hide_viewport = False
    if not linked:  # the other collections may be hidden
        scene_collection.objects.link(object_)
    context.view_layer.update()
    concealed = object_.hide_get()
    object_.hide_set(False)
    context.view_layer.objects.active = object_
    try:
        with context.temp_override(active_object=object_, object=object_, selected_objects=[object_]):
            yield
    finally:
        context.view_layer.objects.active = active
        object_.hide_set(concealed)
        object_.hide_viewport = hidden
        if not linked:
            scene_collection.objects.unlink(object_)


def _place_bones(armature, matrices, heads, ends):
    """Move the bones of a shown armature: axes of matrices (j, 3, 4) in the world, ends (j, 3) in its own space."""
    turn, names = np.linalg.inv(world(armature)[:3, :3]), [bone.name for bone in armature.data.bones]
    is_mirrored = armature.data.use_mirror_x
    armature.data.use_mirror_x = False  # else bones move those of the other side
    bpy.ops.object.mode_set(mode="EDIT")
    bones = armature.data.edit_bones
    connected = [bones[name].use_connect for name in names]
    for name in names:
        bones[name].use_connect = False
    for row, name in enumerate(names):
        bone = bones[name]
        along, up = turn @ matrices[row, :, 1], turn @ matrices[row, :, 2]
        length = max(float(np.linalg.norm(ends[row] - heads[row])), 1e-6)
        bone.head = heads[row]
        bone.tail = heads[row] + length / np.linalg.norm(along) * along
        bone.align_roll(up)
    for name, on in zip(names, connected, strict=True):
        if on:
            bones[name].parent.tail = bones[name].head
            bones[name].use_connect = True
    bpy.ops.object.mode_set(mode="OBJECT")
    armature.data.use_mirror_x = is_mirrored


def bind(object_, armature, template=None):
    """Let an armature deform an object, before all that subdivides it, with the options of modifier ``template``."""
    modifier = next((m for m in object_.modifiers if m.type == "ARMATURE"), None)
    if modifier is None:
        modifier = object_.modifiers.new("Armature", "ARMATURE")
        object_.modifiers.move(len(object_.modifiers) - 1, 0)
    modifier.object = armature
    for option in _ARMATURE_OPTIONS if template else ():
        setattr(modifier, option, getattr(template, option))
