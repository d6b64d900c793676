"""`cagemap suggest`: write a landmark file with suggested landmarks of a RESULT, for correction by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap.errors import ParameterError
from cagemap.files.atomic import check_outputs, require_no_input
from cagemap.files.landmarks.curves import is_along_vertices
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.result.folder import ARRAYS, read_result
from cagemap.files.result.manifest import MANIFEST, read_files
from cagemap.files.text import require_suffix
from cagemap.maps.pair import nearest_free_vertices
from cagemap.maps.result import MatchResult
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.mesh_report import count_noun
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.suggest import SuggestRequest

# Radius within which a landmark is taken to decide between answers, of sqrt(area).
LANDMARK_REACH = 0.2
# Weight of the distance from all landmarks, added to the doubt.
DISTANCE_SHARE = 0.5


def run_suggest(request: SuggestRequest, stages: Stages) -> SummaryAndWarnings:
    """Write the landmarks of a result and ``count`` suggested ones."""
    folder, output, count = request.result, request.output, request.count
    check_outputs([output], [folder / MANIFEST, folder / ARRAYS], force=request.force)
    result = read_result(folder)
    require_no_input([output], read_files(folder, result.manifest))
    require_suffix(output, (".json",), "the name of a landmark file")
    landmarks = suggested_landmarks(result, count)
    left_out = [pair.name for pair in landmarks.curves if not is_along_vertices(pair)]
    landmarks = replace(landmarks, curves=tuple(filter(is_along_vertices, landmarks.curves)))
    numbers = [side.control.file_vertices for side in (result.target, result.source)]
    to_file = (lambda vertices, own=own: vertices if own is None else own[vertices] for own in numbers)
    write_landmarks(output, landmarks.renumbered(*to_file), force=request.force)
    target, source = result.target.control.file_vertex, result.source.control.file_vertex
    new = zip(landmarks.names, landmarks.target.tolist(), landmarks.source.tolist(), strict=True)
    lines = [f"  {name}: target vertex {target(a)}, now on source vertex {source(b)}" for name, a, b in [*new][-count:]]
    head = f"{count_noun(count, 'more landmark')} would tell most here:"
    warnings = [
        f"curve '{name}': has points between vertices, which a file of pairs cannot hold, and is not in {output}. Draw "
        "it along vertices, or put the new landmarks into the files of points of both meshes"
        for name in left_out
    ]
    return "\n".join([head, *lines, f"wrote {output}; correct them and match again"]), warnings


def suggested_landmarks(result: MatchResult, count: int) -> Landmarks:
    """Landmarks of a result and ``count`` most informative further ones, paired by the map."""
    target, source = result.point_map.target, result.point_map.source
    vertices = result.target.control.n_vertices
    pairs = result.landmarks
    known, partnered = pairs.target_points.heaviest_corners, pairs.source_points.heaviest_corners
    images = result.point_map.images.positions[:vertices]
    others = result.runner_up_images.reshape(-1, vertices, 3) * source.scale
    trust = result.trust[:vertices]
    counted = result.masks.within(result.shared).of_target(target.n)[:vertices]
    chosen = suggested_vertices(target.positions[:vertices], images, others, trust, np.unique(known), count, counted)
    places = source.positions[: result.source.control.n_vertices]
    partners = nearest_free_vertices(places, images[chosen], partnered)
    taken = set(result.landmarks.names)
    free = [name for i in range(1, count + len(taken) + 1) if (name := f"suggested {i}") not in taken]
    return Landmarks.of_points(
        (*result.landmarks.names, *free[:count]),
        CagePoints.joined((pairs.target_points, CagePoints.of_vertices(chosen))),
        CagePoints.joined((pairs.source_points, CagePoints.of_vertices(partners))),
        result.target.control.name,
        result.source.control.name,
        pairs.curves,
    )


def suggested_vertices(
    places: FloatArray,
    images: FloatArray,
    others: FloatArray,
    trust: FloatArray,
    known: IndexArray,
    count: int,
    counted: FloatArray | float = 1.0,
) -> IndexArray:
    """Control vertices of the target for further landmarks, most useful first.

    The score of a vertex is the distance of its image in other answers, less near landmarks, plus its distance to the
    nearest landmark times its doubt. Each suggestion counts as a landmark for the next. At unit area: places and images
    (n_0, 3) of the control vertices on target and source, and images (r, n_0, 3) by other answers or by the reverse
    map. ParameterError if there are fewer control vertices without a landmark than ``count``; those with one are
    ``known`` (p,). Where ``counted`` (n_0,) is 0, as on parts that the source lacks, they come last.
    """
    if not 1 <= count <= len(places) - len(known):
        raise ParameterError(f"count: expected 1 to {len(places) - len(known)} further landmarks, got {count}")
    apart = np.linalg.norm(others - images, axis=2).max(axis=0, initial=0.0)
    gap = np.full(len(places), 1.0)
    chosen: list[int] = []

    def near(vertex: int) -> FloatArray:
        return np.asarray(np.linalg.norm(places - places[vertex], axis=1))

    for vertex in known:
        gap = np.minimum(gap, near(int(vertex)))
    for _ in range(count):
        score = apart * np.minimum(gap / LANDMARK_REACH, 1.0) + gap * (DISTANCE_SHARE + 1.0 - trust)
        score *= np.greater(counted, 0.0)
        score[[*known.tolist(), *chosen]] = -1.0
        chosen.append(int(np.argmax(score)))
        gap = np.minimum(gap, near(chosen[-1]))
    return np.array(chosen, dtype=np.int64)
