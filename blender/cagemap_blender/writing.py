"""What the scene gets: colours, groups, shape keys, UVs, images; what the user made is never replaced."""

from __future__ import annotations

import json
import re
import tempfile

import bpy
import numpy as np

from .client import RefusedError
from .reading import MAP_COLORS, rest_positions, world

# UV maps that Blender takes.
_MOST_UV_MAPS = 8
# Weights below this are rounding and are not written.
_LEAST_WEIGHT = 1e-6


def short_name(name):
    """A name, cut to the 63 bytes that Blender takes."""
    return name.encode()[:63].decode(errors="ignore")


def identity(block):
    """Name and library of a block of data, which find it again after Undo."""
    return block.name, block.library.filepath if block.library else None


def require_existing(collection, key):
    """A block of data by its `identity`; refused if it was removed or renamed while cagemap computed."""
    if key not in collection:
        raise RefusedError(f"{key[0]} was removed while cagemap computed. Press the button again.")
    return collection[key]


def require_rows(object_, rows):
    """Refuse rows that were computed for another state of the mesh."""
    if rows != len(object_.data.vertices):
        raise RefusedError(f"{object_.name} was changed while cagemap computed. Press the button again.")


def require_free(object_, kind, names):
    """Refuse names that are taken, except by what an earlier run made."""
    own, taken = set(_claims(object_)), taken_names(object_, kind)
    foreign = sorted(name for name in names if name in taken and f"{kind} {name}" not in own)
    if foreign:
        raise RefusedError(
            f"{object_.name} has {kind}s of its own called {', '.join(foreign[:8])}. Rename or delete them."
        )
    count = len(taken | set(names))
    if kind == "UV map" and count > _MOST_UV_MAPS:
        raise RefusedError(f"{object_.name} would have {count} UV maps, Blender takes {_MOST_UV_MAPS}. Delete some.")


def _claims(object_):
    """What earlier runs made, each as kind and name."""
    return json.loads(object_.get("cagemap_made", "[]"))


def claim(object_, kind, names):
    """Note names that are written now, so that a later run may replace them."""
    require_free(object_, kind, names)
    made = {*_claims(object_), *(f"{kind} {name}" for name in names)}
    object_["cagemap_made"] = json.dumps(sorted(made))


def forget_deleted(object_):
    """Forget names whose owner was deleted or renamed: what has them later is the user's."""
    names_in_use = {f"{kind} {one.name}" for kind, values in _named_values(object_).items() for one in values}
    claims = _claims(object_)
    kept = [one for one in claims if one in names_in_use]
    if kept != claims:
        object_["cagemap_made"] = json.dumps(kept)


def taken_names(object_, kind):
    """Names of the groups, shape keys, UV maps or colour attributes of an object."""
    return {one.name for one in _named_values(object_)[kind]}


def _named_values(object_):
    """Groups, shape keys, UV maps and colour attributes of an object, by kind."""
    keys = object_.data.shape_keys
    return {
        "vertex group": object_.vertex_groups,
        "shape key": keys.key_blocks if keys else (),
        "UV map": object_.data.uv_layers,
        "colour attribute": object_.data.color_attributes,
    }


def show_map(object_, colors):
    """Write the map's colours (n, 3) of an object, and show them."""
    require_rows(object_, len(colors))
    attributes = object_.data.color_attributes
    active = attributes.active_color
    if active is not None and active.name != MAP_COLORS:
        object_["cagemap_active_color"] = active.name
    layer = object_.data.attributes.get(MAP_COLORS) or attributes.new(MAP_COLORS, "FLOAT_COLOR", "POINT")
    if (layer.domain, layer.data_type) != ("POINT", "FLOAT_COLOR"):
        raise RefusedError(f"{object_.name} has an attribute of its own called {MAP_COLORS}. Rename or delete it.")
    values = np.ones((len(colors), 4), dtype=np.float32)
    values[:, :3] = np.clip(colors, 0.0, 1.0)
    layer.data.foreach_set("color", values.ravel())
    attributes.active_color = layer
    object_.data.update()


def hide_map(object_):
    """Make the colours active that were so before those of the map."""
    attributes = object_.data.color_attributes
    layer = attributes.get(object_.get("cagemap_active_color", ""))
    if layer is not None:
        attributes.active_color = layer


def show_in_views(context, color_type):
    """Let Solid views show vertex colours ("VERTEX") or images ("TEXTURE")."""
    for area in context.screen.areas if context.screen else ():
        if area.type == "VIEW_3D" and area.spaces.active.shading.type == "SOLID":
            area.spaces.active.shading.color_type = color_type


def set_groups(object_, groups):
    """Write vertex groups, weights (n,) by name."""
    claim(object_, "vertex group", groups)
    for name, weights in groups.items():
        require_rows(object_, len(weights))
        made = object_.vertex_groups.get(name) or object_.vertex_groups.new(name=name)
        made.remove(range(len(weights)))
        for vertex in np.flatnonzero(weights > _LEAST_WEIGHT).tolist():
            made.add([vertex], float(weights[vertex]), "REPLACE")


def set_shapes(object_, offsets):
    """Write shape keys, offsets (n, 3) in the world's axes by name."""
    turn = np.linalg.inv(world(object_)[:3, :3])
    set_positions(object_, {name: rest_positions(object_) + rows @ turn.T for name, rows in offsets.items()})


def set_positions(object_, shapes):
    """Write shape keys, positions (n, 3) in the object's space by name."""
    for positions in shapes.values():
        require_rows(object_, len(positions))
    keys = object_.data.shape_keys
    claim(object_, "shape key", shapes)
    if keys is None:
        object_.shape_key_add(name="Rest shape" if "Basis" in shapes else "Basis", from_mix=False)
    for name, positions in shapes.items():
        key = object_.data.shape_keys.key_blocks.get(name) or object_.shape_key_add(name=name, from_mix=False)
        key.data.foreach_set("co", positions.astype(np.float32).ravel())
        key.value = 0.0  # Blender 5 shows new ones at once
    object_.data.update()


def set_uvs(object_, layers):
    """Write UV layers (c, 2) by name; corners without values keep what they have, in new layers 0."""
    claim(object_, "UV map", layers)
    for name, uvs in layers.items():
        layer = object_.data.uv_layers.get(name) or object_.data.uv_layers.new(name=name, do_init=False)
        kept = np.zeros(uvs.shape, dtype=np.float32)
        layer.uv.foreach_get("vector", kept.ravel())
        # Not `layer.uv`: that would write into copies of the mesh and into Undo as well.
        layer.data.foreach_set("uv", np.where(np.isnan(uvs), kept, uvs).astype(np.float32).ravel())


def set_colors(object_, colors):
    """Write colour attributes: values, domain and type by name."""
    attributes = object_.data.color_attributes
    claim(object_, "colour attribute", colors)
    for name, (values, domain, kind) in colors.items():
        known = attributes.get(name)
        if known is not None:
            attributes.remove(known)
        attributes.new(name, kind, domain).data.foreach_set("color", np.nan_to_num(values).astype(np.float32).ravel())


def new_image(name, tiles, like):
    """An image of pixels (h, w, channels), row 0 at the top, by UDIM number or 0; kept in the .blend file."""
    name = short_name(name)
    if list(tiles) == [0]:
        image = _plain_image(name, tiles[0], like)
        image.pack()
        image["cagemap_made"] = name
        return image
    stem, suffix = re.sub(r"[^\w-]+", "_", name), "exr" if like.is_float else "png"
    with tempfile.TemporaryDirectory() as folder:
        for number, pixels in tiles.items():  # Blender takes pixels of the first tile only, but files of all
            tile = _plain_image(name, pixels, like)
            tile.file_format = "OPEN_EXR" if like.is_float else "PNG"
            tile.filepath_raw = f"{folder}/{stem}.{number}.{suffix}"
            tile.save()
            bpy.data.images.remove(tile)
        image = bpy.data.images.load(f"{folder}/{stem}.{min(tiles)}.{suffix}")
        image.source, image.name = "TILED", name
        image.filepath = f"{folder}/{stem}.<UDIM>.{suffix}"
        numbers = {tile.number for tile in image.tiles}
        for number in sorted(set(tiles) - numbers):
            image.tiles.new(tile_number=number)
        for tile in [tile for tile in image.tiles if tile.number not in tiles]:
            image.tiles.remove(tile)
        _interpret_like(image, like)
        image.reload()
        image.pack()
    image.filepath_raw = f"//textures/{stem}.<UDIM>.{suffix}"  # where it goes if it is unpacked
    image["cagemap_made"] = name
    return image


def _interpret_like(image, like):
    """Give an image colour space and alpha of another; Blender holds floats of colours linear and premultiplied."""
    is_linear = like.is_float and not like.colorspace_settings.is_data
    if not is_linear:
        image.colorspace_settings.name = like.colorspace_settings.name
    image.alpha_mode = "PREMUL" if like.is_float and like.alpha_mode == "STRAIGHT" else like.alpha_mode


def _plain_image(name, pixels, like):
    height, width, channels = pixels.shape
    values = np.ones((height, width, 4), dtype=np.float32)
    scale = 255.0 if pixels.dtype == np.uint8 else 1.0
    values[:, :, :channels] = pixels[::-1] / np.float32(scale)
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=like.is_float)
    _interpret_like(image, like)
    image.pixels.foreach_set(values.ravel())
    image.update()
    return image
