"""What can be transferred: requests to the computing process, and functions that write the replies into the scene."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Any, NamedTuple

import bpy
import numpy as np

from . import copies, reading, writing
from .client import RefusedError
from .materials import image_uses, set_materials
from .reading import sides


def count_phrase(values, noun):
    """A count and its noun."""
    return f"{len(values)} {noun}{'s' * (len(values) != 1)}"


def transfer_textures(context):
    """Compute materials and images; a function that writes them."""
    target, source = sides(context)
    if not any(slot.material for slot in source.material_slots):
        raise RefusedError(f"{source.name} has no materials.")
    last = max(len(source.material_slots) - 1, 0)  # as Blender shows faces of slots that are gone
    numbers = np.minimum(reading.numbers(source.data.polygons, "material_index", kind=np.int32), last)
    faces = (yield "materials", {"materials": numbers.astype(np.int64)})["materials"]
    target, source = sides(context)
    slots = [slot for number, slot in enumerate(source.material_slots) if number in faces]
    uses = {use.key: use for slot in slots for use in image_uses(source, slot.material)}
    names, size, images = _image_names(uses), context.scene.cagemap.size, []
    uvs = reading.uv_layers(source)
    for key, use in uses.items():
        pixels = reading.pixels_of(use.image)
        first = next(iter(pixels.values())) if isinstance(pixels, dict) else pixels
        images.append(
            {
                "name": names[key],
                "pixels": pixels,
                "size": (size, size) if size else first.shape[:2],
                "uvs": use.mapped(uvs[use.layer]),
                "normals": use.normals,
            }
        )
    baked = {}
    if images:
        layer = next((layer for layer in target.data.uv_layers if layer.active_render), None)
        if layer is None:
            raise RefusedError(f"{target.name} has no UV map to bake into. Unwrap it, or transfer UV Maps instead.")
        uvs = reading.uv_layers(target)[layer.name]
        baked = (yield "bake", {"images": images, "target_uvs": uvs})["images"]

    def write(context):
        target, source = sides(context)
        bakes = {
            key: writing.new_image(
                f"{name} on {target.name}", baked[name], writing.require_existing(bpy.data.images, key[0])
            )
            for key, name in names.items()
        }
        set_materials(target, source, faces, bakes)
        for object_ in (target, source):
            writing.hide_map(object_)
        writing.show_in_views(context, "TEXTURE")
        return count_phrase(bakes, "image")

    return write


def _image_names(uses):
    """Names of baked images by key: of an image's first use its own, of its other uses with a free number."""
    first_keys = {use.image.name: key for key, use in reversed(uses.items())}
    names = {key: name for name, key in first_keys.items()}
    for key, use in uses.items():
        if key not in names:
            numbered = (f"{use.image.name} {number}" for number in count(2))
            names[key] = next(name for name in numbered if name not in names.values())
    return names


def transfer_weights(context):
    """Compute vertex groups; a function that writes them."""
    target, source = sides(context)
    groups, bones = reading.vertex_groups(source), reading.bone_names(source)
    if not groups:
        raise RefusedError(f"{source.name} has no vertex groups.")
    writing.require_free(target, "vertex group", groups)
    skin = [name for name in groups if name in bones]
    carried = {}
    if skin:
        table = (yield "weights", {"weights": np.column_stack([groups[name] for name in skin])})["weights"]
        carried = dict(zip(skin, table.T, strict=True))
    others = {name: groups[name] for name in groups if name not in carried}
    carried |= (yield "values", {"vertices": others, "corners": {}})["vertices"]

    def write(context):
        writing.set_groups(sides(context)[0], carried)
        return count_phrase(carried, "vertex group")

    return write


def _named(kind, read, request, write_reply):
    """Transfer of named values: ``request`` asks the worker for them, ``write_reply`` writes them."""

    def carry(context):
        target, source = sides(context)
        given = read(source)
        if not given:
            raise RefusedError(f"{source.name} has no {kind}s.")
        writing.require_free(target, kind, given)
        reply = yield request(given)

        def write(context):
            write_reply(*sides(context), reply, given)
            return count_phrase(given, kind)

        return write

    return carry


def _color_request(attributes):
    """Colours by their domain."""
    vertices, corners = (
        {name: values for name, (values, own, _) in attributes.items() if own == domain}
        for domain in ("POINT", "CORNER")
    )
    return "values", {"vertices": vertices, "corners": corners}


def _set_colors(target, source, reply, attributes):
    """Colour attributes with the domains and types of the source's; the one for rendering as well, if there is none."""
    values = reply["vertices"] | reply["corners"]
    writing.set_colors(target, {name: (values[name], *attributes[name][1:]) for name in values})
    shown, own = (one.data.color_attributes for one in (source, target))
    rendered = shown[shown.render_color_index].name
    if rendered in values and own[own.render_color_index].name == reading.MAP_COLORS:
        own.render_color_index = own.keys().index(rendered)


def _set_shapes(target, source, reply, _):
    """Shape keys with the ranges of the source's."""
    writing.set_shapes(target, reply["shapes"])
    made, given = (one.data.shape_keys.key_blocks for one in (target, source))
    for name in set(reply["shapes"]) & set(given.keys()):
        for end in ("slider_min", "slider_max", "slider_min"):  # Blender clamps either end at the other one
            setattr(made[name], end, getattr(given[name], end))


def _set_uvs(target, source, reply, _):
    """UV maps; on a target without any the source's map for rendering is that of the target as well."""
    had_none = not target.data.uv_layers
    writing.set_uvs(target, reply["corners"])
    for layer in source.data.uv_layers if had_none else ():
        if layer.active_render and layer.name in target.data.uv_layers:
            target.data.uv_layers.active = target.data.uv_layers[layer.name]
            target.data.uv_layers.active.active_render = True


transfer_shapes = _named(
    "shape key",
    reading.masked_offsets,
    lambda offsets: ("shapes", {"shapes": offsets}),
    _set_shapes,
)
transfer_uvs = _named(
    "UV map",
    reading.uv_layers,
    lambda layers: ("values", {"vertices": {}, "corners": layers}),
    _set_uvs,
)
transfer_colors = _named("colour attribute", reading.color_attributes, _color_request, _set_colors)


def transfer_clothes(context):
    """Compute the selected garments; a function that writes copies of them."""
    _, source = sides(context)
    garments = selected_garments(context)
    if not garments:
        raise RefusedError("Select the clothes as well: meshes other than source and target.")
    keys = [writing.identity(garment) for garment in garments]
    meshes = [reading.mesh_arrays(context, garment, of=source) for garment in garments]
    shapes = [reading.shape_offsets(garment) for garment in garments]
    reply = yield "clothes", {"meshes": meshes, "shapes": shapes}

    def write(context):
        target, source = sides(context)
        garments = [writing.require_existing(bpy.data.objects, key) for key in keys]
        copy_of = {
            garment: copies.copy_garment(context, garment, target, source, *arrays)
            for garment, *arrays in zip(garments, reply["positions"], reply["shapes"], strict=True)
        }
        removed = copies.fit_modifiers(copy_of, target, source)
        notes = [*reply["notes"], *([f"removed, to be bound again: {', '.join(removed)}"] if removed else [])]
        if unweighted := copies.find_unweighted(copy_of.values(), reading.armature_of(target)):
            notes.append(f"without weights, not moved by bones: {', '.join(unweighted)}")
        return count_phrase(keys, "garment") + (f" ({'; '.join(notes)})" if notes else "")

    return write


def selected_garments(context):
    """Selected meshes but for the pair and for earlier copies on the target."""
    pair = sides(context)
    return [
        object_
        for object_ in context.scene.objects
        if object_.select_get()
        and object_.type == "MESH"
        and object_ not in pair
        and not object_.get("cagemap_copy", "").endswith(f" on {pair[0].name}")
    ]


class Kind(NamedTuple):
    """What can be transferred: its name in scripts, in the panel, a description, and the requests."""

    identifier: str
    label: str
    description: str
    requests: Callable[..., Any]


KINDS = (
    Kind(
        "TEXTURES",
        "Materials and Textures",
        "Copies of the source's materials, their images baked into the target's UVs",
        transfer_textures,
    ),
    Kind("WEIGHTS", "Vertex Groups", "Groups of bones as skin weights, others as plain values", transfer_weights),
    Kind("SHAPES", "Shape Keys", "All shape keys of the source", transfer_shapes),
    Kind("UVS", "UV Maps", "The source's UV maps, so that its images fit the target as they are", transfer_uvs),
    Kind("COLORS", "Colour Attributes", "Painted vertex colours", transfer_colors),
    Kind(
        "CLOTHES",
        "Clothes",
        "Copies of the other selected meshes, which sit on the source, on the target",
        transfer_clothes,
    ),
)
ITEMS = tuple(kind[:3] for kind in KINDS)
