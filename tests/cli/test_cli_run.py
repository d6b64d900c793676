"""`cagemap run` on real files: the same maps as single commands, and nothing twice."""

import csv
import json
import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from cagemap.cli.app import app
from cagemap.errors import FormatError, ParameterError
from cagemap.example import ExamplePair
from cagemap.files.atomic import write_whole
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import read_result
from cagemap.files.result.manifest import code_version
from cagemap.jobs.consistency import Consistency
from cagemap.jobs.farm import farm_steps
from cagemap.jobs.job import read_job
from cagemap.jobs.page import PairRow
from cagemap.jobs.plan import Task, plan_job
from cagemap.jobs.tree import spanning_tree
from cagemap.subdivision import refine
from cagemap.tasks import dry_run
from cagemap.tasks.requests.catalogue import COMMANDS, WRITTEN
from cagemap.tasks.run_job import rows_in_user_words

from job_text import job_text, table

COLORED = {"files.color": "pony.png"}
PAIRS = [{"source": name, "target": "deer", "landmarks": "landmarks.json"} for name in ("pony", "broken")]
JOB = job_text("vertices = 500", {"pony": COLORED, "deer": {}, "broken": COLORED}, PAIRS)
JOB += table("outputs", command="transfer", texture="{source.color}", size=64, output="{target}.png")

# Numbers of some tasks: three surfaces, two maps, what is made with each of these, the page.
NUMBERED = {
    "match pony -> deer": "4",
    "match broken -> deer": "5",
    "picture pony -> deer": "6",
    "transfer pony -> deer": "6",
    "transfer broken -> deer": "7",
    "page": "8",
}


@pytest.fixture
def folder(pair_files: Path) -> Path:
    (pair_files / "broken.obj").write_text("v 0 0 0\nf 1 2 3\n")
    (pair_files / "job.toml").write_text(JOB)
    return pair_files


def run_job(folder: Path, *words: str, code: int = 0) -> str:
    """What `cagemap run` says of the job."""
    said = CliRunner().invoke(app, ["run", str(folder / "job.toml"), *words])
    assert said.exit_code == code, said.output
    return said.output


def test_a_dry_run_says_what_would_be_done_and_does_nothing(folder: Path) -> None:
    before = sorted(folder.iterdir())
    said = run_job(folder, "--dry-run")
    head = "9 tasks for 2 pairs, 9 to do; --task takes numbers from 1 to 8"
    assert [text for text in (head, "match pony -> deer", "core minutes") if text not in said] == []
    assert sorted(folder.iterdir()) == before


def test_options_that_contradict_each_other_are_refused_before_any_task(folder: Path) -> None:
    job = folder / "job.toml"
    outputs = table("outputs", command="transfer", texture="{source.color}", rays=3, output="other.png")
    outputs += table("outputs", command="wrap", fit_level=1, size=8)
    job.write_text(JOB.replace("vertices = 500", "vertices = 1500\nlevel = 1") + outputs)
    done = CliRunner().invoke(app, ["run", str(job)])
    assert isinstance(done.exception, FormatError)
    message = str(done.exception)
    assert "3 problems; nothing was started" in message
    for words in ("--level and --vertices: expected one", "--rays: expected with --bake", "--size: expected with"):
        assert words in message
    assert not (folder / "night").exists()


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ({"texture": "{source.color}", "output": "skin.psd"}, "expected an image name ending in .png"),
        ({"bake": ["normal"], "detail": "{source.color}", "output": "skin"}, "expected an image name ending in .png"),
        ({"texture": "{source.color}", "output": "s.png", "usd": "s.usdz"}, "expected a name ending in .usda"),
        ({"weights": "{source.color}", "output": "skin.xls"}, "expected a name ending in .npy"),
        ({"joints": "{source.color}", "output": "rig.fbx"}, "expected a name ending in .json"),
        ({"passenger": "{source.color}", "output": "hat.fbx"}, "expected a mesh file ending in .obj"),
    ],
)
def test_names_of_outputs_are_checked_before_any_task(folder: Path, entries: dict[str, Any], said: str) -> None:
    (folder / "job.toml").write_text(JOB + table("outputs", command="transfer", **entries))
    done = CliRunner().invoke(app, ["run", str(folder / "job.toml"), "--dry-run"])
    assert said in str(done.exception)
    assert "nothing was started" in str(done.exception)


def test_workers_of_a_scheduler_are_its_own(folder: Path) -> None:
    words = ["run", str(folder / "job.toml"), "--scheduler", "tcp://127.0.0.1:9", "--workers", "4"]
    with pytest.raises(ParameterError, match="--scheduler: expected none of --workers beside it"):
        CliRunner().invoke(app, words, catch_exceptions=False)


def test_a_dry_run_counts_plain_meshes_without_subdivision(folder: Path) -> None:
    (folder / "job.toml").write_text(JOB.replace("vertices = 500", 'scheme = "none"\nlevel = 3'))
    said = run_job(folder, "--dry-run")
    shown = {int(count) for count in re.findall(r"prepare \w+ \w+: ([0-9,]+) vertices", said)}
    assert shown == {0, *(read_mesh(folder / f"{name}.obj").n_vertices for name in ("pony", "deer"))}


@pytest.mark.parametrize(("option", "levels"), [("target_level = 1", (None, 1)), ("source_level = 0", (0, None))])
def test_a_dry_run_counts_each_side_by_its_own_options(folder, option, levels):
    (folder / "job.toml").write_text(JOB.replace("vertices = 500", f"level = 2\n{option}"))
    said = run_job(folder, "--dry-run")
    (found,) = re.findall(r"match pony -> deer: ([0-9,]+) \+ ([0-9,]+) vertices", said)
    for name, count, level in zip(("pony", "deer"), found, levels, strict=True):
        expected = refine(read_mesh(folder / f"{name}.obj"), 2 if level is None else level).finest
        assert int(count.replace(",", "")) == expected.n_vertices
        assert re.search(rf"prepare {name} \w+: {count} vertices", said)


def test_a_dry_run_counts_a_given_map_at_the_level_that_its_import_chooses(folder: Path) -> None:
    (folder / "map.npy").touch()
    job = job_text("vertices = 500", {"pony": {}, "deer": {}}, [{"source": "pony", "target": "deer", "map": "map.npy"}])
    (folder / "job.toml").write_text(job)
    assert "match pony -> deer: 142,466 + 111,618 vertices" in run_job(folder, "--dry-run")


def test_a_dry_run_shares_the_work_between_workers_but_no_task(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dry_run, "_seconds", lambda task, sizes: 600.0)
    minutes = {}
    for workers in (1, 2, 500):
        said = run_job(folder, "--dry-run", "--workers", str(workers))
        core, found = map(float, re.findall(r"about ([0-9.]+) core minutes, ([0-9.]+) minutes with", said)[0])
        minutes[workers] = found - dry_run.STARTUP_SECONDS / 60
    assert minutes[1] == pytest.approx(core, abs=0.1)
    assert minutes[2] == pytest.approx(core / 2, abs=0.1)
    assert minutes[500] == pytest.approx(10.0, abs=0.1)  # a task takes what it takes


@pytest.mark.slow
def test_a_dry_run_foresees_what_will_be_refused(folder: Path, built_in_pair: ExamplePair) -> None:
    def said(command: str) -> str:
        (folder / "job.toml").write_text(JOB.replace('texture = "{source.color}"\nsize = 64', command))
        return run_job(folder, "--dry-run")

    texture = 'texture = "{source.color}"'
    assert "refused" not in said(texture)
    assert "broken cannot be used: " in said(texture)
    pair = built_in_pair
    write_mesh(folder / "deer.obj", replace(pair.target, uvs=None, uv_indices=None))
    assert "will be refused, for deer has no texture coordinates: add `unwrap = true`" in said(texture)
    assert "refused" not in said(texture + "\nunwrap = true")
    write_mesh(folder / "pony.obj", replace(pair.source, uvs=None, uv_indices=None))
    assert "will be refused, for pony has no texture coordinates, which texture lies over" in said(texture)
    assert "refused" not in said("material_colors = true\nunwrap = true")


def test_the_page_of_a_job_speaks_of_options() -> None:
    row = PairRow("a", "b", "failed", ("use the pairs reversed (`Landmarks.reversed()`)",), 0.0)
    assert rows_in_user_words([row])[0].messages == ("use the pairs reversed (--exchange-landmarks)",)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the tasks that ran; each only writes its files, and `broken` cannot be prepared."""
    ran: list[str] = []

    def write(task: Task) -> dict[str, Any]:
        ran.append(task.name)
        if task.request.get("asset") == "broken":
            raise FormatError("broken.obj: expected a mesh. Mend it.")
        root = Path(task.request["output"]) if "output" in task.request else None
        for output in task.outputs:
            folder = next(place for place in root.parents if place.name == "night")
            (folder / output).parent.mkdir(parents=True, exist_ok=True)
            write_whole(folder / output, "made")
        return {"notes": [f"a note of {task.kind}"]}

    monkeypatch.setattr("cagemap.tasks.run_job.run_task", write)
    return ran


def numbered(folder: Path, words: str) -> tuple[int, str]:
    said = CliRunner().invoke(app, ["run", str(folder / "job.toml"), "--task", words])
    return said.exit_code, said.output


@pytest.mark.slow
def test_each_task_by_its_number_is_done_once_and_has_an_exit_code(folder: Path, quick: list[str]) -> None:
    """Surfaces 1 to 3 (two of them deer's, which are one), maps 4 and 5, their outputs 6 and 7, the page 8."""
    listed = run_job(folder, "--dry-run")
    places = {name: next(line.split()[0] for line in listed.splitlines() if name in line) for name in NUMBERED}
    assert places == NUMBERED
    good, bad = (NUMBERED["match pony -> deer"], NUMBERED["match broken -> deer"])
    code, output = numbered(folder, good)
    assert (code, quick) == (1, [])
    assert "is not done. Run its number first." in output
    assert numbered(folder, "1-3")[0] == 1
    assert len(quick) == 3
    code, output = numbered(folder, good)
    assert (code, "\n  a note of match" in output) == (0, True)
    assert numbered(folder, NUMBERED["transfer pony -> deer"])[0] == 0
    before = list(quick)
    assert before[3:] == ["match pony -> deer", "picture pony -> deer", "transfer pony -> deer: deer.png"]
    assert numbered(folder, NUMBERED["transfer pony -> deer"])[0] == 0
    assert numbered(folder, bad)[0] == 1
    assert quick == before
    code, output = numbered(folder, "8")
    assert code == 1
    assert "match broken -> deer: failed: not done" in output
    assert " done, " not in output
    (folder / "night" / "pony__deer" / "deer.png").unlink()
    code, output = numbered(folder, f"{NUMBERED['transfer pony -> deer']}-8")
    assert "1 done, " in output  # by this command, the others by earlier ones
    assert "deer.png" in (folder / "night" / "index.html").read_text()
    with pytest.raises(ParameterError, match="of tasks 1 to 8, got '9'"):
        CliRunner().invoke(app, ["run", str(folder / "job.toml"), "--task", "9"], catch_exceptions=False)


@pytest.mark.slow
def test_a_numbered_output_is_made_with_the_way_round_its_doubtful_map(folder, quick, monkeypatch):
    """The composed map has no number: who needs it makes it first, once."""
    three = {"pony": COLORED, "deer": {}, "cow": {}}
    outputs = JOB[JOB.index("[[outputs]]") :]
    (folder / "cow.obj").write_bytes((folder / "pony.obj").read_bytes())
    pairs = [
        {"source": source, "target": target} for source, target in (("pony", "deer"), ("cow", "deer"), ("pony", "cow"))
    ]
    (folder / "job.toml").write_text(job_text("vertices = 500", three, pairs) + outputs)
    way = Consistency({}, 1, (), {("deer", "pony"): ("deer", "cow", "pony")})
    monkeypatch.setattr("cagemap.tasks.run_job.collection_verdict", lambda plan, outcomes: way)
    job = read_job(folder / "job.toml", COMMANDS, WRITTEN)
    steps = {step.name: step for step in farm_steps(plan_job(job, code_version(), spanning_tree))}
    maps, outputs = steps["match"], steps["outputs"]
    assert numbered(folder, f"1-{maps.last}")[0] == 0
    assert not [name for name in quick if name.startswith("compose")]
    assert numbered(folder, f"{outputs.first}-{outputs.last}")[0] == 0
    assert [name for name in quick if name.startswith("compose")] == ["compose pony -> deer by way of cow"]
    assert quick.index("compose pony -> deer by way of cow") < quick.index("picture pony -> deer")
    assert numbered(folder, str(outputs.last + 1))[0] == 0


@pytest.mark.slow
def test_a_job_is_exported_for_farms_and_runs_nothing(folder: Path) -> None:
    before = sorted(folder.iterdir())
    made = {
        kind: CliRunner().invoke(app, ["run", str(folder / "job.toml"), "--export", kind])
        for kind in ("openjd", "slurm", "cobol")
    }
    template = json.loads(made["openjd"].output)
    assert [step["name"] for step in template["steps"]] == ["prepare", "match", "outputs", "page"]
    assert f"job={folder}/job.toml" in made["slurm"].output
    assert "'cobol' is not one of 'openjd', 'slurm'" in made["cobol"].output
    for words in (["--export", "slurm"], ["--dry-run"]):  # the text is all that they are run for
        assert CliRunner().invoke(app, ["run", str(folder / "job.toml"), *words, "-q"]).output
    both = CliRunner().invoke(app, ["run", str(folder / "job.toml"), "--export", "slurm", "--task", "1"])
    assert "--task: expected none of --export beside it" in str(both.exception)
    assert sorted(folder.iterdir()) == before


@pytest.mark.slow
@pytest.mark.usefixtures("jobs_in_threads", "quick_fit", "small_pages")
def test_a_job_gives_what_single_commands_give_and_names_what_failed(folder: Path) -> None:
    first = run_job(folder, "--workers", "2", code=1)
    assert "broken" in first
    assert "match broken -> deer: skipped" in first
    night = folder / "night"
    assert (night / "pony__deer" / "deer.png").is_file()
    assert not (night / "broken__deer" / "RESULT").exists()
    assert "skipped" in (night / "index.html").read_text()
    (row,) = [row for row in csv.DictReader((night / "figures.csv").open()) if row["source"] == "broken"]
    assert (row["code"], row["place"].endswith("broken.obj, line 2")) == ("format", True)

    single = ["match", "-t", str(folder / "deer.obj"), "-s", str(folder / "pony.obj"), "--vertices", "500"]
    single += ["--landmarks", str(folder / "landmarks.json"), "-o", str(folder / "RESULT")]
    done = CliRunner().invoke(app, single)
    assert done.exit_code == 0, done.output
    one, many = read_result(folder / "RESULT"), read_result(night / "pony__deer" / "RESULT")
    np.testing.assert_allclose(many.image(), one.image(), atol=1e-12 * np.ptp(one.image()))

    written = {path: path.stat().st_mtime_ns for path in night.rglob("*") if ".lock" not in path.name}
    run_job(folder, "--workers", "2", code=1)
    after = {path: path.stat().st_mtime_ns for path in night.rglob("*") if ".lock" not in path.name}
    assert {path for path in written if after.get(path) != written[path] and path.is_file()} == set()
    (folder / "broken.obj").write_bytes((folder / "pony.obj").read_bytes())
    assert "failed" not in run_job(folder, "--workers", "2")
    assert os.path.isfile(night / "broken__deer" / "deer.png")
