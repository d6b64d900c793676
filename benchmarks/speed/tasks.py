"""What runs in a process of its own: each task checks its result, then says what it took.

``python -m benchmarks.speed.tasks NAME ARGUMENTS.json ANSWER.json``
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.speed.data import BASIS_CAGE, PAIRS, HumanPair
from benchmarks.speed.measure import Figures, timed

# Bars of the accuracy issues, x100 of sqrt(area), with room for other machines' roundings: a fast wrong map is no map.
MEAN_ERROR = 2.6
# Largest relative error of eigenvalues of one level with 20 vertices a function.
MOST_ERROR = 0.05
WARM_LEVEL = 1
# Of the inverted problem, below the spectrum, where SciPy can use any factorisation.
SHIFT = -1.0


def basis(level: int, count: int, exact: bool) -> Figures:
    """Our basis of one level, and exact ones on the same finest operators.

    The exact ones: SciPy's with its own factorisation, SciPy's with ours, and ours. And the paper's comparison (its
    Table 1): a fixed schedule of as many functions against our exact one, same solver, same accuracy.
    """
    from scipy.sparse.linalg import LinearOperator, eigsh

    from cagemap.files.meshes.formats import read_mesh
    from cagemap.numerics.sparse_algebra import factor
    from cagemap.numerics.threads import one_blas_thread
    from cagemap.operators import build_operators
    from cagemap.spectral import BasisConfig, band_pairs, hierarchical_basis
    from cagemap.subdivision import refine

    figures: Figures = {"count": count}
    control = read_mesh(BASIS_CAGE)
    warm = refine(control, WARM_LEVEL)
    hierarchical_basis(warm, build_operators(warm), BasisConfig(count=20))
    with timed(figures, "refine"):
        refinement = refine(control, level)
    with timed(figures, "operators"):
        operators = build_operators(refinement)
    figures["vertices"] = refinement.finest.n_vertices
    with one_blas_thread(), timed(figures, "ours"):
        made = hierarchical_basis(refinement, operators, BasisConfig(count=count))
    figures["level"] = made.last_level
    if not exact:
        return figures
    stiffness, mass = operators.stiffness[-1], operators.mass[-1]
    asked = {"k": count, "M": mass, "sigma": SHIFT, "which": "LM"}
    with timed(figures, "eigsh"):
        values = np.sort(eigsh(stiffness, **asked)[0])
    with one_blas_thread(), timed(figures, "eigsh, our factorisation"):
        shifted = factor(stiffness - SHIFT * mass)
        eigsh(stiffness, OPinv=LinearOperator(stiffness.shape, shifted.solve), **asked)
    with one_blas_thread(), timed(figures, "ours exact"):
        band_pairs(stiffness, mass, 0, count, accuracy=BasisConfig.accuracy)
    figures["fixed schedule"] = [count - 3 * (count // 5), *[count // 5] * 3]
    with one_blas_thread(), timed(figures, "fixed"):
        hierarchical_basis(refinement, operators, BasisConfig(schedule=tuple(figures["fixed schedule"])))
    errors = (made.eigenvalues - values) / np.maximum(values, values[1])
    figures["error"] = float(np.abs(errors).max())
    if not figures["error"] <= MOST_ERROR:
        raise AssertionError(f"eigenvalues: expected within {MOST_ERROR:g}, got {figures['error']:.2e}")
    return figures


def warm_up() -> Figures:
    """Compile every kernel of a match and a bake, where that has not been done; seconds of each compiled now."""
    from numba.core import event

    with tempfile.TemporaryDirectory() as cache, event.install_recorder("numba:compile") as recorder:
        surfaces = _surfaces(PAIRS["proxies"], WARM_LEVEL, 50, cache)
        result = _match(PAIRS["proxies"], surfaces)
        _bake(result, 256)
    return {"kernels": _compile_seconds(recorder.buffer)}


def _compile_seconds(records: list[tuple[float, Any]]) -> dict[str, float]:
    """Wall seconds of each outermost kernel; what it calls is compiled within it."""
    seconds: dict[str, float] = {}
    open_since: dict[int, list[tuple[str, float]]] = {}
    for when, record in records:
        stack = open_since.setdefault(record.data.get("thread", 0), [])
        if record.is_start:
            function = record.data["dispatcher"].py_func
            stack.append((f"{function.__module__.removeprefix('cagemap.')}.{function.__name__}", when))
        elif stack:
            name, since = stack.pop()
            if not stack:
                seconds[name] = seconds.get(name, 0.0) + when - since
    return dict(sorted(seconds.items(), key=lambda item: -item[1]))


def check_map(pair: str, result: str) -> Figures:
    """Mean error of a stored match against the true map, x100 of sqrt(area)."""
    from cagemap.files.result.folder import read_result

    stored = read_result(result)
    return _assert_accurate(
        PAIRS[pair], stored.target.finest_level, stored.source.finest_level, stored.triangle, stored.barycentric
    )


def prepared_match(pair: str, level: int, count: int, cache: str, output: str) -> Figures:
    """A match of two prepared surfaces, read from where they are stored (the first call stores them)."""
    from cagemap.files.result.folder import write_result

    figures: Figures = {}
    _surfaces(PAIRS[pair], level, count, cache)
    with timed(figures, "total"):
        with timed(figures, "load"):
            surfaces = _surfaces(PAIRS[pair], level, count, cache)
        with timed(figures, "match"):
            result = _match(PAIRS[pair], surfaces)
        with timed(figures, "write"):
            write_result(output, result)
    return figures | {"vertices": _sizes(surfaces)}


def landmark_added(pair: str, level: int, count: int, cache: str) -> Figures:
    """From one landmark more to the new map, from the map before it; a whole new match beside it."""
    from cagemap.pipeline import update_match

    figures: Figures = {}
    surfaces = _surfaces(PAIRS[pair], level, count, cache)
    whole = _landmarks(PAIRS[pair])
    fewer = replace(whole, names=whole.names[:-1], target=whole.target[:-1], source=whole.source[:-1])
    before = _match(PAIRS[pair], surfaces, fewer)
    update_match(before, fewer)  # what is compiled or loaded on first use
    with timed(figures, "preview"):
        result = update_match(before, whole)
    with timed(figures, "match again"):
        _match(PAIRS[pair], surfaces, whole)
    figures |= _assert_accurate(
        PAIRS[pair],
        level,
        level,
        result.point_map.triangle,
        result.point_map.barycentric,
    )
    return figures | {"vertices": _sizes(surfaces), "timings": result.timings}


def bake(result: str, sizes: list[int]) -> Figures:
    """A texture through a stored map, in memory; first the map that is the identity must give the texture back."""
    from cagemap.files.result.folder import read_result
    from cagemap.maps.point_map import PointMap
    from cagemap.surface.triangle_surface import TriangleSurface
    from cagemap.transfer import bake_texture, prepare_transfer

    figures: Figures = {}
    stored = read_result(result)
    source, target = stored.source.refinement.finest, stored.target.refinement.finest
    figures["identity error"] = _identity_error(source)
    surfaces = (TriangleSurface.from_faces(side.positions, side.faces) for side in (target, source))
    point_map = PointMap.from_arrays(*surfaces, stored.triangle, stored.barycentric)
    with timed(figures, "prepare"):
        transfer = prepare_transfer(target, source, point_map)
    for size in sizes:
        texture = _smooth_texture(size)
        with timed(figures, f"bake {size}"):
            bake_texture(transfer, texture, size=size, dtype=texture.dtype)
    return figures


def peer(pair: str, level: int, python: str, budget: float, folder: str) -> Figures:
    """pyFM on the triangulated finest meshes with the same landmarks, and its error."""
    import subprocess

    from cagemap.files.meshes.formats import read_mesh
    from cagemap.subdivision import refine, triangles

    chosen = PAIRS[pair]
    landmarks = _landmarks(chosen)
    arrays: dict[str, Any] = {"landmarks": np.column_stack([landmarks.source, landmarks.target])}
    for side, file in (("source", chosen.source_file), ("target", chosen.target_file)):
        finest = refine(read_mesh(file), level).finest
        arrays |= {f"{side}_vertices": finest.positions, f"{side}_triangles": triangles(finest.faces)}
    given, answer = Path(folder) / "given.npz", Path(folder) / "answer.npz"
    np.savez(given, **arrays)
    worker = Path(__file__).with_name("pyfm_worker.py")
    done = subprocess.run(
        [python, str(worker), str(given), str(answer), str(budget)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"pyFM failed: {done.stderr[-2000:]}")
    stored = np.load(answer)
    match = stored["match"]
    # A vertex of the source as a point: the corner of any triangle around it.
    source_triangles = arrays["source_triangles"]
    triangle = np.empty(len(arrays["source_vertices"]), dtype=np.int64)
    corner = np.empty_like(triangle)
    for place in range(3):
        triangle[source_triangles[:, place]], corner[source_triangles[:, place]] = (
            np.arange(len(source_triangles)),
            place,
        )
    barycentric = np.eye(3)[corner[match]]
    error = _mean_error(chosen, level, level, triangle[match], barycentric)
    stages = dict(zip(stored["stages"].tolist(), stored["seconds"].tolist(), strict=True))
    return {
        "vertices": [len(arrays["target_vertices"]), len(arrays["source_vertices"])],
        "stages": stages,
        "total": sum(stages.values()),
        "steps": [int(stored["steps"]), int(stored["wanted"])],
        "mean error": error,
    }


def stages(pair: str, level: int, count: int, cache: str) -> Figures:
    """Every stage beside its physical limit."""
    from benchmarks.speed.stages import measure_stages
    from cagemap.files.meshes.formats import read_mesh

    chosen = PAIRS[pair]
    source = _surfaces(chosen, level, count, cache)[1]
    return measure_stages(read_mesh(chosen.target_file), level, count, lambda target: _match(chosen, (target, source)))


def _surfaces(pair: HumanPair, level: int, count: int, cache: str) -> tuple[Any, Any]:
    from cagemap.files.meshes.formats import read_mesh
    from cagemap.files.result.surface_store import load_or_prepare
    from cagemap.numerics.threads import in_threads
    from cagemap.pipeline import MAP_BASIS

    config = replace(MAP_BASIS, count=count)
    files = [pair.target_file, pair.source_file]
    target, source = in_threads(lambda file: load_or_prepare(cache, read_mesh(file), level, config), files)
    return target, source


def _landmarks(pair: HumanPair) -> Any:
    from cagemap.files.landmarks.pairs import read_landmarks

    return read_landmarks(pair.landmarks, pair.target_file, pair.source_file)[0]


def _match(pair: HumanPair, surfaces: tuple[Any, Any], landmarks: Any = None) -> Any:
    from cagemap.pipeline import match

    return match(*surfaces, landmarks or _landmarks(pair))


def _sizes(surfaces: tuple[Any, Any]) -> list[int]:
    return [surface.refinement.finest.n_vertices for surface in surfaces]


def _mean_error(pair: HumanPair, target_level: int, source_level: int, triangle: Any, barycentric: Any) -> float:
    """Mean distance on the source between the map and the true one, x100 of sqrt(area) (protocol B)."""
    from benchmarks.truth import true_map
    from cagemap.files.meshes.formats import read_mesh
    from cagemap.subdivision import refine
    from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface

    def finest(file: Any, level: int) -> TriangleSurface:
        mesh = refine(read_mesh(file), level).finest
        return TriangleSurface.from_faces(mesh.positions, mesh.faces)

    levels = (target_level, source_level)
    truth = true_map(*(finest(f, n) for f, n in zip(pair.neutral_files, levels, strict=True)))
    source = finest(pair.source_file, source_level)
    image = SurfacePoints(source, triangle, barycentric).positions
    return float(100 * np.linalg.norm(image - truth.on(source).positions, axis=1)[truth.known].mean())


def _assert_accurate(*arguments: Any) -> Figures:
    error = _mean_error(*arguments)
    if not error <= MEAN_ERROR:
        raise AssertionError(
            f"map: expected a mean error of at most {MEAN_ERROR} (x100 of sqrt(area)), got {error:.2f}"
        )
    return {"mean error": error}


def _smooth_texture(size: int) -> Any:
    """A texture whose colour is a smooth function of the place: red by column, green by row, blue by both."""
    line = (np.arange(size) + 0.5) / size
    blue = 0.5 + 0.5 * np.sin(6 * line)[:, None] * np.cos(5 * line)[None, :]
    image = np.stack([*np.broadcast_arrays(line[None, :], line[:, None], blue)], axis=2)
    return np.rint(255 * image).astype(np.uint8)


def _identity_error(level: Any, size: int = 1024) -> float:
    """Largest difference, of 255, between a texture and itself baked through the identity, inside the islands."""
    from cagemap.maps.point_map import PointMap
    from cagemap.surface.triangle_surface import TriangleSurface
    from cagemap.transfer import bake_texture, prepare_transfer

    surface = TriangleSurface.from_faces(level.positions, level.faces)
    identity = PointMap.from_vertices(surface, surface, np.arange(surface.n))
    texture = _smooth_texture(size)
    baked = bake_texture(prepare_transfer(level, level, identity), texture, size=size, dtype=texture.dtype)
    inside = _covered(level, size)
    difference = np.abs(baked.astype(int) - texture.astype(int)).max(axis=2)[inside]
    share = float(np.mean(difference > 2))
    if share > 0.01:
        raise AssertionError(f"bake: expected the identity to keep the texture, {100 * share:.1f} % of texels differ")
    return float(np.percentile(difference, 99))


def _covered(level: Any, size: int) -> Any:
    """(size, size) whether a texel lies inside an island: some face's centre is in it."""
    centres = level.uvs[level.uv_indices].mean(axis=1)
    column = np.clip((centres[:, 0] * size).astype(int), 0, size - 1)
    row = np.clip(((1 - centres[:, 1]) * size).astype(int), 0, size - 1)
    covered = np.zeros((size, size), dtype=bool)
    covered[row, column] = True
    return covered


def _bake(result: Any, size: int) -> None:
    from cagemap.transfer import bake_texture, prepare_transfer

    levels = result.target.refinement.finest, result.source.refinement.finest
    texture = _smooth_texture(size)
    bake_texture(prepare_transfer(*levels, result.point_map), texture, size=size, dtype=texture.dtype)


TASKS = {
    task.__name__: task for task in (basis, warm_up, check_map, prepared_match, landmark_added, stages, bake, peer)
}


if __name__ == "__main__":
    name, arguments, answer = sys.argv[1:]
    Path(answer).write_text(json.dumps(TASKS[name](**json.loads(arguments))))
