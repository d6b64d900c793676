"""The studio's landmark list, its history and its files, without a browser."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cagemap.errors import FormatError, ParameterError
from cagemap.files.result.folder import write_result
from cagemap.files.result.manifest import stated_inputs
from cagemap.studio import landmarks as edit
from cagemap.studio.autosave import autosave_path, read_autosave, write_autosave
from cagemap.studio.downloads import textured_model_name
from cagemap.studio.landmarks import History, LandmarkList, Place
from cagemap.studio.opening import command_line_files, default_files
from cagemap.studio.state import (
    MapState,
    Output,
    StudioState,
    View,
    add_message,
    baked_view,
    layout_mesh,
    update_view,
)
from cagemap.studio.workspace import Workspace
from cagemap.tasks.job_file import note_match
from cagemap.tasks.requests.match import MatchRequest

from example_result import identity_result
from refusals import refuses


def place(x: float) -> Place:
    return Place((x, 0.0, 0.0), (0, 1, 2), (0.5, 0.25, 0.25))


def pair(landmarks: LandmarkList, x: float) -> LandmarkList:
    return edit.add_place(edit.add_place(landmarks, "target", place(x)), "source", place(-x))


def test_the_view_shows_what_was_baked_in_the_layout_that_it_lies_in() -> None:
    names = ("a.png", "tiles.1001.png", "tiles.1012.png", "wrapped.png", "RESULT", "a_unwrapped.mtl", "a_unwrapped.obj")
    outputs = tuple(Output(Path(name), "wrap" if name == "wrapped.png" else "texture") for name in names)
    state = StudioState(outputs=outputs)
    assert state.baked_images == (Path("a.png"), Path("tiles.<UDIM>.png"))
    shown = baked_view(View(), Path("a.png"))
    assert (shown.mode, shown.baked) == ("baked", Path("a.png"))
    assert layout_mesh(state, shown.baked) == Path("a_unwrapped.obj")
    assert baked_view(shown, None) == View()


def test_a_model_is_shown_with_an_image_of_colours_where_there_is_one() -> None:
    def state(*outputs: tuple[str, str]) -> StudioState:
        files = default_files(Path("a.obj"), Path("b.obj"), None)
        return StudioState(files=files, outputs=tuple(Output(Path(name), title) for name, title in outputs))

    others = (
        ("a_from_b_normals.png", "normal map"),
        ("a_from_b_ao.png", "detail"),
        ("a_from_b_vector-displacement.exr", "detail"),
        ("a_from_b_skin_roughness.png", "texture"),
    )
    for name, title in (
        ("a_from_b_colors.png", "detail"),
        ("a_from_b_texture.png", "detail"),
        ("a_from_b_material_colors.png", "material colours"),
        ("a_from_b_skin.png", "texture"),
        ("a_from_b_skin_color.png", "texture"),
    ):
        found = state(*others, (name, title))
        assert update_view(found, mode="baked").baked == Path(name)
        assert textured_model_name(found) == f"{Path(name).stem}.glb"
    assert update_view(state(*others), mode="baked").baked == Path(others[0][0])
    assert textured_model_name(state(*others)) is None


def test_two_clicks_make_a_landmark_and_a_third_begins_the_next() -> None:
    corrected = edit.add_place(LandmarkList(), "target", place(9.0))  # the next click on the same model counts
    one = pair(corrected, 1.0)
    assert [(item.number, item.target, item.source) for item in one.items] == [(1, place(1.0), place(-1.0))]
    two = edit.add_place(one, "source", place(5.0))
    assert (two.open_landmark.number, two.open_landmark.source, two.open_landmark.target) == (2, place(5.0), None)


def test_numbers_stay_when_others_go_and_names_stay_unique() -> None:
    landmarks = pair(pair(pair(LandmarkList(), 1.0), 2.0), 3.0)
    left = edit.remove(landmarks, 2)
    assert [item.number for item in left.items] == [1, 3]
    assert pair(left, 4.0).items[-1].number == 4
    landmarks = edit.rename(edit.rename(edit.remove(landmarks, 3), 1, "nose"), 2, "nose")
    assert [item.name for item in landmarks.items] == ["nose", "nose (2)"]
    assert edit.rename(landmarks, 1, "  ") == landmarks


@pytest.mark.parametrize(
    ("name", "across"),
    [("ear_tip_L", "ear_tip_R"), ("ear.R", "ear.L"), ("left_hand", "right_hand"), ("hip", "hip_mirrored")],
)
def test_a_mirror_name_is_the_other_sides(name: str, across: str) -> None:
    assert edit.mirror_name(name) == across


def test_mirror_adds_the_counterpart_or_nothing() -> None:
    landmarks = edit.rename(pair(LandmarkList(), 1.0), 1, "ear_L")
    both = edit.mirror(landmarks, 1, lambda _, where: place(10 + where.position[0]))
    assert [item.name for item in both.items] == ["ear_L", "ear_R"]
    assert (both.items[1].target, both.items[1].source) == (place(11.0), place(9.0))
    assert edit.mirror(landmarks, 1, lambda side, where: None if side == "source" else where) == landmarks


steps = st.lists(st.sampled_from(["place", "remove", "rename", "undo", "redo"]), max_size=30)


@pytest.mark.slow
@given(steps)
def test_undo_and_redo_walk_the_same_way_back_and_forth(todo: list[str]) -> None:
    history, x = History(), 0.0
    for step in todo:
        x += 1.0
        present = history.present
        if step == "place":
            history = history.advance(edit.add_place(present, "target" if len(present) % 2 else "source", place(x)))
        elif step == "remove" and len(present):
            history = history.advance(edit.remove(present, present.items[0].number))
        elif step == "rename" and len(present):
            history = history.rename_landmark(present.items[-1].number, f"name {x}")
        elif step == "undo":
            history = history.undo()
        elif step == "redo":
            history = history.redo()
    forward = [history.present]
    while history.past:
        history = history.undo()
        forward.append(history.present)
    assert history.present == LandmarkList()
    for expected in reversed(forward[:-1]):
        history = history.redo()
        assert history.present == expected


def test_a_name_typed_letter_by_letter_is_one_step() -> None:
    history = History().advance(pair(LandmarkList(), 1.0)).advance(pair(pair(LandmarkList(), 1.0), 2.0))
    before = history
    for typed in ("e", "ey", "eye"):
        history = history.rename_landmark(1, typed)
    assert history.undo().present == before.present
    other = history.rename_landmark(2, "nose")
    assert other.undo().present == history.present
    assert other.rename_landmark(1, "ear").undo().present == other.present


def test_what_is_known_of_a_landmark_goes_with_its_name() -> None:
    before = pair(pair(LandmarkList(), 1.0), 2.0)
    first, second = (item.name for item in before.items)
    known = MapState(strain={first: 0.1, second: 0.2}, contradictions={second: "far"})
    named = edit.rename(edit.rename(before, 1, "nose"), 2, first)
    assert named.constraints == before.constraints
    assert known.rename_landmarks(before, named) == MapState(
        strain={"nose": 0.1, first: 0.2}, contradictions={first: "far"}
    )
    other = edit.rename(edit.move(before, 1, "target", place(3.0)), 1, "nose")
    assert known.rename_landmarks(before, other) == known  # another place, of which nothing is known


def test_a_new_step_forgets_what_was_undone() -> None:
    history = History().advance(pair(LandmarkList(), 1.0)).undo().advance(pair(LandmarkList(), 2.0))
    assert not history.future
    assert history.advance(history.present) is history


def test_an_autosave_keeps_everything_and_is_checked(tmp_path: Path) -> None:
    landmarks = edit.add_place(pair(LandmarkList(), 1.0), "target", Place((0.1, 0.2, 0.3), (7, 7, 7), (1.0, 0.0, 0.0)))
    file = autosave_path(tmp_path / "a.json")
    write_autosave(file, landmarks)
    assert read_autosave(file, (9, 9)) == landmarks
    write_autosave(file, LandmarkList())
    assert read_autosave(file, (9, 9)) == LandmarkList()
    write_autosave(file, landmarks)
    whole = file.read_text()
    file.write_text(whole.replace("landmark 1", r"\ud800"))  # half a character, which no page can show
    assert read_autosave(file, (9, 9)).items[0].name == "?"
    for k, damaged in enumerate(("{", "[]", json.dumps({"format": "other"}), whole[:-20], whole.replace("7", "9"))):
        file.write_text(damaged)
        refuses(FormatError, "autosave", read_autosave, file, (9, 9))
        # Out of the way of the next one, not lost.
        assert not file.exists()
        assert file.with_name(f"{file.name}.{k + 1}").read_text() == damaged


def test_a_result_names_its_models(tmp_path: Path) -> None:
    for name in ("cow.obj", "spot.obj", "l.json"):
        (tmp_path / name).write_text(name)
    result = tmp_path / "RESULT"
    given = {"target": "cow.obj", "source": "spot.obj", "landmarks": "l.json"}
    inputs = stated_inputs({name: tmp_path / file for name, file in given.items()}, result)
    refuses(FormatError, "result folder", command_line_files, None, None, None, None, result)
    write_result(result, replace(identity_result(1), provenance={"inputs": inputs, "parameters": {"level": 1}}))
    note_match(MatchRequest(tmp_path / "cow.obj", tmp_path / "spot.obj", result, tmp_path / "l.json", level=1))
    manifest = json.loads((result / "manifest.json").read_text())
    manifest["source"]["scheme"] = {"name": "bilinear"}
    (result / "manifest.json").write_text(json.dumps(manifest))
    files = command_line_files(None, None, None, None, result)
    names = (files.target, files.source, files.landmarks, files.result)
    assert names == tuple(tmp_path / name for name in ("cow.obj", "spot.obj", "l.json", "RESULT"))
    assert files.schemes == ("catmull-clark", "bilinear")
    asked = command_line_files(None, None, None, None, result, (None, "none"))
    assert asked.schemes == ("catmull-clark", "none")
    for entry, words in (({"inputs": [1]}, "inputs"), ({"format_version": 99}, "format version 99")):
        (result / "manifest.json").write_text(json.dumps(manifest | entry))
        refuses(FormatError, words, command_line_files, None, None, None, None, result)
    (result / "manifest.json").write_text(json.dumps(manifest))
    (tmp_path / "cow.obj").write_text("edited")
    refuses(ParameterError, "unchanged", command_line_files, None, None, None, None, result)


def test_files_are_named_as_a_pair_or_not_at_all(tmp_path: Path) -> None:
    assert command_line_files(None, None, None, None, None) is None
    refuses(ParameterError, "one of them", command_line_files, tmp_path / "a.obj", None, None, None, None)
    refuses(ParameterError, "beside", command_line_files, None, None, tmp_path / "a.json", None, None)


def test_links_at_default_names_add_no_folder_and_are_refused(tmp_path: Path) -> None:
    models = tmp_path / "models"
    models.mkdir()
    target, source = models / "a.obj", models / "b.obj"
    for name in ("b__a.json", "b__a_RESULT"):
        link = models / name
        for end, words in (("../private/secret", "outside"), (name, "name of a file")):  # the second one is a loop
            link.symlink_to(end)
            files = command_line_files(target, source, None, None, None)
            assert files is not None
            assert {files.landmarks.parent, files.result.parent} == {models}
            refuses(ParameterError, words, Workspace.of(models).resolve_paths, files)
            link.unlink()


def test_messages_do_not_pile_up() -> None:
    messages = add_message((), "note", "again")
    for number in range(200):
        messages = add_message(add_message(messages, "note", f"{number}"), "note", "again")
    assert len(messages) == 100  # what a bake of many outputs says of each stays
    assert sum(message.text == "again" for message in messages) == 1
