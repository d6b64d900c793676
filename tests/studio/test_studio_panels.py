"""Panels and views of the studio's page without a page."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

from cagemap.studio.file_parts import NOTHING
from cagemap.studio.landmarks import History, Landmark, LandmarkList
from cagemap.studio.opening import default_files
from cagemap.studio.page.choices import NONE, Choices
from cagemap.studio.page.panels import FORMS, MOST_ANSWERS, SetupPanel, WorkPanel, with_ending
from cagemap.studio.page.texts import parts_text
from cagemap.studio.page.view import Marker, ModelView
from cagemap.studio.state import Files, MapState, Studio
from cagemap.studio.workspace import Workspace


def server() -> Any:
    """Something that has viser's fields, each of its own."""
    made = MagicMock()
    made.gui.add_text.side_effect = lambda label, value="", **_: MagicMock(value=value)
    made.gui.add_button.side_effect = lambda label, **_: MagicMock(label=label)
    made.gui.add_dropdown.side_effect = lambda label, options, **_: MagicMock(value=options[0], options=options)
    return made


def pair(folder: Path, target: str, source: str) -> Files:
    return default_files(folder, folder / target, folder / source, None)


def test_the_name_to_save_under_is_that_of_the_open_pair(tmp_path: Path) -> None:
    workspace = Workspace.of(tmp_path)
    panel = WorkPanel(server(), MagicMock(workspace=workspace), Choices(workspace))
    first = pair(workspace.folders[0], "cow.obj", "spot.obj")
    panel.refresh(Studio(files=first))
    assert panel._file.value == "spot__cow.json"
    panel._file.value = "mine.json"
    panel.refresh(Studio(files=first, saved=False))
    assert panel._file.value == "mine.json"  # typed, and not yet saved
    panel.refresh(Studio(files=pair(workspace.folders[0], "horse.obj", "zebra.obj")))
    assert panel._file.value == "zebra__horse.json"


def test_a_name_that_is_being_typed_is_left_as_it_is(tmp_path: Path) -> None:
    workspace = Workspace.of(tmp_path)
    session = MagicMock(workspace=workspace)
    panel: Any = WorkPanel(server(), session, Choices(workspace))

    def known(name: str) -> Studio:
        landmarks = LandmarkList((Landmark(1, name), Landmark(2, "eye")))
        return Studio(files=pair(tmp_path, "a.obj", "b.obj"), history=History(landmarks), selected=1)

    def type_(text: str) -> None:
        panel._name.value = text
        panel._rename(client=object())

    session.state = known("landmark 1")
    panel.refresh(session.state)
    type_("ey")
    type_("eye")
    type_("eye_")
    for late in ("landmark 1", "ey", "eye (2)"):  # what the session made of the letters before; eye is another's
        panel.refresh(known(late))
        assert panel._name.value == "eye_"
    panel.refresh(known("eye_"))
    panel.refresh(known("landmark 1"))  # undone
    assert panel._name.value == "landmark 1"


def test_a_new_source_brings_its_texture_or_none(tmp_path: Path) -> None:
    for name in ("zebra.obj", "zebra_skin.png", "horse.obj"):
        (tmp_path / name).touch()
    workspace = Workspace.of(tmp_path)
    session = MagicMock(workspace=workspace, state=Studio())
    panel = SetupPanel(server(), session, Choices(workspace), lambda: None)
    for source, texture in (("zebra.obj", "zebra_skin.png"), ("horse.obj", NONE)):
        panel._source.value = source
        panel._guess_texture(client=object())
        assert panel._texture.value == texture


def test_what_is_chosen_for_the_models_is_opened_and_shown(tmp_path: Path) -> None:
    workspace = Workspace.of(tmp_path)
    session = MagicMock(workspace=workspace, state=Studio())
    panel = SetupPanel(server(), session, Choices(workspace), lambda: None)
    panel._target.value, panel._source.value = "cow.obj", "scan.ply"
    panel._schemes[1].value, panel._ups[1].value = "none", "z"
    panel._open()
    files = session.open.call_args.args[0]
    assert (files.schemes, files.ups) == ((None, "none"), (None, "z"))
    shown = SetupPanel(server(), session, Choices(workspace), lambda: None)
    shown.refresh(Studio(files=files), None)
    assert [handle.value for handle in shown._ups] == ["as the file says", "z"]


def test_how_a_model_is_taken_is_not_said_of_the_next_one(tmp_path: Path) -> None:
    workspace = Workspace.of(tmp_path)
    panel = SetupPanel(server(), MagicMock(workspace=workspace, state=Studio()), Choices(workspace), lambda: None)
    files = pair(tmp_path, "scan.ply", "b.obj")
    panel.refresh(Studio(files=replace(files, schemes=("none", None), ups=("z", None))), None)
    panel._forget(1, SimpleNamespace(client=object()))
    panel._forget(0, SimpleNamespace(client=None))
    assert (panel._schemes[0].value, panel._ups[0].value) == ("none", "z")
    panel._ups[0].value = "y"  # chosen since
    panel._forget(0, SimpleNamespace(client=object()))
    assert (panel._schemes[0].value, panel._ups[0].value) == ("as the file says", "y")


def test_the_view_changes_by_what_a_person_pressed_alone(tmp_path: Path) -> None:
    workspace = Workspace.of(tmp_path)
    session = MagicMock(workspace=workspace, state=Studio())
    panel = SetupPanel(server(), session, Choices(workspace), lambda: None)
    panel._show("cages", SimpleNamespace(client=None, target=SimpleNamespace(value=True)))
    assert not session.show_as.called
    panel._show("cages", SimpleNamespace(client=object(), target=SimpleNamespace(value=True)))
    session.show_as.assert_called_once_with(cages=True)


def test_what_is_chosen_stays_chosen_where_it_is_not_listed(tmp_path: Path) -> None:
    deep = tmp_path / "a" / "b" / "c" / "cow.obj"
    choices = Choices(Workspace.of(tmp_path))
    handle = choices.dropdown(server().gui, "Target", (".obj",))
    choices.choose(handle, deep)
    (tmp_path / "new.obj").touch()
    choices.refresh()
    assert (handle.value, tuple(handle.options)) == ("a/b/c/cow.obj", (NONE, "new.obj", "a/b/c/cow.obj"))


def test_names_of_files_and_parts_are_shown_as_they_are() -> None:
    shape = SimpleNamespace(name="<i>.obj", positions=[0] * 5, parts=("a*b*", "<b>"))
    said = parts_text(SimpleNamespace(target=shape, source=shape, offers=(NOTHING, NOTHING)))
    assert "&lt;i&gt;.obj</b>, 5 vertices: a*b*, &lt;b&gt;" in said


def test_a_landmark_dropped_beside_the_model_returns(tmp_path: Path) -> None:
    session, nodes = MagicMock(), (SimpleNamespace(), SimpleNamespace())
    view = ModelView(server(), "target", session)
    view._shape = MagicMock(to_view=lambda point: 2 * point)
    view._markers = {1: (Marker(1, "1", (0.0, 0.5, 0.0), (0, 0, 0), 0.1, solid=True), *nodes)}
    client = SimpleNamespace(camera=SimpleNamespace(position=(0.0, 0.0, 3.0)))

    def drag(phase: str, place: object) -> None:
        session.place_under.return_value = place
        event: Any = SimpleNamespace(client=client, end_position=(0.0, 0.0, 0.0), phase=phase)
        asyncio.run(view._dragger(1)(event))

    drag("update", SimpleNamespace(position=(1.0, 0.0, 0.0)))
    assert [tuple(node.position) for node in nodes] == [(2.0, 0.0, 0.0)] * 2
    drag("update", None)
    assert [tuple(node.position) for node in nodes] == [(2.0, 0.0, 0.0)] * 2
    drag("end", None)
    assert [tuple(node.position) for node in nodes] == [(0.0, 0.5, 0.0)] * 2
    assert not session.move.called


def test_another_form_has_another_ending() -> None:
    name = "a.b.json"
    for ending in FORMS.values():
        name = with_ending(name, ending)
        assert name == f"a.b{ending}"
    assert with_ending("marks", ".pp") == "marks.pp"


def test_every_other_answer_is_a_button(tmp_path: Path) -> None:
    workspace = Workspace.of(tmp_path)
    session = MagicMock(workspace=workspace, state=Studio(map=MapState(answers=("as it is", "turned"), chosen=0)))
    panel = WorkPanel(server(), session, Choices(workspace))
    panel.refresh(session.state)
    assert [button.visible for button in panel._answers] == [True, True] + [False] * (MOST_ANSWERS - 2)
    assert [button.label for button in panel._answers[:2]] == ["1 \u00b7 as it is", "2 \u00b7 turned"]
    panel._choose_answer(0, None)
    assert not session.choose_answer.called
    panel._choose_answer(1, None)
    session.choose_answer.assert_called_once_with(1)
    panel.refresh(Studio(map=MapState(answers=("as it is",))))
    assert not any(button.visible for button in panel._answers)
