"""`cagemap map`: write a RESULT from a point map of any program, for transfer, wrap and report."""

from __future__ import annotations

from collections.abc import Callable

from cagemap.errors import ParameterError
from cagemap.files.atomic import require_no_input
from cagemap.files.meshes.formats import read_mesh
from cagemap.files.result.folder import ARRAYS, check_result_folder, write_result
from cagemap.files.result.manifest import MANIFEST, stated_inputs
from cagemap.files.result.maps import dense_map, read_images, source_level
from cagemap.files.usd.space import unit_notes
from cagemap.maps.quality import measure_quality
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh, Plain
from cagemap.mesh.checks import require_valid
from cagemap.mesh.faces import faces_of_one_size, split_into_fans
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import choose_level
from cagemap.spectral import Surface
from cagemap.subdivision import refine
from cagemap.tasks.job_file import note_match
from cagemap.tasks.masks import mask_inputs, masks_on, read_masks
from cagemap.tasks.mesh_commands import require_size
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.import_map import MapRequest
from cagemap.tasks.requests.options import field_values
from cagemap.tasks.subdivision import weld_side

MAP_VERTICES = 50_000


def run_map(
    request: MapRequest,
    stages: Stages,
    require: Callable[[ControlMesh, ControlMesh], object] = lambda target, source: None,
) -> SummaryAndWarnings:
    """Measure a map's quality and write it as a RESULT folder; returns a summary and warnings.

    ``require`` refuses target and source that the caller cannot use, before any work.
    """
    files = {"target": request.target, "source": request.source, "map": request.map}
    files.update(mask_inputs(request))
    check_result_folder(request.output, force=request.force)
    require_no_input([request.output / name for name in (ARRAYS, MANIFEST)], files.values())
    stages("read")
    stated = stated_inputs(files, request.output)
    filed = read_mesh(request.target), read_mesh(request.source)
    welded = [weld_side(mesh, request, side) for mesh, side in zip(filed, ("target", "source"), strict=True)]
    require(*(joined.mesh for joined in welded))
    target, source = (_surface(joined.mesh, request.level) for joined in welded)
    level = None if request.level is not None else source_level(request.map, source.refinement)
    if level is not None and level != source.refinement.finest_level:
        source = Surface(source.refinement.up_to(level))
    places = target.finest_triangles, source.finest_triangles
    # A map may have the vertices of any level: they are the first vertices of every finer level.
    point_map = dense_map(read_images(request.map, places[1]), target.refinement, places[0])
    file_masks = read_masks(request, filed, (request.target, request.source))
    masks = masks_on(file_masks, (target, source))
    masks.require_fit(places[0].n, places[1].n)
    stages("quality")
    quality = measure_quality(point_map, masks=masks)
    options = field_values(request, "weld", "target_weld", "source_weld", "target_mask", "source_mask", "mask_edge")
    parameters = {"method": "map of the user's", "level": request.level, **options}
    notes = [*unit_notes(request.target, request.source), *(note for joined in welded for note in joined.notes)]
    notes += dict.fromkeys(
        f"{joined.mesh.name}: faces of different sizes are split into triangles"
        for joined, surface in zip(welded, (target, source), strict=True)
        if surface.control.n_faces > joined.mesh.n_faces
    )
    provenance = {"parameters": parameters, "inputs": stated, "notes": notes}
    result = MatchResult(target, source, Landmarks.none(), point_map, quality, masks=masks, provenance=provenance)
    stages("write")
    write_result(request.output, result, force=request.force)
    note_match(request)
    text = (
        f"wrote {request.output}: {len(target.vertices)} target vertices, {100 * quality.flipped_area:.2f} % of the "
        f"area folded, {100 * quality.coverage:.1f} % of the source reached"
    )
    if level is not None:
        text += f"\n  its points are taken for those of level {level} of {request.source.name}; --level says another"
    return text, [*notes, *quality.warnings]


def _surface(control: ControlMesh, level: int | None) -> Surface:
    require_valid(control, plain=False)
    if isinstance(control.scheme, Plain) and faces_of_one_size(control) is None:
        control = split_into_fans(control)
    if level is not None and level < 1:
        raise ParameterError(f"--level: expected 1 or more, got {level}. Leave it out to have one chosen.")
    finest = level or choose_level(control, MAP_VERTICES)
    require_size(control, finest)
    return Surface(refine(control, finest, control.scheme))
