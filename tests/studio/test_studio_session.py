"""The session behind all pages: its maps and views, what ends them, and what is shown of bakes."""

import os
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.errors import ParameterError
from cagemap.files.images.image import write_image
from cagemap.files.result.manifest import note_transfer
from cagemap.pictures import Z_UP
from cagemap.studio.compute import FindMap, MapUpdate, OpenModels, ShowImage, ShowPosed, Task
from cagemap.studio.finish import Command, FinishOptions
from cagemap.studio.landmarks import LandmarkList
from cagemap.studio.page.shown import page_state
from cagemap.studio.places import vertex_place
from cagemap.studio.scene import map_point
from cagemap.studio.session import Session
from cagemap.studio.skins import PreviewMap
from cagemap.studio.state import MapState, Message, Output, View
from cagemap.studio.worker import CANCELLED_KIND, STOPPED_KIND, Failure
from cagemap.surface.closest_points import build_tree, closest_points

from refusals import refuses
from studio_boxes import add_landmarks, at_rest, click, click_between, mapped, until


def test_it_starts_with_a_map_and_follows_clicks(opened: Session) -> None:
    click(opened, "target", 2)
    proposal = opened.state.proposal or pytest.fail("no proposal")
    assert (proposal.number, proposal.side) == (1, "source")
    assert proposal.place.position[0] > 2  # on the other box
    click(opened, "source", 2)
    until(lambda: opened.state.map.revision >= 2, opened)
    there = opened.state.history.present.complete_landmarks[0].target
    np.testing.assert_allclose(there.position, vertex_place(opened.scene.target, 2).position, atol=1e-6)
    assert set(opened.state.map.strain) == {"landmark 1"}
    opened.undo()
    opened.undo()
    assert not opened.state.history.present.items
    opened.redo()
    opened.redo()
    assert len(opened.state.history.present.complete_landmarks) == 1


def test_answers_that_are_no_longer_wanted_are_no_errors(opened: Session) -> None:
    """Of models that are open no more; and of a search that was dropped, whose models are open again at once."""
    before, pair_files = opened.state, opened._preview.pair_files
    opened._receive(OpenModels(replace(pair_files, vertices=7)), Failure("FormatError", "of another pair"))
    opened._receive(OpenModels(pair_files), Failure(CANCELLED_KIND, "not wanted"))
    assert opened.state == before


def test_results_that_no_task_gives_are_logged(opened: Session, caplog: pytest.LogCaptureFixture) -> None:
    before, pair_files = opened.state, opened._preview.pair_files
    opened._receive(ShowPosed(pair_files, "of an earlier view", None), (b"target", b"source"))
    assert not caplog.records
    opened._receive(ShowPosed(pair_files, before.view.pose, None), (b"target", None))
    assert [record.getMessage() for record in caplog.records] == [
        "unexpected result <class 'tuple'> of <class 'cagemap.studio.preview_tasks.ShowPosed'>"
    ]
    assert opened.state == before


def test_a_source_that_the_map_turns_is_turned_in_the_view(opened: Session) -> None:
    scene = opened.scene
    # About where half a turn about the vertical takes the box, which is slanted.
    places = scene.source.centre + (scene.target.positions - scene.target.centre) * [-1.0, 1.0, -1.0]
    triangle, weights, _ = closest_points(build_tree(scene.source.positions, scene.source.triangles), places)
    answer = MapUpdate(PreviewMap(triangle, weights, scene.preview_map.trust), (b"target", b"source"), opened.state.map)
    opened._receive(FindMap(opened._preview.pair_files, LandmarkList()), answer)
    np.testing.assert_array_equal(opened.scene.source.rotation, np.diag([-1.0, 1.0, -1.0]))
    assert opened.scene.skins == (b"target", b"source")


def test_a_turn_keeps_the_map_the_history_and_what_was_baked(opened: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    add_landmarks(opened, 2)
    opened.select(1)
    until(lambda: opened.state.map.strain and at_rest(opened), opened)
    opened._change(outputs=(Output(Path("a.png"), "texture"),))
    tasks = list[Task]()
    run = opened._preview._worker.run
    monkeypatch.setattr(opened._preview._worker, "run", lambda task: tasks.append(task) or run(task))
    before, scene = opened.state, opened.scene
    opened.turn_up("target")
    opened.turn_up("source")
    until(lambda: opened.state.files.ups == ("z", "z") and at_rest(opened), opened)
    assert {type(task) for task in tasks} == {ShowPosed}
    assert replace(opened.state, files=before.files) == before
    assert opened.scene.preview_map is scene.preview_map
    np.testing.assert_array_equal(opened.scene.target.rotation, Z_UP)
    assert opened.scene.skins[0] != scene.skins[0]
    for up in ("y", "z"):
        opened.turn_up("target")
        until(lambda up=up: opened.state.files.ups[0] == up and at_rest(opened), opened)


def test_a_first_look_is_shown_and_does_not_count(opened: Session) -> None:
    checked, source = opened.state.map, opened.scene.source
    known = replace(checked, notes=("folded",), strain={"nose": 0.1})
    opened._change(map=known)
    turned = replace(source, rotation=source.rotation @ np.diag([-1.0, 1.0, -1.0]))
    opened._scene = scene = replace(opened.scene, source=turned)
    task = FindMap(opened._preview.pair_files, LandmarkList())
    rough = MapUpdate(
        replace(scene.preview_map, trust=np.ones(len(scene.preview_map.trust))),
        (b"rough", None),
        MapState(unchecked=True),
    )
    opened._receive(task, rough)
    assert opened.scene.skins[0] == b"rough"
    assert opened.scene.source is turned  # as it is drawn: only a checked map turns it
    assert opened.state.map == replace(known, unchecked=True, from_start=False)
    # One that comes after the search was cancelled is not shown, and the cancelling is still said.
    opened._cancelled = True
    opened._receive(task, replace(rough, skins=(b"late", None)))
    assert opened.scene.skins[0] == b"rough"
    opened._receive(task, Failure(STOPPED_KIND, "killed"))
    assert opened.state.messages[-1].text == "cancelled"  # not: the map stays as it was
    assert (opened.state.map.notes, opened.state.map.strain) == ((), {})  # those of the map before
    opened._receive(task, MapUpdate(scene.preview_map, scene.skins, checked))
    assert (opened.state.map.unchecked, opened.state.map.revision) == (False, known.revision + 1)
    np.testing.assert_array_equal(opened.scene.source.rotation, source.rotation)


def test_a_bake_is_given_the_map_of_the_page_until_landmarks_change_it(opened: Session, started: list[Command]) -> None:
    mapped(opened, opened.match_again)
    opened.finish(FinishOptions())
    np.testing.assert_array_equal(started[0].computed.result.triangle, opened.scene.preview_map.triangle)
    assert len(started) > 1
    assert [command.computed for command in started[1:]] == [None] * len(started[1:])
    mapped(opened, add_landmarks, opened, 2)
    started.clear()
    opened.finish(FinishOptions())
    assert started[0].computed is None


def test_the_next_landmark_is_proposed_on_both_models(opened: Session) -> None:
    vertex = opened.state.map.suggestion
    opened.next_landmark()
    waiting, proposal = opened.state.history.present.open_landmark, opened.state.proposal
    assert waiting.target == vertex_place(opened.scene.target, vertex)
    assert (proposal.number, proposal.side) == (waiting.number, "source")
    mapped(opened, opened.accept)
    assert opened.state.map.suggestion != vertex
    opened.next_landmark()
    before = opened.state.proposal
    clicked = click_between(opened, "target")  # corrected: the end moves, and the proposal with it
    np.testing.assert_allclose(opened.state.history.present.open_landmark.target.position, clicked, atol=0.01)
    assert opened.state.proposal != before


@pytest.mark.slow
def test_a_killed_computation_keeps_the_map_and_the_next_click_works(opened: Session) -> None:
    revision = opened.state.map.revision
    opened._preview.kill()  # as the system does where memory runs out
    add_landmarks(opened, 6)
    until(lambda: opened.state.map.revision > revision, opened)
    assert opened.scene.preview_map is not None


def test_a_fault_of_ours_is_a_message_and_the_next_click_works(opened, monkeypatch):
    def broken(*_: object) -> None:
        raise ZeroDivisionError("a slip")

    revision = opened.state.map.revision
    with monkeypatch.context() as patch:
        for module in ("preview_results", "landmark_edits"):
            patch.setattr(f"cagemap.studio.{module}.propose_place", broken)
        click(opened, "target", 2)  # here, and where the answer of the computation is taken in
        opened.match_again()
        until(lambda: opened.state.preview_job is None, opened)
    assert "internal error, ZeroDivisionError: a slip" in opened.state.messages[-1].text
    add_landmarks(opened, 2)
    until(lambda: opened.state.map.revision > revision and opened.state.map.strain, opened)


def test_a_bake_has_the_vertices_of_the_map_shown_unless_others_or_a_level_are_asked_for(opened: Session) -> None:
    level, vertices = ("match", "level"), ("match", "vertices")
    for given, count in (({}, 300), ({vertices: None}, 300), ({vertices: 2000}, 2000), ({level: 2, vertices: 9}, None)):
        request = opened.plan(FinishOptions().with_values(given))[0].request
        assert (request.vertices, request.level) == (count, given.get(level))


def test_a_target_whose_uvs_are_missing_or_one_point_is_laid_out(opened, monkeypatch):
    scene = opened.scene
    assert scene.target.uvs is None
    control = scene.target.control
    flat = control.with_uvs(np.array([[0.0, 1.0]]), np.zeros(len(control.face_indices), dtype=np.int64))
    target = replace(scene.target, control=flat, uvs=flat.uvs, uv_triangles=np.zeros_like(scene.target.triangles))
    for shown in (scene, replace(scene, target=target)):
        monkeypatch.setattr(opened, "_scene", shown)
        assert next(one for one in opened.plan(FinishOptions()) if one.title == "texture").request.unwrap


def titles_of(commands: list[Command]) -> list[str]:
    titles = [command.title for command in commands]
    commands.clear()
    return titles


def test_without_an_image_colours_or_ambient_occlusion_are_baked(opened: Session, started: list[Command]) -> None:
    opened._change(files=replace(opened.state.files, texture=None))
    bake, plain = ("transfer", "bake"), opened.scene
    control = replace(plain.source.control, vertex_colors=np.full((plain.source.control.n_vertices, 3), 0.5))
    painted = replace(plain, source=replace(plain.source, control=control), has_colors=False)
    occlusion = "ambient occlusion, the wrapped mesh"
    for scene, kinds, titles, made in (
        (replace(plain, has_colors=True), (), ["material colours"], "the colours of its materials"),
        (replace(plain, has_colors=False), (), ["detail", "wrap"], occlusion),
        (painted, (), ["detail"], "vertex colours"),
        (painted, ("ao",), ["detail", "wrap"], occlusion),
        (painted, ("normal",), ["detail", "wrap"], "normal, the wrapped mesh"),
    ):
        opened._scene = scene
        opened.finish(FinishOptions(report=False).with_values({bake: kinds}))
        assert titles_of(started) == ["match", *titles]
        assert opened.state.messages[-1].text == f"the source has no image; made instead: {made}"
    detailed = FinishOptions().with_values({("transfer", "detail"): opened.state.files.source})
    assert opened.plan(detailed)[1].request.bake == ("ao",)  # the detailed mesh has no colours
    opened._scene = plain
    opened._change(messages=())
    opened.finish(FinishOptions(texture=False))
    assert titles_of(started) == ["match", "report"]
    assert not opened.state.messages


def test_a_number_of_vertices_below_one_is_refused(opened: Session) -> None:
    for number in (0, -5):
        options = FinishOptions().with_values({("match", "vertices"): number})
        refuses(ParameterError, f"expected 1 or more, got {number}", opened.plan, options)


def test_a_plain_target_gets_a_picture_and_no_wrap(opened: Session) -> None:
    files, has_colors = opened.state.files, opened.scene.has_colors
    opened._scene = replace(opened.scene, has_colors=False)
    opened._change(files=replace(files, texture=None, schemes=("none", None)))
    try:
        for options in (FinishOptions(wrap=True), FinishOptions(texture=False, wrap=True)):
            refuses(ParameterError, "open as a plain mesh, which cannot be wrapped", opened.plan, options)
        occlusion = opened.plan(FinishOptions())[1].request
        assert occlusion.bake == ("ao",)
        assert occlusion.unwrap
        assert [one.title for one in opened.plan(FinishOptions(texture=False))] == ["match", "report"]
        shape_too = FinishOptions().with_values({("transfer", "source_uvs"): True})
        assert [one.title for one in opened.plan(shape_too)] == ["match", "detail", "UVs of the source", "report"]
    finally:
        opened._scene = replace(opened.scene, has_colors=has_colors)
        opened._change(files=files)


@pytest.mark.slow
def test_a_cancelled_finish_leaves_nothing_and_the_next_one_runs(opened: Session, boxes: Path) -> None:
    def files() -> set[Path]:
        return {path for path in boxes.rglob("*") if path.is_file()}

    def at_work() -> bool:
        job = opened.state.finish_job
        return job is not None and ":" in job.stage and job.fraction > 0

    def said(text: str) -> bool:
        return any(text in message.text for message in opened.state.messages)

    before = files()
    options = FinishOptions(report=False, option_values={("match", "vertices"): 300, ("transfer", "size"): 8})
    opened.finish(options)
    until(at_work, opened)
    opened.finish(options)
    assert said("a bake is running")
    opened.cancel()
    until(lambda: said("Bake: cancelled"), opened)
    assert opened.state.finish_job is None
    assert files() == before
    opened.finish(replace(options, texture=False))
    until(lambda: said("Bake: done"), opened)
    assert [output.title for output in opened.state.outputs] == ["the map"]
    # The map is there: another bake of it does not compute it again, unless something has changed; that something was
    # made of it is noted beside it.
    note_transfer(opened.state.files.result, {"kind": "texture", "output": "a.png"})
    arrays = opened.state.files.result / "map.npz"
    written = arrays.stat().st_mtime_ns
    todo = opened.plan(replace(options, report=True))
    left = [opened._written_map.remaining_commands(todo, opened.state)]
    assert left == [todo[1:]]
    opened._change(messages=())
    opened.finish(replace(options, texture=False))
    until(lambda: said("Bake: done"), opened)
    assert [output.title for output in opened.state.outputs] == ["the map"]
    assert arrays.stat().st_mtime_ns == written
    last = opened._written_map._written
    other = opened.plan(options.with_values({("match", "vertices"): 301}))
    add_landmarks(opened, 0)
    moved, before_that = opened.state, replace(opened.state, history=opened.state.history.undo().undo())
    assert opened._written_map.remaining_commands(todo, before_that) == todo[1:]
    for commands, state in ((other, before_that), (todo, moved)):
        opened._written_map._written = last
        assert opened._written_map.remaining_commands(commands, state) == commands
    for changed in (opened.state.files.target, arrays):
        opened._written_map._written, status = last, changed.stat()
        os.utime(changed, ns=(1, 1))
        assert opened._written_map.remaining_commands(todo, before_that) == todo
        os.utime(changed, ns=(status.st_atime_ns, status.st_mtime_ns))
    for path in files() - before:
        path.unlink()


def test_a_landmark_of_symmetric_models_brings_its_counterpart(opened: Session) -> None:
    corners = cube().positions
    across = np.argmin(np.linalg.norm(corners[:, None] * [-1.0, 1.0, 1.0] - corners, axis=2), axis=1)
    opened._scene = replace(opened.scene, mirrors=(across, across))
    opened.show(replace(opened.state.view, symmetric=True))
    add_landmarks(opened, 2)
    placed, image = opened.state.history.present.complete_landmarks
    assert opened.state.selected == placed.number
    assert {image.target.corners[k] for k in range(3)} == set(across[list(placed.target.corners)])
    opened.undo()
    assert opened.state.history.present.complete_landmarks == ()  # both in one step
    opened.redo()
    opened.remove(placed.number)
    click(opened, "target", 2)
    click(opened, "source", 2)
    assert len(opened.state.history.present.complete_landmarks) == 2  # the counterpart is there already
    opened.mirror(opened.state.history.present.items[0].number)
    assert len(opened.state.history.present) == 2  # also for Mirror, pressed twice
    assert "none at its mirror image yet" in opened.state.messages[-1].text
    # Next landmark takes the place of one that waits, and its own is selected.
    placed, image = opened.state.history.present.items
    opened.remove(image.number)
    click(opened, "target", 5)
    waiting = opened.state.history.present.open_landmark
    opened.mirror(placed.number)
    opened.next_landmark()
    assert opened.state.history.present.get(waiting.number) is None
    assert opened.state.selected == opened.state.history.present.open_landmark.number
    opened._scene = replace(opened.scene, mirrors=(None, None))


@pytest.mark.slow
def test_changes_of_two_pages_at_once_are_both_kept(opened: Session) -> None:
    add_landmarks(opened, 0, 3)
    with opened._lock:
        changes = [
            threading.Thread(target=opened.rename, args=(1, "nose")),
            threading.Thread(target=opened.remove, args=(2,)),
        ]
        for change in changes:
            change.start()
        time.sleep(0.2)
        click(opened, "target", 5)
    for change in changes:
        change.join()
    assert [item.name for item in opened.state.history.present.items] == ["nose", "landmark 3"]


@pytest.mark.slow
def test_a_probe_points_at_both_models(opened: Session) -> None:
    scene = opened.scene
    point = scene.target.to_view(scene.target.positions[1])
    opened.probe("target", 3 * point, -point / np.linalg.norm(point))
    probe = opened.state.probe
    assert np.linalg.norm(np.array(probe.target) - scene.target.positions[1]) < 0.3
    np.testing.assert_array_equal(probe.source, map_point(scene, "target", np.array(probe.target)).position)
    assert probe.source[0] > 2  # on the other box
    opened.probe("target", np.array([9.0, 9.0, 9.0]), np.array([1.0, 0.0, 0.0]))
    assert opened.state.probe is None


def test_earlier_outputs_stay_until_a_bake_replaces_them(opened: Session, started: list[Command]) -> None:
    earlier = (Output(Path("a.png"), "texture"), Output(Path("b.obj"), "wrap"), Output(Path("R"), "the map"))
    opened._change(outputs=earlier)
    opened.finish(FinishOptions())
    opened._on_end(Message("note", "Bake: cancelled"), True)
    assert opened.state.outputs == earlier
    opened.finish(FinishOptions())
    opened._on_output(Output(Path("R"), "the map"))
    opened._on_output(Output(Path("c.png"), "texture"))
    opened._on_output(Output(Path("R"), "texture"))  # its record of the bake
    assert opened.state.outputs == (Output(Path("R"), "the map"), Output(Path("c.png"), "texture"), earlier[1])
    assert opened.state.view.baked == Path("c.png")
    opened._on_end(Message("note", "Bake: done"), False)  # what it did not make shows an earlier map
    assert opened.state.outputs == (Output(Path("R"), "the map"), Output(Path("c.png"), "texture"))


def test_a_partly_failed_bake_of_a_new_map_leaves_no_outputs_of_the_map_before(opened, started, monkeypatch):
    monkeypatch.setattr(opened._written_map, "remaining_commands", lambda commands, _: commands)
    earlier = (Output(Path("b.obj"), "wrap"), Output(Path("R"), "the map"))
    ends = {"Bake: cancelled": True, "Bake: not everything could be made: wrap": False}
    for text, is_cancelled in ends.items():
        opened._change(outputs=earlier)
        opened.finish(FinishOptions())
        opened._on_end(Message("error", text), is_cancelled)  # before its map
        assert opened.state.outputs == earlier
        opened.finish(FinishOptions())
        opened._on_output(Output(Path("R"), "the map"))
        opened._on_output(Output(Path("c.png"), "texture"))
        opened._on_end(Message("error", text), is_cancelled)
        made = (Output(Path("R"), "the map"), Output(Path("c.png"), "texture"))
        assert opened.state.outputs == ((*made, earlier[0]) if is_cancelled else made)


def test_a_probe_ends_with_the_map_and_the_landmarks_that_it_was_made_of(opened: Session) -> None:
    def probe() -> None:
        point = opened.scene.target.to_view(opened.scene.target.positions[1])
        opened.probe("target", 3 * point, -point / np.linalg.norm(point))
        assert opened.state.probe is not None

    probe()
    click(opened, "target", 2)
    assert opened.state.probe is None
    probe()
    mapped(opened, opened.accept)
    assert opened.state.probe is None
    probe()
    opened.show(replace(opened.state.view, pose="nod"))
    assert opened.state.probe is None


def test_another_image_of_the_open_models_is_drawn_and_nothing_else_changes(opened, boxes, monkeypatch):
    write_image(boxes / "other.png", np.full((8, 8, 3), 10, dtype=np.uint8))
    (boxes / "broken.png").write_bytes(b"no image")
    opened._change(outputs=(Output(boxes / "a.png", "texture"),))
    click(opened, "target", 2)
    before, skins, first = opened.state, opened.scene.skins, opened.state.files
    tasks = list[Task]()
    run = opened._preview._worker.run
    monkeypatch.setattr(opened._preview._worker, "run", lambda task: tasks.append(task) or run(task))
    opened.open(replace(first, texture=boxes / "other.png"))
    until(lambda: opened.state.files.texture == boxes.resolve() / "other.png" and at_rest(opened), opened)
    assert replace(opened.state, files=first) == before
    assert opened.scene.skins[1] != skins[1]
    assert {type(task) for task in tasks} == {ShowImage}
    opened.open(replace(opened.state.files, texture=boxes / "broken.png"))
    until(lambda: opened.state.messages and at_rest(opened), opened)
    assert "broken.png" in opened.state.messages[-1].text
    assert opened.state.files.texture == boxes.resolve() / "other.png"
    opened.open(replace(opened.state.files, texture=first.texture))
    until(lambda: opened.state.files == first and at_rest(opened), opened)
    assert opened.scene.skins == skins
    for name in ("other.png", "broken.png"):
        (boxes / name).unlink()


def test_a_source_without_image_and_colours_shows_the_colours_of_the_map(opened: Session) -> None:
    def shown(texture: Path | None, *, has_colors: bool, mode: str) -> str:
        state = replace(opened.state, view=View(mode), files=replace(opened.state.files, texture=texture))
        entries = page_state(state, replace(opened.scene, has_colors=has_colors), opened.workspace, {})
        return entries["view"]["mode"]

    assert shown(None, has_colors=False, mode="texture") == "colours"
    assert shown(None, has_colors=True, mode="texture") == "texture"
    assert shown(Path("a.png"), has_colors=False, mode="texture") == "texture"
    for mode in ("checker", "plain", "colours"):
        assert shown(None, has_colors=False, mode=mode) == mode
