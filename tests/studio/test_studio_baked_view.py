"""Baked images in the view of a session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.files.images.image import write_image
from cagemap.studio.finish import FinishOptions
from cagemap.studio.session import Session
from cagemap.studio.state import Message, Output, View, image_uv_set

from studio_boxes import add_landmarks, at_rest, click, until


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
