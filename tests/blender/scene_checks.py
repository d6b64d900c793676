"""Run by an interpreter that has `bpy`: single behaviours of the extension, each in an empty scene.

``PYTHON scene_checks.py ZIP FOLDER [NAME ...]``; FOLDER/checks.json gets the traceback of each check by name, "" where
it holds. ZIP "-" takes the extension that is installed in the profile.
"""

import json
import sys
import time
import traceback
from pathlib import Path

import bpy

ZIP, FOLDER, NAMES = sys.argv[1], Path(sys.argv[2]), sys.argv[3:]

bpy.ops.wm.read_factory_settings(use_empty=True)
if ZIP == "-":
    bpy.ops.preferences.addon_enable(module="bl_ext.user_default.cagemap")
else:
    bpy.ops.extensions.package_install_files(filepath=ZIP, repo="user_default", enable_on_install=True)
from bl_ext.user_default.cagemap import operators, work  # noqa: E402

SETTINGS = bpy.context.scene.cagemap
CHECKS = {}


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
        self.scene, self.view_layer = bpy.context.scene, bpy.context.view_layer
        self.evaluated_depsgraph_get = bpy.context.evaluated_depsgraph_get

    def event_timer_add(self, seconds, window):
        self.timers += 1
        return self

    def event_timer_remove(self, timer):
        self.timers -= 1

    def modal_handler_add(self, button):
        pass

    def status_text_set(self, text):
        self.status.append(text)

    def press(self, kind=operators.CAGEMAP_OT_match):
        """A button that was pressed, and what Blender is answered."""
        window = self

        class Button(work.Work):
            bl_label, requests = kind.bl_label, kind.requests

            def report(self, kinds, text):
                window.reports.append([*kinds, text])

        button = Button()
        return button, button.invoke(self, event("LEFTMOUSE")).pop()

    def step(self, button, kind="TIMER"):
        """What a button answers to an event."""
        return button.modal(self, event(kind)).pop()

    def finish(self, button):
        """The last answer of a button."""
        answer, end = "PASS_THROUGH", time.monotonic() + 120.0
        while answer == "PASS_THROUGH" and time.monotonic() < end:
            time.sleep(0.02)
            answer = self.step(button)
        return answer


def event(kind):
    return type("Event", (), {"type": kind})()


@check
def a_button_in_a_window_returns_at_once_and_writes_at_the_end():
    _, target = pair()
    window = Window()
    begun = time.perf_counter()
    button, answer = window.press()
    assert answer == "RUNNING_MODAL"
    assert time.perf_counter() - begun < 2.0  # a loaded machine
    assert window.press()[1] == "CANCELLED"  # a second one
    assert window.step(button, "MOUSEMOVE") == "PASS_THROUGH"
    assert window.step(button, "ESC") == "CANCELLED"
    assert (window.timers, work.Work.running) == (0, False)
    assert "cagemap" not in target.data.color_attributes
    button, _ = window.press()
    assert window.finish(button) == "FINISHED"
    assert (window.timers, work.Work.running) == (0, False)
    assert "cagemap" in target.data.color_attributes
    assert any("prepare" in text for text in window.status if text)
    assert window.status[-1] is None


@check
def other_objects_chosen_meanwhile_end_the_computation():
    source, target = pair()
    window = Window()
    button, _ = window.press()
    SETTINGS.target = source
    assert window.step(button) == "CANCELLED"
    assert "same mesh" in window.reports[-1][1]
    assert not work.WORKER.busy
    SETTINGS.target = target
    button, _ = window.press()
    assert window.finish(button) == "FINISHED"


@check
def edit_mode_meanwhile_delays_the_result():
    _, target = pair()
    window = Window()
    button, _ = window.press()
    bpy.context.view_layer.objects.active = target
    bpy.ops.object.mode_set(mode="EDIT")
    for _ in range(400):  # long enough for the result
        assert window.step(button) == "PASS_THROUGH", window.reports
        time.sleep(0.02)
    assert "Edit Mode" in window.status[-1]
    bpy.ops.object.mode_set(mode="OBJECT")
    assert window.finish(button) == "FINISHED", window.reports
    assert "cagemap" in target.data.color_attributes
    assert work.WORKER.has_match


results = {}
for name in NAMES or CHECKS:
    clear()
    try:
        CHECKS[name]()
        results[name] = ""
    except Exception:
        results[name] = traceback.format_exc()
        if NAMES:
            sys.stdout.write(results[name])
clear()
(FOLDER / "checks.json").write_text(json.dumps(results))
