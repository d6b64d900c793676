"""What a page is told and what it may ask for, without a page."""

import json
import re
import time
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from cagemap.studio.compute import FindMap, OpenModels, run_task
from cagemap.studio.downloads import textured_model, textured_model_name
from cagemap.studio.finish import FinishOptions
from cagemap.studio.finish_layout import OMITTED_OPTIONS, sections
from cagemap.studio.landmarks import History, Landmark, LandmarkList, Proposal
from cagemap.studio.opening import default_files
from cagemap.studio.page.actions import Actions
from cagemap.studio.page.app import PageRequest, StudioApp
from cagemap.studio.page.form import form_fields, read_form
from cagemap.studio.page.shown import page_state
from cagemap.studio.page.words import STAGES, bake_hint, confidence_text, status_entries, verdict
from cagemap.studio.places import vertex_place
from cagemap.studio.session import Session
from cagemap.studio.state import MapState, Message, Output, RunningJob, StudioState
from cagemap.studio.workspace import Workspace
from cagemap.tasks.requests.catalogue import all_options

from locations import FIXTURES
from studio_boxes import click, session_of, until

# Words that only a researcher knows.
FOREIGN = ("hypothes", "projection", "coarse fit", "operator", "basis", "eigen", "energy", "solver")


def sent(session: Any, **message: Any) -> None:
    Actions(session).handle(json.dumps(message))


@pytest.mark.slow
def test_every_stage_of_a_match_is_said_in_words_of_the_page(opened: Session) -> None:
    stages: list[str] = []
    opening = opened._preview.pair_files
    cache, _ = run_task(None, OpenModels(opening), stages.append)
    shapes = cache.target.shape, cache.source.shape
    pairs = [(0, 0), (2, 2), (5, 5), (6, 1)]
    items = tuple(
        Landmark(k, f"l{k}", *(vertex_place(shape, one) for shape, one in zip(shapes, pair, strict=True)))
        for k, pair in enumerate(pairs, 1)
    )
    for count, fresh in ((0, True), (1, False), (4, True)):
        cache, _ = run_task(cache, FindMap(opening, LandmarkList(items[:count]), fresh), stages.append)
    assert len(set(stages)) > 5
    for stage in stages:
        said = status_entries(StudioState(preview_job=RunningJob("Matching", stage)), None)
        assert said["text"] != f"Matching: {stage}", f"{stage}: no words for it in page/words.py"
        assert said["fraction"] is not None
    assert not [word for _, words, _ in STAGES for word in FOREIGN if word in words]


def test_the_status_says_what_is_asked_of_the_user() -> None:
    files = default_files(Path("a.obj"), Path("b.obj"), None)
    landmark = LandmarkList((Landmark(1, "nose"),))
    ready = StudioState(files=files, map=MapState(revision=1))
    wrong = Message("error", "a.obj, line 4: expected a number. Correct it.")
    for state, kind, words in (
        (StudioState(), "ready", "Open two models"),
        (ready, "ready", "Map found."),
        (replace(ready, history=History(landmark)), "ask", "the same place on the other model"),
        (replace(ready, messages=(wrong,)), "error", "line 4"),
        (replace(ready, finish_job=RunningJob("finish 2/3", "texture: bake", 0.4)), "busy", "step 2/3"),
    ):
        said = status_entries(state, None)
        assert (said["kind"], words in said["text"]) == (kind, True), said
    assert said["fraction"] == 0.4
    assert said["cancel"]


def test_every_stage_of_a_bake_is_said_in_words_of_the_page() -> None:
    tasks = resources.files("cagemap.tasks")
    modules = ("match", "transfer", "bake_tiles", "detail_bakes", "carry_images", "wrap", "report")
    sources = "".join((tasks / f"{name}.py").read_text(encoding="utf-8") for name in modules)
    stages = {"bake", *re.findall(r'stages\(f?"([^"{ ][^"{]*)', sources)}
    assert len(stages) > 10
    for stage in stages:
        said = status_entries(StudioState(finish_job=RunningJob("finish 1/3", f"texture: {stage}", 0.1)), None)["text"]
        assert said.startswith("Baking, step 1/3, texture: ")
        assert not said.endswith(f": {stage}"), f"{stage}: no words for it in page/words.py"


def test_a_computation_says_how_long_it_has_run() -> None:
    job = RunningJob("Matching", "elastic alignment", begun=time.monotonic() - 40)
    assert 40 <= status_entries(StudioState(preview_job=job), None)["seconds"] < 50
    assert "seconds" not in status_entries(StudioState(), None)


def test_an_error_leaves_the_status_after_the_next_action(opened: Session) -> None:
    for _ in range(2):
        sent(opened, do="open")
        sent(opened, do="list")  # which the page asks by itself
        assert "expected a target and a source" in status_entries(opened.state, opened.scene)["text"]
        sent(opened, do="open")  # the same once more
        assert status_entries(opened.state, opened.scene)["kind"] == "error"
        sent(opened, do="select", number=None)
        assert status_entries(opened.state, opened.scene)["kind"] != "error"
    assert opened.state.messages[-1].kind == "error"  # in the list of messages it stays


def test_how_sure_a_map_is_is_said_in_words() -> None:
    scene: Any = MagicMock()
    scene.preview_map.trust = np.array([1.0, 0.2, 1.0, 1.0])
    scene.target.surface.vertex_areas = np.array([0.3, 0.1, 0.3, 0.3])
    assert verdict(StudioState(), scene) == ""
    known = MapState(revision=1, confidence="sure: the target is aligned as filed; no other alignment fits")
    assert verdict(StudioState(map=known), scene) == "Alignment sure, 10 % stretched or folded"
    poor = replace(known, poor="10 % of the target is folded over")
    assert verdict(StudioState(map=poor), scene) == "Poor map: 10 % of the target is folded over"
    doubt = replace(known, confidence="two answers: as filed (`answer=1`). A landmark at target vertex 12 decides")
    assert verdict(StudioState(map=doubt), scene).startswith("Two answers")
    placed = doubt.confidence.replace("12", "12 at (1, -2.5, 3)")
    assert confidence_text(placed) == confidence_text(doubt.confidence)
    look = replace(known, confidence="look at it: as filed, but it jumps between parts that only touch")
    assert verdict(StudioState(map=look), scene).startswith("Look at it")
    assert "`" not in confidence_text(doubt.confidence)
    assert "Next landmark" in confidence_text(doubt.confidence)
    folds = "0.5 % of the target's area is folded over, worst at (0, 3.523, -4.1) of the target's file"
    assert confidence_text(folds) == "0.5 % of the target's area is folded over"  # it is drawn red
    assert confidence_text(folds.replace("worst", "most")) == confidence_text(folds)
    assert "contradicts" in verdict(StudioState(map=replace(known, contradictions={"nose": "far off"})), scene)
    assert "Not yet checked" in verdict(StudioState(map=MapState(unchecked=True)), scene)


@pytest.mark.slow
def test_a_bake_says_beforehand_that_it_matches_again_and_how_long_the_map_took(opened: Session) -> None:
    hint = page_state(opened.state, opened.scene, opened.workspace, {})["bake_hint"]
    assert f"takes {opened.state.map.first_seconds:.0f} s" in hint
    assert opened.state.map.first_seconds > 0
    opened.match_again()
    until(lambda: opened.state.map.revision > 1, opened)
    assert page_state(opened.state, opened.scene, opened.workspace, {})["bake_hint"] == hint
    assert page_state(StudioState(), None, opened.workspace, {})["bake_hint"] == ""
    for from_start, words in ((True, "The map shown is baked."), (False, "A bake computes the map from the start")):
        state = replace(opened.state, map=replace(opened.state.map, from_start=from_start))
        assert bake_hint(state, opened.scene).startswith(words)
    state = replace(opened.state, map=MapState(), preview_job=RunningJob("Matching"))
    assert bake_hint(state, opened.scene) == "A bake uses the map that is being computed."


def test_every_control_of_the_page_is_used_in_a_browser() -> None:
    page = (resources.files("cagemap.studio.page") / "index.html").read_text(encoding="utf-8")
    controls = re.findall(r'<(?:button|input|select) [^>]*?(?:id|name)="([\w-]+)"', page)
    tests = "".join(path.read_text(encoding="utf-8") for path in Path(__file__).parent.glob("*.py"))
    tests += (FIXTURES / "browser_page.py").read_text(encoding="utf-8")
    assert len(controls) > 40
    assert [name for name in controls if not re.search(rf"[\"'=]{name}[\"'\]]", tests)] == []


def test_the_state_of_a_page_names_all_that_is_drawn(opened: Session) -> None:
    click(opened, "target", 2)
    state = page_state(opened.state, opened.scene, opened.workspace, {})
    json.dumps(state)
    (row,) = state["landmarks"]
    assert (row["complete"], row["proposed"], state["proposal"]) == (False, "source", True)
    place = opened.state.history.present.open_landmark.target
    np.testing.assert_allclose(row["target"][:3], opened.scene.target.to_view(np.array(place.position)), atol=1e-5)
    assert isinstance(opened.state.proposal, Proposal)
    assert state["models"]["target"]["name"] == "a.obj"
    assert page_state(StudioState(), None, opened.workspace, {})["models"] is None


def test_names_of_what_is_drawn_change_with_it_alone(opened: Session) -> None:
    app = StudioApp.__new__(StudioApp)
    app.__dict__.update(session=opened, _drawings={}, _key_count=iter(range(1, 99)), _drawings_lock=MagicMock())
    first = app._drawing_keys(opened.state, opened.scene)
    again = app._drawing_keys(opened.state, opened.scene)
    assert again == first
    assert app._draw(first["target/skin"]) == opened.scene.skins[0]
    assert app._draw(first["target/cage"]).startswith(b"glTF")
    assert app._draw(first["source/curves"]).startswith(b"glTF")
    other = app._drawing_keys(opened.state, replace(opened.scene, skins=(b"new", opened.scene.skins[1])))
    assert {name for name in first if other[name] != first[name]} == {"target/skin"}
    assert app._draw(first["target/skin"]) is None


def test_messages_of_a_page_reach_the_session() -> None:
    session = MagicMock(workspace=Workspace.of(Path()))
    ray = {"side": "source", "origin": [0, 0, 3], "direction": [0, 0, -1]}
    sent(session, do="click", **ray)
    assert session.click.call_args.args[0] == "source"
    sent(session, do="move", number=2, **ray)
    assert session.move.call_args.args[:2] == (2, "source")
    sent(session, do="view", fields={"cages": True, "mode": "checker"})
    session.change_view.assert_called_once_with(cages=True, mode="checker")
    for name in ("undo", "redo", "accept", "cancel"):
        sent(session, do=name)
        assert getattr(session, name).called


@pytest.mark.parametrize(
    "message",
    [
        "{",
        "[]",
        '{"do": "nothing"}',
        '{"do": "click"}',
        '{"do": "click", "side": "left", "origin": [0, 0, 3], "direction": [0, 0, 1]}',
        '{"do": "click", "side": "target", "origin": [0, 0], "direction": [0, 0, 1]}',
        '{"do": "click", "side": "target", "origin": [0, 0, NaN], "direction": [0, 0, 1]}',
        '{"do": "bake", "options": {"match.color": 1}}',
        b"no head",
    ],
)
def test_what_no_page_of_ours_sends_is_refused_in_words(opened: Session, message: str | bytes) -> None:
    before = opened.state.history
    Actions(opened).handle(message)
    assert opened.state.history == before
    assert "Reload" in opened.state.messages[-1].text
    assert "internal error" not in opened.state.messages[-1].text


def test_a_dropped_model_is_opened_in_place_of_the_other_one(opened: Session, boxes: Path) -> None:
    begun: list[Any] = []
    session = MagicMock(wraps=opened, workspace=opened.workspace, requested_files=opened.state.files)
    session.open.side_effect = begun.append
    content = (boxes / "a.obj").read_bytes()
    for role in ("target", "source"):
        Actions(session).handle(json.dumps({"name": "c.obj", "role": role}).encode() + b"\n" + content)
        assert getattr(begun[-1], role).name.startswith("c")
    assert begun[0].texture is not None
    assert begun[1].texture is None  # that of another source
    for path in boxes.glob("c*.obj"):
        path.unlink()


def test_another_image_of_the_open_models_keeps_their_landmarks(opened: Session, boxes: Path) -> None:
    begun: list[Any] = []
    own = {"landmarks": boxes / "own.json", "result": boxes / "own", "schemes": ("bilinear", None), "ups": ("z", None)}
    files = replace(opened.state.files, **own)
    session = MagicMock(wraps=opened, workspace=opened.workspace, requested_files=files)
    session.open.side_effect = begun.append
    image = json.dumps({"name": "other.png", "role": "target"}).encode() + b"\n" + (boxes / "b.png").read_bytes()
    Actions(session).handle(image)
    assert begun.pop() == replace(files, texture=boxes / "other.png")
    names = {"target": "a.obj", "source": "b.obj", "texture": ""}
    sent(session, do="open", **names, schemes=["none", ""])
    assert begun.pop() == replace(files, texture=None, schemes=("none", None))
    sent(session, do="open", **names | {"source": "a.obj"}, schemes=["", ""])
    assert begun.pop().landmarks.name == "a__a.json"
    (boxes / "other.png").unlink()


def test_a_model_that_stays_is_opened_as_before(opened: Session, boxes: Path) -> None:
    begun: list[Any] = []
    own = {"schemes": ("bilinear", "none"), "ups": ("z", "y"), "parts": ("eye", "object:body")}
    files = replace(opened.state.files, **own)
    session = MagicMock(wraps=opened, workspace=opened.workspace, requested_files=files)
    session.open.side_effect = begun.append
    (boxes / "c.obj").write_bytes((boxes / "a.obj").read_bytes())
    for side, number in (("target", 0), ("source", 1)):
        head = json.dumps({"name": "c.obj", "role": side}).encode()
        Actions(session).handle(head + b"\n" + (boxes / "c.obj").read_bytes())
        names = {"target": "a.obj", "source": "b.obj", "texture": ""} | {side: "c.obj"}
        sent(session, do="open", **names, schemes=list(own["schemes"]))
        for _ in range(2):
            dropped = begun.pop()
            for name in ("ups", "parts"):
                expected = [*own[name]]
                expected[number] = None
                assert getattr(dropped, name) == tuple(expected), (side, name)
        schemes = ["bilinear", "none"]
        schemes[number] = None
        assert dropped.schemes == tuple(schemes)
        assert dropped.result.name.endswith("_RESULT")
    (boxes / "c.obj").unlink()


def test_models_dropped_one_after_the_other_are_opened_together(tmp_path: Path, boxes: Path) -> None:
    begun: list[Any] = []
    session = MagicMock(wraps=session_of(tmp_path))
    session.workspace, session.requested_files = Workspace.of(tmp_path), None
    session.open.side_effect = begun.append
    actions = Actions(session)
    for name, role in (("a.mtl", "target"), ("b.png", "source"), ("a.obj", "target"), ("b.obj", "source")):
        content = b"newmtl a" if name == "a.mtl" else (boxes / name).read_bytes()
        assert not begun
        actions.handle(json.dumps({"name": name, "role": role}).encode() + b"\n" + content)
    assert [path.name for path in (begun[0].target, begun[0].source, begun[0].texture)] == ["a.obj", "b.obj", "b.png"]
    session.load.assert_not_called()
    said = [call.args[0] for call in session.note.call_args_list]
    assert said == [
        "b.png was added. Drop the target on the left half and the source on the right half.",
        "a.obj was added. Drop the source on the right half.",
    ]


def test_the_form_has_every_option_that_the_page_shows() -> None:
    options = all_options()
    shown = form_fields(options, 6000)["form"]
    rows = [*shown["first"], *(line for fold in shown["folds"] for line in fold["fields"])]
    keys = [line["key"] for line in rows]
    assert len(keys) == len(set(keys))
    wanted = {".".join(field.key) for fold in sections(options) for field in fold.fields}
    assert wanted <= set(keys)
    assert not {".".join(key) for key in OMITTED_OPTIONS} & set(keys)
    json.dumps(shown)
    assert all(line["hint"] for line in rows)
    assert next(line for line in rows if line["key"] == "match.vertices")["value"] == 6000
    hints = [form_fields(options, count)["form"]["first"][2]["hint"] for count in (6000, 300_000)]
    assert ["such as 200000" in hint for hint in hints] == [True, False]
    for line in rows:
        if line["kind"] in ("choice", "several"):
            assert line["choices"], line
        elif line["kind"] == "number":
            option = options[tuple(line["key"].split("."))]
            assert (line["least"], line["most"]) == (option.least, option.most)
        assert ("suffixes" in line) == ("file" in line["kind"]), line


def test_values_of_the_form_are_those_of_the_command_line() -> None:
    options = all_options()
    assert read_form(options, {"match.vertices": ""}) == read_form(options, {}) == FinishOptions()
    sent_values = {
        "texture": False,
        "maps": "roughness=r.png, n.png",
        "match.vertices": "3000",
        "transfer.size": "512",
        "transfer.normal_map": "n.png",
        "transfer.bake": ["normal"],
        "match.level": "3",
        "match.trust_landmarks": True,
    }
    asked = read_form(options, sent_values)
    assert asked.maps == (("roughness", Path("r.png")), ("", Path("n.png")))
    assert asked.option_values[("transfer", "normal_map")] == Path("n.png")
    assert asked.option_values[("match", "vertices")] == 3000
    assert asked.option_values[("transfer", "bake")] == ("normal",)
    assert asked.option_values[("match", "trust_landmarks")] is True
    with pytest.raises(Exception, match="Level: expected a whole number or nothing, got 'many'"):
        read_form(options, {"match.level": "many"})


@pytest.mark.slow
def test_the_target_with_its_baked_image_is_one_file(opened: Session, boxes: Path) -> None:
    import pygltflib

    assert textured_model_name(opened.state) is None
    state = replace(opened.state, outputs=(Output(boxes / "b.png", "texture"),))
    assert textured_model_name(state) == "b.glb"
    document = pygltflib.GLTF2.load_from_bytes(textured_model(state, opened.scene))
    assert len(document.images) == len(document.materials) == len(document.meshes) == 1
    assert document.materials[0].pbrMetallicRoughness.baseColorTexture.index == 0


@pytest.mark.slow
def test_a_studio_is_served_and_ends(boxes: Path) -> None:
    app = StudioApp(PageRequest(None, all_options(), (boxes,), port=0, open_browser=False))
    try:
        assert app.address.startswith("http://127.0.0.1:")
        first, second = map(json.loads, app._first_messages())
        assert {"fixed", "listing", "form"} <= set(first)
        assert second["status"]["text"].startswith("Open two models")
    finally:
        app.close()


def test_without_models_or_a_map_the_status_says_what_to_press(opened: Session) -> None:
    files = default_files(Path("a.obj"), Path("b.obj"), None)
    assert status_entries(StudioState(files=files), None)["text"] == "These models are not open. Press Open…"
    without_map = replace(opened.scene, preview_map=None)
    assert status_entries(StudioState(files=files), without_map)["text"] == "No map yet. Press Match again."


def test_landmarks_and_result_of_a_pair_are_beside_its_target(tmp_path: Path) -> None:
    session = MagicMock(workspace=Workspace.of(tmp_path), state=StudioState())
    for name in ("anna", "bob"):
        sent(session, do="open", target=f"{name}/body.obj", source="base.obj", schemes=["", ""])
    files = [call.args[0] for call in session.open.call_args_list]
    folders = [tmp_path.resolve() / name for name in ("anna", "bob")]
    assert [one.landmarks for one in files] == [folder / "base__body.json" for folder in folders]
    assert [one.result for one in files] == [folder / "base__body_RESULT" for folder in folders]


def test_after_an_error_a_probe_says_what_is_there(opened: Session) -> None:
    sent(opened, do="open")
    assert status_entries(opened.state, opened.scene)["kind"] == "error"
    sent(opened, do="probe", side="target", origin=[9, 9, 9], direction=[1, 0, 0])
    assert status_entries(opened.state, opened.scene)["kind"] == "ready"
