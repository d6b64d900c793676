"""Run by an interpreter that has `bpy`: single behaviours of the extension, each in an empty scene.

``PYTHON scene_checks.py ZIP FOLDER [NAME ...]``; FOLDER/checks.json gets the traceback of each check by name, "" where
it holds. ZIP "-" takes the extension that is installed in the profile.
"""

import json
import sys
import time
import traceback
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np

ZIP, FOLDER, NAMES = sys.argv[1], Path(sys.argv[2]), sys.argv[3:]

bpy.ops.wm.read_factory_settings(use_empty=True)
if ZIP == "-":
    bpy.ops.preferences.addon_enable(module="bl_ext.user_default.cagemap")
else:
    bpy.ops.extensions.package_install_files(filepath=ZIP, repo="user_default", enable_on_install=True)
import bmesh  # noqa: E402
from bl_ext.user_default.cagemap import live, operators, reading, work  # noqa: E402

SETTINGS = bpy.context.scene.cagemap
CHECKS = {}


def check(function):
    CHECKS[function.__name__] = function
    return function


def clear():
    global SETTINGS
    SETTINGS = bpy.context.scene.cagemap  # another one after Undo
    work.stop()
    for object_ in list(bpy.data.objects):
        bpy.data.objects.remove(object_)
    bpy.data.orphans_purge(do_recursive=True)


def pair():
    """Source and target: two monkeys."""
    bpy.ops.mesh.primitive_monkey_add()
    source = bpy.context.object
    source.name = "source"
    target = source.copy()
    target.data, target.name = source.data.copy(), "target"
    bpy.context.collection.objects.link(target)
    SETTINGS.source, SETTINGS.target, SETTINGS.vertices = source, target, 1000
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.update()
    return source, target


def refusal(button, **options):
    try:
        button(**options)
    except RuntimeError as error:
        return str(error)
    return ""


class Window:
    """A context with a window, which Blender does not have here; keeps what is shown in it."""

    def __init__(self):
        self.status, self.timers, self.reports = [], 0, []
        self.window_manager = self.workspace = self
        self.screen = self.window = None

    def __getattr__(self, name):
        return getattr(bpy.context, name)

    def event_timer_add(self, seconds, window):
        self.timers += 1
        return self

    def event_timer_remove(self, timer):
        self.timers -= 1

    def modal_handler_add(self, button):
        pass

    def status_text_set(self, text):
        self.status.append(text)

    def press(self, kind=operators.CAGEMAP_OT_match, **options):
        """A button that was pressed, and what Blender is answered."""
        window = self

        class Button(work.Work):
            bl_label, requests = kind.bl_label, kind.requests

            def report(self, kinds, text):
                window.reports.append([*kinds, text])

        button = Button()
        vars(button).update(options)
        return button, button.invoke(self, event("LEFTMOUSE")).pop()

    def step(self, button, kind="TIMER"):
        """What a button answers to an event."""
        return button.modal(self, event(kind)).pop()

    def finish(self, button):
        """The last answer of a button."""
        answer, end = "PASS_THROUGH", time.monotonic() + 120.0
        while answer == "PASS_THROUGH" and time.monotonic() < end:
            time.sleep(0.02)
            answer = self.step(button)
        return answer


def event(kind):
    return type("Event", (), {"type": kind})()


@check
def a_button_in_a_window_returns_at_once_and_writes_at_the_end():
    _, target = pair()
    window = Window()
    begun = time.perf_counter()
    button, answer = window.press()
    assert answer == "RUNNING_MODAL"
    assert time.perf_counter() - begun < 2.0  # a loaded machine
    assert window.press()[1] == "CANCELLED"  # a second one
    assert window.step(button, "MOUSEMOVE") == "PASS_THROUGH"
    assert window.step(button, "ESC") == "CANCELLED"
    assert (window.timers, work.Work.running) == (0, False)
    assert "cagemap" not in target.data.color_attributes
    button, _ = window.press()
    assert window.finish(button) == "FINISHED"
    assert (window.timers, work.Work.running) == (0, False)
    assert "cagemap" in target.data.color_attributes
    assert any("prepare" in text for text in window.status if text)
    assert window.status[-1] is None


@check
def other_objects_chosen_meanwhile_end_the_computation():
    source, target = pair()
    window = Window()
    button, _ = window.press()
    SETTINGS.target = source
    assert window.step(button) == "CANCELLED"
    assert "same mesh" in window.reports[-1][1]
    assert not work.WORKER.busy
    SETTINGS.target = target
    button, _ = window.press()
    assert window.finish(button) == "FINISHED"


@check
def edit_mode_meanwhile_delays_the_result():
    _, target = pair()
    window = Window()
    button, _ = window.press()
    bpy.context.view_layer.objects.active = target
    bpy.ops.object.mode_set(mode="EDIT")
    for _ in range(400):  # long enough for the result
        assert window.step(button) == "PASS_THROUGH", window.reports
        time.sleep(0.02)
    assert "Edit Mode" in window.status[-1]
    bpy.ops.object.mode_set(mode="OBJECT")
    assert window.finish(button) == "FINISHED", window.reports
    assert "cagemap" in target.data.color_attributes
    assert work.WORKER.has_match


def shader_nodes(object_, name="coat"):
    """Node tree of a new material of an object."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    object_.data.materials.append(material)
    return material.node_tree


def principled(tree):
    return next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")


def image_node(tree, image):
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    return node


def gradient(name="gradient", size=512):
    """An image in which every texel has a colour of its own."""
    image = bpy.data.images.new(name, size, size)
    x, y = np.meshgrid(np.linspace(0, 1, size), np.linspace(0, 1, size))
    image.pixels.foreach_set(np.stack([x, y, (x + y) / 2, np.ones_like(x)], axis=2).astype(np.float32).ravel())
    return image


def pixels(image):
    return np.array(image.pixels[:]).reshape(image.size[1], image.size[0], 4)


def texels(image, uvs):
    """Pixels at UVs (n, 2), repeated outside of the image."""
    width, height = image.size
    column, row = (np.mod(uvs, 1.0) * (width, height)).astype(int).T
    return pixels(image)[np.minimum(row, height - 1), np.minimum(column, width - 1)]


def face_middles(object_):
    """UVs (m, 2) inside the faces."""
    uvs = np.array([loop.vector[:] for loop in object_.data.uv_layers.active.uv])
    return np.array([uvs[list(polygon.loop_indices)].mean(0) for polygon in object_.data.polygons])


def baked_images(tree):
    """Images of a node tree and of its groups."""
    found = [node.image for node in tree.nodes if node.type == "TEX_IMAGE"]
    for node in tree.nodes:
        if node.type == "GROUP":
            found += baked_images(node.node_tree)
    return found


@check
def a_constant_mapping_is_baked():
    source, target = pair()
    tree = shader_nodes(source)
    texture, mapping, coordinates = (
        image_node(tree, gradient()),
        tree.nodes.new("ShaderNodeMapping"),
        tree.nodes.new("ShaderNodeTexCoord"),
    )
    mapping.inputs["Scale"].default_value = (4.0, 2.0, 1.0)
    mapping.inputs["Rotation"].default_value = (0.0, 0.0, 0.3)
    mapping.inputs["Location"].default_value = (0.3, 0.1, 0.0)
    tree.links.new(coordinates.outputs["UV"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], principled(tree).inputs["Base Color"])
    plain = image_node(tree, texture.image)  # the same image without the mapping
    tree.links.new(plain.outputs["Color"], principled(tree).inputs["Roughness"])
    bpy.ops.cagemap.transfer(what={"TEXTURES"})
    made = target.material_slots[0].material.node_tree
    baked, unmapped = (principled(made).inputs[name].links[0].from_node.image for name in ("Base Color", "Roughness"))
    uvs = face_middles(target)
    for image, at in (
        (unmapped, uvs),
        (baked, uvs * (4.0, 2.0) @ np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]]) + (0.3, 0.1)),
    ):
        apart = np.abs(texels(image, uvs) - texels(texture.image, at)).max(axis=1)
        assert np.median(apart) < 0.02, np.quantile(apart, [0.1, 0.5, 0.9])


@check
def layouts_that_cannot_be_baked_are_refused_by_name():
    source, _ = pair()
    tree = shader_nodes(source)
    texture = image_node(tree, gradient())
    tree.links.new(texture.outputs["Color"], principled(tree).inputs["Base Color"])
    coordinates, mapping = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
    tree.links.new(coordinates.outputs["Generated"], texture.inputs["Vector"])
    assert "coat, node Texture Coordinate" in refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    tree.links.new(coordinates.outputs["UV"], mapping.inputs["Vector"])
    value = tree.nodes.new("ShaderNodeCombineXYZ")
    tree.links.new(value.outputs["Vector"], mapping.inputs["Scale"])
    assert "coat, node Mapping" in refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})
    tree.links.new(coordinates.outputs["UV"], texture.inputs["Vector"])
    texture.projection = "BOX"
    assert "coat, node Image Texture" in refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})


def color_group(name):
    """A node group that takes a Vector and gives a Color, with its input and output nodes."""
    group = bpy.data.node_groups.new(name, "ShaderNodeTree")
    group.interface.new_socket("Vector", in_out="INPUT", socket_type="NodeSocketVector")
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    return group, group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")


@check
def images_in_node_groups_are_baked_into_copies_of_the_groups():
    source, target = pair()
    tree = shader_nodes(source)
    group, begin, end = color_group("hair")
    texture = image_node(group, gradient())
    group.links.new(begin.outputs[0], texture.inputs["Vector"])
    group.links.new(texture.outputs["Color"], end.inputs[0])
    outer_group, begin, end = color_group("fur")
    node = outer_group.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    outer_group.links.new(begin.outputs[0], node.inputs[0])
    outer_group.links.new(node.outputs[0], end.inputs[0])
    node, coordinates = tree.nodes.new("ShaderNodeGroup"), tree.nodes.new("ShaderNodeTexCoord")
    node.node_tree = outer_group
    tree.links.new(coordinates.outputs["UV"], node.inputs[0])
    tree.links.new(node.outputs[0], principled(tree).inputs["Base Color"])
    for _ in range(2):
        bpy.ops.cagemap.transfer(what={"TEXTURES"})
        (image,) = baked_images(target.material_slots[0].material.node_tree)
        assert image.name == "gradient on target"
        assert texture.image.name == "gradient"
        assert sorted(bpy.data.node_groups.keys()) == ["fur", "fur on target", "hair", "hair on target"]
        assert len(bpy.data.images) == 2, list(bpy.data.images)
    uvs = face_middles(target)
    assert np.median(np.abs(texels(image, uvs) - texels(texture.image, uvs)).max(axis=1)) < 0.02


@check
def images_of_slots_without_faces_are_not_baked():
    source, target = pair()
    for name in ("used", "unused"):
        tree = shader_nodes(source, name)
        tree.links.new(image_node(tree, gradient(name)).outputs["Color"], principled(tree).inputs["Base Color"])
    assert not refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})
    assert [slot.material.name for slot in target.material_slots] == ["used on target"]
    assert sorted(bpy.data.images.keys()) == ["unused", "used", "used on target"]
    assert SETTINGS.message == "1 image transferred"


@check
def a_material_replaced_during_a_bake_leaves_no_baked_image():
    source, target = pair()
    tree = shader_nodes(source)
    tree.links.new(image_node(tree, gradient()).outputs["Color"], principled(tree).inputs["Base Color"])
    window = Window()
    button, _ = window.press(operators.CAGEMAP_OT_transfer, what={"TEXTURES"})
    while not button._stage.startswith("bake"):
        time.sleep(0.02)
        assert window.step(button) == "PASS_THROUGH"
    source.material_slots[0].material = bpy.data.materials.new("plain")
    assert window.finish(button) == "FINISHED"
    assert target.material_slots[0].material.name == "plain on target"
    assert bpy.data.images.keys() == ["gradient"]


@check
def an_image_named_like_a_second_layout_is_baked_as_well():
    source, target = pair()
    tree = shader_nodes(source)
    first = gradient("coat")
    other = bpy.data.images.new("coat 2", 64, 64)
    other.generated_color = (1.0, 0.0, 1.0, 1.0)
    nodes = [image_node(tree, image) for image in (first, first, other)]
    mapping = tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Scale"].default_value = (2.0, 2.0, 1.0)
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    tree.links.new(coordinates.outputs["UV"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], nodes[1].inputs["Vector"])
    for node, name in zip(nodes, ("Base Color", "Roughness", "Metallic"), strict=True):
        tree.links.new(node.outputs["Color"], principled(tree).inputs[name])
    bpy.ops.cagemap.transfer(what={"TEXTURES"})
    made = baked_images(target.material_slots[0].material.node_tree)
    assert [image.name for image in made] == ["coat on target", "coat 3 on target", "coat 2 on target"]
    uvs = face_middles(target)
    for image, given, scale in zip(made, (first, first, other), (1.0, 2.0, 1.0), strict=True):
        assert np.median(np.abs(texels(image, uvs) - texels(given, scale * uvs)).max(axis=1)) < 0.02, image.name


@check
def only_plain_normal_maps_are_baked():
    source, _ = pair()
    tree = shader_nodes(source)
    texture, bend, normals = (
        image_node(tree, gradient()),
        tree.nodes.new("ShaderNodeRGBCurve"),
        tree.nodes.new("ShaderNodeNormalMap"),
    )
    tree.links.new(normals.outputs["Normal"], principled(tree).inputs["Normal"])
    tree.links.new(texture.outputs["Color"], bend.inputs["Color"])
    tree.links.new(bend.outputs["Color"], normals.inputs["Color"])
    assert "coat, node RGB Curves" in refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})
    tree.links.new(texture.outputs["Color"], normals.inputs["Color"])
    normals.space = "OBJECT"
    assert "coat, node Normal Map" in refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})
    normals.space, normals.uv_map = "TANGENT", "UVMap"
    assert not refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})
    made = SETTINGS.target.material_slots[0].material.node_tree.nodes["Normal Map"]
    assert made.uv_map == ""  # the target's own layout


def landmark(object_, name, place=(0.0, 0.0, 0.0)):
    """A landmark, with a number behind its name if that is taken."""
    empty = bpy.data.objects.new(name, None)
    bpy.context.collection.objects.link(empty)
    empty.parent, empty.location = object_, place
    bpy.context.view_layer.update()
    return empty


@check
def equal_names_of_empties_matter_on_both_objects_alone():
    source, target = pair()
    landmark(target, "Empty"), landmark(target, "Empty")
    for object_ in (target, source):
        landmark(object_, "nose", object_.data.vertices[5].co)
    assert not refusal(bpy.ops.cagemap.match)
    landmark(source, "Empty")
    assert "target: more than one landmark is called Empty" in refusal(bpy.ops.cagemap.match)


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


@check
def a_group_made_during_rig_like_leaves_no_armature():
    source, target = pair()
    rig(source)
    window = Window()
    button, _ = window.press(operators.CAGEMAP_OT_rig)
    while button._stage != "carry weights":
        time.sleep(0.02)
        assert window.step(button) == "PASS_THROUGH"
    target.vertex_groups.new(name="tip")
    assert window.finish(button) == "CANCELLED"
    assert "vertex groups of its own called tip" in window.reports[-1][1]
    assert [one.name for one in bpy.data.objects if one.type == "ARMATURE"] == ["skeleton"]
    assert not target.modifiers


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
def undo_during_a_bake_leaves_no_removed_objects():
    source, _ = pair()
    tree = shader_nodes(source)
    tree.links.new(image_node(tree, gradient()).outputs["Color"], principled(tree).inputs["Base Color"])
    bpy.ops.cagemap.match()
    bpy.ops.ed.undo_push(message="before")
    for name in ("source", "target"):
        bpy.data.objects[name].pass_index = 1
    bpy.ops.ed.undo_push(message="after")
    window = Window()
    button, _ = window.press(operators.CAGEMAP_OT_transfer, what={"TEXTURES"})
    while not button._stage.startswith("bake"):
        time.sleep(0.02)
        assert window.step(button) == "PASS_THROUGH"
    bpy.ops.ed.undo()
    assert window.finish(button) == "FINISHED"
    assert len(bpy.data.objects["target"].material_slots) == 1


@check
def undo_while_rig_like_matches_leaves_no_removed_objects():
    source, _ = pair()
    rig(source)
    bpy.ops.ed.undo_push(message="before")
    for object_ in bpy.data.objects:
        object_.pass_index = 1
    bpy.ops.ed.undo_push(message="after")
    window = Window()
    button, _ = window.press(operators.CAGEMAP_OT_rig)
    bpy.ops.ed.undo()
    assert window.finish(button) == "FINISHED"
    assert bpy.data.objects["target"].modifiers["Armature"].object == bpy.data.objects["skeleton on target"]


@check
def a_fault_does_not_end_the_live_map():
    source, _ = pair()
    bpy.ops.cagemap.match()
    landmark(source, "nose")

    def fault(context):
        raise ValueError("broken")

    whole, live.following, live._moved = live.following, fault, True
    try:
        assert live.follow() > 0
    finally:
        live.following = whole
    assert "broken" in SETTINGS.message


def followed(seconds=60.0):
    """Whether the live map asked the computing process after a landmark moved; waits until it is done."""
    asked, end = live._requests is not None or work.WORKER.busy, time.monotonic() + seconds
    while time.monotonic() < end:
        live.follow()
        asked = asked or work.WORKER.busy
        if not live._moved and live._requests is None:
            break
        time.sleep(0.01)
    return asked


@check
def the_live_map_asks_only_where_landmarks_moved_on_their_objects():
    source, target = pair()
    empties = [landmark(object_, "nose", object_.data.vertices[5].co) for object_ in (target, source)]
    live._moved = False
    empties[0].location.z += 0.1
    bpy.context.view_layer.update()
    assert not live._moved  # there is no map yet
    bpy.ops.cagemap.match()
    target.location.x += 1.0  # takes its landmark along
    bpy.context.view_layer.update()
    assert live._moved
    assert not followed()
    empties[0].location.z += 0.1
    bpy.context.view_layer.update()
    assert followed()
    sent = SETTINGS.message
    bpy.ops.cagemap.follow()
    assert SETTINGS.message == sent


@check
def edit_mode_and_other_objects_do_not_disturb_the_live_map():
    source, target = pair()
    empties = [landmark(object_, "nose", object_.data.vertices[5].co) for object_ in (target, source)]
    bpy.ops.cagemap.match()
    SETTINGS.message = ""
    bpy.context.view_layer.objects.active = target
    empties[0].location.z += 0.1
    bpy.context.view_layer.update()
    live.follow()
    assert work.WORKER.busy
    bpy.ops.object.mode_set(mode="EDIT")
    assert followed(seconds=3.0)
    assert not SETTINGS.message
    bpy.ops.object.mode_set(mode="OBJECT")
    assert followed()
    assert not SETTINGS.message
    empties[0].location.z += 0.1
    bpy.context.view_layer.update()
    live.follow()
    SETTINGS.source = None
    followed()
    assert not work.WORKER.busy
    assert not live._moved
    SETTINGS.source = source
    assert not refusal(bpy.ops.cagemap.match)


@check
def after_textures_were_transferred_views_show_them():
    source, target = pair()
    tree = shader_nodes(source)
    tree.links.new(image_node(tree, gradient()).outputs["Color"], principled(tree).inputs["Base Color"])
    own = target.data.color_attributes.new("own", "FLOAT_COLOR", "POINT")
    target.data.color_attributes.active_color = own
    window = Window()
    shading = SimpleNamespace(type="SOLID", color_type="MATERIAL")
    area = SimpleNamespace(type="VIEW_3D", spaces=SimpleNamespace(active=SimpleNamespace(shading=shading)))
    window.screen = SimpleNamespace(areas=[area])
    for _ in range(2):
        button, _ = window.press()
        assert window.finish(button) == "FINISHED"
        assert shading.color_type == "VERTEX"
        assert target.data.color_attributes.active_color.name == "cagemap"
        button, _ = window.press(operators.CAGEMAP_OT_transfer, what={"TEXTURES"})
        assert window.finish(button) == "FINISHED"
        assert shading.color_type == "TEXTURE"
        assert target.data.color_attributes.active_color.name == "own"


@check
def a_window_that_is_closed_ends_its_button():
    pair()
    window, first = Window(), Window()
    window.workspace = first
    button, _ = window.press()
    window.workspace = Window()  # of another tab
    button.cancel(window)
    assert (window.timers, work.Work.running, work.WORKER.busy) == (0, False, False)
    assert first.status[-1] is None
    assert not window.workspace.status
    button, _ = window.press()
    assert window.finish(button) == "FINISHED"


@check
def weights_of_removed_groups_are_not_read():
    source, _ = pair()
    source.vertex_groups.new(name="own").add([0, 1], 0.5, "REPLACE")
    mesh = bmesh.new()
    mesh.from_mesh(source.data)
    mesh.verts.ensure_lookup_table()
    mesh.verts[3][mesh.verts.layers.deform.verify()][5] = 1.0
    mesh.to_mesh(source.data)
    mesh.free()
    weights = reading.vertex_groups(source)
    assert list(weights) == ["own"]
    assert weights["own"].sum() == 1.0


@check
def a_mesh_without_vertices_is_refused():
    source, _ = pair()
    source.data = bpy.data.meshes.new("empty")
    for button in (bpy.ops.cagemap.match, bpy.ops.cagemap.wrap, bpy.ops.cagemap.landmark):
        assert "source has no vertices. Choose another source" in refusal(button)


@check
def messages_name_vertices_and_no_places_of_a_file():
    pair()
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=9, y_subdivisions=9)
    SETTINGS.source = bpy.context.object
    assert not refusal(bpy.ops.cagemap.match)
    assert "folded over" in SETTINGS.message
    assert " at (" not in SETTINGS.message, SETTINGS.message
    assert "file" not in SETTINGS.message, SETTINGS.message
    assert "answer=" not in SETTINGS.message, SETTINGS.message


@check
def a_ninth_uv_map_is_refused():
    source, target = pair()
    source.data.uv_layers[0].name = "other"
    while len(target.data.uv_layers) < 8:
        target.data.uv_layers.new()
    assert "target would have 9 UV maps" in refusal(bpy.ops.cagemap.transfer, what={"UVS"})


@check
def what_the_user_made_after_deleting_ours_is_kept():
    source, target = pair()
    source.shape_key_add(name="Basis")
    source.shape_key_add(name="wide").data[0].co.x += 0.1
    source.vertex_groups.new(name="own").add([0], 1.0, "REPLACE")
    source.data.uv_layers.new(name="second")
    kinds = {"SHAPES", "WEIGHTS", "UVS"}
    target.data.uv_layers[0].name = "first"
    for _ in range(2):
        bpy.ops.cagemap.transfer(what=kinds)
        bpy.context.view_layer.update()
    for kind, delete, make in (
        ("shape key", lambda: target.shape_key_remove(target.data.shape_keys.key_blocks["wide"]), target.shape_key_add),
        ("vertex group", lambda: target.vertex_groups.remove(target.vertex_groups["own"]), target.vertex_groups.new),
        (
            "UV map",
            lambda: target.data.uv_layers.remove(target.data.uv_layers["second"]),
            target.data.uv_layers.new,
        ),
    ):
        delete()
        target.data.update()
        bpy.context.view_layer.update()
        make(name={"shape key": "wide", "vertex group": "own", "UV map": "second"}[kind])
        bpy.context.view_layer.update()
        assert f"{kind}s of its own called" in refusal(bpy.ops.cagemap.transfer, what=kinds), kind
        delete()
        bpy.context.view_layer.update()
        assert not refusal(bpy.ops.cagemap.transfer, what=kinds)


@check
def float_images_keep_their_colours_in_the_file():
    source, target = pair()
    tree, deep = shader_nodes(source), FOLDER / "deep.png"
    given = bpy.data.images.new("deep", 16, 16, alpha=True, float_buffer=True)
    given.generated_color = (0.05, 0.2, 0.4, 0.5)
    settings = bpy.context.scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGBA", "16"
    given.save_render(str(deep))
    texture = image_node(tree, bpy.data.images.load(str(deep)))
    assert texture.image.is_float
    assert texture.image.colorspace_settings.name == "sRGB"
    tree.links.new(texture.outputs["Color"], principled(tree).inputs["Base Color"])
    bpy.ops.cagemap.transfer(what={"TEXTURES"})
    (image,) = baked_images(target.material_slots[0].material.node_tree)
    place, expected = face_middles(target)[:1], pixels(texture.image)[0, 0]
    assert np.abs(texels(image, place) - expected).max() < 1e-3
    image.reload()  # as when the .blend file is opened
    assert np.abs(texels(image, place) - expected).max() < 1e-3, (texels(image, place), expected)


@check
def uvs_of_copies_of_the_target_are_kept():
    source, target = pair()
    target.data.uv_layers[0].name = "own"
    bpy.ops.cagemap.transfer(what={"UVS"})
    backup = target.data.copy()
    before = reading.numbers(backup.uv_layers["UVMap"].uv, "vector", 2)
    source.data.uv_layers[0].data.foreach_set("uv", np.full(2 * len(source.data.loops), 0.5, dtype=np.float32))
    bpy.ops.cagemap.transfer(what={"UVS"})
    assert np.ptp(reading.numbers(target.data.uv_layers["UVMap"].uv, "vector", 2)) < 1e-6
    np.testing.assert_array_equal(reading.numbers(backup.uv_layers["UVMap"].uv, "vector", 2), before)


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
def disabled_objects_are_evaluated():
    source, target = pair()
    empty = landmark(target, "nose")
    source.modifiers.new("Mirror", "MIRROR")
    source.hide_viewport = target.hide_viewport = empty.hide_viewport = True
    assert "source: its modifiers (Mirror)" in refusal(bpy.ops.cagemap.match)
    source.modifiers.clear()
    source.location.x = target.location.y = 3.0
    bpy.ops.cagemap.wrap()
    assert source.hide_viewport
    assert tuple(source.matrix_world.translation) == (3.0, 0.0, 0.0)
    assert tuple(empty.matrix_world.translation) == (0.0, 3.0, 0.0)


def linked_from_file(path, **names):
    with bpy.data.libraries.load(str(path), link=True) as (_, linked):
        for kind, ones in names.items():
            setattr(linked, kind, ones)
    return linked


@check
def linked_data_are_told_from_data_of_the_same_names():
    source, _ = pair()
    armature, path = rig(source), FOLDER / "library.blend"
    tree = shader_nodes(source)
    image = gradient("skin", 32)
    image.pack()
    tree.links.new(image_node(tree, image).outputs["Color"], principled(tree).inputs["Base Color"])
    bpy.data.libraries.write(str(path), {source, armature})
    clear()
    (linked,) = linked_from_file(path, objects=["source"]).objects
    own, target = pair()
    bpy.context.collection.objects.link(linked)
    bpy.data.objects.new("skeleton", bpy.data.armatures.new("bones"))
    SETTINGS.source = linked
    bpy.ops.cagemap.rig()
    assert target.modifiers[0].object.data.bones.keys() == ["root", "tip"]
    own.data.materials.append(linked.data.materials[0])
    tree = shader_nodes(own, "own")
    image = image_node(tree, gradient("skin", 16))
    tree.links.new(image.outputs["Color"], principled(tree).inputs["Base Color"])
    for polygon in own.data.polygons:
        polygon.material_index = int(polygon.center.x > 0)
    SETTINGS.source = own
    bpy.ops.cagemap.transfer(what={"TEXTURES"})
    sizes = {slot.name: baked_images(slot.material.node_tree)[0].size[0] for slot in target.material_slots}
    assert sizes == {"coat on target": 32, "own on target": 16}
    SETTINGS.target = linked
    assert "source is linked from another file" in refusal(bpy.ops.cagemap.match)


@check
def images_that_end_are_refused_where_uvs_leave_them():
    source, _ = pair()
    tree = shader_nodes(source)
    texture = image_node(tree, gradient("gradient", 64))
    tree.links.new(texture.outputs["Color"], principled(tree).inputs["Base Color"])
    texture.extension = "CLIP"
    assert not refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})
    uvs = reading.numbers(source.data.uv_layers[0].uv, "vector", 2)
    source.data.uv_layers[0].data.foreach_set("uv", (3.0 * uvs - 1.0).ravel())
    assert "Image Texture: only images that repeat" in refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})


@check
def packed_tiles_are_read():
    source, target = pair()
    tree = shader_nodes(source)
    paths = [FOLDER / f"packed.{number}.png" for number in (1001, 1002)]
    for path in paths:
        gradient(path.stem, 32).save(filepath=str(path))
    image = bpy.data.images.load(str(paths[0]))
    image.source, image.filepath = "TILED", str(FOLDER / "packed.<UDIM>.png")
    if len(image.tiles) < 2:
        image.tiles.new(tile_number=1002)
    image.pack()
    for path in paths:
        path.unlink()
    tree.links.new(image_node(tree, image).outputs["Color"], principled(tree).inputs["Base Color"])
    assert not refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})
    assert baked_images(target.material_slots[0].material.node_tree)[0].size[0] == 32


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


@check
def shape_keys_keep_range_and_mask_and_never_become_the_rest_shape():
    source, target = pair()
    source.vertex_groups.new(name="half").add([0, 1, 2], 0.5, "REPLACE")
    source.shape_key_add(name="Neutral")
    key = source.shape_key_add(name="Basis")
    key.slider_min, key.slider_max, key.vertex_group = -1.0, 2.0, "half"
    for point in key.data:
        point.co.z += 1.0
    rest = reading.rest_positions(target)
    bpy.ops.cagemap.transfer(what={"SHAPES"})
    made = target.data.shape_keys.key_blocks["Basis"]
    assert (made.slider_min, made.slider_max) == (-1.0, 2.0)
    np.testing.assert_array_equal(reading.rest_positions(target), rest)
    assert abs(reading.coordinates(made.data)[:, 2] - rest[:, 2]).max() < 0.6


@check
def a_second_run_leaves_groups_in_their_place():
    source, target = pair()
    for name in "ab":
        source.vertex_groups.new(name=name).add([0], 1.0, "REPLACE")
    bpy.ops.cagemap.transfer(what={"WEIGHTS"})
    target.vertex_groups.new(name="own").add([0], 0.3, "REPLACE")
    target.vertex_groups["a"].lock_weight = True
    source.vertex_groups["a"].add([0], 0.4, "REPLACE")
    bpy.ops.cagemap.transfer(what={"WEIGHTS"})
    assert target.vertex_groups.keys() == ["a", "b", "own"]
    assert target.vertex_groups["a"].lock_weight
    weights = reading.vertex_groups(target)
    assert [round(float(weights[name][0]), 3) for name in weights] == [0.4, 1.0, 0.3]


@check
def what_is_rendered_on_a_bare_target_is_what_the_source_renders():
    source, target = pair()
    source.data.uv_layers.new(name="second").active_render = True
    target.data.uv_layers.remove(target.data.uv_layers[0])
    for name in ("first", "second colour"):
        source.data.color_attributes.new(name, "BYTE_COLOR", "CORNER")
    source.data.color_attributes.render_color_index = 1
    bpy.ops.cagemap.transfer(what={"UVS", "COLORS"})
    assert [layer.name for layer in target.data.uv_layers if layer.active_render] == ["second"]
    attributes = target.data.color_attributes
    assert attributes[attributes.render_color_index].name == "second colour"


@check
def an_attribute_named_like_the_map_is_refused():
    _, target = pair()
    target.data.color_attributes.new("cagemap", "BYTE_COLOR", "CORNER")
    assert "target has an attribute of its own called cagemap" in refusal(bpy.ops.cagemap.match)


results = {}
for name in NAMES or CHECKS:
    clear()
    try:
        CHECKS[name]()
        results[name] = ""
    except Exception:
        results[name] = traceback.format_exc()
        if NAMES:
            sys.stdout.write(results[name])
clear()
(FOLDER / "checks.json").write_text(json.dumps(results))
