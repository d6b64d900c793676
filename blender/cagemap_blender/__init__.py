"""cagemap in Blender: maps between two models, and what the maps carry.

See docs/blender.md. The buttons are in the sidebar of the 3D view, tab *cagemap*; scripts call
``bpy.ops.cagemap.match()`` and so on. `worker` computes, in a process of its own; `client` talks to it; `reading` and
`writing` are all that touches the scene, with `materials` and `copies`; `transfers` lists what can be transferred;
`work` runs a button.
"""

import bpy

from . import live, operators, panel, work

_CLASSES = (panel.CagemapSettings, *operators.CLASSES, panel.CAGEMAP_PT_panel)


def register():
    """Make the buttons known to Blender."""
    for kind in _CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.Scene.cagemap = bpy.props.PointerProperty(type=panel.CagemapSettings)
    bpy.app.handlers.load_pre.append(work.stop)
    bpy.app.handlers.depsgraph_update_post.append(work.objects_changed)
    live.register()


def unregister():
    """Take them away again."""
    live.unregister()
    bpy.app.handlers.depsgraph_update_post.remove(work.objects_changed)
    bpy.app.handlers.load_pre.remove(work.stop)
    work.stop()
    del bpy.types.Scene.cagemap
    for kind in reversed(_CLASSES):
        bpy.utils.unregister_class(kind)
