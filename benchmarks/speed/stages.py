"""Every stage beside its physical limit: bytes it must move or operations it must do, at this machine's rates."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.speed.measure import Figures, timed

ELEMENTS = 1 << 24  # of the arrays that the rates are measured with: 128 MB, far beyond any cache
SIDE = 1500  # of the matrices multiplied


def machine_rates() -> Figures:
    """Bytes a second that one core copies (read and written); its operations a second in a matrix product."""
    source, target = np.ones(ELEMENTS), np.zeros(ELEMENTS)
    matrix = np.ones((SIDE, SIDE))
    copy = min(_seconds(lambda: np.copyto(target, source)) for _ in range(4))
    product = min(_seconds(lambda: matrix @ matrix) for _ in range(4))
    return {"bytes": 2 * source.nbytes / copy, "flops": 2 * SIDE**3 / product}


def measure_stages(control: Any, level: int, count: int, run: Callable[[Any], Any]) -> Figures:
    """Stages of preparing one surface, then of a match of ``run``'s making; each with its least work.

    Parameters
    ----------
    control : ControlMesh
    run : callable
        Surface -> MatchResult, with that surface as target.
    """
    from cagemap.files.result.folder import write_result
    from cagemap.files.result.surface_store import load_surface, save_surface
    from cagemap.numerics.threads import one_blas_thread
    from cagemap.pipeline import MAP_BASIS, judge
    from cagemap.spectral.surface import Surface
    from cagemap.subdivision import refine

    with one_blas_thread(), tempfile.TemporaryDirectory() as folder:
        times: Figures = {}
        rates, config = machine_rates(), replace(MAP_BASIS, count=count)
        with timed(times, "refine"):
            refinement = refine(control, level)
        surface, place = Surface(refinement, config), Path(folder) / "surface.npz"
        with timed(times, "operators"):
            operators = surface.operators
        with timed(times, "basis"):
            basis = surface.basis
        with timed(times, "store a surface"):
            save_surface(place, surface)
        with timed(times, "load a surface"):
            load_surface(place)
        result = run(surface)
        with timed(times, "quality"):
            judge(result.target, result.point_map)
        with timed(times, "write the result"):
            write_result(Path(folder) / "RESULT", result)
        written = sum(file.stat().st_size for file in (Path(folder) / "RESULT").iterdir())
        matrices = sum(map(_sparse_bytes, refinement.matrices))
        levels = sum(
            array.nbytes for mesh in refinement.levels for array in vars(mesh).values() if isinstance(array, np.ndarray)
        )
        patterns = sum(map(_sparse_bytes, operators.stiffness)) + sum(mass.data.nbytes for mass in operators.mass)
        bands = sum(4 * len(band) * band.shape[1] ** 2 for band in basis.bands)
        work = {
            "refine": ("bytes", matrices + levels, "matrices and meshes written once"),
            "operators": ("bytes", matrices + patterns, "S read once, W and M written once"),
            "basis": ("flops", bands, "one Gram matrix and one rotation of every band"),
            "store a surface": ("bytes", 2 * place.stat().st_size, "its file read from memory and written once"),
            "load a surface": (
                "bytes",
                2 * place.stat().st_size + matrices + levels,
                "its file read once, levels written",
            ),
            "quality": ("bytes", _mesh_bytes(result.target) + _mesh_bytes(result.source), "both meshes read once"),
            "write the result": ("bytes", 2 * written, "its files read from memory and written once"),
        }
    rows = {
        name: {"cpu": times[name]["cpu"], "wall": times[name]["wall"], "limit": amount / rates[unit], "work": note}
        | {"amount": amount, "unit": unit}
        for name, (unit, amount, note) in work.items()
    }
    return {"rates": rates, "rows": rows, "vertices": refinement.finest.n_vertices, "map": result.timings}


def _mesh_bytes(surface: Any) -> int:
    finest = surface.refinement.finest
    return int(finest.positions.nbytes + finest.faces.nbytes)


def _sparse_bytes(matrix: Any) -> int:
    return int(matrix.data.nbytes + matrix.indices.nbytes + matrix.indptr.nbytes)


def _seconds(work: Callable[[], Any]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start
