"""The tab in the sidebar, its settings, and the preferences."""

import bpy

from .work import Work


def _is_mesh(settings, thing):
    return thing.type == "MESH"


class CagemapSettings(bpy.types.PropertyGroup):
    """What the buttons work on."""

    target: bpy.props.PointerProperty(type=bpy.types.Object, poll=_is_mesh, name="Target", description="Receives")
    source: bpy.props.PointerProperty(type=bpy.types.Object, poll=_is_mesh, name="Source", description="Gives")
    image: bpy.props.PointerProperty(
        type=bpy.types.Image, name="Image", description="Of the source; empty: the one that its material shows"
    )
    vertices: bpy.props.IntProperty(name="Vertices", default=100_000, min=1000, max=2_000_000)
    size: bpy.props.IntProperty(name="Texels", default=2048, min=64, max=16384, description="Texels a side")
    part: bpy.props.StringProperty(name="Part", description="of a mesh of several pieces: 'largest', or 'each'")
    folder: bpy.props.StringProperty(name="Folder", default="//cagemap", subtype="DIR_PATH")
    said: bpy.props.StringProperty()


class CagemapPreferences(bpy.types.AddonPreferences):
    """Where cagemap is."""

    bl_idname = __package__
    command: bpy.props.StringProperty(name="Command", default="cagemap", subtype="FILE_PATH")

    def draw(self, context):
        """Show the field."""
        self.layout.prop(self, "command")


class CAGEMAP_PT_panel(bpy.types.Panel):
    """The tab in the sidebar."""

    bl_label = "cagemap"
    bl_category = "cagemap"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"

    def draw(self, context):
        """Show settings, buttons, and what the last command said."""
        settings, layout = context.scene.cagemap, self.layout
        layout.enabled = Work.running is None
        for name in ("target", "source", "vertices", "part", "folder"):
            layout.prop(settings, name)
        layout.operator("cagemap.match")
        for name in ("image", "size"):
            layout.prop(settings, name)
        for name in ("texture", "weights", "shapes", "wrap", "report"):
            layout.operator(f"cagemap.{name}")
        for line in settings.said.splitlines()[:12]:
            layout.label(text=line)
