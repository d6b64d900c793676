"""Run by an interpreter that has `bpy`: single behaviours of the extension, each in an empty scene.

``PYTHON scene_checks.py ZIP FOLDER [NAME ...]``; FOLDER/checks.json gets the traceback of each check by name, "" where
it holds. ZIP "-" takes the extension that is installed in the profile.
"""

import json
import sys
import time
import traceback

import bpy
import character_checks  # noqa: F401
import numpy as np
import texture_checks  # noqa: F401
from scene_kit import CHECKS, FOLDER, NAMES, SETTINGS, Window, bmesh, check, clear, live, pair, reading, refusal, work


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
    window.run()
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
    window.run()


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


def landmark(object_, name, place=(0.0, 0.0, 0.0)):
    """A landmark, with a number behind its name if that is taken."""
    empty = bpy.data.objects.new(name, None)
    bpy.context.collection.objects.link(empty)
    empty.parent, empty.location = object_, place
    bpy.context.view_layer.update()
    return empty


def noses(*objects):
    """A landmark at the same vertex of each object."""
    return [landmark(object_, "nose", object_.data.vertices[5].co) for object_ in objects]


@check
def equal_names_of_empties_matter_on_both_objects_alone():
    source, target = pair()
    landmark(target, "Empty"), landmark(target, "Empty")
    noses(target, source)
    assert not refusal(bpy.ops.cagemap.match)
    landmark(source, "Empty")
    assert "target: more than one landmark is called Empty" in refusal(bpy.ops.cagemap.match)


@check
def a_fault_does_not_end_the_live_map():
    source, _ = pair()
    bpy.ops.cagemap.match()
    landmark(source, "nose")

    def fault(context):
        raise ValueError("broken")

    whole, live.following, live._moved = live.following, fault, True
    try:
        assert live.follow() > 0
    finally:
        live.following = whole
    assert "broken" in SETTINGS.message


def followed(seconds=60.0):
    """Whether the live map asked the computing process after a landmark moved; waits until it is done."""
    asked, end = live._requests is not None or work.WORKER.busy, time.monotonic() + seconds
    while time.monotonic() < end:
        live.follow()
        asked = asked or work.WORKER.busy
        if not live._moved and live._requests is None:
            break
        time.sleep(0.01)
    return asked


@check
def the_live_map_asks_only_where_landmarks_moved_on_their_objects():
    source, target = pair()
    empties = noses(target, source)
    live._moved = False
    empties[0].location.z += 0.1
    bpy.context.view_layer.update()
    assert not live._moved  # there is no map yet
    bpy.ops.cagemap.match()
    target.location.x += 1.0  # takes its landmark along
    bpy.context.view_layer.update()
    assert live._moved
    assert not followed()
    empties[0].location.z += 0.1
    bpy.context.view_layer.update()
    assert followed()
    sent = SETTINGS.message
    bpy.ops.cagemap.follow()
    assert SETTINGS.message == sent


@check
def edit_mode_and_other_objects_do_not_disturb_the_live_map():
    source, target = pair()
    empties = noses(target, source)
    bpy.ops.cagemap.match()
    SETTINGS.message = ""
    bpy.context.view_layer.objects.active = target
    empties[0].location.z += 0.1
    bpy.context.view_layer.update()
    live.follow()
    assert work.WORKER.busy
    bpy.ops.object.mode_set(mode="EDIT")
    assert followed(seconds=3.0)
    assert not SETTINGS.message
    bpy.ops.object.mode_set(mode="OBJECT")
    assert followed()
    assert not SETTINGS.message
    empties[0].location.z += 0.1
    bpy.context.view_layer.update()
    live.follow()
    SETTINGS.source = None
    followed()
    assert not work.WORKER.busy
    assert not live._moved
    SETTINGS.source = source
    assert not refusal(bpy.ops.cagemap.match)


@check
def a_window_that_is_closed_ends_its_button():
    pair()
    window, first = Window(), Window()
    window.workspace = first
    button, _ = window.press()
    window.workspace = Window()  # of another tab
    button.cancel(window)
    assert (window.timers, work.Work.running, work.WORKER.busy) == (0, False, False)
    assert first.status[-1] is None
    assert not window.workspace.status
    window.run()


@check
def weights_of_removed_groups_are_not_read():
    source, _ = pair()
    source.vertex_groups.new(name="own").add([0, 1], 0.5, "REPLACE")
    mesh = bmesh.new()
    mesh.from_mesh(source.data)
    mesh.verts.ensure_lookup_table()
    mesh.verts[3][mesh.verts.layers.deform.verify()][5] = 1.0
    mesh.to_mesh(source.data)
    mesh.free()
    weights = reading.vertex_groups(source)
    assert list(weights) == ["own"]
    assert weights["own"].sum() == 1.0


@check
def a_mesh_without_vertices_is_refused():
    source, _ = pair()
    source.data = bpy.data.meshes.new("empty")
    for button in (bpy.ops.cagemap.match, bpy.ops.cagemap.wrap, bpy.ops.cagemap.landmark):
        assert "source has no vertices. Choose another source" in refusal(button)


@check
def messages_name_vertices_and_no_places_of_a_file():
    pair()
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=9, y_subdivisions=9)
    SETTINGS.source = bpy.context.object
    assert not refusal(bpy.ops.cagemap.match)
    assert "folded over" in SETTINGS.message
    assert " at (" not in SETTINGS.message, SETTINGS.message
    assert "file" not in SETTINGS.message, SETTINGS.message
    assert "answer=" not in SETTINGS.message, SETTINGS.message


@check
def a_ninth_uv_map_is_refused():
    source, target = pair()
    source.data.uv_layers[0].name = "other"
    while len(target.data.uv_layers) < 8:
        target.data.uv_layers.new()
    assert "target would have 9 UV maps" in refusal(bpy.ops.cagemap.transfer, what={"UVS"})


@check
def what_the_user_made_after_deleting_ours_is_kept():
    source, target = pair()
    source.shape_key_add(name="Basis")
    source.shape_key_add(name="wide").data[0].co.x += 0.1
    source.vertex_groups.new(name="own").add([0], 1.0, "REPLACE")
    source.data.uv_layers.new(name="second")
    kinds = {"SHAPES", "WEIGHTS", "UVS"}
    target.data.uv_layers[0].name = "first"
    for _ in range(2):
        bpy.ops.cagemap.transfer(what=kinds)
        bpy.context.view_layer.update()
    for kind, delete, make in (
        ("shape key", lambda: target.shape_key_remove(target.data.shape_keys.key_blocks["wide"]), target.shape_key_add),
        ("vertex group", lambda: target.vertex_groups.remove(target.vertex_groups["own"]), target.vertex_groups.new),
        (
            "UV map",
            lambda: target.data.uv_layers.remove(target.data.uv_layers["second"]),
            target.data.uv_layers.new,
        ),
    ):
        delete()
        target.data.update()
        bpy.context.view_layer.update()
        make(name={"shape key": "wide", "vertex group": "own", "UV map": "second"}[kind])
        bpy.context.view_layer.update()
        assert f"{kind}s of its own called" in refusal(bpy.ops.cagemap.transfer, what=kinds), kind
        delete()
        bpy.context.view_layer.update()
        assert not refusal(bpy.ops.cagemap.transfer, what=kinds)


@check
def uvs_of_copies_of_the_target_are_kept():
    source, target = pair()
    target.data.uv_layers[0].name = "own"
    bpy.ops.cagemap.transfer(what={"UVS"})
    backup = target.data.copy()
    before = reading.numbers(backup.uv_layers["UVMap"].uv, "vector", 2)
    source.data.uv_layers[0].data.foreach_set("uv", np.full(2 * len(source.data.loops), 0.5, dtype=np.float32))
    bpy.ops.cagemap.transfer(what={"UVS"})
    assert np.ptp(reading.numbers(target.data.uv_layers["UVMap"].uv, "vector", 2)) < 1e-6
    np.testing.assert_array_equal(reading.numbers(backup.uv_layers["UVMap"].uv, "vector", 2), before)


@check
def disabled_objects_are_evaluated():
    source, target = pair()
    empty = landmark(target, "nose")
    source.modifiers.new("Mirror", "MIRROR")
    source.hide_viewport = target.hide_viewport = empty.hide_viewport = True
    assert "source: its modifiers (Mirror)" in refusal(bpy.ops.cagemap.match)
    source.modifiers.clear()
    source.location.x = target.location.y = 3.0
    bpy.ops.cagemap.wrap()
    assert source.hide_viewport
    assert tuple(source.matrix_world.translation) == (3.0, 0.0, 0.0)
    assert tuple(empty.matrix_world.translation) == (0.0, 3.0, 0.0)


@check
def shape_keys_keep_range_and_mask_and_never_become_the_rest_shape():
    source, target = pair()
    source.vertex_groups.new(name="half").add([0, 1, 2], 0.5, "REPLACE")
    source.shape_key_add(name="Neutral")
    key = source.shape_key_add(name="Basis")
    key.slider_min, key.slider_max, key.vertex_group = -1.0, 2.0, "half"
    for point in key.data:
        point.co.z += 1.0
    rest = reading.rest_positions(target)
    bpy.ops.cagemap.transfer(what={"SHAPES"})
    made = target.data.shape_keys.key_blocks["Basis"]
    assert (made.slider_min, made.slider_max) == (-1.0, 2.0)
    np.testing.assert_array_equal(reading.rest_positions(target), rest)
    assert abs(reading.coordinates(made.data)[:, 2] - rest[:, 2]).max() < 0.6


@check
def ranges_of_shape_keys_are_kept_wherever_they_are():
    source, target = pair()
    for name in ("Basis", "smile"):
        source.shape_key_add(name=name)
    key = source.data.shape_keys.key_blocks["smile"]
    for low, high in ((2.0, 3.0), (5.0, 6.0), (-4.0, -3.0)):
        for _ in range(2):  # neither end passes the other
            key.slider_min, key.slider_max = low, high
        bpy.ops.cagemap.transfer(what={"SHAPES"})
        made = target.data.shape_keys.key_blocks["smile"]
        assert (made.slider_min, made.slider_max) == (low, high)


@check
def a_second_run_leaves_groups_in_their_place():
    source, target = pair()
    for name in "ab":
        source.vertex_groups.new(name=name).add([0], 1.0, "REPLACE")
    bpy.ops.cagemap.transfer(what={"WEIGHTS"})
    target.vertex_groups.new(name="own").add([0], 0.3, "REPLACE")
    target.vertex_groups["a"].lock_weight = True
    source.vertex_groups["a"].add([0], 0.4, "REPLACE")
    bpy.ops.cagemap.transfer(what={"WEIGHTS"})
    assert target.vertex_groups.keys() == ["a", "b", "own"]
    assert target.vertex_groups["a"].lock_weight
    weights = reading.vertex_groups(target)
    assert [round(float(weights[name][0]), 3) for name in weights] == [0.4, 1.0, 0.3]


@check
def what_is_rendered_on_a_bare_target_is_what_the_source_renders():
    source, target = pair()
    source.data.uv_layers.new(name="second").active_render = True
    target.data.uv_layers.remove(target.data.uv_layers[0])
    for name in ("first", "second colour"):
        source.data.color_attributes.new(name, "BYTE_COLOR", "CORNER")
    source.data.color_attributes.render_color_index = 1
    bpy.ops.cagemap.transfer(what={"UVS", "COLORS"})
    assert [layer.name for layer in target.data.uv_layers if layer.active_render] == ["second"]
    attributes = target.data.color_attributes
    assert attributes[attributes.render_color_index].name == "second colour"


@check
def an_attribute_named_like_the_map_is_refused():
    _, target = pair()
    target.data.color_attributes.new("cagemap", "BYTE_COLOR", "CORNER")
    assert "target has an attribute of its own called cagemap" in refusal(bpy.ops.cagemap.match)


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
