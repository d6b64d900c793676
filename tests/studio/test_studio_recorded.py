"""A RESULT that the studio opens: what of its match is taken over, and what a bake writes then."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cagemap.files.result.manifest import read_manifest
from cagemap.studio.finish import FinishOptions
from cagemap.studio.finish_layout import VERTICES_KEY, sections
from cagemap.studio.opening import command_line_files
from cagemap.studio.page.form import form_fields, read_form
from cagemap.studio.recorded import FORM_FIELDS
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
    until(lambda: session.state.map.revision >= 1, session)
    until(lambda: at_rest(session), session)
    return session


def filled_form(files: Files) -> FinishOptions:
    """What a page sends whose form nobody has changed."""
    options = all_options()
    form = form_fields(options, 300, files.recorded.form_values)["form"]
    rows = [*form["first"], *(row for fold in form["folds"] for row in fold["fields"])]
    return read_form(options, {row["key"]: row["value"] for row in rows if row.get("always")})


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
    until(lambda: session.state.map.revision >= 1, session)
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
        (note,) = files.recorded.notes
        assert lost in note
        assert "R_studio" in note
        for name in ("curves.json", "mask.csv"):
            (folder / f"{name}.away").rename(folder / name)
        shutil.rmtree(folder / "R")
    matched(folder)
    assert opened_result(folder / "R").result == folder / "R"
    assert opened_result(folder / "R").recorded.notes == ()


@pytest.mark.slow
def test_the_alignment_of_a_result_is_chosen_where_the_preview_finds_it(folder: Path) -> None:
    matched(folder)
    files = opened_result(folder / "R")
    for answer in (1, 9):  # the preview has fewer than ten
        recorded = replace(files.recorded, request=replace(files.recorded.request, answer=answer))
        session = opened_session(folder, replace(files, recorded=recorded))
        count = len(session.state.map.answers)
        assert session.state.map.chosen_answer == (answer if answer < count else 0)
        assert session.plan(FinishOptions())[0].request.answer == session.state.map.chosen_answer
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
