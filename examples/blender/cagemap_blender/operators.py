"""The buttons."""

import json
import webbrowser
from pathlib import Path

import bpy
import numpy as np

from .errors import RefusedError
from .incoming import obj_positions, require_rows, set_groups, set_shapes, show_image
from .outgoing import (
    LANDMARK_GROUP,
    TO_FILE,
    bone_names,
    coordinates,
    file_name,
    image_file,
    landmark_points,
    plain_name,
    rest_positions,
    short_name,
    texture_of,
    vertex_groups,
    write_object,
)
from .work import Work, pair_folder, placement, sides, write_placements


class CAGEMAP_OT_match(Work, bpy.types.Operator):
    """Find the map between source and target, with the landmarks that both have."""

    bl_idname = "cagemap.match"
    bl_label = "Match"
    bl_description = "Find the map between source and target, with the landmarks that both have"

    def commands(self, context):
        """Write what is read, and give the arguments."""
        target, source = sides(context)
        folder = pair_folder(context, made=True)
        settings = context.scene.cagemap
        layers = {"target": target.data.uv_layers.active, "source": None}
        layers["source"] = next((layer for layer in source.data.uv_layers if layer.active_render), None)
        given = ["match", "--vertices", settings.vertices, "-o", folder / "RESULT"]
        points = {role: landmark_points(thing) for role, thing in (("target", target), ("source", source))}
        if any(points.values()) and not all(points.values()):
            bare = target if points["source"] else source
            self.report({"WARNING"}, f"{bare.name} has no landmarks, so those of the other object are not used.")
        write_placements(folder, {"target": target, "source": source})
        for role, thing in (("target", target), ("source", source)):
            write_object(context, thing, folder / f"{role}.obj", layers[role])
            given += [f"--{role}", folder / f"{role}.obj"]
            if all(points.values()):
                file = folder / f"{role}_points.json"
                file.write_text(json.dumps({"points": points[role]}, indent=1), encoding="utf-8")
                given += [f"--{role}-points", file]
        if settings.part:
            given += ["--part", settings.part]
        return [given]


class CAGEMAP_OT_texture(Work, bpy.types.Operator):
    """Bake the source's texture into the target's UV map, as a new material of the target."""

    bl_idname = "cagemap.texture"
    bl_label = "Texture"
    bl_description = "Bake the source's texture into the target's UV map, as a new material of the target"

    def commands(self, context):
        """Write what is read, and give the arguments."""
        target, source = sides(context)
        folder, settings = pair_folder(context), context.scene.cagemap
        if target.data.uv_layers.active is None:
            raise RefusedError(f"{target.name}: has no UV map. Unwrap it, and match again.")
        image = settings.image or texture_of(source)
        name = Path(plain_name(image.name).replace(".<UDIM>", "")).stem
        tile = ".<UDIM>" if image.source == "TILED" and len(image.tiles) > 1 else ""
        self._output = folder / f"{file_name(target.name)}_{file_name(name)}{tile}.png"
        given = ["--texture", image_file(image, folder), "--size", settings.size, "-o", self._output]
        return [["transfer", folder / "RESULT", *given]]

    def finish(self, context):
        """Take what was written into the scene."""
        image = show_image(context.scene.cagemap.target, self._output)
        return f"{image.name}: {self._output}"


class CAGEMAP_OT_weights(Work, bpy.types.Operator):
    """Carry the source's vertex groups to the target: groups of bones as skin weights, others as plain values."""

    bl_idname = "cagemap.weights"
    bl_label = "Vertex Groups"
    bl_description = (
        "Carry the source's vertex groups to the target: groups of bones as skin weights, others as plain values"
    )

    def commands(self, context):
        """Write what is read, and give the arguments."""
        _, source = sides(context)
        folder, bones = pair_folder(context), bone_names(source)
        groups = {n: w for n, w in vertex_groups(source).items() if w and not n.startswith(LANDMARK_GROUP)}
        if not groups:
            raise RefusedError(f"{source.name}: has no vertex groups.")
        self._outputs, commands = [], []
        for option in ("weights", "attribute"):
            chosen = {n: w for n, w in groups.items() if (n in bones) == (option == "weights")}
            if chosen:
                data = [{"name": n, "vertices": list(w), "weights": list(w.values())} for n, w in chosen.items()]
                file, output = folder / f"source_{option}.json", folder / f"target_{option}.json"
                file.write_text(json.dumps({"groups": data}), encoding="utf-8")
                commands.append(["transfer", folder / "RESULT", f"--{option}", file, "-o", output])
                self._outputs.append(output)
        return commands

    def finish(self, context):
        """Take what was written into the scene."""
        read = [json.loads(output.read_text(encoding="utf-8"))["groups"] for output in self._outputs]
        groups = [group for some in read for group in some]
        set_groups(context.scene.cagemap.target, groups)
        return f"{len(groups)} vertex groups"


class CAGEMAP_OT_shapes(Work, bpy.types.Operator):
    """Carry the source's shape keys to the target."""

    bl_idname = "cagemap.shapes"
    bl_label = "Shape Keys"
    bl_description = "Carry the source's shape keys to the target"

    def commands(self, context):
        """Write what is read, and give the arguments."""
        _, source = sides(context)
        folder, keys = pair_folder(context), source.data.shape_keys
        if keys is None or len(keys.key_blocks) < 2:
            raise RefusedError(f"{source.name}: has no shape keys.")
        turn = placement(folder, "source")
        offsets = {
            key.name: (coordinates(key.data) - coordinates(key.relative_key.data)) @ turn.T
            for key in keys.key_blocks
            if key != keys.reference_key
        }
        np.savez(folder / "source_shapes.npz", **offsets)
        self._output = folder / "target_shapes.npz"
        return [["transfer", folder / "RESULT", "--blend-shapes", folder / "source_shapes.npz", "-o", self._output]]

    def finish(self, context):
        """Take what was written into the scene."""
        target = context.scene.cagemap.target
        turn = np.linalg.inv(placement(pair_folder(context), "target"))
        with np.load(self._output) as data:
            offsets = {name: data[name] for name in data.files if data[name].ndim == 2}
        for rows in offsets.values():
            require_rows(target, len(rows))
        set_shapes(target, {name: rest_positions(target) + rows @ turn.T for name, rows in offsets.items()})
        return f"{len(offsets)} shape keys"


class CAGEMAP_OT_wrap(Work, bpy.types.Operator):
    """Give the target's control mesh the shape of the source, as a shape key."""

    bl_idname = "cagemap.wrap"
    bl_label = "Wrap"
    bl_description = "Give the target's control mesh the shape of the source, as a shape key"

    def commands(self, context):
        """Write what is read, and give the arguments."""
        sides(context)
        folder = pair_folder(context)
        self._output = folder / "wrapped.obj"
        return [["wrap", folder / "RESULT", "-o", self._output]]

    def finish(self, context):
        """Take what was written into the scene."""
        target, source = sides(context)
        to_object = np.array((TO_FILE @ target.matrix_world).inverted())
        positions = obj_positions(self._output.read_text(encoding="utf-8"))
        name = short_name(f"wrapped {source.name}")
        set_shapes(target, {name: positions @ to_object[:3, :3].T + to_object[:3, 3]})
        target.data.shape_keys.key_blocks[name].value = 1.0


class CAGEMAP_OT_report(Work, bpy.types.Operator):
    """Write the page that shows how good the map is, and open it in the browser."""

    bl_idname = "cagemap.report"
    bl_label = "Report"
    bl_description = "Write the page that shows how good the map is, and open it in the browser"

    def commands(self, context):
        """Write what is read, and give the arguments."""
        sides(context)
        folder = pair_folder(context)
        self._output = folder / "report.html"
        return [["report", folder / "RESULT", "-o", self._output]]

    def finish(self, context):
        """Take what was written into the scene."""
        if not bpy.app.background:
            webbrowser.open(self._output.as_uri())
