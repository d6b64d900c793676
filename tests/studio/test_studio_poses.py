"""Models posed before any bake, and baked images in the view of a session."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from test_studio_skins import attributes_of

from cagemap.character.poses import pose_at
from cagemap.character.values import skinned_positions
from cagemap.errors import ParameterError
from cagemap.files.images.image import write_image
from cagemap.files.meshes.formats import write_mesh
from cagemap.mesh import ControlMesh
from cagemap.studio.compute import FindMap, PairFiles, ShowPosed, run_task
from cagemap.studio.finish import FinishOptions
from cagemap.studio.landmarks import LandmarkList
from cagemap.studio.session import Session
from cagemap.studio.state import Message, Output, View, image_uv_set

from example_character import bare_body, character, write_character
from refusals import refuses
from studio_boxes import add_landmarks, at_rest, click, until


@pytest.fixture(scope="module")
def body() -> ControlMesh:
    return bare_body(1)


@pytest.mark.slow
def test_the_target_moves_as_the_source_does(tmp_path: Path, body: ControlMesh) -> None:
    made = character(body)
    write_character(tmp_path / "C.glb", made)
    write_mesh(tmp_path / "B.glb", body)
    pair_files = PairFiles(tmp_path / "B.glb", tmp_path / "C.glb", None, 300, tmp_path, parts=(None, "object:body"))
    cache, found = run_task(None, FindMap(pair_files, LandmarkList()), lambda _: None)
    assert found.map_state.poses == tuple(f"nod, {time:.2g} s" for time in (0.25, 0.5, 0.75))

    def drawn(pose: str) -> list[np.ndarray]:
        task = ShowPosed(pair_files, pose, found.preview_map)
        _, skins = run_task(cache, task, lambda _: None)
        assert isinstance(skins, tuple)
        return [attributes_of(skin, "model")["POSITION"] for skin in skins]

    rest, nodding = drawn(""), drawn("nod, 0.5 s")
    for still, moved in zip(rest, nodding, strict=True):
        assert np.abs(still - moved).max() > 0.02
    assert cKDTree(nodding[0]).query(nodding[1])[0].max() < 2e-3  # one body, so that both are one picture
    wanted = skinned_positions(made.parts[0], made.rig, pose_at(made.rig, made.animations[0], 0.5))
    size = np.linalg.norm(np.ptp(wanted, axis=0)) / 2
    np.testing.assert_allclose(np.ptp(nodding[0], axis=0), np.ptp(wanted, axis=0) / size, atol=5e-3)
    with pytest.raises(ParameterError, match="Pose: expected a pose of the source"):
        run_task(cache, ShowPosed(pair_files, "wave, 1 s", found.preview_map), lambda _: None)
    refuses(ParameterError, "Pose: expected", run_task, None, ShowPosed(pair_files, "nod, 0.5 s", None), lambda _: None)


@pytest.mark.slow
def test_poses_after_a_cancelled_match_are_those_of_the_map_on_the_page(tmp_path, body, quick_fit):
    """Cancel kills the process, so that the next one has neither the map nor the rotation of the source."""
    turned = body.with_positions(body.positions @ np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]))
    write_character(tmp_path / "C.glb", character(body))
    write_mesh(tmp_path / "B.glb", turned)
    pair_files = PairFiles(tmp_path / "B.glb", tmp_path / "C.glb", None, 300, tmp_path, parts=(None, "object:body"))
    cache, found = run_task(None, FindMap(pair_files, LandmarkList()), lambda _: None)
    for pose in ("", "nod, 0.5 s"):
        task = ShowPosed(pair_files, pose, found.preview_map)
        kept, again = (run_task(cached, task, lambda _: None)[1] for cached in (cache, None))
        assert isinstance(kept, tuple)
        assert isinstance(again, tuple)
        for one, other in zip(kept, again, strict=True):
            attributes = attributes_of(one, "model")
            assert set(attributes) == set(attributes_of(other, "model"))
            for name, values in attributes.items():
                np.testing.assert_allclose(attributes_of(other, "model")[name], values, atol=1e-6)
    assert "_PLACE" in attributes_of(again[0], "model")


@pytest.mark.slow
def test_other_files_have_no_poses(tmp_path: Path, body: ControlMesh) -> None:
    for name in ("B.obj", "S.obj"):
        write_mesh(tmp_path / name, body)
    pair_files = PairFiles(tmp_path / "B.obj", tmp_path / "S.obj", None, 300, tmp_path)
    _, found = run_task(None, FindMap(pair_files, LandmarkList()), lambda _: None)
    assert found.map_state.poses == ()


def test_a_view_computes_nothing(opened: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    wanted: list[None] = []
    monkeypatch.setattr(opened._preview, "request", lambda *_: wanted.append(None))
    before = opened.scene.skins
    for view in (View(cages=True), View("colours"), View("checker", doubts=False), View()):
        opened.show(view)
    assert opened.scene.skins == before
    assert not wanted


@pytest.mark.slow
def test_a_baked_image_is_shown_and_the_map_after_it(opened: Session, boxes: Path) -> None:
    write_image(boxes / "b.png", np.full((8, 8, 3), 90, dtype=np.uint8))
    before = opened.scene.skins
    opened._preview.kill()  # a killed computation reads the models again
    baked(opened, boxes)
    until(lambda: opened.scene.skins[0] != before[0], opened)
    shown = opened.scene.skins[0]
    opened.turn_up("target")
    until(lambda: opened.state.files.ups[0] == "z" and at_rest(opened), opened)
    assert opened.state.view.mode == "baked"
    assert b"baked" in opened.scene.skins[0]
    assert opened.scene.skins[0] != shown
    revision = opened.state.map.revision
    add_landmarks(opened, 1)
    assert opened.state.view.mode == "texture"
    until(lambda: opened.state.map.revision > revision, opened)
    assert b"baked" not in opened.scene.skins[0]


def baked(session: Session, boxes: Path) -> Path:
    """An image as a bake leaves it, on the model."""
    image = boxes.resolve() / "b.png"
    with session._lock:
        session._change(outputs=())
        session._finish_inputs = session.state.map_inputs
        session._on_output(Output(image, "texture"))
        assert (session.state.view.mode, session.state.view.baked) == ("baked", image)  # while the report is written
        session._on_end(Message("note", "Bake: done"), False)
    assert (session.state.view.mode, session.state.view.baked) == ("baked", image)
    return image


def test_a_bake_is_shown_though_its_map_cannot_be_compared(opened, boxes, monkeypatch):
    monkeypatch.setattr("cagemap.studio.session.map_difference_notes", lambda *_: [][0])
    baked(opened, boxes)
    assert any("internal error, IndexError" in message.text for message in opened.state.messages)


def test_a_bake_of_an_earlier_map_is_not_shown_as_that_of_now(opened: Session, boxes: Path) -> None:
    shown: list[View] = []
    baked(opened, boxes)
    click(opened, "target", 2)
    assert opened.state.view.mode == "baked"  # half a landmark changes no map
    opened.accept()
    shown.append(opened.state.view)
    baked(opened, boxes)
    opened.match_again()
    shown.append(opened.state.view)
    baked(opened, boxes)
    opened.undo()
    shown.append(opened.state.view)
    assert [view.mode for view in shown] == ["texture"] * 3
    # Nor is one that ends after the landmarks have changed.
    with opened._lock:
        opened._finish_inputs = opened.state.map_inputs
        opened.redo()
        opened._on_end(Message("note", "Bake: done"), False)
    assert opened.state.view.mode == "texture"
    assert "before the last changes" in opened.state.messages[-1].text
    # Nor on other models, nor while the next one is made of other options.
    baked(opened, boxes)
    opened.finish(FinishOptions(option_values={("match", "vertices"): 300}))
    assert opened.state.view.mode == "texture"
    opened.cancel()
    until(lambda: opened.state.finish_job is None, opened)
    until(lambda: any("cancelled" in message.text for message in opened.state.messages), opened)
    baked(opened, boxes)
    opened.open(opened.state.files)
    assert opened.state.view.mode == "texture"
    until(lambda: opened.state.map.revision >= 1, opened)


@pytest.mark.slow
def test_what_was_baked_is_shown_where_there_is_any(opened: Session, boxes: Path) -> None:
    opened.change_view(mode="baked")
    assert opened.state.view.mode == "texture"
    assert "Press Bake" in opened.state.messages[-1].text
    before, image = opened.state.view, baked(opened, boxes)
    opened.show_baked_image(None)
    opened.change_view(mode="baked", cages=True)
    assert opened.state.view == replace(before, mode="baked", cages=True, baked=image)


@pytest.mark.slow
def test_what_a_bake_of_other_models_wrote_is_no_output_of_the_open_ones(opened: Session, boxes: Path) -> None:
    image = Output(boxes / "else_from_b.png", "texture")
    with opened._lock:
        models, *others = opened.state.map_inputs
        opened._finish_inputs = ((boxes / "else.obj", *models[1:]), *others)
        opened._on_output(image)
        assert opened.state.outputs == ()
        assert image.path.name in opened.state.messages[-1].text
        opened._finish_inputs = opened.state.map_inputs
        opened._on_output(image)
        assert opened.state.outputs == (image,)


def test_an_image_of_an_earlier_bake_is_drawn_and_downloaded_in_its_own_uv_set(opened, monkeypatch):
    drawn = list[tuple[Path, str | None]]()
    monkeypatch.setattr(opened._preview, "request", lambda _kind, image, _layout, uv_set: drawn.append((image, uv_set)))
    monkeypatch.setattr(opened._runner, "start", lambda _: None)
    images = {name: Path(f"{name}.png") for name in ("first", "second")}
    for name, uv_set in (("first", None), ("second", "UVMap2")):
        opened.finish(FinishOptions(option_values={("match", "target_uv_set"): uv_set}))
        opened._on_output(Output(images[name], name))
    opened._on_end(Message("note", "Bake: cancelled"), True)
    opened.show_baked_image(images["first"])
    assert drawn == [(images["first"], None), (images["second"], "UVMap2"), (images["first"], None)]
    assert [image_uv_set(opened.state, image) for image in images.values()] == [None, "UVMap2"]
    opened.show_baked_image(None)


def test_a_bake_shows_its_colours_rather_than_the_normals_before_them(
    opened: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opened._preview, "request", lambda *_: None)
    monkeypatch.setattr(opened._runner, "start", lambda _: None)
    outputs = [Output(Path(name), title) for name, title in (("n_normal.png", "normal map"), ("c.png", "texture"))]
    for looked_at in (False, True):
        opened.finish(FinishOptions())
        opened._on_output(outputs[0])
        assert opened.state.view.baked == outputs[0].path
        if looked_at:
            opened.show_baked_image(None)  # what the user has chosen meanwhile stays
        opened._on_output(outputs[1])
        assert opened.state.view.baked == (None if looked_at else outputs[1].path)
        opened._on_end(Message("note", "Bake: cancelled"), True)
    opened.show_baked_image(None)
