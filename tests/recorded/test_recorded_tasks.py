"""Parameters, options, plans of jobs, pages and results of whole matches are what they were when they were recorded."""

import re
from dataclasses import MISSING, replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, cube, icosahedron, torus, triangulated

import cagemap.tasks as tasks
from cagemap import Landmarks, MatchConfig, match, prepare_surface
from cagemap.character.body_frames import FrameConfig
from cagemap.character.contact import ContactConfig
from cagemap.character.passenger_pieces import PieceConfig
from cagemap.character.self_collision import CollisionConfig
from cagemap.files.meshes.formats import write_mesh
from cagemap.jobs.job import read_job
from cagemap.jobs.plan import plan_job
from cagemap.jobs.run import TaskOutcome
from cagemap.jobs.tree import spanning_tree
from cagemap.maps.masks import Masks
from cagemap.maps.regions import region_figures
from cagemap.maps.result import MatchResult
from cagemap.paper.hfm import HfmConfig
from cagemap.paper.method import PaperConfig
from cagemap.report import build_page, draw_gallery
from cagemap.report.figures import _checker
from cagemap.spectral import BasisConfig
from cagemap.spectral.eigenpairs import SolverConfig
from cagemap.spectral.zoomout import ZoomOutSchedule
from cagemap.studio.page.form import form_fields
from cagemap.studio.page.shown import constant_entries, page_state
from cagemap.studio.session import Session
from cagemap.tasks.match_summary import body_warnings, match_figures, next_commands, summary, warnings
from cagemap.tasks.requests.catalogue import COMMANDS, WRITTEN, all_options
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.options import option_fields
from cagemap.tasks.run_job import summary as job_summary
from cagemap.wrap import WrapConfig
from cagemap.wrap.net import MendConfig
from recorded import check

from example_result import identity_result
from job_text import table
from quick_match import QUICK
from studio_boxes import add_landmarks


def test_parameters() -> None:
    """Every default of what a user may set; a change of one is a change of results."""
    kinds = (MatchConfig, WrapConfig, HfmConfig, PaperConfig, BasisConfig, SolverConfig, ZoomOutSchedule)
    others = (MendConfig, ContactConfig, FrameConfig, CollisionConfig, PieceConfig)
    check("parameters", {kind.__name__: kind() for kind in (*kinds, *others)})


def test_options() -> None:
    """Names, ranges and defaults of all options, on the command line and in the studio."""
    requests = {name: getattr(tasks, name) for name in tasks._TASKS}
    found = {
        f"{name}.{field.name}": f"{'' if field.default is MISSING else field.default} {kind} {replace(option, help='')}"
        for name, request in requests.items()
        for field, kind, option in option_fields(request)
    }
    options = {key: replace(one, help="") for key, one in all_options().items()}
    shown = {str(key): str(one) for key, one in options.items()}
    check("options", [found, shown, constant_entries(), str(form_fields(options, 300, {}))])


def test_a_plan(tmp_path: Path) -> None:
    for name, mesh in (("a", cube()), ("b", torus()), ("c", icosahedron())):
        write_mesh(tmp_path / f"{name}.obj", mesh)
    (tmp_path / "a.png").write_bytes(b"not read here")
    text = 'output = "out"\n[options]\nvertices = 500\n'
    text += table("assets", name="a", file="a.obj", scheme="bilinear") + 'files = { color = "a.png" }\n'
    text += "".join(table("assets", name=name, file=f"{name}.obj") for name in "bc")
    text += (
        table("pairs", tree=["a", "b", "c"])
        + table("pairs", source="a", target="b")
        + table("pairs", source="c", target="a")
    )
    text += table("outputs", command="transfer", texture="{source.color}", size=64, bits=16)
    text += table("outputs", command="wrap", output="{target}_{source}.usda", displacement="{target}.exr")
    text += table("outputs", command="report", output="{source}.html")
    (tmp_path / "job.toml").write_text(text)
    plan = plan_job(read_job(tmp_path / "job.toml", COMMANDS, WRITTEN), "1", spanning_tree)
    keys = {task.key: f"key {number}" for number, task in enumerate(plan.tasks)}
    found = [replace(task, key=keys[task.key], input_hashes={}) for task in plan.tasks]
    outcomes = {
        task.name: TaskOutcome(task.name, state, "why" * (state == "failed"), float(number), {"notes": [state]})
        for number, (task, state) in enumerate(zip(plan.tasks, 3 * ("done", "kept", "failed", "skipped"), strict=False))
    }
    told = [job_summary(plan, outcomes, ["a note"], page, 1.25) for page in (None, Path("page.html"))]
    check("plan", [found, plan.omitted_outputs, told], folder=tmp_path)


@pytest.fixture(scope="module")
def bent() -> MatchResult:
    """A creature onto itself with bent legs, by five landmarks."""
    mesh = triangulated(creature())
    x, y, z = mesh.positions.T
    other = mesh.with_positions(np.column_stack([1.2 * x + 0.1 * y**2, y, z * (1.0 + 0.1 * y)]))
    vertices = np.linspace(0, mesh.n_vertices - 1, 5).astype(np.int64)
    marks = Landmarks(tuple("abcde"), vertices, vertices, "target.obj", "source.obj")
    target, source = (prepare_surface(one, 2, config=BasisConfig(count=20)) for one in (mesh, other))
    return match(target, source, marks, QUICK)


def test_a_match(bent: MatchResult) -> None:
    machine = ("timings", "versions", "peak_memory_bytes", "parameters", "threads")
    figures = {name: value for name, value in bent.manifest.items() if name not in machine}
    check("match", [figures, bent.point_map.images.positions, region_figures(bent), bent.landmark_errors], 2e-3)


def test_what_is_said_of_results(tmp_path: Path) -> None:
    whole = identity_result()
    half = np.where(whole.target.vertices[:, 0] > 0, 1.0, 0.0)
    results = [
        whole,
        replace(whole, landmarks=Landmarks.none(), quality=replace(whole.quality, landmark_errors=np.zeros(0))),
        replace(whole, shared=Masks(target=half, source=half)),
    ]
    quality = replace(whole.quality, flipped_area=0.3)
    results.append(replace(whole, quality=quality))
    found = []
    for result in results:
        request = MatchRequest(tmp_path / "t.obj", tmp_path / "s.obj", Path("RESULT x"))
        said = summary(result, Path("R"), match_figures(result, 2.5)), next_commands(result, request)
        found.append([*said, warnings(result), body_warnings(result)])
    check("said_of_results", found)


@pytest.mark.usefixtures("small_pages")
def test_a_page(bent: MatchResult) -> None:
    found = []
    for result in (identity_result(2), bent):
        text = build_page(result, draw_gallery(result, size=(24, 18)))
        text = re.sub(r"(?s)<script.*?</script>|<style.*?</style>|data:[^\"']*", "", text)
        found.append(
            [line for line in text.splitlines() if not re.search(r"generator|version|second|timing| s</td>", line)]
        )
    check("page", found, 5e-2)


def test_the_state_of_the_studio(opened: Session, quick_fit: None) -> None:
    """Without what depends on how long something takes."""
    first = page_state(opened.state, opened.scene, opened.workspace, {})
    for name in ("bake_hint", "status", "revision"):
        first.pop(name)
    add_landmarks(opened, 0, 5)
    second = page_state(opened.state, opened.scene, opened.workspace, {})
    edited = {name: second[name] for name in ("landmarks", "count", "selected", "proposal", "undo", "redo")}
    check("studio", [first, edited], 1e-2, opened.workspace.folders[0])


def test_a_checker_of_one_vertex() -> None:
    """Of an extent of 0, it has cells of one 28th of a unit."""
    point, steps = np.array([[1.0, 2.0, 3.0]]), np.array([[0.5, 0, 0], [1.5, 0, 0], [1.5, 1.5, 0]])
    light, dark = [0.93, 0.90, 0.84], [0.20, 0.45, 0.55]
    np.testing.assert_array_equal(_checker(point + steps / 28, point), [light, dark, light])
