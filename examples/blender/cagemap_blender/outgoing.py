"""What goes out: control meshes as OBJ files with subdivision tags, landmarks, vertex groups, images."""

import re
import zlib
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from .errors import RefusedError

# Blender's world (Z up) to that of the files (Y up), as its own OBJ exporter has it.
TO_FILE = Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)))
LANDMARK_GROUP = "lm_"
_UV_SMOOTH = {
    "NONE": 5,
    "PRESERVE_CORNERS": 1,
    "PRESERVE_CORNERS_AND_JUNCTIONS": 2,
    "PRESERVE_CORNERS_JUNCTIONS_AND_CONCAVE": 3,
    "PRESERVE_BOUNDARIES": 4,
    "SMOOTH_ALL": 0,
}
_BOUNDARY = {"PRESERVE_CORNERS": 1, "ALL": 2}
_CAGE_MODIFIERS = ("SUBSURF", "MULTIRES")


def mesh_text(vertices, faces, uvs=None, materials=None, tags=()):
    """A control mesh as the text of an OBJ file.

    Parameters
    ----------
    vertices : (n, 3) array
    faces : list of sequences of int
        Vertices of each face, from 0.
    uvs : (corners, 2) array, optional
        One row for each corner of each face, face after face.
    materials : list of str, optional
        Name of the material of each face.
    tags : iterable of str
        Subdivision tags, see docs/formats.md.
    """
    lines = ["# control mesh, written by cagemap's add-on for Blender"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    if uvs is not None:
        places, number = np.unique(uvs, axis=0, return_inverse=True)
        number = number.ravel()
        lines += [f"vt {u:.9g} {v:.9g}" for u, v in places]
    corner, material = 0, None
    for i, face in enumerate(faces):
        if materials is not None and materials[i] != material:
            material = materials[i]
            lines.append("usemtl " + re.sub(r"\s+", "_", material))
        if uvs is None:
            lines.append("f " + " ".join(str(v + 1) for v in face))
        else:
            lines.append("f " + " ".join(f"{v + 1}/{number[corner + k] + 1}" for k, v in enumerate(face)))
        corner += len(face)
    return "\n".join([*lines, *tags, ""])


def crease_tags(edges, creases, corners):
    """Tags of creased edges and vertices: Blender's crease c is the sharpness 10 c^2.

    Parameters
    ----------
    edges : (e, 2) array
    creases : (e,) array
        From 0 to 1.
    corners : (n,) array
        Of the vertices, from 0 to 1.
    """
    tags = [f"t crease 2/1/0 {edges[e][0]} {edges[e][1]} {10 * creases[e] ** 2:.6g}" for e in np.flatnonzero(creases)]
    return tags + [f"t corner 1/1/0 {v} {10 * corners[v] ** 2:.6g}" for v in np.flatnonzero(corners)]


def plain_name(name):
    """The name of a landmark: Blender's number for names that are taken says nothing."""
    return re.sub(r"\.\d{3,}$", "", name)


def cage_modifier(thing):
    """The modifier that subdivides an object, None where none that is shown does."""
    return next((m for m in thing.modifiers if m.type in _CAGE_MODIFIERS and m.show_viewport), None)


def modifier_tags(thing):
    """Subdivision options of an object as its modifier has them; a mesh without one is its own surface."""
    modifier = cage_modifier(thing)
    if modifier is None:
        return ["t scheme 0/0/1 none"]
    simple = getattr(modifier, "subdivision_type", "CATMULL_CLARK") == "SIMPLE"
    tags = [
        f"t scheme 0/0/1 {'bilinear' if simple else 'catmull-clark'}",
        f"t interpolateboundary 1/0/0 {_BOUNDARY[modifier.boundary_smooth]}",
        f"t facevaryinginterpolateboundary 1/0/0 {_UV_SMOOTH[modifier.uv_smooth]}",
    ]
    if not modifier.use_creases:
        return tags
    mesh = thing.data
    edges = np.empty(2 * len(mesh.edges), dtype=np.int64)
    mesh.edges.foreach_get("vertices", edges)
    creases = _attribute(mesh, "crease_edge", len(mesh.edges))
    return tags + crease_tags(edges.reshape(-1, 2), creases, _attribute(mesh, "crease_vert", len(mesh.vertices)))


def require_control_mesh(context, thing):
    """Refuse an object whose modifiers make another mesh before it is subdivided: numbers would not fit."""
    stack = list(thing.modifiers)
    subdivides = cage_modifier(thing)
    first = len(stack) if subdivides is None else stack.index(subdivides)
    shown = [m.show_viewport for m in stack]
    try:
        for modifier in stack[first:]:
            modifier.show_viewport = False
        mesh = thing.evaluated_get(context.evaluated_depsgraph_get()).data
        same = (len(mesh.vertices), len(mesh.polygons)) == (len(thing.data.vertices), len(thing.data.polygons))
    finally:
        for modifier, before in zip(stack, shown, strict=True):
            modifier.show_viewport = before
    if not same:
        names = ", ".join(m.name for m, on in zip(stack, shown, strict=True) if on and m in stack[:first])
        raise RefusedError(f"{thing.name}: its modifiers ({names}) add or remove vertices. Apply or hide them first.")


def write_object(context, thing, path, uv_layer):
    """Write the control mesh of an object, where it stands in the world, at rest (no pose, no shape keys)."""
    require_control_mesh(context, thing)
    mesh, to_file = thing.data, TO_FILE @ thing.matrix_world
    positions = rest_positions(thing) @ np.array(to_file.to_3x3()).T + np.array(to_file.translation)
    faces = [list(polygon.vertices) for polygon in mesh.polygons]
    corners = [list(polygon.loop_indices) for polygon in mesh.polygons]
    if to_file.determinant() < 0:  # a mirrored object shows its faces from the other side
        faces, corners = [face[::-1] for face in faces], [some[::-1] for some in corners]
    uvs = None
    if uv_layer is not None:
        flat = np.empty(2 * len(mesh.loops), dtype=np.float32)
        uv_layer.uv.foreach_get("vector", flat)
        uvs = flat.reshape(-1, 2)[[corner for some in corners for corner in some]]
    names = [slot.name or f"slot{i}" for i, slot in enumerate(thing.material_slots)]
    last = len(names) - 1  # which Blender shows where a face says a slot that is gone
    materials = [names[min(polygon.material_index, last)] for polygon in mesh.polygons] if last > 0 else None
    path.write_text(mesh_text(positions, faces, uvs, materials, modifier_tags(thing)), encoding="utf-8")


def rest_positions(thing):
    """(n, 3) positions of the control vertices in the object's space, without shape keys."""
    keys = thing.data.shape_keys
    return coordinates(keys.reference_key.data if keys else thing.data.vertices)


def coordinates(points):
    """(n, 3) places of vertices or of a shape key's points."""
    flat = np.empty(3 * len(points), dtype=np.float32)
    points.foreach_get("co", flat)
    return flat.reshape(-1, 3).astype(np.float64)


def _attribute(mesh, name, count):
    values = np.zeros(count, dtype=np.float32)
    if name in mesh.attributes:
        mesh.attributes[name].data.foreach_get("value", values)
    return values


def landmark_points(thing):
    """Landmarks of an object by name: empties that are its children, and vertex groups lm_NAME of one vertex."""
    points = []
    for child in thing.children:
        if child.type == "EMPTY":
            place = TO_FILE @ child.matrix_world.translation
            points.append({"name": plain_name(child.name), "position": list(place)})
    for name, weights in vertex_groups(thing).items():
        if name.startswith(LANDMARK_GROUP):
            if len(weights) != 1:
                raise RefusedError(
                    f"{thing.name}: {name} has {len(weights)} vertices. A landmark is a group of one vertex."
                )
            points.append({"name": name[len(LANDMARK_GROUP) :], "vertex": next(iter(weights))})
    names = [point["name"] for point in points]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise RefusedError(f"{thing.name}: more than one landmark is called {', '.join(twice)}. Rename or delete one.")
    return points


def vertex_groups(thing):
    """Vertices and weights of every vertex group, by name; zeros are no membership."""
    names = [group.name for group in thing.vertex_groups]
    groups = {name: {} for name in names}
    for vertex in thing.data.vertices:
        for element in vertex.groups:
            if element.weight > 0:
                groups[names[element.group]][vertex.index] = element.weight
    return groups


def bone_names(thing):
    """Names of the bones that deform an object: their groups are skin weights, all others are plain values."""
    armatures = [m.object for m in thing.modifiers if m.type == "ARMATURE" and m.object]
    return {bone.name for armature in armatures for bone in armature.data.bones if bone.use_deform}


def texture_of(thing):
    """The image that the source's material shows: the first one on its way to a base colour."""
    for slot in thing.material_slots:
        nodes = slot.material.node_tree.nodes if slot.material and slot.material.node_tree else []
        images = [node for node in nodes if node.type == "TEX_IMAGE" and node.image]
        colours = [n for n in images if any(link.to_socket.name == "Base Color" for o in n.outputs for link in o.links)]
        for node in [*colours, *images]:
            return node.image
    raise RefusedError(f"{thing.name}: its materials have no image. Choose one under Image.")


def image_file(image, folder):
    """The file of an image; one that has none, or was painted on since, is written beside the models."""
    path = Path(bpy.path.abspath(image.filepath_raw))
    if image.source == "TILED" or (image.filepath_raw and path.is_file() and not image.is_dirty):
        return path
    kept = folder / f"{file_name(image.name)}.{'exr' if image.is_float else 'png'}"
    copy = image.copy()
    try:
        copy.file_format = "OPEN_EXR" if image.is_float else "PNG"
        copy.filepath_raw = str(kept)
        copy.save()
    except RuntimeError as error:
        raise RefusedError(f"{image.name}: could not be saved ({error}). Save it as a file first.") from error
    finally:
        bpy.data.images.remove(copy)
    return kept


def file_name(name):
    """A name as files may have it; one that had to be changed gets a number that keeps it apart from others."""
    plain = re.sub(r"[^\w.-]+", "_", name).strip("._")
    return plain if plain == name else f"{plain or 'model'}_{zlib.crc32(name.encode()):08x}"


def short_name(name):
    """A name as long as Blender takes it."""
    return name.encode()[:63].decode(errors="ignore")
