"""The map follows while a landmark is dragged: a handler sees that one moved, a timer asks for the new map."""

from __future__ import annotations

import traceback

import bpy

from .client import RefusedError
from .operators import following
from .reading import chosen_pair, landmark_points, object_in_edit_mode
from .work import WORKER, Work, begin, landmark_digest, proceed

_SECONDS = 0.05
_moved = False
_requests = None


@bpy.app.handlers.persistent
def landmark_moved(scene, depsgraph):
    """Note that a landmark of the pair moved."""
    global _moved
    settings = scene.cagemap
    if _moved or not settings.live or not (WORKER.has_match or WORKER.busy):
        return
    for update in depsgraph.updates:
        object_ = update.id.original
        if isinstance(object_, bpy.types.Object) and object_.type == "EMPTY" and update.is_updated_transform:
            _moved = _moved or (object_.parent is not None and object_.parent in (settings.target, settings.source))


def follow():
    """Ask for the map of the landmarks as they are now, or show it; seconds until the next call."""
    try:
        _step(bpy.context)
    except RefusedError as error:
        _end(str(error))
    except Exception as error:  # Blender would end the timer
        traceback.print_exc()
        _end(f"The map does not follow: {type(error).__name__}: {error}. Press Match.")
    return _SECONDS


def _step(context):
    """Take a reply, or send a request if landmarks moved on their objects."""
    global _moved, _requests
    if _requests is not None:
        if not WORKER.busy:  # it was stopped
            _requests = None
        elif object_in_edit_mode(context) is None:  # else the reply waits: nothing can be written in Edit Mode
            message = WORKER.receive()
            if message is not None and proceed(_requests, message) is not True:
                _requests = None
    elif _moved and not Work.running and not WORKER.busy and WORKER.has_match and object_in_edit_mode(context) is None:
        _moved = False
        context.view_layer.update()
        if landmark_digest(*landmark_points(*chosen_pair(context))) != WORKER.matched[1]:
            _requests = following(context)
            begin(_requests)


def _end(message):
    """Forget the request that runs, and show why."""
    global _moved, _requests
    if _requests is not None and WORKER.busy:
        WORKER.stop()  # its reply would be read by the next request
    _moved, _requests = False, None
    bpy.context.scene.cagemap.message = message


def register():
    """Start the handler and the timer."""
    bpy.app.handlers.depsgraph_update_post.append(landmark_moved)
    bpy.app.timers.register(follow, persistent=True)


def unregister():
    """Stop the timer and the handler."""
    bpy.app.timers.unregister(follow)
    bpy.app.handlers.depsgraph_update_post.remove(landmark_moved)
