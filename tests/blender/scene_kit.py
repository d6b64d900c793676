"""What the checks in Blender share: the installed extension, two monkeys, a window, and the list of all checks.

The command line is that of `scene_checks.py`.
"""

import sys
import time
from pathlib import Path

import bpy

ZIP, FOLDER, NAMES = sys.argv[1], Path(sys.argv[2]), sys.argv[3:]

bpy.ops.wm.read_factory_settings(use_empty=True)
if ZIP == "-":
    bpy.ops.preferences.addon_enable(module="bl_ext.user_default.cagemap")
else:
    bpy.ops.extensions.package_install_files(filepath=ZIP, repo="user_default", enable_on_install=True)
import bmesh  # noqa: E402, F401
from bl_ext.user_default.cagemap import live, operators, reading, work  # noqa: E402, F401

CHECKS = {}


class Settings:
    """The scene's settings, which are another object after Undo."""

    def __getattr__(self, name):
        return getattr(bpy.context.scene.cagemap, name)

    def __setattr__(self, name, value):
        setattr(bpy.context.scene.cagemap, name, value)


SETTINGS = Settings()


def check(function):
    CHECKS[function.__name__] = function
    return function


def clear():
    work.stop()
    for object_ in list(bpy.data.objects):
        bpy.data.objects.remove(object_)
    bpy.data.orphans_purge(do_recursive=True)


def pair():
    """Source and target: two monkeys."""
    bpy.ops.mesh.primitive_monkey_add()
    source = bpy.context.object
    source.name = "source"
    target = source.copy()
    target.data, target.name = source.data.copy(), "target"
    bpy.context.collection.objects.link(target)
    SETTINGS.source, SETTINGS.target, SETTINGS.vertices = source, target, 1000
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.update()
    return source, target


def refusal(button, **options):
    try:
        button(**options)
    except RuntimeError as error:
        return str(error)
    return ""


class Window:
    """A context with a window, which Blender does not have here; keeps what is shown in it."""

    def __init__(self):
        self.status, self.timers, self.reports = [], 0, []
        self.window_manager = self.workspace = self
        self.screen = self.window = None

    def __getattr__(self, name):
        return getattr(bpy.context, name)

    def event_timer_add(self, seconds, window):
        self.timers += 1
        return self

    def event_timer_remove(self, timer):
        self.timers -= 1

    def modal_handler_add(self, button):
        pass

    def status_text_set(self, text):
        self.status.append(text)

    def press(self, kind=operators.CAGEMAP_OT_match, **options):
        """A button that was pressed, and what Blender is answered."""
        window = self

        class Button(work.Work):
            bl_label, requests = kind.bl_label, kind.requests

            def report(self, kinds, text):
                window.reports.append([*kinds, text])

        button = Button()
        vars(button).update(options)
        return button, button.invoke(self, event("LEFTMOUSE")).pop()

    def step(self, button, kind="TIMER"):
        """What a button answers to an event."""
        return button.modal(self, event(kind)).pop()

    def wait_for(self, button, stage):
        """Until the computation of a button is at a stage."""
        while not button._stage.startswith(stage):
            time.sleep(0.02)
            assert self.step(button) == "PASS_THROUGH"

    def run(self, kind=operators.CAGEMAP_OT_match, **options):
        """Press a button and wait until it is done."""
        button, _ = self.press(kind, **options)
        assert self.finish(button) == "FINISHED", self.reports

    def finish(self, button):
        """The last answer of a button."""
        answer, end = "PASS_THROUGH", time.monotonic() + 120.0
        while answer == "PASS_THROUGH" and time.monotonic() < end:
            time.sleep(0.02)
            answer = self.step(button)
        return answer


def event(kind):
    return type("Event", (), {"type": kind})()


def change_all_objects():
    """A change that can be undone."""
    bpy.ops.ed.undo_push(message="before")
    for object_ in bpy.data.objects:
        object_.pass_index = 1
    bpy.ops.ed.undo_push(message="after")
