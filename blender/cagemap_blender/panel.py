"""The tab in the sidebar, and its settings."""

from __future__ import annotations

import bpy

from .transfers import ITEMS
from .work import Work


def _is_mesh(settings, object_):
    return object_.type == "MESH"


class CagemapSettings(bpy.types.PropertyGroup):
    """What the buttons work on."""

    source: bpy.props.PointerProperty(
        type=bpy.types.Object, poll=_is_mesh, name="Source", description="The object that gives"
    )
    target: bpy.props.PointerProperty(
        type=bpy.types.Object, poll=_is_mesh, name="Target", description="The object that receives"
    )
    vertices: bpy.props.IntProperty(
        name="Vertices",
        default=100_000,
        min=1000,
        max=2_000_000,
        description="About how many vertices subdivided meshes are matched with; more are finer and slower",
    )
    live: bpy.props.BoolProperty(name="Live", default=True, description="The map follows while a landmark is dragged")
    what: bpy.props.EnumProperty(items=ITEMS, options={"ENUM_FLAG"}, default={"TEXTURES"}, name="Transfer")
    size: bpy.props.IntProperty(
        name="Texels", default=0, min=0, max=16384, description="Texels a side of baked images; 0: as the source's"
    )
    message: bpy.props.StringProperty()


class CAGEMAP_PT_panel(bpy.types.Panel):
    """The tab in the sidebar."""

    bl_label = "cagemap"
    bl_category = "cagemap"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"

    def draw(self, context):
        """Show settings, buttons, and what is known of the map."""
        settings, layout = context.scene.cagemap, self.layout
        layout.enabled = not Work.running
        pair = layout.column()
        pair.use_property_split, pair.use_property_decorate = True, False
        for name in ("source", "target", "vertices"):
            pair.prop(settings, name)
        layout.operator("cagemap.match", icon="MOD_MESHDEFORM")
        row = layout.row(align=True)
        row.operator("cagemap.landmark", icon="EMPTY_AXIS")
        row.prop(settings, "live", toggle=True)
        row.operator("cagemap.follow", text="", icon="FILE_REFRESH")
        box = layout.box()
        box.column().prop(settings, "what")
        if "TEXTURES" in settings.what:
            box.prop(settings, "size")
        box.operator("cagemap.transfer", icon="TRIA_RIGHT").what = settings.what
        row = layout.row(align=True)
        row.operator("cagemap.wrap", icon="MOD_SHRINKWRAP")
        row.operator("cagemap.rig", icon="ARMATURE_DATA")
        width = max(20, int(context.region.width / (7 * context.preferences.system.ui_scale)))
        lines = layout.column(align=True)
        for sentence in settings.message.splitlines():
            for line in _wrapped(sentence, width):
                lines.label(text=line)


def _wrapped(sentence, width):
    """Lines of a sentence that fit the panel."""
    lines = [""]
    for word in sentence.split():
        if lines[-1] and len(lines[-1]) + len(word) >= width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines
