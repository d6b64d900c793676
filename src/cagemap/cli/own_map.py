"""`cagemap map`: a RESULT from anyone's point map, for transfer, wrap and report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cagemap.cli.progress import Stages
from cagemap.errors import ParameterError
from cagemap.files.atomic import require_no_input
from cagemap.files.maps import dense_map, read_images
from cagemap.files.meshes import read_mesh
from cagemap.files.result import ARRAYS, MANIFEST, check_result_folder, file_hash, stated_path, write_result
from cagemap.files.result_values import Result, Side
from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.quality import measure_quality
from cagemap.mesh.checks import require_valid
from cagemap.pipeline import choose_level
from cagemap.refinement import Refinement, refine

DEFAULT_VERTICES = 50_000


@dataclass(frozen=True)
class MapRequest:
    """What the user asked for, as said on the command line."""

    map: Path
    target: Path
    source: Path
    output: Path
    level: int | None = None
    force: bool = False


def run_map(request: MapRequest, stages: Stages) -> tuple[str, list[str]]:
    """Judge a map and write it as a RESULT folder; returns a summary and warnings."""
    files = {"target": request.target, "source": request.source, "map": request.map}
    check_result_folder(request.output, force=request.force)
    require_no_input([request.output / name for name in (ARRAYS, MANIFEST)], files.values())
    stages("read")
    refined = [_refined(path, request.level) for path in (request.target, request.source)]
    target, source = (TriangleSurface.from_faces(r.finest.positions, np.asarray(r.finest.faces)) for r in refined)
    # A map may count the vertices of any level: those of a coarser one are the first of every finer one.
    point_map = dense_map(read_images(request.map, source), refined[0], target)
    stages("quality")
    quality = measure_quality(point_map)
    entries = {
        name: {"file": path.name, "path": stated_path(path, request.output), "sha256": file_hash(path)}
        for name, path in files.items()
    }
    result = Result(
        target=_side(refined[0]),
        source=_side(refined[1]),
        source_triangles=source.triangles,
        triangle=point_map.triangle,
        barycentric=point_map.barycentric,
        functional_map=np.ones((1, 1)),  # of the constant function, all that is known of the basis
        trust=quality.trust,
        landmark_errors=np.zeros(0),
        manifest={
            "quality": quality.summary(),
            "parameters": {"method": "map of the user's", "level": request.level},
            "inputs": entries,
            "timings": {},
        },
    )
    stages("write")
    write_result(request.output, result, force=request.force)
    text = (
        f"wrote {request.output}: {target.n} target vertices, {100 * quality.flipped_area:.2f} % of the area folded, "
        f"{100 * quality.coverage:.1f} % of the source reached"
    )
    return text, list(quality.warnings)


def _refined(path: Path, level: int | None) -> Refinement:
    control = read_mesh(path)
    require_valid(control)
    if level is not None and level < 1:
        raise ParameterError(f"--level: expected 1 or more, got {level}")
    return refine(control, level or choose_level(control, DEFAULT_VERTICES), control.scheme)


def _side(refined: Refinement) -> Side:
    finest = refined.finest
    return Side(
        control=refined.control,
        scheme=refined.scheme,
        level=refined.n_levels,
        vertices=finest.positions,
        faces=np.asarray(finest.faces),
        eigenvalues=np.zeros(1),
        landmarks=np.zeros(0, dtype=np.int64),
    )
