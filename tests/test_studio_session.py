"""The session behind all pages, with its worker's process but without a browser."""

from __future__ import annotations

import json
import os
import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.cli.option_list import all_options
from cagemap.errors import FormatError, ParameterError
from cagemap.files.images import write_image
from cagemap.files.landmarks import write_landmarks
from cagemap.files.manifest import note_transfer
from cagemap.files.meshes import write_mesh
from cagemap.files.point_forms import POINT_FORMS
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.shapes import cube
from cagemap.studio.autosave import autosave_path, read_autosave
from cagemap.studio.bench import OpenModels, Task
from cagemap.studio.finish import FinishOptions
from cagemap.studio.landmark_files import points_file
from cagemap.studio.landmarks import LandmarkList
from cagemap.studio.opening import default_files
from cagemap.studio.options import Value
from cagemap.studio.places import vertex_place
from cagemap.studio.preview import Preview
from cagemap.studio.scene import carried
from cagemap.studio.session import Session
from cagemap.studio.shape import pick
from cagemap.studio.state import Files, Job, Message, Output, Studio, View
from cagemap.studio.worker import DROPPED, Failure, Worker
from cagemap.studio.workspace import Workspace

# The computation stands back for everything else, so that a busy machine takes long over a first map.
PATIENCE = 150.0


def until(done: Callable[[], object], session: Session) -> None:
    end = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < end, [message.text for message in session.state.messages]
        time.sleep(0.01)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("boxes")
    mesh = cube()
    # Sides of three lengths, and slanted: no turn takes the box onto itself.
    corners = mesh.positions * [1.0, 1.3, 1.7]
    corners[:, 0] += 0.4 * corners[:, 1] * (corners[:, 2] > 0)
    write_mesh(folder / "a.obj", mesh.with_positions(corners))
    write_mesh(folder / "b.obj", mesh.with_positions(corners + np.array([4.0, 0.0, 0.0])))
    write_image(folder / "b.png", np.full((8, 8, 3), 200, dtype=np.uint8))
    return folder


@pytest.fixture(scope="module")
def session(folder: Path) -> Iterator[Session]:
    session = Session(Workspace.of(folder), 300, all_options())
    yield session
    session.close()


@pytest.fixture
def opened(session: Session, folder: Path) -> Session:
    """The boxes without a landmark."""
    files = default_files(folder, folder / "a.obj", folder / "b.obj", folder / "b.png")
    for path in folder.glob("*.json*"):
        path.unlink()
    autosave_path(files.landmarks).unlink(missing_ok=True)
    with session._lock:  # what an earlier test has left
        again = session.state.files == files and session.scene is not None
        session._change(messages=(), outputs=(), view=View(), finish_job=None)
    if again:
        # The match without landmarks, which is most of an opening, is there already.
        (folder / "none.json").write_text(json.dumps({"pairs": []}))
        session.load(Path("none.json"))
        autosave_path(files.landmarks).unlink(missing_ok=True)
    else:
        session.open(files)
    until(lambda: session.state.map.revision >= 1 and not session.state.map.strain, session)
    until(lambda: at_rest(session), session)
    return session


def at_rest(session: Session) -> bool:
    """Whether the computing thread waits for a wish: it does so once it has handed its last answer over."""
    return bool(session._preview._wake._waiters)  # type: ignore[attr-defined]


def click(session: Session, side: str, vertex: int) -> None:
    """A click along the ray through a corner's point, from outside."""
    scene = session.scene
    assert scene is not None
    point = scene.shape(side).to_view(scene.shape(side).positions[vertex])
    session.click(side, 3 * point, -point / np.linalg.norm(point))


def test_it_starts_with_a_map_and_follows_clicks(opened: Session) -> None:
    click(opened, "target", 2)
    proposal = opened.state.proposal or pytest.fail("no proposal")
    assert (proposal.number, proposal.side) == (1, "source")
    assert proposal.place.position[0] > 2  # on the other box
    click(opened, "source", 2)
    until(lambda: opened.state.map.revision >= 2, opened)
    there = opened.state.history.present.complete[0].target
    np.testing.assert_allclose(there.position, vertex_place(opened.scene.target, 2).position, atol=1e-6)
    assert set(opened.state.map.strain) == {"landmark 1"}
    opened.undo()
    opened.undo()
    assert not opened.state.history.present.items
    opened.redo()
    opened.redo()
    assert len(opened.state.history.present.complete) == 1


def test_saved_landmarks_are_read_again_and_a_persons_file_is_kept(opened: Session) -> None:
    files = opened.state.files
    for vertex in (0, 3, 5):
        click(opened, "target", vertex)
        opened.accept()
    assert not opened.state.saved
    assert autosave_path(files.landmarks).is_file()
    theirs = {"source": "b.obj", "target": "a.obj", "pairs": [{"name": "mine", "source": 1, "target": 1}]}
    files.landmarks.write_text(json.dumps(theirs))
    opened.save()
    assert opened.state.saved
    assert not autosave_path(files.landmarks).exists()
    assert json.loads(files.landmarks.with_name(f"{files.landmarks.name}.before-studio").read_text()) == theirs
    before = opened.state.history.present.complete
    opened.remove(1)
    opened.load(files.landmarks)
    assert [item.name for item in opened.state.history.present.complete] == [item.name for item in before]
    opened.undo()
    assert len(opened.state.history.present.complete) == 2


def test_a_landmark_file_of_other_models_is_kept(opened: Session) -> None:
    landmarks = opened.state.files.landmarks
    click(opened, "target", 0)
    opened.accept()
    opened.save()
    ours = landmarks.read_text()
    write_landmarks(landmarks, Landmarks(("mine",), np.array([1]), np.array([1]), "c.obj", "d.obj"))
    theirs = landmarks.read_text()
    kept = landmarks.with_name(f"{landmarks.name}.before-studio")
    for _ in range(2):  # what it saves itself is replaced as ever
        opened.save()
        assert kept.read_text() == theirs
        assert landmarks.read_text() == ours
        assert not landmarks.with_name(f"{kept.name}-2").exists()


def test_a_landmark_file_that_cannot_be_read_costs_no_map(opened: Session) -> None:
    files = opened.state.files
    files.landmarks.write_text("{")
    opened.open(files)
    until(lambda: opened.state.map.revision >= 1, opened)
    assert any("expected JSON" in message.text for message in opened.state.messages)


def test_no_finish_begins_with_landmarks_that_were_not_saved(opened: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise FormatError("full: no room. Make some.")

    click(opened, "target", 0)
    opened.accept()
    with monkeypatch.context() as patch:
        patch.setattr("cagemap.studio.session.save_landmarks", refused)
        opened.finish(FinishOptions())
    assert opened.state.finish_job is None
    assert "no room" in opened.state.messages[-1].text


def test_answers_about_models_that_are_no_longer_open_are_left_out(opened: Session) -> None:
    before = opened.state
    assert opened._preview.models is not None
    others = replace(opened._preview.models, vertices=7)
    opened._receive(OpenModels(others, View()), Failure("FormatError", "of another pair"))
    assert opened.state == before


def test_a_search_that_was_dropped_is_no_error_where_its_models_are_open_again(opened: Session) -> None:
    """Another part, and back at once: the answer comes when its models count again."""
    before = opened.state
    assert opened._preview.models is not None
    opened._receive(OpenModels(opened._preview.models, View()), Failure(DROPPED, "not wanted"))
    assert opened.state == before


def click_between(session: Session, side: str) -> np.ndarray:
    """A click on the middle of a face; the place clicked, in file units."""
    shape = session.scene.shape(side)
    middle = shape.positions[shape.control.face_indices[:4]].mean(axis=0)
    ray = shape.to_view(middle) / np.linalg.norm(shape.to_view(middle))
    hit = pick(shape, 3 * ray, -ray)
    assert hit is not None
    session.click(side, 3 * ray, -ray)
    return hit.position


PER_MESH = [f"both{form.ending}" for form in POINT_FORMS]


@pytest.mark.parametrize("name", ["", "other.json", *PER_MESH])
def test_a_click_between_vertices_stays_where_it_was(opened: Session, folder: Path, name: str) -> None:
    clicked = [click_between(opened, side) for side in ("target", "source")]
    item = opened.state.history.present.complete[0]
    for place, position, side in ((item.target, clicked[0], "target"), (item.source, clicked[1], "source")):
        assert np.linalg.norm(np.array(place.position) - position) < 0.01 * opened.scene.shape(side).radius
        assert max(place.weights) < 0.9
    opened.save_as(name)
    opened.remove(1)
    if name not in PER_MESH:
        assert opened.state.files.landmarks.name == (name or "b__a.json")
        opened.load(Path(name or "b__a.json"))
    else:
        assert opened.state.files.landmarks.name == "b__a.json"
        opened.load(points_file(Path(name), "target"), points_file(Path(name), "source"))
        for side in ("target", "source"):  # Wrap's form has no mark, so that nothing is written over it
            points_file(folder / name, side).unlink()
        said = [message.text for message in opened.state.messages if "order alone" in message.text]
        assert bool(said) == (name == "both.txt")
    again = opened.state.history.present.complete[0]
    for side in ("target", "source"):
        np.testing.assert_allclose(again.on(side).position, item.on(side).position, atol=1e-6)
    for refused in ("refused.md", "refused"):
        opened.save_as(refused)
        assert "Choose such a name" in opened.state.messages[-1].text
        assert not (folder / refused).exists()


def test_curves_of_a_file_are_used_and_saved_again(opened: Session, folder: Path) -> None:
    curve = {"name": "rim", "source": [0, 1, 2, 3], "target": [0, 1, 2, 3], "closed": True}
    corners = opened.scene.target.control.face_indices[:4].tolist()
    curve |= {"source": corners, "target": corners}
    given = {"source": "b.obj", "target": "a.obj", "pairs": [], "curves": [curve]}
    (folder / "rim.json").write_text(json.dumps(given))
    revision = opened.state.map.revision
    opened.load(Path("rim.json"))
    until(lambda: opened.state.map.revision > revision, opened)
    opened.click("target", np.array([0.0, 0.0, 5.0]), np.array([0.0, 0.0, -1.0]))
    assert opened.state.history.present.curves.names == ("rim",)
    kept = read_autosave(autosave_path(opened.state.files.landmarks), (8, 8))
    assert kept.curves.names == ("rim",)
    np.testing.assert_array_equal(kept.curves.target.points.vertices, corners)
    for name in ("other.json", "both.points.json"):
        opened.save_as(name)
    assert json.loads((folder / "other.json").read_text())["curves"] == [curve]
    opened.load(Path("both.target.points.json"), Path("both.source.points.json"))
    np.testing.assert_array_equal(opened.state.history.present.curves.source.points.vertices, corners)


def test_the_next_landmark_is_proposed_on_both_models(opened: Session) -> None:
    vertex = opened.state.map.suggestion
    opened.next_landmark()
    waiting, proposal = opened.state.history.present.open, opened.state.proposal
    assert waiting.target == vertex_place(opened.scene.target, vertex)
    assert (proposal.number, proposal.side) == (waiting.number, "source")
    revision = opened.state.map.revision
    opened.accept()
    until(lambda: opened.state.map.revision > revision, opened)
    assert opened.state.map.suggestion != vertex
    opened.next_landmark()
    before = opened.state.proposal
    clicked = click_between(opened, "target")  # corrected: the end moves, and the proposal with it
    np.testing.assert_allclose(opened.state.history.present.open.target.position, clicked, atol=0.01)
    assert opened.state.proposal != before


def test_a_kill_of_the_session_loses_nothing(opened: Session, folder: Path) -> None:
    click(opened, "target", 4)
    opened.rename(1, "corner")
    other = Session(Workspace.of(folder), 300, all_options())
    try:
        other.open(opened.state.files)
        until(lambda: other.state.history.present.items, other)
        assert other.state.history.present == opened.state.history.present
        assert any("recovered" in message.text for message in other.state.messages)
    finally:
        other.close()


def test_a_killed_computation_keeps_the_map_and_the_next_click_works(opened: Session) -> None:
    revision = opened.state.map.revision
    opened._preview.stop()  # as the system does where memory runs out
    click(opened, "target", 6)
    opened.accept()
    until(lambda: opened.state.map.revision > revision, opened)
    assert opened.scene.images is not None


def test_a_fault_of_ours_is_a_message_and_the_next_click_works(
    opened: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("a slip")

    revision = opened.state.map.revision
    with monkeypatch.context() as patch:
        patch.setattr("cagemap.studio.session.proposed", broken)
        click(opened, "target", 2)  # here, and where the answer of the computation is taken in
        opened.match_again()
        until(lambda: opened.state.preview_job is None, opened)
    assert "internal error, ZeroDivisionError: a slip" in opened.state.messages[-1].text
    click(opened, "target", 2)
    opened.accept()
    until(lambda: opened.state.map.revision > revision and opened.state.map.strain, opened)


class Idle(Worker):
    """Does nothing, at once."""

    def start(self) -> None:
        pass

    def run(self, task: object) -> None:
        pass


def test_only_the_first_opening_is_said_to_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cagemap.studio.preview.Worker", Idle)
    titles: list[str] = []

    def on_job(job: Job | None) -> None:
        if job is not None:
            titles.append(job.title)

    preview = Preview(100, lambda: (LandmarkList(), View(), None), on_job, lambda *_: None)
    for count in (1, 2):
        preview.open(Files(Path("a.obj"), Path("b.obj"), None, Path("c.json"), Path("RESULT")))
        end = time.monotonic() + 10
        while len(titles) < count and time.monotonic() < end:
            time.sleep(0.01)
    preview.close()
    assert ["compiles" in title for title in titles] == [True, False]


def test_a_map_of_models_that_are_open_no_more_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both parts of a pair are chosen one after the other; opening itself goes on, its surfaces are wanted again."""
    begun, dropped, goes_on = queue.Queue[Task](), list[Task](), threading.Event()

    class Slow(Idle):
        def run(self, task: Task) -> None:
            begun.put(task)
            assert goes_on.wait(10)
            goes_on.clear()

        def drop(self, task: Task) -> None:
            dropped.append(task)
            goes_on.set()

    monkeypatch.setattr("cagemap.studio.preview.Worker", Slow)
    preview = Preview(100, lambda: (LandmarkList(), View(), None), lambda _: None, lambda *_: None)
    files = Files(Path("a.obj"), Path("b.obj"), None, Path("c.json"), Path("RESULT"))
    preview.open(replace(files, parts=("one", None)))
    assert isinstance(begun.get(timeout=10), OpenModels)
    preview.open(replace(files, parts=("one", "two")))
    goes_on.set()
    assert isinstance(begun.get(timeout=10), OpenModels)
    assert dropped == []
    preview.find(fresh=True)
    goes_on.set()
    search = begun.get(timeout=10)
    preview.open(replace(files, parts=("one", "two")))  # the same once more: the map is wanted
    assert dropped == []
    preview.open(files)
    assert dropped == [search]
    assert isinstance(begun.get(timeout=10), OpenModels)
    preview.close()
    goes_on.set()


def test_cancelling_ends_what_runs(opened: Session) -> None:
    def cancel(state: Studio, _: object) -> None:
        if state.preview_job is not None and state.preview_job.stage:
            opened.cancel_preview()

    images = opened.scene.images
    opened._preview.stop()  # so that the next map starts with the files, in stages
    opened.subscribe(cancel)
    opened.match_again()
    until(lambda: any("cancelled" in message.text for message in opened.state.messages), opened)
    assert opened.scene.images is images
    opened._listeners.remove(cancel)


def test_errors_are_messages_and_paths_outside_are_refused(opened: Session, tmp_path: Path) -> None:
    opened.load(Path("../elsewhere.json"))
    assert opened.state.messages[-1].kind == "error"
    assert "ParameterError" in opened.state.messages[-1].text
    opened.save(tmp_path / "out.json")
    assert not (tmp_path / "out.json").exists()
    opened.accept()  # nothing waits
    opened.mirror(1)  # nothing to mirror
    assert opened.state.messages[-1].kind == "error"
    opened.finish(FinishOptions(given={("transfer", "displacement"): tmp_path / "secret.png"}))
    assert opened.state.finish_job is None


@pytest.mark.parametrize("path", ["../x.json", "/etc/passwd", "a/../../x.json", "bad\0name", "~/../../x"])
def test_no_word_of_the_page_reaches_outside(opened: Session, folder: Path, path: str) -> None:
    def listed() -> set[Path]:
        return set(folder.parent.rglob("*"))

    before, files, history = listed(), opened.state.files, opened.state.history
    opened.save_as(path)
    opened.load(Path(path))
    opened.load(files.target, Path(path))
    for key, option in opened.options.items():
        named: dict[str, Value] = {"file": Path(path), "files": (Path(path),), "named files": (("a", Path(path)),)}
        named |= {"name or file": f"not:{path}.png"}
        if option.kind in named:
            opened.finish(FinishOptions(given={key: named[option.kind]}))
    opened.finish(FinishOptions(maps=(("roughness", Path(path)),)))
    opened.finish(FinishOptions(name=path))
    for name in ("target", "source", "texture", "landmarks", "result"):
        opened.open(replace(files, **{name: Path(path)}))
    assert opened.state.messages[-1].kind == "error"
    assert opened.state.files == files
    assert opened.state.history == history
    assert opened.state.finish_job is None
    assert listed() == before


def test_a_target_without_uvs_is_laid_out(opened: Session) -> None:
    # The boxes have none.
    assert opened.scene.target.uvs is None
    bake = next(command for command in opened.plan(FinishOptions()) if command.title == "texture")
    assert "--unwrap" in bake.arguments


def test_a_cancelled_finish_leaves_nothing_and_the_next_one_runs(opened: Session, folder: Path) -> None:
    def files() -> set[Path]:
        return {path for path in folder.rglob("*") if path.is_file()}

    def at_work() -> bool:
        job = opened.state.finish_job
        return job is not None and ":" in job.stage and job.fraction > 0

    def said(text: str) -> bool:
        return any(text in message.text for message in opened.state.messages)

    before = files()
    options = FinishOptions(report=False, given={("match", "vertices"): 300, ("transfer", "size"): 8})
    opened.finish(options)
    until(at_work, opened)
    opened.finish(options)
    assert said("no finish to be running")
    opened.cancel_finish()
    until(lambda: said("finish: cancelled"), opened)
    assert opened.state.finish_job is None
    assert files() == before
    opened.finish(replace(options, texture=False))
    until(lambda: said("finish: done"), opened)
    assert [output.what for output in opened.state.outputs] == ["the map"]
    # The map is there: another bake of it does not compute it again, unless something has changed; that something was
    # made of it is noted beside it.
    note_transfer(opened.state.files.result, {"kind": "texture", "output": "a.png"})
    arrays = opened.state.files.result / "map.npz"
    written = arrays.stat().st_mtime_ns
    todo = opened.plan(replace(options, report=True))
    left = [opened._last.left_of(todo, opened.state)]
    assert left == [todo[1:]]
    opened._change(messages=())
    opened.finish(replace(options, texture=False))
    until(lambda: said("finish: done"), opened)
    assert [output.what for output in opened.state.outputs] == ["the map"]
    assert arrays.stat().st_mtime_ns == written
    last = opened._last._made
    other = opened.plan(options.giving({("match", "vertices"): 301}))
    click(opened, "target", 0)
    opened.accept()
    moved, before_that = opened.state, replace(opened.state, history=opened.state.history.undo().undo())
    assert opened._last.left_of(todo, before_that) == todo[1:]
    for commands, state in ((other, before_that), (todo, moved)):
        opened._last._made = last
        assert opened._last.left_of(commands, state) == commands
    for changed in (opened.state.files.target, arrays):
        opened._last._made, status = last, changed.stat()
        os.utime(changed, ns=(1, 1))
        assert opened._last.left_of(todo, before_that) == todo
        os.utime(changed, ns=(status.st_atime_ns, status.st_mtime_ns))
    for path in files() - before:
        path.unlink()


def test_the_view_is_drawn_anew_only_where_it_changes(opened: Session) -> None:
    before = opened.scene.skins
    opened.show(View(cages=True))
    opened.show(View("colours"))
    until(lambda: opened.scene.skins[0] != before[0] and opened.scene.skins[1] != before[1], opened)
    opened.show(View())
    until(lambda: opened.scene.skins == before, opened)


def test_a_killed_computation_leaves_the_map_on_the_target(opened: Session) -> None:
    before = opened.scene.skins
    opened._preview.stop()
    for view in (View("colours"), View()):
        shown = opened.scene.skins
        opened.show(view)
        until(lambda shown=shown: opened.scene.skins[0] != shown[0], opened)
    assert opened.scene.skins == before


def test_a_view_that_changes_with_the_landmarks_is_drawn_on_both(opened: Session) -> None:
    before = opened.scene.skins
    with opened._lock:
        opened.match_again()
        opened.show(View("checker"))
    until(lambda: opened.scene.skins[0] != before[0] and opened.scene.skins[1] != before[1], opened)


def baked(session: Session, folder: Path) -> Path:
    """An image as a bake leaves it, on the model."""
    image = folder.resolve() / "b.png"
    with session._lock:
        session._change(outputs=(Output(image, "texture"),))
        session._finishing = session.state.wish
        session._ended(Message("note", "finish: done"))
    assert (session.state.view.mode, session.state.view.baked) == ("baked", image)
    return image


def test_a_bake_is_shown_though_its_map_cannot_be_compared(
    opened: Session, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cagemap.studio.session.led_elsewhere", lambda *_: [][0])
    baked(opened, folder)
    assert [message.kind for message in opened.state.messages[-2:]] == ["error", "note"]


def test_a_bake_of_an_earlier_map_is_not_shown_as_that_of_now(opened: Session, folder: Path) -> None:
    shown: list[View] = []
    baked(opened, folder)
    click(opened, "target", 2)
    assert opened.state.view.mode == "baked"  # half a landmark changes no map
    opened.accept()
    shown.append(opened.state.view)
    baked(opened, folder)
    opened.match_again()
    shown.append(opened.state.view)
    baked(opened, folder)
    opened.undo()
    shown.append(opened.state.view)
    assert shown == [View()] * 3
    # Nor is one that ends after the landmarks have changed.
    with opened._lock:
        opened._finishing = opened.state.wish
        opened.redo()
        opened._ended(Message("note", "finish: done"))
    assert opened.state.view == View()
    assert "before the last changes" in opened.state.messages[-1].text
    # Nor on other models, nor while the next one is made of other options.
    baked(opened, folder)
    opened.finish(FinishOptions(given={("match", "vertices"): 300}))
    assert opened.state.view == View()
    opened.cancel_finish()
    until(lambda: opened.state.finish_job is None, opened)
    until(lambda: any("cancelled" in message.text for message in opened.state.messages), opened)
    baked(opened, folder)
    opened.open(opened.state.files)
    assert opened.state.view == View()
    until(lambda: opened.state.map.revision >= 1, opened)


def test_what_was_baked_is_shown_where_there_is_any(opened: Session, folder: Path) -> None:
    opened.show_as(mode="baked")
    assert opened.state.view.mode == "texture"
    assert "Press Bake" in opened.state.messages[-1].text
    image = baked(opened, folder)
    opened.look_at(None)
    opened.show_as(mode="baked", cages=True)
    assert opened.state.view == View("baked", cages=True, baked=image)


def test_changes_of_two_pages_at_once_are_both_kept(opened: Session) -> None:
    for vertex in (0, 3):
        click(opened, "target", vertex)
        opened.accept()
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


def test_an_autosave_of_the_name_to_save_as_is_moved_aside(opened: Session, folder: Path) -> None:
    theirs = autosave_path(folder / "other.json")
    theirs.write_text("unsaved")
    click(opened, "target", 0)
    opened.accept()
    opened.save_as("other.json")
    click(opened, "target", 3)
    assert theirs.with_name(f"{theirs.name}.1").read_text() == "unsaved"
    for path in folder.glob(".*autosave*"):
        path.unlink()
    opened.save_as("b__a.json")


def test_a_probe_points_at_both_models(opened: Session) -> None:
    scene = opened.scene
    point = scene.target.to_view(scene.target.positions[1])
    opened.probe("target", 3 * point, -point / np.linalg.norm(point))
    probe = opened.state.probe
    assert probe is not None
    assert np.linalg.norm(np.array(probe.target) - scene.target.positions[1]) < 0.3
    np.testing.assert_array_equal(probe.source, carried(scene, "target", np.array(probe.target)).position)
    assert probe.source[0] > 2  # on the other box
    opened.probe("target", np.array([9.0, 9.0, 9.0]), np.array([1.0, 0.0, 0.0]))
    assert opened.state.probe is None


def test_files_are_added_under_free_names(session: Session, folder: Path) -> None:
    workspace = session.workspace
    first, second = workspace.add("../x.obj", b"1"), workspace.add("x.obj", b"2")
    assert (first.name, second.name) == ("x.obj", "x (2).obj")
    assert first.parent == second.parent == folder.resolve()
    assert not session.add_file("x.sh", b"rm")
    for path in (first, second):
        path.unlink()


@pytest.mark.parametrize(
    "line",
    [b"mtllib ../out.mtl", b" mtllib own.mtl /etc/passwd\r", b"mtllib \\\n..\\out.mtl", b"v 0 0 0\rmtllib ../out.mtl"],
)
def test_an_added_mesh_names_no_file_outside_the_folders(session: Session, folder: Path, line: bytes) -> None:
    before = sorted(folder.iterdir())
    with pytest.raises(ParameterError, match="got one outside"):
        session.workspace.add("x.obj", b"v 0 0 0\n" + line + b"\nv 1 0 0\n")
    assert sorted(folder.iterdir()) == before
    added = session.workspace.add("x.obj", b"mtllib my own.mtl\n")
    added.unlink()


@pytest.mark.parametrize(
    "words",
    [
        "(subLayers = [@../out.usda@])",
        'def "a"(references = @/out.usda@){}',
        'def "a"(payload = @./../out.usda@){}',
        'def "a"(references = @elsewhere.usda@){}',
        'def "a"(references = @./x.usda:SDF_FORMAT_ARGS:a=b@){}',
        'def "a" {\nasset f = @/etc/passwd@\n}',
        'def "a" {\nasset[] f.timeSamples = {0: [@../out.png@]}\n}',
        'def "a"(clips = {dictionary b = {string templateAssetPath = "../out.###.usda"}}){}',
        '(expressionVariables = {string A = "x"})\ndef "a"(references = @`"./${A}.usda"`@){}',
    ],
)
def test_an_added_usd_file_names_no_file_outside_the_folders(session: Session, folder: Path, words: str) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    before = sorted(folder.iterdir())
    text = "#usda 1.0\n" + words.replace("){}", "){\n}\n")
    with pytest.raises(ParameterError, match="got one outside"):
        session.workspace.add("x.usda", text.encode())
    assert sorted(folder.iterdir()) == before


def test_an_added_usd_file_may_name_files_beside_it_and_a_package_its_own(session: Session, tmp_path: Path) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    from pxr import Sdf

    text = b'#usda 1.0\ndef "a" {\nasset f = @./textures/a.png@\n}\n'
    session.workspace.add("x.usda", text).unlink()
    with pytest.raises(FormatError, match="cannot be read as USD"):
        session.workspace.add("x.usda", b"no layer")
    layer, image, package = tmp_path / "a.usda", tmp_path / "a.png", tmp_path / "p.usdz"
    layer.write_bytes(text.replace(b"./textures/", b""))
    image.write_bytes(b"png")
    for entry, named in (("a.png", True), ("b.png", False)):
        with Sdf.ZipFileWriter.CreateNew(str(package)) as writer:
            writer.AddFile(str(layer), "a.usda")
            writer.AddFile(str(image), entry)
        if named:
            session.workspace.add("p.usdz", package.read_bytes()).unlink()
        else:
            with pytest.raises(ParameterError, match=r"got one outside: a\.png"):
                session.workspace.add("p.usdz", package.read_bytes())
