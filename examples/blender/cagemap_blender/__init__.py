"""cagemap inside Blender: maps between two models, and what the maps carry, by an installed `cagemap` command.

See docs/blender.md. The buttons are in the sidebar of the 3D view, tab *cagemap*; scripts call
``bpy.ops.cagemap.match()`` and so on. Models go out as OBJ files with subdivision tags (the control mesh, never what
modifiers make of it), cagemap does the rest, and what it wrote comes back as images, vertex groups and shape keys.
"""

import bpy

from . import operators, panel, work

bl_info = {
    "name": "cagemap",
    "author": "the cagemap authors",
    "version": (0, 1, 0),
    "blender": (4, 2, 0),
    "location": "3D View > Sidebar > cagemap",
    "description": "Carry textures, weights and shapes between models of different topology",
    "category": "Object",
}

_CLASSES = (
    panel.CagemapSettings,
    panel.CagemapPreferences,
    operators.CAGEMAP_OT_match,
    operators.CAGEMAP_OT_texture,
    operators.CAGEMAP_OT_weights,
    operators.CAGEMAP_OT_shapes,
    operators.CAGEMAP_OT_wrap,
    operators.CAGEMAP_OT_report,
    panel.CAGEMAP_PT_panel,
)


def register():
    """Make the buttons known to Blender."""
    for kind in _CLASSES:
        bpy.utils.register_class(kind)
    bpy.app.handlers.load_pre.append(work.stop)
    bpy.types.Scene.cagemap = bpy.props.PointerProperty(type=panel.CagemapSettings)


def unregister():
    """Take them away again."""
    work.stop()
    bpy.app.handlers.load_pre.remove(work.stop)
    del bpy.types.Scene.cagemap
    for kind in reversed(_CLASSES):
        bpy.utils.unregister_class(kind)
