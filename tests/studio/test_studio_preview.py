"""Requests of the preview: what is computed again, waits, is dropped or cancelled, and what a bake waits for."""

import json
import queue
import threading
import time
import types
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from cagemap.studio.compute import FindMap, OpenModels, ShowImage, ShowPosed, Task
from cagemap.studio.finish import Command, FinishOptions
from cagemap.studio.landmarks import LandmarkList
from cagemap.studio.page.actions import Actions
from cagemap.studio.preview import Preview
from cagemap.studio.session import Session
from cagemap.studio.state import Files, MapState, RunningJob, StudioState
from cagemap.studio.worker import CANCELLED_KIND, STOPPED_KIND, Failure

from studio_boxes import Idle, add_landmarks, at_rest, click, until

ANY_FILES = Files(Path("a.obj"), Path("b.obj"), None, Path("c.json"), Path("RESULT"))
SlowPreview = tuple[Preview, queue.Queue[Task], list[Task], threading.Event]


@pytest.fixture
def slow_preview(monkeypatch: pytest.MonkeyPatch) -> Iterator[SlowPreview]:
    """A preview whose tasks last until an event is set or they are cancelled; what begins and what is cancelled."""
    begun, dropped, goes_on = queue.Queue[Task](), list[Task](), threading.Event()

    class Slow(Idle):
        def run(self, task: Task) -> None:
            begun.put(task)
            assert goes_on.wait(10)
            goes_on.clear()

        def cancel(self, task: Task) -> None:
            dropped.append(task)
            goes_on.set()

    monkeypatch.setattr("cagemap.studio.preview.Worker", Slow)
    made = Preview(100, Path(), lambda: (LandmarkList(), None, 0), lambda _: None, lambda *_: None)
    yield made, begun, dropped, goes_on
    made.close()
    goes_on.set()


def test_a_map_that_is_computed_during_a_turn_is_computed_again(slow_preview: SlowPreview) -> None:
    preview, begun, _, goes_on = slow_preview
    preview.open(ANY_FILES)
    assert isinstance(begun.get(timeout=10), OpenModels)
    goes_on.set()
    for ask, side, ups in (
        (lambda: preview.find(fresh=True), "target", ("z", None)),
        (lambda: preview.request("answer", 1), "source", ("z", "z")),
    ):
        ask()
        search = begun.get(timeout=10)
        preview.turn(side, "z", "")
        drawing = begun.get(timeout=10)
        goes_on.set()
        again = begun.get(timeout=10)
        goes_on.set()
        assert isinstance(drawing, ShowPosed)
        assert drawing.pair_files.ups == ups
        assert again == replace(search, pair_files=drawing.pair_files)


def test_a_match_from_the_start_is_one_also_after_an_edit_and_a_turn(slow_preview: SlowPreview) -> None:
    preview, begun, _, goes_on = slow_preview
    preview.open(ANY_FILES)
    begun.get(timeout=10)
    goes_on.set()
    preview.find(fresh=True)
    begun.get(timeout=10)
    preview.find(fresh=False)  # a landmark was added
    preview.turn("target", "z", "")
    assert isinstance(begun.get(timeout=10), ShowPosed)
    goes_on.set()
    again = begun.get(timeout=10)
    assert isinstance(again, FindMap)
    assert again.fresh


def test_until_a_first_map_is_compiled_titles_say_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("cagemap.studio.preview.Worker", Idle)
    kernel = types.SimpleNamespace(stats=types.SimpleNamespace(cache_path=str(tmp_path)))  # of NUMBA_CACHE_DIR
    monkeypatch.setattr("cagemap.numerics.sparse_algebra._multiply_rows", kernel)
    titles: list[str] = []

    def on_job(job: RunningJob | None) -> None:
        if job is not None:
            titles.append(job.title)

    preview = Preview(100, Path(), lambda: (LandmarkList(), None, 0), on_job, lambda *_: None)
    preview.open(ANY_FILES)
    end = time.monotonic() + 10
    while len(titles) < 2 and time.monotonic() < end:
        if titles:
            (tmp_path / "products.nbi").touch()
            preview.find(fresh=False)
        time.sleep(0.01)
    preview.close()
    assert ["first time" in title for title in titles[:2]] == [True, False]


def test_a_map_of_models_that_are_open_no_more_is_dropped(slow_preview: SlowPreview) -> None:
    preview, begun, dropped, goes_on = slow_preview
    preview.open(replace(ANY_FILES, parts=("one", None)))
    assert isinstance(begun.get(timeout=10), OpenModels)
    preview.open(replace(ANY_FILES, parts=("one", "two")))
    goes_on.set()
    assert isinstance(begun.get(timeout=10), OpenModels)
    assert dropped == []
    preview.find(fresh=True)
    goes_on.set()
    search = begun.get(timeout=10)
    preview.open(replace(ANY_FILES, parts=("one", "two")))  # the same once more: the map is wanted
    assert dropped == []
    preview.open(ANY_FILES)
    assert dropped == [search]
    assert isinstance(begun.get(timeout=10), OpenModels)


@pytest.mark.slow
def test_cancelling_ends_what_runs(opened: Session) -> None:
    def cancel(state: StudioState, _: object) -> None:
        if state.preview_job is not None and state.preview_job.stage:
            opened.cancel()

    images = opened.scene.preview_map
    opened._preview.kill()  # so that the next map starts with the files, in stages
    opened.subscribe(cancel)
    opened.match_again()
    until(lambda: any("cancelled" in message.text for message in opened.state.messages), opened)
    assert opened.scene.preview_map is images
    opened._listeners.remove(cancel)


def test_cancelling_the_first_map_does_not_say_that_a_map_stays(opened: Session) -> None:
    shown = opened.state.map
    opened._change(map=MapState())
    opened._cancelled = True
    opened._receive(FindMap(opened._preview.pair_files, LandmarkList()), Failure(STOPPED_KIND, "killed"))
    opened._change(map=shown)
    assert opened.state.messages[-1].text == "cancelled"


def test_a_request_carries_the_chosen_answer(opened: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    tasks = queue.Queue[Task]()
    monkeypatch.setattr(opened._preview._worker, "run", lambda task: tasks.put(task) or Failure(CANCELLED_KIND, ""))
    shown = opened.state.map
    opened._change(map=replace(shown, chosen_answer=1))
    opened.match_again()
    assert tasks.get(timeout=10).chosen_answer == 1
    opened._change(map=shown)


@pytest.fixture
def held_tasks(opened: Session, monkeypatch: pytest.MonkeyPatch) -> Iterator[queue.Queue[Task]]:
    """Tasks of the preview as they begin; each runs until it is cancelled."""
    begun, killed, shown = queue.Queue[Task](), threading.Event(), opened.state.map

    def run(task: Task) -> Failure:
        begun.put(task)
        killed.wait(10)
        killed.clear()
        return Failure(STOPPED_KIND, "killed")

    with monkeypatch.context() as patch:
        patch.setattr(opened._preview._worker, "run", run)
        patch.setattr(opened._preview._worker, "kill", killed.set)
        yield begun
        opened._preview._requests.clear()
        killed.set()
        until(lambda: at_rest(opened), opened)
    opened._change(map=shown)


def test_cancel_drops_the_map_that_waits_too(opened: Session, held_tasks: queue.Queue[Task]) -> None:
    opened.match_again()
    held_tasks.get(timeout=10)
    add_landmarks(opened, 2)
    opened.cancel()
    until(lambda: opened.state.preview_job is None and at_rest(opened), opened)
    assert held_tasks.empty()
    assert (opened.state.map.unchecked, opened.state.map.from_start) == (True, False)
    assert opened.state.messages[-1].text == "cancelled"


def test_cancelling_a_drawing_leaves_a_map_of_the_same_landmarks_checked(opened, boxes, held_tasks):
    before, texture = opened.state.map, opened.state.files.texture
    assert 0 < before.first_seconds < 600
    opened.match_again()
    held_tasks.get(timeout=10)
    opened.open(replace(opened.state.files, texture=boxes / "other.png"))
    opened._preview.kill()  # as another image does with the match, which then waits again
    assert isinstance(held_tasks.get(timeout=10), ShowImage)
    opened.cancel()
    until(lambda: opened.state.preview_job is None and at_rest(opened), opened)
    assert held_tasks.empty()
    assert opened.state.map == before
    assert opened.state.files.texture == texture
    assert opened.state.messages[-1].text == "cancelled; the map stays as it was"


def test_no_bake_starts_while_a_chosen_alignment_is_computed(opened, held_tasks, started):
    opened._change(map=replace(opened.state.map, answers=("as filed", "turned")))
    opened.choose_answer(1)
    held_tasks.get(timeout=10)
    opened.finish(FinishOptions())
    assert started == []
    assert "the chosen alignment has no map yet" in opened.state.messages[-1].text


def test_no_bake_starts_while_another_image_is_drawn_and_the_former_one_can_be_chosen_again(
    opened: Session, boxes: Path, held_tasks: queue.Queue[Task], started: list[Command]
) -> None:
    files = opened.state.files
    click(opened, "target", 2)
    history = opened.state.history
    opened.open(replace(files, texture=boxes / "other.png"))
    assert isinstance(held_tasks.get(timeout=10), ShowImage)
    opened.finish(FinishOptions())
    assert started == []
    assert "the chosen image is being drawn" in opened.state.messages[-1].text
    opened.open(files)
    opened._preview.kill()
    again = held_tasks.get(timeout=10)
    assert isinstance(again, ShowImage)
    assert again.pair_files.texture == files.texture
    assert opened.state.history == history


def test_a_chosen_image_and_axis_that_are_not_drawn_yet_stay_when_models_are_opened(opened, boxes, monkeypatch):
    begun = list[Files]()
    monkeypatch.setattr(opened, "_open_pair", lambda files, _: begun.append(files))
    monkeypatch.setattr(opened._preview, "request", lambda *_: None)
    monkeypatch.setattr(opened._preview, "is_requested", lambda kind: kind == "image")
    files, pair_files = opened.state.files, opened._preview.pair_files
    image = files.texture.with_name("other.png")
    try:
        opened.open(replace(files, texture=image))
        opened.turn_up("target")
        opened.choose_part("target", None)
        opened.open_plain("source")
        for role in ("target", "source"):
            head = json.dumps({"name": "c.obj", "role": role}).encode()
            Actions(opened).handle(head + b"\n" + (boxes / "a.obj").read_bytes())
    finally:
        opened._preview.pair_files = pair_files
        (boxes / "c.obj").unlink()
    dropped = [(image, (None, files.ups[1])), (None, ("z", None))]
    assert [(one.texture, one.ups) for one in begun] == [*2 * [(image, ("z", files.ups[1]))], *dropped]
