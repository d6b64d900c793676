"""The bench behind the studio: maps of opened models, answers and suggestions, and the worker that computes them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path

import numpy as np
import pytest

from cagemap.errors import ParameterError
from cagemap.files.images.image import write_image
from cagemap.files.meshes.formats import write_mesh
from cagemap.studio.compute import (
    Bench,
    FindMap,
    Found,
    Opening,
    OpenModels,
    ShowBaked,
    perform,
    told_apart,
)
from cagemap.studio.landmarks import LandmarkList
from cagemap.studio.places import vertex_place
from cagemap.studio.scene import Scene, carried_place, mirrored
from cagemap.studio.worker import DROPPED, Failure, Worker, _serve

from studio_boxes import landmarks, unwrapped_cube


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> tuple[Bench, OpenModels]:
    folder = tmp_path_factory.mktemp("models")
    mesh = unwrapped_cube()
    write_mesh(folder / "a.obj", mesh.with_positions(mesh.positions * [1.0, 1.2, 1.4]))
    # Not the very same surface, which has one answer.
    write_mesh(folder / "b.obj", mesh.with_positions(mesh.positions * [1.0, 1.2, 1.4003] + [5.0, 0.0, 0.0]))
    write_image(folder / "t.png", np.full((8, 8, 3), [255, 0, 0], dtype=np.uint8))
    task = OpenModels(Opening(folder / "a.obj", folder / "b.obj", folder / "t.png", 300, folder))
    bench, _ = perform(Bench(), task, lambda _: None)
    return bench, task


def test_the_bench_maps_and_follows_landmarks(opened: tuple[Bench, OpenModels]) -> None:
    bench, task = opened
    bench, first = perform(bench, FindMap(task.opening, landmarks(bench, *range(8))), lambda _: None)
    assert isinstance(first, Found)
    bench, second = perform(bench, FindMap(task.opening, landmarks(bench, *range(7))), lambda _: None)
    assert isinstance(second, Found)
    assert set(second.known.strain) == {f"v{v}" for v in range(7)}
    assert second.skins[1] is None  # the source faces as the target does
    # The models are translates of each other: the map carries a point to the same point, five units to the right.
    target, source = bench.target, bench.source
    mirrors = target.mirror, source.mirror
    scene = Scene(target.shape, source.shape, mirrors, (second.skins[0], b""), second.images)
    there = carried_place(scene, "target", vertex_place(scene.target, 0))
    # Within two edges of the preview's level.
    np.testing.assert_allclose(np.array(there.position) - [5, 0, 0], scene.target.positions[0], atol=0.3)
    back = carried_place(scene, "source", there)
    np.testing.assert_allclose(back.position, scene.target.positions[0], atol=0.3)


@pytest.mark.slow
def test_without_landmarks_the_bench_has_answers_to_choose_from(opened: tuple[Bench, OpenModels]) -> None:
    bench, task = opened
    with pytest.raises(ParameterError, match="answer 99"):
        perform(bench, FindMap(task.opening, LandmarkList(), answer=99), lambda _: None)
    looks = list[Found]()
    bench, first = perform(bench, FindMap(task.opening, LandmarkList()), lambda _: None, looks.append)
    assert isinstance(first, Found)
    # As the files stand, and the best of all rough fits; both are maps of every vertex, and said to be rough.
    assert [look.known.rough for look in looks] == [True, True]
    assert not first.known.rough
    assert {look.images.triangle.shape for look in looks} == {first.images.triangle.shape}
    # A box on a box: each half turn is an answer.
    assert len(first.known.answers) > 1
    assert first.known.confidence
    bench, second = perform(bench, FindMap(task.opening, LandmarkList(), answer=1), lambda _: None)
    assert isinstance(second, Found)
    assert second.known.chosen == 1
    assert not np.array_equal(first.images.triangle, second.images.triangle)
    # One landmark moves that answer, and taking it away gives it back.
    bench, third = perform(bench, FindMap(task.opening, landmarks(bench, 0)), lambda _: None)
    assert isinstance(third, Found)
    assert set(third.known.strain) == {"v0"}
    bench, fourth = perform(bench, FindMap(task.opening, LandmarkList()), lambda _: None)
    assert isinstance(fourth, Found)
    np.testing.assert_array_equal(fourth.images.triangle, second.images.triangle)


def test_every_map_suggests_a_free_vertex_until_all_are_taken(opened: tuple[Bench, OpenModels]) -> None:
    bench, task = opened
    taken = [0, 3, 5]
    for step in range(3):
        if step == 1:  # all but two of the eight
            taken += [vertex for vertex in range(8) if vertex not in taken][:2]
        bench, found = perform(bench, FindMap(task.opening, landmarks(bench, *taken)), lambda _: None)
        assert isinstance(found, Found)
        assert found.known.suggestion not in (None, *taken)
        taken.append(found.known.suggestion or 0)
    _, found = perform(bench, FindMap(task.opening, landmarks(bench, *taken)), lambda _: None)
    assert isinstance(found, Found)
    assert found.known.suggestion is None


def test_mirror_images_lie_across_the_plane(opened: tuple[Bench, OpenModels]) -> None:
    bench, _ = opened
    shape = bench.target.shape
    scene = Scene(shape, bench.source.shape, (bench.target.mirror, bench.source.mirror), (b"", b""))
    corner = vertex_place(shape, 0)
    across = mirrored(scene, "target", corner)
    assert across.corners != corner.corners
    assert mirrored(scene, "target", across) == corner
    assert mirrored(Scene(shape, shape, (None, None), (b"", b"")), "target", corner) is None


def test_a_failing_task_is_a_named_failure_and_the_worker_lives_on(opened: tuple[Bench, OpenModels]) -> None:
    _, task = opened
    stages: list[str] = []
    worker = Worker(stages.append)
    missing = worker.run(OpenModels(replace(task.opening, target=Path("/nowhere/a.obj"))))
    assert isinstance(missing, Failure)
    assert missing.kind == "FormatError"
    assert "a.obj" in missing.message
    answer = worker.run(task)
    assert not isinstance(answer, Failure)
    assert stages
    worker.stop()
    assert isinstance(worker.run(task), (Failure, type(answer)))
    # Whatever happened to the process that was killed, the next task has one.
    assert not isinstance(worker.run(task), Failure)
    worker.stop()


def test_a_task_that_is_not_wanted_ends_at_its_next_stage(
    opened: tuple[Bench, OpenModels], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that has ended already, or is named no more, disturbs no other."""
    _, task = opened
    unwanted, wanted = FindMap(task.opening, LandmarkList()), ShowBaked(task.opening, Path(), None, None)
    here, there = Pipe()
    worker = Worker(lambda stage: worker.drop(unwanted))
    monkeypatch.setattr(worker, "_connected", lambda: here)
    worker._connection = here

    def work(bench: Bench, task: object, progress: Callable[[str], None], _: object) -> tuple[Bench, object]:
        for stage in range(10_000 if isinstance(task, FindMap) else 3):  # the unwanted one has time to hear of it
            progress(str(stage))
            time.sleep(1e-3)
        return bench, type(task).__name__

    monkeypatch.setattr("cagemap.studio.compute.perform", work)
    monkeypatch.setattr("cagemap.studio.worker._step_back", lambda: None)  # it is this process that serves
    serving = threading.Thread(target=_serve, args=(there,), daemon=True)
    serving.start()
    for _ in range(2):
        assert worker.run(unwanted) == Failure(DROPPED, "the computation is not wanted any more")
        worker.drop(unwanted)
        assert worker.run(wanted) == "ShowBaked"
    here.close()
    serving.join(10)
    assert not serving.is_alive()


def test_a_vertex_cannot_be_named_twice(opened: tuple[Bench, OpenModels]) -> None:
    bench, task = opened
    one = landmarks(bench, 0).items[0]
    with pytest.raises(ValueError, match="one pair only"):
        perform(bench, FindMap(task.opening, LandmarkList((one, replace(one, name="again")))), lambda _: None)


def test_answers_of_one_name_are_told_apart() -> None:
    assert told_apart(["as filed", "turned", "as filed", "as filed"]) == (
        "as filed",
        "turned",
        "as filed (2)",
        "as filed (3)",
    )
