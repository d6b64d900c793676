"""Checks of rigs and clothes: what is copied to the target, and what their parts refer to then."""

import bpy
import numpy as np
from scene_kit import SETTINGS, Window, change_all_objects, check, operators, pair, refusal, work


def rig(object_):
    """A skeleton of two bones for an object, with weights and inverse kinematics."""
    bones = bpy.data.armatures.new("bones")
    armature = bpy.data.objects.new("skeleton", bones)
    bpy.context.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    for name, low, high in (("root", -0.8, 0.0), ("tip", 0.0, 0.8)):
        bone = bones.edit_bones.new(name)
        bone.head, bone.tail = (0.0, 0.0, low), (0.0, 0.0, high)
    bpy.ops.object.mode_set(mode="OBJECT")
    object_.modifiers.new("Armature", "ARMATURE").object = armature
    numbers = range(len(object_.data.vertices))
    for name in ("root", "tip"):
        object_.vertex_groups.new(name=name).add(list(numbers), 0.5, "REPLACE")
    return armature


@check
def an_armature_that_is_disabled_or_hidden_is_copied():
    source, target = pair()
    armature = rig(source)
    armature.hide_viewport = True
    hidden = bpy.data.collections.new("hidden")
    bpy.context.scene.collection.children.link(hidden)
    hidden.objects.link(target)
    bpy.context.scene.collection.objects.unlink(target)
    hidden.hide_viewport = True
    bpy.context.view_layer.objects.active = source
    bpy.ops.object.mode_set(mode="WEIGHT_PAINT")
    bpy.ops.cagemap.rig()
    assert source.mode == "WEIGHT_PAINT"
    bpy.ops.object.mode_set(mode="OBJECT")
    made = target.modifiers["Armature"].object
    assert made.name == "skeleton on target"
    assert made.hide_viewport
    assert [collection.name for collection in made.users_collection] == ["hidden"]
    assert sorted(group.name for group in target.vertex_groups) == ["root", "tip"]
    assert made.data.bones["tip"].length > 0.1


def started_rig():
    """A pair whose source has a rig, and a window in which Rig Like has begun to carry weights."""
    source, target = pair()
    rig(source)
    window = Window()
    button, _ = window.press(operators.CAGEMAP_OT_rig)
    window.wait_for(button, "carry weights")
    return source, target, window, button


@check
def a_group_made_during_rig_like_leaves_no_armature():
    _, target, window, button = started_rig()
    target.vertex_groups.new(name="tip")
    assert window.finish(button) == "CANCELLED"
    assert "vertex groups of its own called tip" in window.reports[-1][1]
    assert [one.name for one in bpy.data.objects if one.type == "ARMATURE"] == ["skeleton"]
    assert not target.modifiers


@check
def an_armature_modifier_removed_during_rig_like_ends_it():
    source, target, window, button = started_rig()
    source.modifiers.clear()
    assert window.finish(button) == "CANCELLED"
    assert "source was changed while cagemap computed" in window.reports[-1][1]
    assert [one.name for one in bpy.data.objects if one.type == "ARMATURE"] == ["skeleton"]
    assert not target.vertex_groups


@check
def what_a_rig_refers_to_is_redirected_to_its_copy():
    source, target = pair()
    armature = rig(source)
    bone = armature.pose.bones["tip"]
    chain, blend = (bone.constraints.new(kind) for kind in ("IK", "ARMATURE"))
    chain.target = chain.pole_target = armature
    chain.subtarget = chain.pole_subtarget = "root"
    one = blend.targets.new()
    one.target, one.subtarget = armature, "root"
    armature.constraints.new("COPY_SCALE").target = source
    for owner, path in ((bone, "location"), (armature.data, "show_names")):
        driver = owner.driver_add(path)
        for curve in driver if isinstance(driver, list) else [driver]:
            for id_type, id_ in (("OBJECT", armature), ("ARMATURE", armature.data)):
                variable = curve.driver.variables.new()
                variable.targets[0].id_type = id_type
                variable.targets[0].id = id_
    bpy.ops.cagemap.rig()
    made = target.modifiers["Armature"].object
    chain, blend = made.pose.bones["tip"].constraints
    assert [chain.target, chain.pole_target, blend.targets[0].target] == 3 * [made]
    assert made.constraints[0].target == target
    curves = [*made.animation_data.drivers, *made.data.animation_data.drivers]
    assert len(curves) == 4
    for curve in curves:
        assert [variable.targets[0].id for variable in curve.driver.variables] == [made, made.data]
    chain, blend = bone.constraints
    assert [chain.target, chain.pole_target, blend.targets[0].target] == 3 * [armature]


def garment(source):
    """A selected shell around the source."""
    shirt = source.copy()
    shirt.data, shirt.name = source.data.copy(), "shirt"
    bpy.context.collection.objects.link(shirt)
    for vertex in shirt.data.vertices:
        vertex.co += 0.05 * vertex.normal
    bpy.context.view_layer.update()
    shirt.select_set(True)
    return shirt


@check
def modifiers_of_clothes_refer_to_the_target():
    source, target = pair()
    shirt = garment(source)
    shrink, bound, free = (
        shirt.modifiers.new(name, kind)
        for name, kind in (("Fit", "SHRINKWRAP"), ("Bound", "SURFACE_DEFORM"), ("Free", "SURFACE_DEFORM"))
    )
    shrink.target = bound.target = free.target = source
    plain = bpy.data.objects.new("cube", bpy.data.meshes.new("cube"))
    plain.data.from_pydata([(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], [], [(0, 1, 2, 3)])
    bpy.context.collection.objects.link(plain)
    bound.target = plain
    bpy.context.view_layer.objects.active = shirt
    bpy.context.view_layer.update()
    bpy.ops.object.surfacedeform_bind(modifier="Bound")
    source.shape_key_add(name="Basis")
    target.shape_key_add(name="Basis")
    shirt.shape_key_add(name="Basis")
    for id_type, id_ in (("OBJECT", source), ("KEY", source.data.shape_keys)):
        driven = shirt.shape_key_add(name=id_type)
        aim = driven.driver_add("value").driver.variables.new().targets[0]
        aim.id_type, aim.id = id_type, id_
    assert bound.is_bound
    bpy.ops.cagemap.transfer(what={"CLOTHES"})
    made = bpy.data.objects["shirt on target"]
    assert [modifier.name for modifier in made.modifiers] == ["Fit", "Free"]
    assert [modifier.target for modifier in made.modifiers] == [target, target]
    drivers = made.data.shape_keys.animation_data.drivers
    assert [one.driver.variables[0].targets[0].id for one in drivers] == [target, target.data.shape_keys]
    assert "bound again: Bound of shirt on target" in SETTINGS.message
    assert [modifier.target for modifier in shirt.modifiers] == [source, plain, source]


@check
def shape_keys_of_clothes_stay_relative_to_their_keys():
    source, _ = pair()
    shirt = garment(source)
    basis, wide, long = (shirt.shape_key_add(name=name) for name in ("Basis", "wide", "long"))
    for row, vertex in enumerate(basis.data):
        wide.data[row].co.x = 1.3 * vertex.co.x
        long.data[row].co = wide.data[row].co
        long.data[row].co.z += 0.2
    long.relative_key = wide
    bpy.ops.cagemap.transfer(what={"CLOTHES"})
    keys = bpy.data.objects["shirt on target"].data.shape_keys.key_blocks
    assert keys["long"].relative_key == keys["wide"]
    for key in (basis, wide, long):  # source and target are the same
        before, after = (np.array([point.co for point in one.data]) for one in (key, keys[key.name]))
        assert np.abs(before - after).max() < 0.03, (key.name, np.abs(before - after).max())


@check
def clothes_that_are_far_away_are_reported():
    source, _ = pair()
    garment(source).location.z += 50.0
    bpy.context.view_layer.update()
    bpy.ops.cagemap.transfer(what={"CLOTHES"})
    assert "1 garment (shirt is " in SETTINGS.message
    assert "check its place and size)" in SETTINGS.message


@check
def actions_of_a_body_in_another_pose_are_reported():
    source, _ = pair()
    armature = rig(source)
    whole = work.WORKER.receive

    def receive(**options):
        message = whole(**options)
        if message is not None and message[0] == "done" and "is_posed" in message[1]:
            message[1]["is_posed"] = True
        return message

    work.WORKER.receive = receive
    try:
        for animated in (False, True):
            if animated:
                armature.keyframe_insert("location", frame=1)
            bpy.ops.cagemap.rig()
            assert ("target stands in another pose than source" in SETTINGS.message) == animated
            SETTINGS.target.modifiers.clear()
    finally:
        del work.WORKER.receive


@check
def a_second_run_replaces_clothes():
    source, _ = pair()
    garment(source)
    for _ in range(2):
        bpy.ops.cagemap.transfer(what={"CLOTHES"})
        assert sorted(object_.name for object_ in bpy.data.objects) == ["shirt", "shirt on target", "source", "target"]
        bpy.ops.object.select_all(action="SELECT")  # results are no clothes of the source


@check
def clothes_may_be_thickened_but_not_mirrored():
    source, _ = pair()
    shirt = garment(source)
    shirt.modifiers.new("Solidify", "SOLIDIFY")
    assert not refusal(bpy.ops.cagemap.transfer, what={"CLOTHES"})
    made = bpy.data.objects["shirt on target"]
    assert len(made.data.vertices) == len(shirt.data.vertices)
    assert made.modifiers[0].type == "SOLIDIFY"
    shirt.modifiers.new("Mirror", "MIRROR")
    assert "shirt: its modifiers (Mirror)" in refusal(bpy.ops.cagemap.transfer, what={"CLOTHES"})


@check
def undo_while_rig_like_matches_leaves_no_removed_objects():
    source, _ = pair()
    rig(source)
    change_all_objects()
    window = Window()
    button, _ = window.press(operators.CAGEMAP_OT_rig)
    bpy.ops.ed.undo()
    assert window.finish(button) == "FINISHED"
    assert bpy.data.objects["target"].modifiers["Armature"].object == bpy.data.objects["skeleton on target"]


@check
def bones_of_a_mirrored_armature_are_placed_one_by_one():
    source, target = pair()
    armature = rig(source)
    bpy.ops.object.mode_set(mode="EDIT")
    for name, side in (("ear.L", 1.0), ("ear.R", -1.0)):
        bone = armature.data.edit_bones.new(name)
        bone.head, bone.tail = (0.6 * side, 0.0, 0.3), (1.2 * side, 0.0, 0.5)
    bpy.ops.object.mode_set(mode="OBJECT")
    armature.data.use_mirror_x = True
    for vertex in target.data.vertices:
        vertex.co.x *= 1.6 if vertex.co.x > 0 else 1.0
    bpy.ops.cagemap.rig()
    made = target.modifiers["Armature"].object.data
    assert made.use_mirror_x
    assert made.bones["ear.L"].head_local.x > 0.8
    assert made.bones["ear.R"].head_local.x > -0.7


@check
def edit_mode_of_all_that_is_read_is_refused():
    source, target = pair()
    armature, shirt = rig(source), garment(source)
    twin = target.copy()  # of the same mesh
    bpy.context.collection.objects.link(twin)
    for object_, name in ((armature, "skeleton"), (shirt, "shirt"), (twin, "target")):
        bpy.context.view_layer.objects.active = object_
        bpy.ops.object.mode_set(mode="EDIT")
        shirt.select_set(True)
        assert f"{name} is in Edit Mode" in refusal(bpy.ops.cagemap.rig), name
        bpy.ops.object.mode_set(mode="OBJECT")
    assert not target.modifiers


@check
def clothes_keep_their_parents_on_the_target():
    source, target = pair()
    armature, root = rig(source), bpy.data.objects.new("root", None)
    bpy.context.collection.objects.link(root)
    armature.parent = root
    target.location.x = 4.0
    eye, hat = garment(source), garment(source)
    eye.name, hat.name = "eye", "hat"
    for object_ in (eye, hat):
        object_.vertex_groups.clear()
        object_.modifiers.clear()
    eye.parent, eye.parent_type, eye.parent_bone = armature, "BONE", "tip"
    hat.parent = source
    bpy.context.view_layer.update()
    source.modifiers["Armature"].use_deform_preserve_volume = True
    bpy.ops.cagemap.rig()
    made = target.modifiers["Armature"].object
    assert target.modifiers["Armature"].use_deform_preserve_volume
    assert made.parent is None
    copied = bpy.data.objects["eye on target"]
    assert (copied.parent, copied.parent_type, copied.parent_bone, len(copied.modifiers)) == (made, "BONE", "tip", 0)
    shift = copied.matrix_world.translation - eye.matrix_world.translation
    np.testing.assert_allclose(shift, (4.0, 0.0, 0.0), atol=1e-5)
    assert bpy.data.objects["hat on target"].parent == target
    assert "without weights, not moved by bones: hat on target" in SETTINGS.message
