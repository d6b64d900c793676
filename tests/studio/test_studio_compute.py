"""Tasks of the preview: maps that follow landmarks, their answers and suggestions, and the worker that runs them."""

import logging
import os
import pickle
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path

import numpy as np
import pytest

from cagemap.errors import FormatError, ParameterError
from cagemap.files.images.image import write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import read_result
from cagemap.studio.compute import (
    FindMap,
    MapUpdate,
    OpenModels,
    PairFiles,
    PreviewCache,
    ShowBaked,
    run_task,
)
from cagemap.studio.landmark_files import to_landmarks
from cagemap.studio.landmarks import LandmarkList
from cagemap.studio.places import vertex_place
from cagemap.studio.recorded_match import number_duplicates
from cagemap.studio.scene import Scene, map_place, mirror_place
from cagemap.studio.worker import CANCELLED_KIND, RESULT, Failure, Worker, serve_preview
from cagemap.tasks.match import run_match
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.match import MatchRequest

from refusals import refuses
from studio_boxes import landmarks, opened_pair, unwrapped_cube


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> tuple[PreviewCache, OpenModels]:
    folder = tmp_path_factory.mktemp("models")
    mesh = unwrapped_cube()
    write_mesh(folder / "a.obj", mesh.with_positions(mesh.positions * [1.0, 1.2, 1.4]))
    # Not the very same surface, which has one answer.
    write_mesh(folder / "b.obj", mesh.with_positions(mesh.positions * [1.0, 1.2, 1.4003] + [5.0, 0.0, 0.0]))
    write_image(folder / "t.png", np.full((8, 8, 3), [255, 0, 0], dtype=np.uint8))
    task = OpenModels(PairFiles(folder / "a.obj", folder / "b.obj", folder / "t.png", 300, folder))
    cache, _ = run_task(None, task, lambda _: None)
    return cache, task


def test_the_preview_maps_and_follows_landmarks(opened: tuple[PreviewCache, OpenModels]) -> None:
    cache, task = opened
    cache, first = run_task(cache, FindMap(task.pair_files, landmarks(cache, *range(8))), lambda _: None)
    assert isinstance(first, MapUpdate)
    looks = list[MapUpdate]()
    seven = FindMap(task.pair_files, landmarks(cache, *range(7)))
    cache, second = run_task(cache, seven, lambda _: None, looks.append)
    # An update is shown before its quality is known, with the trust of the map before.
    (look,) = looks
    assert look.map_state.unchecked
    np.testing.assert_array_equal(look.preview_map.triangle, second.preview_map.triangle)
    np.testing.assert_array_equal(look.preview_map.trust, first.preview_map.trust)
    assert set(second.map_state.strain) == {f"v{v}" for v in range(7)}
    assert second.skins[1] is None  # the source faces as the target does
    # The models are translates of each other: the map carries a point to the same point, five units to the right.
    target, source = cache.target, cache.source
    mirrors = target.mirror, source.mirror
    scene = Scene(target.shape, source.shape, mirrors, (second.skins[0], b""), second.preview_map)
    there = map_place(scene, "target", vertex_place(scene.target, 0))
    # Within two edges of the preview's level.
    np.testing.assert_allclose(np.array(there.position) - [5, 0, 0], scene.target.positions[0], atol=0.3)
    back = map_place(scene, "source", there)
    np.testing.assert_allclose(back.position, scene.target.positions[0], atol=0.3)


def test_an_image_that_a_source_lacks_is_named_on_the_page(tmp_path: Path) -> None:
    for name in ("a.obj", "b.obj"):
        write_mesh(tmp_path / name, unwrapped_cube())
    text = (tmp_path / "b.obj").read_text()
    (tmp_path / "b.obj").write_text("mtllib b.mtl\n" + text.replace("\nf ", "\nusemtl skin\nf ", 1))
    (tmp_path / "b.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    _, _, opened = opened_pair(tmp_path / "a.obj", tmp_path / "b.obj")
    (note,) = [note for note in opened.source.notes if "skin.png" in note]
    assert note.startswith("b.obj: material skin: 'skin.png' is not found")


def test_what_reading_warned_of_is_said_with_the_error_that_ends_it(tmp_path, monkeypatch):
    for name in ("a.obj", "b.obj"):
        write_mesh(tmp_path / name, unwrapped_cube())

    def refuse(*_: object) -> None:
        logging.getLogger("cagemap.files").warning("%s: no image", tmp_path / "skins" / "b.png")
        raise FormatError("b.png is empty")

    monkeypatch.setattr("cagemap.studio.compute.textured", refuse)
    monkeypatch.setattr("cagemap.studio.worker._lower_priority", lambda: None)  # it is this process that serves
    here, there = Pipe()
    serving = threading.Thread(target=serve_preview, args=(there,), daemon=True)
    serving.start()
    here.send(OpenModels(PairFiles(tmp_path / "a.obj", tmp_path / "b.obj", None, 300, tmp_path)))
    kind = ""
    while kind != RESULT:
        assert here.poll(60)
        kind, result = here.recv()
    here.close()
    serving.join(10)
    assert result == Failure("FormatError", "b.png is empty", (f"skins{os.sep}b.png: no image",))


@pytest.mark.slow
def test_a_bake_writes_the_map_of_the_page_if_a_match_would_find_the_same(opened, tmp_path, monkeypatch):
    cache, task = opened
    files, places = task.pair_files, landmarks(cache, *range(8))
    cache, shown = run_task(cache, FindMap(files, places), lambda _: None)
    _, updated = run_task(cache, FindMap(files, landmarks(cache, *range(7))), lambda _: None)
    assert updated.computed is None  # an update is not what a match from the start finds
    computed = pickle.loads(pickle.dumps(shown.computed))  # the bake has a process of its own
    pairs = tmp_path / "pairs.json"
    write_landmarks(pairs, to_landmarks(places, cache.target.control, cache.source.control))
    request = MatchRequest(files.target, files.source, tmp_path / "R", pairs, vertices=300)
    run_match(request, Stages())
    searched = read_result(tmp_path / "R").point_map
    monkeypatch.setattr("cagemap.tasks.match.match", lambda *_, **__: pytest.fail("searched again"))
    run_match(request, Stages(), computed)
    for name in ("triangle", "barycentric"):
        np.testing.assert_array_equal(getattr(read_result(tmp_path / "R").point_map, name), getattr(searched, name))
    for changed in ({"vertices": 1000}, {"landmarks": None}, {"trust_landmarks": True}, {"source": files.target}):
        refuses(pytest.fail.Exception, "searched again", run_match, replace(request, **changed), Stages(), computed)
    renamed = replace(computed.result.landmarks, names=tuple(f"{name} x" for name in computed.result.landmarks.names))
    with pytest.raises(pytest.fail.Exception, match="searched again"):  # its messages name the landmarks
        run_match(request, Stages(), replace(computed, result=replace(computed.result, landmarks=renamed)))


@pytest.mark.slow
def test_fbx_models_are_converted_once_to_files_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh, converted = unwrapped_cube(), list[Path]()

    def convert(path: Path) -> bytes:
        converted.append(path)
        return (path.parent / "made.glb").read_bytes()

    (tmp_path / "body.glb").write_bytes(b"another file of this name")
    for side, height in (("target", 1.2), ("source", 1.4)):
        (tmp_path / side).mkdir()
        write_mesh(tmp_path / side / "made.glb", mesh.with_positions(mesh.positions * [1.0, height, 1.0]))
        (tmp_path / side / "body.fbx").write_bytes(b"an FBX file")
    for module in ("files.gltf.document", "studio.models"):
        monkeypatch.setattr(f"cagemap.{module}.fbx_as_glb", convert, raising=False)
    target, source = given = [tmp_path / side / "body.fbx" for side in ("target", "source")]
    pair_files = PairFiles(target, source, None, 300, tmp_path)
    for _ in range(2):  # the files that were put there are used again
        converted.clear()
        cache, opened = run_task(None, OpenModels(pair_files), lambda _: None)
        assert (opened.target.path, opened.source.path) == (tmp_path / "body1.glb", tmp_path / "body2.glb")
        assert opened.source.path.read_bytes() == (source.parent / "made.glb").read_bytes()
        assert "body.fbx is converted: body2.glb is used in its place" in opened.source.notes
        heights = [float(np.ptp(side.control.positions[:, 1])) for side in (opened.target, opened.source)]
        assert heights[1] / heights[0] == pytest.approx(1.4 / 1.2)
    run_task(cache, FindMap(pair_files, landmarks(cache, *range(8))), lambda _: None)
    assert converted == given
    assert (tmp_path / "body.glb").read_bytes() == b"another file of this name"


@pytest.mark.slow
def test_without_landmarks_the_preview_has_answers_to_choose_from(opened, quick_fit):
    cache, task = opened
    with pytest.raises(ParameterError, match="answer 99"):
        run_task(cache, FindMap(task.pair_files, LandmarkList(), answer=99), lambda _: None)
    looks = list[MapUpdate]()
    cache, first = run_task(cache, FindMap(task.pair_files, LandmarkList()), lambda _: None, looks.append)
    # As the files stand, and the best of all rough fits; both are maps of every vertex, and said to be rough.
    assert [look.map_state.unchecked for look in looks] == [True, True]
    assert not first.map_state.unchecked
    assert {look.preview_map.triangle.shape for look in looks} == {first.preview_map.triangle.shape}
    # A box on a box: each half turn is an answer.
    assert len(first.map_state.answers) > 1
    assert first.map_state.confidence
    cache, second = run_task(cache, FindMap(task.pair_files, LandmarkList(), answer=1), lambda _: None)
    assert second.map_state.chosen_answer == 1
    assert not np.array_equal(first.preview_map.triangle, second.preview_map.triangle)
    # One landmark moves that answer, and taking it away gives it back.
    cache, third = run_task(cache, FindMap(task.pair_files, landmarks(cache, 0)), lambda _: None)
    assert set(third.map_state.strain) == {"v0"}
    cache, fourth = run_task(cache, FindMap(task.pair_files, LandmarkList()), lambda _: None)
    np.testing.assert_array_equal(fourth.preview_map.triangle, second.preview_map.triangle)


@pytest.mark.slow
def test_every_map_suggests_a_free_vertex_until_all_are_taken(opened, quick_fit):
    cache, task = opened
    for taken in ((), range(7), range(8)):
        cache, found = run_task(cache, FindMap(task.pair_files, landmarks(cache, *taken)), lambda _: None)
        if len(taken) < 8:
            assert found.map_state.suggestion not in (None, *taken)
    assert found.map_state.suggestion is None


def test_mirror_images_lie_across_the_plane(opened: tuple[PreviewCache, OpenModels]) -> None:
    cache, _ = opened
    shape = cache.target.shape
    scene = Scene(shape, cache.source.shape, (cache.target.mirror, cache.source.mirror), (b"", b""))
    corner = vertex_place(shape, 0)
    across = mirror_place(scene, "target", corner)
    assert across.corners != corner.corners
    assert mirror_place(scene, "target", across) == corner
    assert mirror_place(Scene(shape, shape, (None, None), (b"", b"")), "target", corner) is None


@pytest.mark.slow
def test_a_failing_task_is_a_named_failure_and_the_worker_lives_on(opened: tuple[PreviewCache, OpenModels]) -> None:
    _, task = opened
    stages: list[str] = []
    worker = Worker(stages.append, serve_preview)
    missing = worker.run(OpenModels(replace(task.pair_files, target=Path("/nowhere/a.obj"))))
    assert isinstance(missing, Failure)
    assert missing.kind == "MissingFileError"
    assert "a.obj" in missing.message
    answer = worker.run(task)
    assert not isinstance(answer, Failure)
    assert stages
    worker.kill()
    worker.run(task)  # it may fail with the process that was killed; the next task has one
    assert not isinstance(worker.run(task), Failure)
    worker.kill()


def test_a_task_that_is_not_wanted_ends_at_its_next_stage(opened, monkeypatch):
    """One that has ended already, or is named no more, disturbs no other."""
    _, task = opened
    unwanted, wanted = FindMap(task.pair_files, LandmarkList()), ShowBaked(task.pair_files, Path(), None, None, None)
    here, there = Pipe()
    worker = Worker(lambda stage: worker.cancel(unwanted), serve_preview)
    monkeypatch.setattr(worker, "_connect", lambda: here)
    worker._connection = here

    def work(
        cache: PreviewCache, task: object, progress: Callable[[str], None], _: object
    ) -> tuple[PreviewCache, object]:
        for stage in range(10_000 if isinstance(task, FindMap) else 3):  # the unwanted one has time to hear of it
            progress(str(stage))
            time.sleep(1e-3)
        return cache, type(task).__name__

    monkeypatch.setattr("cagemap.studio.compute.run_task", work)
    monkeypatch.setattr("cagemap.studio.worker._lower_priority", lambda: None)  # it is this process that serves
    serving = threading.Thread(target=serve_preview, args=(there,), daemon=True)
    serving.start()
    for _ in range(2):
        assert worker.run(unwanted) == Failure(CANCELLED_KIND, "the computation was cancelled")
        worker.cancel(unwanted)
        assert worker.run(wanted) == "ShowBaked"
    here.close()
    serving.join(10)
    assert not serving.is_alive()


def test_a_vertex_cannot_be_named_twice(opened: tuple[PreviewCache, OpenModels]) -> None:
    cache, task = opened
    one = landmarks(cache, 0).items[0]
    with pytest.raises(ValueError, match="one pair only"):
        run_task(cache, FindMap(task.pair_files, LandmarkList((one, replace(one, name="again")))), lambda _: None)


def test_answers_of_one_name_are_numbered() -> None:
    numbered = ("as filed", "turned", "as filed (2)", "as filed (3)")
    assert number_duplicates(["as filed", "turned", "as filed", "as filed"]) == numbered


@pytest.mark.slow
def test_a_process_that_lost_its_map_starts_from_the_chosen_answer(opened, quick_fit):
    cache, task = opened
    _, chosen = run_task(cache, FindMap(task.pair_files, LandmarkList(), answer=1), lambda _: None)
    again = FindMap(task.pair_files, LandmarkList(), chosen_answer=1)
    cache, restarted = run_task(None, again, lambda _: None)
    assert restarted.map_state.chosen_answer == 1
    np.testing.assert_array_equal(restarted.preview_map.triangle, chosen.preview_map.triangle)
    _, updated = run_task(None, replace(again, landmarks=landmarks(cache, 0)), lambda _: None)
    assert updated.map_state.chosen_answer == 1


@pytest.mark.slow
def test_a_match_from_the_start_uses_one_landmark_too_and_three_in_place_of_a_chosen_answer(opened, quick_fit):
    cache, task = opened
    again = FindMap(task.pair_files, landmarks(cache, 0), fresh=True)
    free, _ = run_task(cache, FindMap(task.pair_files, LandmarkList()), lambda _: None)
    assert run_task(free, again, lambda _: None)[1].map_state.from_start
    chosen, _ = run_task(free, FindMap(task.pair_files, LandmarkList(), answer=1), lambda _: None)
    kept = run_task(chosen, again, lambda _: None)[1].map_state
    assert (kept.chosen_answer, kept.from_start) == (1, False)
    three = replace(again, landmarks=landmarks(cache, 0, 3, 5))
    found = run_task(chosen, three, lambda _: None)[1].map_state
    assert (found.chosen_answer, found.from_start) == (0, True)
