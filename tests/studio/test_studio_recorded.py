"""A RESULT that the studio opens: what of its match is taken over, and what a bake writes then."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.manifest import read_manifest
from cagemap.studio.finish import FinishOptions
from cagemap.studio.finish_layout import VERTICES_KEY, sections
from cagemap.studio.opening import command_line_files, default_files
from cagemap.studio.page.form import form_fields, read_form
from cagemap.studio.page.shown import page_state
from cagemap.studio.recorded_match import FORM_FIELDS, lost_welds
from cagemap.studio.session import Session
from cagemap.studio.state import Files
from cagemap.tasks.match import match_files
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.catalogue import all_options
from cagemap.tasks.requests.match import MatchRequest

from browser_page import PATIENCE, Page, studio
from studio_boxes import at_rest, session_of, until, write_boxes

SIDES = (("target", "a"), ("source", "b"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_boxes(tmp_path)
    points = [{"name": f"p{number}", "vertex": number} for number in range(4)]
    for name in ("a", "b"):
        (tmp_path / f"{name}.points.json").write_text(json.dumps({"points": points}))
    curves = [{"name": "rim", "target": [0, 1, 3, 2], "source": [0, 1, 3, 2], "closed": True}]
    (tmp_path / "curves.json").write_text(json.dumps({"curves": curves}))
    (tmp_path / "mask.csv").write_text("mask\n" + "1\n" * 5 + "0\n")
    return tmp_path


def matched(folder: Path, **options: object) -> MatchRequest:
    asked = {"vertices": 300, "output": folder / "R"} | options
    request = MatchRequest(folder / "a.obj", folder / "b.obj", **asked)  # type: ignore[arg-type]
    match_files(request, Stages())
    return request


def opened_result(result: Path) -> Files:
    return command_line_files(None, None, None, None, result)


def opened_session(folder: Path, files: Files) -> Session:
    session = session_of(folder)
    session.open(files)
    wait_for_map(session)
    return session


def wait_for_map(session: Session) -> None:
    until(lambda: session.state.map.revision >= 1, session)
    until(lambda: at_rest(session), session)


def filled_form(files: Files) -> FinishOptions:
    """What a page sends whose form nobody has changed."""
    options = all_options()
    form = form_fields(options, 300, files.recorded_match.form_values)["form"]
    rows = [*form["first"], *(row for fold in form["folds"] for row in fold["fields"])]
    return read_form(options, {row["key"]: row["value"] for row in rows if row.get("always_sent")})


def test_the_form_has_every_option_that_a_result_is_asked_for() -> None:
    shown = {field.key for section in sections(all_options()) for field in section.fields} | {VERTICES_KEY}
    assert {("match", name) for name in (*FORM_FIELDS, "force")} == {key for key in shown if key[0] == "match"}


@pytest.mark.slow
def test_points_curves_masks_and_options_of_a_result_are_those_of_the_next_bake(folder: Path) -> None:
    asked = matched(
        folder,
        target_points=folder / "a.points.json",
        source_points=folder / "b.points.json",
        curves=folder / "curves.json",
        target_mask=f"not:{folder / 'mask.csv'}",
        mask_edge=0.1,
        boundary="edge-only",
        trust_landmarks=True,
        vertices=700,
    )
    files = opened_result(folder / "R")
    assert (files.result, files.landmarks.name) == (folder / "R", "b__a.json")
    session = opened_session(folder, files)
    assert not [message.text for message in session.state.messages if message.kind == "error"]
    present = session.state.history.present
    assert [item.name for item in present.items] == ["p0", "p1", "p2", "p3"]
    assert [curve.name for curve in present.curves] == ["rim"]
    assert not session.state.saved
    request = session.plan(filled_form(files))[0].request
    for name in (*FORM_FIELDS, "output"):
        assert getattr(request, name) == getattr(asked, name), name
    session.save()
    assert session.state.saved
    # From here on the saved file is theirs, also where the models are opened again.
    session.remove(1)
    session.save()
    session.open_plain("source")
    wait_for_map(session)
    assert [item.name for item in session.state.history.present.items] == ["p1", "p2", "p3"]
    session.close()


@pytest.mark.slow
def test_pairs_of_the_other_direction_and_changed_files_are_taken_as_they_are_now(folder: Path) -> None:
    pairs = [{"name": f"q{number}", "target": number, "source": number} for number in range(3)]
    (folder / "pairs.json").write_text(json.dumps({"target": "b.obj", "source": "a.obj", "pairs": pairs}))
    matched(folder, landmarks=folder / "pairs.json", exchange_landmarks=True)
    (folder / "pairs.json").write_text(json.dumps({"target": "b.obj", "source": "a.obj", "pairs": pairs[:2]}))
    files = opened_result(folder / "R")
    assert (files.result, files.landmarks.name) == (folder / "R", "b__a.json")
    session = opened_session(folder, files)
    assert [item.name for item in session.state.history.present.items] == ["q0", "q1"]
    assert any("pairs.json was changed since R was computed" in message.text for message in session.state.messages)
    session.close()


@pytest.mark.slow
def test_a_result_is_not_replaced_by_a_match_without_its_options(folder: Path) -> None:
    for options, lost in (
        (
            {"method": "hfm", **{f"{side}_points": folder / f"{name}.points.json" for side, name in SIDES}},
            "--method hfm",
        ),
        ({"part": "each"}, "--part each"),
        ({"target_level": 2, "vertices": None}, "--set target.level"),
        ({"curves": folder / "curves.json"}, "--curves curves.json"),
        ({"target_mask": str(folder / "mask.csv")}, "--target-mask mask.csv"),
    ):
        matched(folder, **options)
        for name in ("curves.json", "mask.csv"):
            (folder / name).rename(folder / f"{name}.away")
        files = opened_result(folder / "R")
        assert files.result == folder / "R_studio", lost
        (note,) = files.recorded_match.notes
        assert lost in note
        assert "R_studio" in note
        for name in ("curves.json", "mask.csv"):
            (folder / f"{name}.away").rename(folder / name)
        shutil.rmtree(folder / "R")
    matched(folder)
    assert opened_result(folder / "R").result == folder / "R"
    assert opened_result(folder / "R").recorded_match.notes == ()


def restated(result: Path, **entries: object) -> None:
    """Change entries of a RESULT's manifest; None removes one."""
    manifest = json.loads((result / "manifest.json").read_text()) | entries
    kept = {name: entry for name, entry in manifest.items() if entry is not None}
    (result / "manifest.json").write_text(json.dumps(kept))


@pytest.mark.slow
def test_a_map_that_no_single_match_makes_is_not_replaced(folder: Path) -> None:
    matched(folder)
    parameters, inputs = (read_manifest(folder / "R")[name] for name in ("parameters", "inputs"))
    job = (folder / "R" / "job.toml").read_bytes()
    for entries, reason in (
        ({"way": ["a", "c", "b"]}, "composed of the maps b -> c -> a"),
        ({"parameters": None}, "does not say how"),
        ({"inputs": inputs | {"map": inputs["target"]}}, "cagemap map"),
        ({"parameters": parameters | {"answer": 99}}, "--answer 99"),
        ({}, "job.toml"),
    ):
        (folder / "R" / "job.toml").write_bytes(job if entries else job + b"# edited")
        restated(folder / "R", **({"way": None, "parameters": parameters, "inputs": inputs} | entries))
        files = opened_result(folder / "R")
        assert files.result == folder / "R_studio", reason
        (note,) = files.recorded_match.notes
        assert reason in note


@pytest.mark.slow
def test_a_result_of_other_welding_is_not_replaced(folder: Path) -> None:
    box = read_mesh(folder / "b.obj")  # each face has vertices of its own
    corners = box.positions[box.face_indices]
    write_mesh(folder / "b.obj", replace(box, positions=corners, face_indices=np.arange(len(corners))))
    for weld, kept in (({"source_weld": "0.01"}, False), ({"weld": "auto"}, True), ({"source_weld": "0.0"}, True)):
        asked = matched(folder, **weld)
        session = opened_session(folder, opened_result(folder / "R"))
        assert session.state.files.result == (folder / "R" if kept else folder / "R_studio"), weld
        said = [message.text for message in session.state.messages if "--source-weld 0.01" in message.text]
        assert len(said) == (not kept)
        session.close()
        shutil.rmtree(folder / "R")
    assert lost_welds(replace(asked, source_weld=None), ("0.5", None)) == [
        "it was matched without --target-weld; the studio welds within 0.5"
    ]


@pytest.mark.slow
def test_a_result_whose_landmarks_do_not_fit_any_more_is_not_replaced(folder: Path) -> None:
    matched(folder, **{f"{side}_points": folder / f"{name}.points.json" for side, name in SIDES})
    (folder / "a.points.json").write_text(json.dumps({"points": [{"name": "p0", "vertex": 99}]}))
    session = opened_session(folder, opened_result(folder / "R"))
    assert any(message.kind == "error" for message in session.state.messages)
    assert session.state.files.result == folder / "R_studio"
    session.close()


@pytest.mark.slow
def test_the_alignment_of_a_result_is_chosen_by_its_name(folder: Path) -> None:
    box = read_mesh(folder / "b.obj")  # another shape, so that several alignments are possible
    write_mesh(folder / "b.obj", box.with_positions(box.positions * [1.0, 1.5, 0.8]))
    matched(folder)
    readings = read_manifest(folder / "R")["confidence"]["readings"]
    names = [reading["name"] for reading in readings]
    assert len(set(names)) == len(names) > 1
    parameters = read_manifest(folder / "R")["parameters"]
    answer, unknown = len(names), [{**reading, "name": f"unknown {k}"} for k, reading in enumerate(readings)]
    for name in (names[1], names[0], "head over heels"):  # at another place, or not found by the preview
        found = names.index(name) if name in names else 0
        more = [*unknown, {**readings[1], "name": name}]
        restated(
            folder / "R",
            parameters=parameters | {"answer": answer},
            confidence=read_manifest(folder / "R")["confidence"] | {"readings": more},
        )
        session = opened_session(folder, opened_result(folder / "R"))
        assert session.state.map.chosen_answer == found
        request = session.plan(FinishOptions())[0].request
        assert request.answer == (answer if name in names else 0)
        assert request.output == (folder / "R" if name in names else folder / "R_studio")
        other = FinishOptions().with_values({("match", "vertices"): 350})
        assert session.plan(other)[0].request.answer == found
        assert any("head over heels" in message.text for message in session.state.messages) == (name not in names)
        session.choose_answer(0)
        wait_for_map(session)
        session.open_plain("source")
        wait_for_map(session)
        assert session.state.map.chosen_answer == session.plan(FinishOptions())[0].request.answer == 0
        session.close()


@pytest.mark.slow
def test_a_bake_waits_for_the_map_of_the_alignment_of_a_result(folder: Path) -> None:
    box = read_mesh(folder / "b.obj")
    write_mesh(folder / "b.obj", box.with_positions(box.positions * [1.0, 1.5, 0.8]))
    matched(folder, answer=1)
    session = session_of(folder)
    session.open(opened_result(folder / "R"))
    until(lambda: session.scene is not None, session)
    session.cancel()
    until(lambda: session.state.preview_job is None, session)
    assert session.state.map.revision == 0
    session.finish(FinishOptions(texture=False))
    assert session.state.finish_job is None
    assert "Match again" in session.state.messages[-1].text
    session.match_again()
    wait_for_map(session)
    assert session.plan(FinishOptions())[0].request.answer == 1
    session.close()
    files = command_line_files(None, None, None, None, folder / "R", schemes=("none", None))
    assert files.recorded_match.request.answer == 0
    files = command_line_files(None, None, None, None, folder / "R", schemes=("catmull-clark", None))
    assert files.recorded_match.request.answer == 1


@pytest.mark.slow
@pytest.mark.browser
def test_options_of_a_result_are_not_those_of_other_models(folder: Path, browser: Any) -> None:
    asked = matched(folder, boundary="edge-only", target_mask=str(folder / "mask.csv"), mask_edge=0.1)
    shutil.copy(folder / "b.obj", folder / "c.obj")
    value = "return document.querySelector(`[data-key='match.${arguments[0]}'] :is(input, select)`).value"
    with studio("--result", str(asked.output), "--vertices", "300", forks=True) as (_, address):
        page = Page(browser, address)
        page.until(lambda: page.revision() >= 1, "the first map")
        assert [page.run(value, name) for name in ("boundary", "target_mask", "mask_edge")] == [
            "edge-only",
            str(folder / "mask.csv"),
            "0.1",
        ]
        # A studio that is started again has no pair at first.
        page.run("window.studio.state.pair = []; document.getElementById('models').dispatchEvent(new Event('close'))")
        assert page.run(value, "boundary") == "edge-only"
        page.run("document.getElementById('open').click()")
        page.run(
            "const {elements} = document.querySelector('#models form'), at = elements.source;"
            "at.value = 'c.obj'; at.dispatchEvent(new Event('change', {bubbles: true}));"
            "document.getElementById('models').close('open')"
        )
        page.until(lambda: (page.state("files") or {}).get("source") == "c.obj", "the other source")
        assert [page.run(value, name) for name in ("boundary", "target_mask", "mask_edge")] == ["", "", ""]


@pytest.mark.slow
def test_a_converted_model_is_still_the_one_that_was_opened(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = opened_session(folder, default_files(folder / "a.obj", folder / "b.obj", None))
    opened = session.state.models
    assert opened == (folder / "a.obj", folder / "b.obj")
    with session._lock:
        session._change(files=replace(session.state.files, source=folder / "b2.glb"))
    assert page_state(session.state, session.scene, session.workspace, {})["pair"] == ["a.obj", "b.obj"]
    session.close()


@pytest.mark.slow
@pytest.mark.browser
def test_a_bake_of_the_unchanged_page_repeats_the_match_of_the_result(folder: Path, browser: Any) -> None:
    asked = matched(folder, boundary="edge-only", vertices=700)
    before = read_manifest(folder / "R")["parameters"]
    with studio("--result", str(asked.output), "--vertices", "300", forks=True) as (_, address):
        page = Page(browser, address)
        page.until(lambda: page.revision() >= 1, "the first map")
        page.option("", "Texture", False)
        page.press("start")
        page.until(lambda: page.said("Bake: done"), "the end", 3 * PATIENCE)
    parameters = read_manifest(folder / "R")["parameters"]
    assert parameters["target_scheme"] == "catmull-clark"  # of the page's match, which states it
    assert {name: parameters[name] for name in FORM_FIELDS} == {name: before[name] for name in FORM_FIELDS}
