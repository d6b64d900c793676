"""Checks of baked textures: layouts, node groups, slots, and what happens while a bake runs."""

from types import SimpleNamespace

import bpy
import numpy as np
from character_checks import rig
from scene_kit import FOLDER, SETTINGS, Window, change_all_objects, check, clear, operators, pair, reading, refusal


def shader_nodes(object_, name="coat"):
    """Node tree of a new material of an object."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    object_.data.materials.append(material)
    return material.node_tree


def principled(tree):
    return next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")


def new_nodes(tree, *kinds):
    return [tree.nodes.new(f"ShaderNode{kind}") for kind in kinds]


def image_node(tree, image):
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    return node


def textured(object_, name="coat", image=None):
    """A new material whose base colour is an image: its node tree and the image's node."""
    tree = shader_nodes(object_, name)
    texture = image_node(tree, image or gradient())
    tree.links.new(texture.outputs["Color"], principled(tree).inputs["Base Color"])
    return tree, texture


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


def assert_same_colours(image, given, uvs, given_uvs=None):
    """An image has the colours of another one, each at its own UVs."""
    apart = np.abs(texels(image, uvs) - texels(given, uvs if given_uvs is None else given_uvs)).max(axis=1)
    assert np.median(apart) < 0.02, (image.name, np.quantile(apart, [0.1, 0.5, 0.9]))


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
    tree, texture = textured(source)
    mapping, coordinates = new_nodes(tree, "Mapping", "TexCoord")
    mapping.inputs["Scale"].default_value = (4.0, 2.0, 1.0)
    mapping.inputs["Rotation"].default_value = (0.0, 0.0, 0.3)
    mapping.inputs["Location"].default_value = (0.3, 0.1, 0.0)
    tree.links.new(coordinates.outputs["UV"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
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
        assert_same_colours(image, texture.image, uvs, at)


@check
def layouts_that_cannot_be_baked_are_refused_by_name():
    source, _ = pair()
    tree, texture = textured(source)
    coordinates, mapping, value = new_nodes(tree, "TexCoord", "Mapping", "CombineXYZ")
    tree.links.new(coordinates.outputs["Generated"], texture.inputs["Vector"])
    assert "coat, node Texture Coordinate" in refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    tree.links.new(coordinates.outputs["UV"], mapping.inputs["Vector"])
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
    node, coordinates = new_nodes(tree, "Group", "TexCoord")
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
    assert_same_colours(image, texture.image, face_middles(target))


@check
def images_of_slots_without_faces_are_not_baked():
    source, target = pair()
    for name in ("used", "unused"):
        textured(source, name, gradient(name))
    assert not refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})
    assert [slot.material.name for slot in target.material_slots] == ["used on target"]
    assert sorted(bpy.data.images.keys()) == ["unused", "used", "used on target"]
    assert SETTINGS.message == "1 image transferred"


@check
def a_material_replaced_during_a_bake_leaves_no_baked_image():
    source, target = pair()
    textured(source)
    window = Window()
    button, _ = window.press(operators.CAGEMAP_OT_transfer, what={"TEXTURES"})
    window.wait_for(button, "bake")
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
    mapping, coordinates = new_nodes(tree, "Mapping", "TexCoord")
    mapping.inputs["Scale"].default_value = (2.0, 2.0, 1.0)
    tree.links.new(coordinates.outputs["UV"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], nodes[1].inputs["Vector"])
    for node, name in zip(nodes, ("Base Color", "Roughness", "Metallic"), strict=True):
        tree.links.new(node.outputs["Color"], principled(tree).inputs[name])
    bpy.ops.cagemap.transfer(what={"TEXTURES"})
    made = baked_images(target.material_slots[0].material.node_tree)
    assert [image.name for image in made] == ["coat on target", "coat 3 on target", "coat 2 on target"]
    uvs = face_middles(target)
    for image, given, scale in zip(made, (first, first, other), (1.0, 2.0, 1.0), strict=True):
        assert_same_colours(image, given, uvs, scale * uvs)


@check
def only_plain_normal_maps_are_baked():
    source, _ = pair()
    tree = shader_nodes(source)
    texture = image_node(tree, gradient())
    bend, normals = new_nodes(tree, "RGBCurve", "NormalMap")
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


@check
def undo_during_a_bake_leaves_no_removed_objects():
    source, _ = pair()
    textured(source)
    bpy.ops.cagemap.match()
    change_all_objects()
    window = Window()
    button, _ = window.press(operators.CAGEMAP_OT_transfer, what={"TEXTURES"})
    window.wait_for(button, "bake")
    bpy.ops.ed.undo()
    assert window.finish(button) == "FINISHED"
    assert len(bpy.data.objects["target"].material_slots) == 1


@check
def after_textures_were_transferred_views_show_them():
    source, target = pair()
    textured(source)
    own = target.data.color_attributes.new("own", "FLOAT_COLOR", "POINT")
    target.data.color_attributes.active_color = own
    window = Window()
    shading = SimpleNamespace(type="SOLID", color_type="MATERIAL")
    area = SimpleNamespace(type="VIEW_3D", spaces=SimpleNamespace(active=SimpleNamespace(shading=shading)))
    window.screen = SimpleNamespace(areas=[area])
    for _ in range(2):
        window.run()
        assert shading.color_type == "VERTEX"
        assert target.data.color_attributes.active_color.name == "cagemap"
        window.run(operators.CAGEMAP_OT_transfer, what={"TEXTURES"})
        assert shading.color_type == "TEXTURE"
        assert target.data.color_attributes.active_color.name == "own"


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
    message = refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})
    assert "Image Texture: only images that repeat" in message
    assert "move the UVs onto the image" in message  # a decal that repeats looks different


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
    for path in (image.filepath, ""):  # without a path: painted and packed, never saved
        image.filepath_raw = path
        assert not refusal(bpy.ops.cagemap.transfer, what={"TEXTURES"})
        assert baked_images(target.material_slots[0].material.node_tree)[0].size[0] == 32
