"""The page and the table of all pairs."""

import csv
import errno
import logging
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from html.parser import HTMLParser
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from cagemap.errors import FormatError
from cagemap.files import atomic
from cagemap.jobs.page import PairRow, build_library_page, build_table, pair_rows, write_library
from cagemap.jobs.plan import Plan, Task
from cagemap.jobs.run import TaskOutcome, execute
from cagemap.numerics.threads import ThreadPool
from cagemap.tasks.run_job import run_task, summary

from refusals import refuses

QUALITY = {
    "landmark_error_mean": 0.001,
    "landmark_error_worst": 0.002,
    "flipped_area": 0.0004,
    "coverage": 0.99,
    "dirichlet": 1.1,
    "aspect_ratio_percentiles": {"50": 1.2},
    "trusted_area": 0.95,
    "warnings": [],
}
PREPARE = Task("prepare", "prepare b", "k", (), {}, (), ("a", "b"))
GOOD = PairRow("a", "b", "good", (), 3.25, QUALITY, 0.001, ("a__b/b.png",), b"\xff\xd8jpeg")


class Cells(HTMLParser):
    """Text and data-value of every cell, row by row; attributes that leave the page."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str | None]] = []
        self.outside: list[str] = []
        self.images = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        if tag == "tr":
            self.rows.append([])
        if tag == "td":
            self.rows[-1].append(found.get("data-value"))
        self.images += tag == "img"
        self.outside += [v for k, v in attrs if k in ("src", "href") and v and v.startswith(("http:", "https:", "//"))]


def cells(page: str) -> Cells:
    parser = Cells()
    parser.feed(page)
    return parser


def test_the_page_shows_every_pair_and_needs_nothing_beside_it() -> None:
    failed = PairRow("c", "d", "failed", ("match c -> d: <mesh> is broken & lost",), 0.5)
    found = cells(build_library_page("night", [failed, GOOD], ["a note"]))
    assert found.outside == []
    assert found.images == 1
    head, first, second = found.rows
    assert head == []
    assert first[1:3] == ["c → d", "0"]
    assert second[1:5] == ["a → b", "3", "0.04", "99"]
    assert "&lt;mesh&gt; is broken &amp; lost" in build_library_page("night", [failed])
    page = build_library_page("night", [replace(GOOD, files=("a__b/skin #1 50%?.png",))])
    assert '<a href="a__b/skin%20%231%2050%25%3F.png">skin #1 50%?.png</a>' in page


def test_the_table_has_all_figures(tmp_path: Path) -> None:
    write_library(tmp_path, "night", [GOOD, replace(GOOD, source="c", cycle_error=None)])
    with (tmp_path / "figures.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["source"] for row in rows] == ["a", "c"]
    assert float(rows[0]["aspect_ratio_percentiles.50"]) == 1.2
    assert (rows[0]["cycle_error"], rows[1]["cycle_error"]) == ("0.001", "")
    assert set(build_table([GOOD])[0]) == set(rows[0])


def test_writing_the_same_again_writes_nothing(tmp_path: Path) -> None:
    write_library(tmp_path, "night", [GOOD])
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.suffix != ".parquet"}
    write_library(tmp_path, "night", [GOOD])
    assert {path: path.stat().st_mtime_ns for path in before} == before
    write_library(tmp_path, "night", [replace(GOOD, seconds=4.0)])
    assert "4.0" in (tmp_path / "figures.csv").read_text()


def test_the_same_parquet_is_not_written_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arrow, parquet = ModuleType("pyarrow"), ModuleType("pyarrow.parquet")
    arrow.__spec__ = ModuleSpec("pyarrow", None)
    vars(arrow).update(parquet=parquet, table=lambda arrays, metadata: repr((arrays, metadata)).encode())
    vars(parquet).update(write_table=lambda table, stream: stream.write(table))
    monkeypatch.setitem(sys.modules, "pyarrow", arrow)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", parquet)
    rows = [replace(GOOD, cycle_error=float("nan"))]  # which is not equal to itself
    data = write_library(tmp_path, "night", rows)[2]
    before = data.stat().st_mtime_ns, data.stat().st_ino
    write_library(tmp_path, "night", rows)
    assert (data.stat().st_mtime_ns, data.stat().st_ino) == before
    write_library(tmp_path, "night", [replace(GOOD, seconds=4.0)])
    assert b"4.0" in data.read_bytes()


@pytest.mark.parametrize("full", [".csv", ".sha256"])
def test_a_table_that_found_no_room_is_written_by_the_next_run(tmp_path, monkeypatch, full):
    """It has no place for a mark, so it and the note that says whose it is must go together."""
    honest = atomic.os.replace

    def replaced(temporary: Path, place: Path) -> None:
        if place.suffix == full:
            raise OSError(errno.ENOSPC, "No space left on device", str(place))
        honest(temporary, place)

    write_library(tmp_path, "night", [GOOD])
    with monkeypatch.context() as disk:
        disk.setattr(atomic.os, "replace", replaced)
        refuses(FormatError, "No space", write_library, tmp_path, "night", [replace(GOOD, seconds=4.0)])
    write_library(tmp_path, "night", [replace(GOOD, seconds=4.0)])
    assert "4.0" in (tmp_path / "figures.csv").read_text()


@pytest.mark.parametrize("name", ["index.html", "figures.csv"])
def test_a_file_that_somebody_edited_is_not_overwritten(tmp_path: Path, name: str) -> None:
    write_library(tmp_path, "night", [GOOD])
    edited = (tmp_path / name).read_text() + "my remark\n"
    (tmp_path / name).write_text(edited)
    refuses(FormatError, "not overwritten", write_library, tmp_path, "night", [replace(GOOD, seconds=4.0)])
    assert (tmp_path / name).read_text() == edited


def test_rows_gather_what_the_tasks_of_a_pair_said(tmp_path: Path) -> None:
    def task(kind: str, pair: tuple[str, str], output: str) -> Task:
        return Task(kind, f"{kind} {pair[0]} -> {pair[1]}", "k", (), {}, (f"{pair[0]}__{pair[1]}/{output}",), pair)

    pairs = (("a", "b"), ("b", "a"))
    tasks = tuple(task(kind, pair, f"{kind}.out") for pair in pairs for kind in ("match", "transfer"))
    outcomes = {
        tasks[0].name: TaskOutcome(
            tasks[0].name, "done", "", 2.0, {"quality": QUALITY, "warnings": []}, tasks[0].outputs
        ),
        tasks[1].name: TaskOutcome(tasks[1].name, "kept", "", 1.0, {}, ("a__b/shapes/x.obj", "a__b/shapes/y.obj")),
        tasks[2].name: TaskOutcome(tasks[2].name, "done", "", 2.0, {"quality": QUALITY, "warnings": []}),
        tasks[3].name: TaskOutcome(
            tasks[3].name, "failed", "a.png: expected an image, got none. Export it again.", code="format"
        ),
    }
    rows = pair_rows(Plan(tmp_path, tasks, pairs), outcomes, {("b", "a"): 0.5})
    assert [(row.source, row.target, row.verdict) for row in rows] == [("b", "a", "failed"), ("a", "b", "good")]
    assert rows[1].seconds == 3.0
    assert rows[1].cycle_error == 0.5  # of target b and source a
    assert rows[1].files == ("a__b/match.out", "a__b/shapes")  # a folder is one link
    assert "expected an image" in rows[0].messages[0]
    failure = {"code": "format", "place": "a.png", "remedy": "Export it again."}
    assert rows[0].failure == failure
    assert [{name: row[name] for name in failure} for row in build_table(rows)] == [failure, dict.fromkeys(failure, "")]


def test_the_picture_of_an_earlier_map_is_not_shown_for_a_pair_that_failed(tmp_path: Path) -> None:
    pair = ("a", "b")
    tasks = tuple(Task(kind, f"{kind} a -> b", "k", (), {}, (), pair) for kind in ("match", "picture"))
    (tmp_path / "a__b").mkdir()
    (tmp_path / "a__b" / "picture.jpg").write_bytes(b"jpeg")
    for states, picture in ((("kept", "kept"), b"jpeg"), (("failed", "skipped"), b"")):
        outcomes = {task.name: TaskOutcome(task.name, state) for task, state in zip(tasks, states, strict=True)}
        (row,) = pair_rows(Plan(tmp_path, tasks, (pair,)), outcomes)
        assert row.picture == picture


def test_a_row_has_the_warnings_and_notes_of_all_tasks_of_its_pair(tmp_path: Path) -> None:
    pair = ("a", "b")
    tasks = tuple(Task(kind, f"{kind} a -> b", "k", (), {}, (), pair) for kind in ("match", "transfer"))
    logged = {"logged": ["/b.obj: colours are left out"]}  # by each task that reads the file
    figures = {"quality": QUALITY, "warnings": [], "notes": ["b.obj: 3 vertices are welded"], **logged}
    outcomes = {
        tasks[0].name: TaskOutcome(tasks[0].name, "done", "", 2.0, figures),
        tasks[1].name: TaskOutcome(tasks[1].name, "kept", "", 1.0, {"warnings": ["b.obj: UVs overlap"], **logged}),
    }
    plan = Plan(tmp_path, tasks, (pair,))
    (row,) = pair_rows(plan, outcomes)
    said = ["b.obj: 3 vertices are welded", *logged["logged"], "transfer a -> b: b.obj: UVs overlap"]
    assert row.messages == tuple(said)
    assert row.verdict == "good"
    lines = summary(plan, outcomes, [], Path("page.html"), 1.0).splitlines()
    assert lines[1:] == [f"  match a -> b: {said[0]}", f"  {said[1]}", f"  {said[2]}", "Open page.html in a browser."]


def test_warnings_that_a_task_logs_are_among_its_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The path of a file is written as in other tasks; other words are kept as they are."""
    others = ["http://a//b: has moved", "no file// here", "a/../b// is meant"]

    def prepare(task: Task) -> dict[str, Any]:
        for text in (f"{tmp_path / 'jobs' / '..' / 'b.usda'}: curves are left out", *others):
            logging.getLogger("cagemap.files").warning(text)
        return {"level": 1}

    (tmp_path / "jobs").mkdir()
    (tmp_path / "b.usda").touch()
    monkeypatch.setattr("cagemap.tasks.run_job._prepare", prepare)
    found = run_task(PREPARE)
    assert found == {"level": 1, "logged": [f"{tmp_path / 'b.usda'}: curves are left out", *others]}


def test_warnings_of_a_task_that_fails_are_in_its_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def prepare(task: Task) -> dict[str, Any]:
        logging.getLogger("cagemap.files").warning("b.usda: curves are left out")
        raise FormatError("b.usda: expected a mesh, got none")

    monkeypatch.setattr("cagemap.tasks.run_job._prepare", prepare)
    outcome = execute(PREPARE, tmp_path, run_task)
    assert outcome.state == "failed"
    (row,) = pair_rows(Plan(tmp_path, (PREPARE,), (PREPARE.pair,)), {PREPARE.name: outcome})
    assert row.messages == (str(outcome), "b.usda: curves are left out")


def test_tasks_in_threads_of_one_process_have_their_own_warnings(monkeypatch: pytest.MonkeyPatch) -> None:
    both = threading.Barrier(2)

    def prepare(task: Task) -> dict[str, Any]:
        both.wait(10)
        with ThreadPool(1) as inner:
            inner.submit(logging.getLogger("cagemap.files").warning, task.name).result()
        both.wait(10)
        return {}

    monkeypatch.setattr("cagemap.tasks.run_job._prepare", prepare)
    tasks = [replace(PREPARE, name=name) for name in "ab"]
    with ThreadPoolExecutor(2) as workers:
        assert list(workers.map(run_task, tasks)) == [{"logged": ["a"]}, {"logged": ["b"]}]
