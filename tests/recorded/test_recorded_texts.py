"""Plans of jobs and what is said of results are what they were when they were recorded."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from examples.shapes import cube, icosahedron, torus

from cagemap import Landmarks
from cagemap.files.meshes.formats import write_mesh
from cagemap.jobs.job import read_job
from cagemap.jobs.plan import plan_job
from cagemap.jobs.run import TaskOutcome
from cagemap.jobs.tree import spanning_tree
from cagemap.maps.masks import Masks
from cagemap.tasks.match_summary import body_warnings, match_figures, next_commands, summary, warnings
from cagemap.tasks.requests.catalogue import COMMANDS, WRITTEN
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.run_job import summary as job_summary
from recorded import check

from example_result import identity_result
from job_text import table


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
