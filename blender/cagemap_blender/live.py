"""The map follows while a landmark is dragged: a handler sees that one moved, a timer asks for the new map."""

from __future__ import annotations

import traceback

import bpy

from .client import RefusedError
from .operators import following
from .work import WORKER, Work, begin, proceed

_SECONDS = 0.05
_moved = False
_requests = None


@bpy.app.handlers.persistent
def landmark_moved(scene, depsgraph):
    """Note that a landmark of the pair moved."""
    global _moved
    settings = scene.cagemap
    if not settings.live:
        return
    for update in depsgraph.updates:
        thing = update.id.original
        if isinstance(thing, bpy.types.Object) and thing.type == "EMPTY" and update.is_updated_transform:
            _moved = _moved or (thing.parent is not None and thing.parent in (settings.target, settings.source))


def follow():
    """Ask for the map of the landmarks as they are now, or show it; seconds until the next look."""
    global _moved, _requests
    try:
        if _requests is not None:
            message = WORKER.receive()
            if (message is not None and proceed(_requests, message) is not True) or not WORKER.busy:
                _requests = None
        elif _moved and not Work.running and not WORKER.busy and WORKER.has_match:
            _moved = False
            _requests = following(bpy.context)
            begin(_requests)
    except RefusedError as error:
        _requests = None
        bpy.context.scene.cagemap.said = str(error)
    except Exception as error:  # Blender would end the timer
        _requests = None
        traceback.print_exc()
        bpy.context.scene.cagemap.said = f"The map does not follow: {type(error).__name__}: {error}. Press Match."
    return _SECONDS


def register():
    """Begin to look."""
    bpy.app.handlers.depsgraph_update_post.append(landmark_moved)
    bpy.app.timers.register(follow, persistent=True)


def unregister():
    """Look no more."""
    bpy.app.timers.unregister(follow)
    bpy.app.handlers.depsgraph_update_post.remove(landmark_moved)
