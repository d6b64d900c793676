"""Run by an interpreter that has `bpy`: two creatures in a scene, through all buttons of the add-on.

``PYTHON blender_scene.py ADDONS FOLDER COMMAND``; prints what `test_blender.py` looks at, as JSON on the last line.
"""

import json
import sys
from pathlib import Path

import bpy
import numpy as np

ADDONS, FOLDER, COMMAND = sys.argv[1], Path(sys.argv[2]), sys.argv[3]
sys.path.insert(0, ADDONS)
import cagemap_blender  # noqa: E402
from cagemap_blender import incoming, work  # noqa: E402

bpy.ops.wm.read_factory_settings(use_empty=True)
cagemap_blender.register()
work.command_path = lambda context: COMMAND


def loaded(name):
    bpy.ops.wm.obj_import(filepath=str(FOLDER / f"{name}.obj"))
    thing = bpy.context.selected_objects[0]
    thing.name = name
    thing.modifiers.new("Subdivision", "SUBSURF").levels = 2
    return thing


def refused(button):
    try:
        button()
    except RuntimeError as error:
        return str(error)
    return ""


target, source = loaded("deer"), loaded("pony")
source.location = (2.0, 0.0, 0.5)
for pair in json.loads((FOLDER / "landmarks.json").read_text())["pairs"]:
    for thing, side in ((target, "target"), (source, "source")):
        if pair is None or (side == "source" and pair["name"].endswith("left")):
            thing.vertex_groups.new(name=f"lm_{pair['name']}").add([pair[side]], 1.0, "REPLACE")
            continue
        empty = bpy.data.objects.new(pair["name"], None)
        bpy.context.collection.objects.link(empty)
        empty.parent, empty.location = thing, thing.data.vertices[pair[side]].co
image = bpy.data.images.load(str(FOLDER / "pony.png"))
material = bpy.data.materials.new("coat")
if material.node_tree is None:
    material.use_nodes = True
texture = material.node_tree.nodes.new("ShaderNodeTexImage")
texture.image = image
shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
material.node_tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
source.data.materials.clear()
source.data.materials.append(material)
heights = np.array([vertex.co.y for vertex in source.data.vertices])
group = source.vertex_groups.new(name="high")
for i, value in enumerate((heights - heights.min()) / np.ptp(heights)):
    group.add([i], float(value), "REPLACE")
source.shape_key_add(name="Basis")
wide = source.shape_key_add(name="wide")
wide.value = 0.0
for point in wide.data:
    point.co.x *= 1.2
creases = source.data.attributes.new("crease_edge", "FLOAT", "EDGE")
creases.data[5].value = 0.5

settings = bpy.context.scene.cagemap
said = {"unsaved": refused(bpy.ops.cagemap.match)}
bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "scene.blend"))
settings.target, settings.source, settings.vertices, settings.size = target, source, 1500, 64
said["too early"] = refused(bpy.ops.cagemap.wrap)
mirror = source.modifiers.new("Mirror", "MIRROR")
source.modifiers.move(1, 0)
said["mirror"] = refused(bpy.ops.cagemap.match)
source.modifiers.remove(mirror)
bpy.context.view_layer.objects.active = target
bpy.ops.object.mode_set(mode="EDIT")
said["edit"] = refused(bpy.ops.cagemap.match)
bpy.ops.object.mode_set(mode="OBJECT")
for button in ("match", "texture", "weights", "shapes", "wrap", "report", "shapes"):
    # Shapes lie as they were matched, however objects are turned afterwards.
    source.rotation_euler.z = 1.5 if button == "shapes" else 0.0
    getattr(bpy.ops.cagemap, button)()
source.rotation_euler.z = 0.0
bpy.context.view_layer.update()
target.vertex_groups["high"].name = "kept"
target.vertex_groups.new(name="high")
bpy.ops.cagemap.weights()  # the group of that name was made by the add-on once, so it may be replaced
target.shape_key_add(name="mine")
source.data.shape_keys.key_blocks["wide"].name = "mine"
said["taken"] = refused(bpy.ops.cagemap.shapes)

keys = target.data.shape_keys.key_blocks
wrapped = np.array([target.matrix_world @ point.co for point in keys["wrapped pony"].data])
there = np.array([source.matrix_world @ vertex.co for vertex in source.data.vertices])
said["wrapped"] = [*(wrapped.mean(axis=0) - there.mean(axis=0)).tolist(), float(np.ptp(there))]
basis, wide = (np.array([point.co for point in keys[name].data]) for name in ("Basis", "wide"))
said["wider"] = float(np.ptp(wide[:, 0]) / np.ptp(basis[:, 0]))
said["groups"] = [one.name for one in target.vertex_groups]
said["keys"] = [(key.name, key.value) for key in list(keys)[1:]]
source.modifiers["Subdivision"].use_limit_surface = False
mesh = source.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
points = np.array([source.matrix_world @ vertex.co for vertex in mesh.vertices])
np.save(FOLDER / "refined.npy", points[:, [0, 2, 1]] * (1, 1, -1))
for number in (1001, 1003):
    image.save(filepath=str(FOLDER / f"tiled.{number}.png"))
shown = incoming.show_image(target, FOLDER / "tiled.<UDIM>.png")
said["tiles"] = sorted(tile.number for tile in shown.tiles)
said["materials"] = [slot.name for slot in target.material_slots]
source.data.vertices.add(1)
said["changed"] = refused(bpy.ops.cagemap.wrap)
sys.stdout.write("\n" + json.dumps(said) + "\n")
