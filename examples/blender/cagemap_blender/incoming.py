"""What comes back: images as materials, vertex groups, shape keys; what the user made is never replaced."""

import json
import re

import bpy
import numpy as np

from .errors import RefusedError
from .outgoing import short_name


def obj_positions(text):
    """(n, 3) positions of the vertices of an OBJ file."""
    return np.array([line.split()[1:4] for line in text.splitlines() if line.startswith("v ")], dtype=np.float64)


def require_rows(thing, rows):
    """Refuse what was computed for another state of the mesh."""
    if rows != len(thing.data.vertices):
        raise RefusedError(
            f"{thing.name}: has {len(thing.data.vertices)} vertices, the result {rows}: it was changed. Match again."
        )


def claim(thing, kind, names, taken):
    """Names that may be written: new ones, and those that an earlier run of ours made; others of the user are kept."""
    own = set(json.loads(thing.get("cagemap_made", "[]")))
    foreign = sorted(name for name in names if name in taken and f"{kind} {name}" not in own)
    if foreign:
        raise RefusedError(
            f"{thing.name}: has {kind}s of its own called {', '.join(foreign[:8])}. Rename or delete them."
        )
    thing["cagemap_made"] = json.dumps(sorted(own | {f"{kind} {name}" for name in names}))


def set_groups(thing, groups):
    """Write vertex groups as `cagemap transfer` carried them."""
    claim(thing, "vertex group", [group["name"] for group in groups], {group.name for group in thing.vertex_groups})
    for group in groups:
        known = thing.vertex_groups.get(group["name"])
        if known is not None:
            thing.vertex_groups.remove(known)
        made = thing.vertex_groups.new(name=group["name"])
        weights = group.get("weights") or [1.0] * len(group["vertices"])
        for vertex, weight in zip(group["vertices"], weights, strict=True):
            made.add([vertex], weight, "REPLACE")


def set_shapes(thing, shapes):
    """Write shape keys; `shapes` are positions (n, 3) in the object's space by name."""
    for positions in shapes.values():
        require_rows(thing, len(positions))
    keys = thing.data.shape_keys
    claim(thing, "shape key", shapes, {key.name for key in keys.key_blocks} if keys else set())
    if keys is None:
        thing.shape_key_add(name="Basis", from_mix=False)
    for name, positions in shapes.items():
        key = thing.data.shape_keys.key_blocks.get(name) or thing.shape_key_add(name=name, from_mix=False)
        key.data.foreach_set("co", np.asarray(positions, dtype=np.float32).ravel())
        key.value = 0.0  # Blender 5 shows new ones at once
    thing.data.update()


def tile_numbers(path):
    """Numbers of the tiles that are there of a set, <UDIM> in its name."""
    before, after = map(re.escape, path.name.split("<UDIM>"))
    found = (re.fullmatch(f"{before}(\\d{{4}}){after}", file.name) for file in path.parent.iterdir())
    return {int(one[1]) for one in found if one}


def show_image(thing, path):
    """Load a baked image and give the object a material that shows it; materials that are there stay as they are."""
    image = bpy.data.images.load(str(path), check_existing=True)
    if "<UDIM>" in path.name:  # Blender takes the first tile alone
        image.source = "TILED"
        wanted, there = tile_numbers(path), {tile.number for tile in image.tiles}
        for number in wanted - there:
            image.tiles.new(tile_number=number)
        for tile in [tile for tile in image.tiles if tile.number not in wanted]:
            image.tiles.remove(tile)
    image.reload()
    name = short_name(f"cagemap {path.stem.replace('.<UDIM>', '')}")
    material = bpy.data.materials.get(name)
    if material is None:
        material = bpy.data.materials.new(name)
        if material.node_tree is None:  # from Blender 5 on there always is one
            material.use_nodes = True
        nodes = material.node_tree.nodes
        texture = nodes.new("ShaderNodeTexImage")
        texture.image = image
        shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
        material.node_tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    if name not in [slot.name for slot in thing.material_slots]:
        thing.data.materials.append(material)
    return image
