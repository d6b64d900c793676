"""`cagemap demo`: match and bake the built-in pair into one folder."""

from __future__ import annotations

import shlex
from pathlib import Path

from cagemap.errors import FormatError
from cagemap.example import example_pair
from cagemap.files.atomic import check_outputs
from cagemap.files.images.image import write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import mesh_files, write_mesh
from cagemap.files.result.folder import check_result_folder
from cagemap.tasks.match import run_match
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.report import run_report
from cagemap.tasks.requests.demo import DemoRequest
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.report import ReportRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer

TEXTURE_SIZE = 2048
VERTICES = 100_000
_DONE = """The same by hand:
  cagemap match --target {0} --source {1} --landmarks {2} --vertices {vertices} -o {3}
  cagemap transfer {3} --texture {4} --size {size} -o {5}
  cagemap report {3} -o {6}
Open {report} in a browser."""


def run_demo(request: DemoRequest, stages: Stages) -> SummaryAndWarnings:
    """Write the pair's files, match, bake and report; returns the equivalent commands and the report's path."""
    folder, force = request.output, request.force
    if folder.exists() and not folder.is_dir():
        raise FormatError(f"{folder}: expected a folder to write to, got a file. Give another name.")
    stages("model and paint the pair")
    pair = example_pair(TEXTURE_SIZE)
    target, source = (folder / f"{Path(mesh.name).stem}.obj" for mesh in (pair.target, pair.source))
    landmarks, texture = folder / "landmarks.json", folder / f"{source.stem}.png"
    result, baked, report = folder / "RESULT", folder / f"{target.stem}.png", folder / "report.html"
    folder.mkdir(parents=True, exist_ok=True)
    models = [*mesh_files(target, pair.target), *mesh_files(source, pair.source)]
    check_outputs([*models, landmarks, texture, baked, report], [], force=force)
    check_result_folder(result, force=force)
    write_mesh(target, pair.target, force=force)
    write_mesh(source, pair.source, force=force)
    write_landmarks(landmarks, pair.landmarks, force=force)
    write_image(texture, pair.texture, force=force)
    run_match(MatchRequest(target, source, result, landmarks, vertices=VERTICES, force=force), stages)
    run_transfer(TransferRequest(result, baked, texture=texture, force=force), stages)
    run_report(ReportRequest(result, report, force=force), stages)
    quoted = [shlex.quote(str(path)) for path in (target, source, landmarks, result, texture, baked, report)]
    return _DONE.format(*quoted, report=report, vertices=VERTICES, size=TEXTURE_SIZE), []
