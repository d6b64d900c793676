"""How a button runs: requests to the computing process, in the background, then one undo step."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import suppress
from typing import Any

import bpy

from .client import Message, RefusedError, Worker
from .reading import chosen_pair, digest, match_arguments, object_in_edit_mode, sides
from .writing import forget_deleted, show_map

WORKER = Worker()
Requests = Generator[Message, dict[str, Any], str | None]


def matching(context):
    """Match the pair if it is not matched as it is now; the message about it."""
    arguments = match_arguments(context)
    matched = pair_digest(arguments)
    if WORKER.has_match and WORKER.matched == matched:
        return context.scene.cagemap.message
    reply = yield "match", arguments
    WORKER.matched = matched
    return show_answer(context, reply)


def pair_digest(arguments):
    """Digests of what is matched: of all but the landmarks, and of the landmarks."""
    points = {name: arguments[name] for name in ("target_points", "source_points")}
    rest = {name: value for name, value in arguments.items() if name not in points}
    return digest(rest), landmark_digest(**points)


def landmark_digest(target_points, source_points):
    """Digest of the landmarks of target and source."""
    return digest({"target": target_points, "source": source_points})


def show_answer(context, reply):
    """Show a map as colours on both objects; the message about it."""
    target, source = sides(context)
    show_map(target, reply["target_colors"])
    show_map(source, reply["source_colors"])
    return "\n".join(reply["sentences"])


def begin(requests):
    """Send the first request of a button."""
    WORKER.send(*next(requests))


def proceed(requests, message):
    """Give a reply to a button; True while it asks for more, else its message or None.

    Raises
    ------
    RefusedError
    """
    kind, value = message
    if kind == "refused":
        raise RefusedError(value)
    if kind == "stage":
        return True
    try:
        WORKER.send(*requests.send(value))
    except StopIteration as end:
        return end.value
    return True


@bpy.app.handlers.persistent
def stop(*_):
    """Stop the computing process before another file is opened."""
    WORKER.stop()
    Work.running = False


@bpy.app.handlers.persistent
def objects_changed(scene, depsgraph):
    """Forget results that the user deleted."""
    for update in depsgraph.updates:
        object_ = update.id.original
        if isinstance(object_, bpy.types.Object) and "cagemap_made" in object_ and object_.mode != "EDIT":
            forget_deleted(object_)


class Work:
    """A button: `requests` yields what is computed in the background, and writes the results into the scene."""

    bl_options = frozenset({"UNDO"})  # not REGISTER: to adjust the last operation would block Blender
    running = False

    def requests(self, context) -> Requests:
        """Requests to the computing process, each of which gives its reply; a message for the panel, or None."""
        raise NotImplementedError

    def execute(self, context):
        """From a script: wait for it."""
        return self._guarded(context, self._all)

    def invoke(self, context, event):
        """From a button: Blender goes on meanwhile; Esc stops it."""
        if Work.running:
            self.report({"ERROR"}, "cagemap is computing. Wait, or press Esc in the 3D view.")
            return {"CANCELLED"}
        return self._guarded(context, self._begin)

    def modal(self, context, event):
        """Take a reply at each tick of the timer."""
        if event.type == "ESC":
            WORKER.stop()
            self._end(context)
            self.report({"WARNING"}, f"{self.bl_label} was stopped; nothing was changed.")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        answer = {"CANCELLED"}
        try:
            answer = self._guarded(context, self._next)
        finally:  # also after a fault of ours: without it the buttons would stay grey
            if answer != {"PASS_THROUGH"}:
                self._end(context)
        return answer

    def cancel(self, context):
        """The window is closed, or another file is opened."""
        self._end(context)

    def _guarded(self, context, step):
        try:
            return step(context)
        except RefusedError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def _all(self, context):
        while WORKER.busy:  # a landmark was dragged just now
            WORKER.receive(timeout=1.0)
            WORKER.matched = ("", "")
        answer = self._start(context)
        while answer is True:
            message = WORKER.receive(timeout=1.0)
            answer = True if message is None else proceed(self._requests, message)
        return self._finish(context, answer)

    def _begin(self, context):
        self._names = [object_.name for object_ in sides(context)]
        self._requests = None
        answer = WORKER.busy or self._start(context)
        if answer is not True:
            return self._finish(context, answer)
        Work.running = True
        self._timer = context.window_manager.event_timer_add(0.05, window=context.window)
        context.window_manager.modal_handler_add(self)
        self._workspace, self._stage, self._shown = context.workspace, "starting", ""
        self._show(self._stage)
        return {"RUNNING_MODAL"}

    def _start(self, context):
        """Send the first request; True, or the message if nothing needs to be computed."""
        self._requests = self.requests(context)
        try:
            begin(self._requests)
        except StopIteration as end:
            return end.value
        return True

    def _next(self, context):
        if [object_.name for object_ in chosen_pair(context)] != self._names:
            raise RefusedError(f"Other objects were chosen than {' and '.join(self._names)}. Choose them again.")
        object_ = object_in_edit_mode(context)
        if object_ is not None:  # nothing can be written there: the reply waits
            self._show(f"waiting until {object_.name} leaves Edit Mode (Tab)")
            return {"PASS_THROUGH"}
        self._show(self._stage)
        if self._requests is None:  # a landmark was dragged just now, `live` takes the reply
            answer = WORKER.busy or self._start(context)
        else:
            message = WORKER.receive()
            if message is None:
                return {"PASS_THROUGH"}
            if message[0] == "stage":
                self._stage = message[1]
            answer = proceed(self._requests, message)
        return {"PASS_THROUGH"} if answer is True else self._finish(context, answer)

    def _show(self, state):
        """Write a state into the status bar, if another one is there."""
        if state != self._shown:
            self._shown = state
            self._workspace.status_text_set(f"cagemap, {self.bl_label}: {state}. Esc stops it.")

    def _finish(self, context, message):
        if message is not None:
            context.scene.cagemap.message = message
            self.report({"INFO"}, message)
        return {"FINISHED"}

    def _end(self, context):
        if WORKER.busy and self._requests is not None:
            WORKER.stop()  # its reply would be read by the next request
        Work.running = False
        context.window_manager.event_timer_remove(self._timer)
        with suppress(ReferenceError):  # the workspace was deleted
            self._workspace.status_text_set(None)
