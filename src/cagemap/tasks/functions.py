"""`cagemap functions`: write eigenfunctions and descriptors of a mesh at its vertices (paper, 4 and 5.1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cagemap import research
from cagemap.errors import ParameterError
from cagemap.files.atomic import check_outputs
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.values.attributes import write_attributes
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import require_valid
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.pictures.colors import AMOUNT_SCALE, BALANCE_SCALE, scalar_colors
from cagemap.pipeline import choose_level, prepare_surface
from cagemap.spectral import BasisConfig, Surface
from cagemap.tasks.mesh_commands import require_size
from cagemap.tasks.method import parse_schedule, with_laplacian
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.functions import FunctionsRequest
from cagemap.tasks.requests.options import refuse_unread
from cagemap.tasks.subdivision import SubdivisionRequest, weld_asked

FUNCTION_VERTICES = 50_000
EIGENFUNCTIONS = "eigenfunctions"
KINDS = (EIGENFUNCTIONS, "heat-signatures", "wave-signatures", "heat-kernels", "wave-kernels")
ARRAYS = (".npz", ".npy", ".csv")


def run_functions(request: FunctionsRequest, stages: Stages) -> SummaryAndWarnings:
    """Write functions of a mesh as arrays or vertex colours; returns a summary and notes."""
    kinds = _kinds(request)
    check_outputs([request.output], [request.mesh], force=request.force)
    basis = _basis(request)
    stages("read")
    file_mesh = read_mesh(request.mesh)
    welded = weld_asked(file_mesh, request.weld)
    subdivision = SubdivisionRequest(request.scheme, request.boundary, None, request.creasing)
    control = subdivision.apply(welded.mesh)
    notes = [*welded.notes, *subdivision.unused_notes([control])]
    require_valid(control, plain=False)
    points = welded.vertex_of[_points(request, kinds, file_mesh)]
    level = choose_level(control, FUNCTION_VERTICES) if request.level is None else request.level
    require_size(control, level)
    at = level if request.at is None else request.at
    if at > level:
        raise ParameterError(f"--at: expected a level from 0 to {level}, got {at}")
    _require_column(request, _most_columns(request, basis, kinds[0], len(points)))
    surface = prepare_surface(control, level, basis, progress=stages)
    if at < surface.basis.last_level and basis.schedule is None and not surface.refinement.is_plain:
        # Functions of a level coarser than the basis are computed on that level.
        surface = prepare_surface(control, level, replace(basis, schedule=(*(0 for _ in range(at)), request.k)))
    stages("functions")
    arrays = functions_at(surface, at, kinds, (request.heat, request.wave), points)
    stages("write")
    count, n = sum(arrays[name].shape[1] for name in _names(kinds)), len(arrays[_names(kinds)[0]])
    stages.record({"functions": count, "vertices": n, "level": at, "eigenvalues": arrays["eigenvalues"].tolist()})
    if request.output.suffix.lower() == ".ply":
        column = _write_colors(request, surface, at, arrays[_names(kinds)[0]])
        text = f"wrote {request.output}: {kinds[0]} {column} in colours, at {n} vertices of level {at}"
        return text, notes
    if request.output.suffix.lower() != ".npz":
        arrays = {name: arrays[name] for name in _names(kinds)}
    write_attributes(request.output, arrays, force=request.force)
    text = f"wrote {request.output}: {count} functions ({', '.join(kinds)}) at {n} vertices of level {at}"
    return text, notes


def functions_at(
    surface: Surface, level: int, kinds: tuple[str, ...], filters: tuple[int, int], points: IndexArray
) -> dict[str, FloatArray]:
    """Functions of some `KINDS` at the vertices of a level, with their eigenvalues, areas and filters.

    ``filters``: (int, int), numbers of heat and wave filters.
    ``points``: (p,), control vertices that kernels start from. Returns (n, q) of each kind, by its name with ``_`` for
        ``-``; ``eigenvalues`` (k,), ``vertex_areas`` (n,); with signatures and kernels ``heat_times``,
        ``wave_energies``; with kernels ``points``. Kernel j of point i is column ``i q + j``.
    """
    on = surface.finest_level if surface.refinement.is_plain else level
    rows, eigenvalues = research.eigenfunctions(surface, on)
    arrays = {"eigenvalues": eigenvalues, "vertex_areas": surface.triangles(on).vertex_areas}
    heat, wave = filters
    values: dict[str, FloatArray] = {EIGENFUNCTIONS: rows}
    if set(kinds) - {EIGENFUNCTIONS}:
        filter_bank = research.heat_and_wave_filters(surface, surface, heat, wave)
        arrays |= {"heat_times": filter_bank.times, "wave_energies": filter_bank.energies}
        signatures = research.signature_functions(surface, filter_bank, on)
        values |= {"heat-signatures": signatures[:, :heat], "wave-signatures": signatures[:, heat:]}
        if any(kind.endswith("kernels") for kind in kinds):
            arrays["points"] = points.astype(np.float64)
            kernels = research.landmark_functions(surface, filter_bank, points, on)
            table = kernels.reshape(len(rows), len(points), heat + wave)
            values["heat-kernels"] = table[:, :, :heat].reshape(len(rows), -1)
            values["wave-kernels"] = table[:, :, heat:].reshape(len(rows), -1)
    for kind, name in zip(kinds, _names(kinds), strict=True):
        arrays[name] = values[kind]
    return arrays


def _kinds(request: FunctionsRequest) -> tuple[str, ...]:
    kinds = tuple(kind.strip() for kind in request.kinds.split(","))
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown or len(set(kinds)) < len(kinds):
        raise ParameterError(f"--kinds: expected some of {', '.join(KINDS)}, each once, got {request.kinds!r}.")
    suffix = request.output.suffix.lower()
    if suffix not in (*ARRAYS, ".ply"):
        raise ParameterError(
            f"--output: expected a name ending in {', '.join(ARRAYS)} or .ply, got {request.output.name!r}. Arrays go "
            "beside any mesh: rows are the vertices that `cagemap refine` writes."
        )
    if len(kinds) > 1 and suffix in (".npy", ".ply"):
        raise ParameterError(f"--kinds: expected one kind for {suffix}, got {len(kinds)}. Write an .npz.")
    if request.column is not None and suffix != ".ply":
        raise ParameterError("--column: expected a .ply with it, which shows one function in colours.")
    read_by = {
        option: [f"--kinds {kind}" for kind in KINDS if word in kind]
        for option, word in (("heat", "heat"), ("wave", "wave"), ("points", "kernels"))
    }
    refuse_unread(request, read_by, [f"--kinds {kind}" for kind in kinds])
    return kinds


def _basis(request: FunctionsRequest) -> BasisConfig:
    schedule = None if request.schedule is None else parse_schedule(request.schedule)
    if request.literal and schedule is None:
        raise ParameterError("--literal: expected a --schedule with it, as in Definition 2, got none.")
    basis = BasisConfig(request.k, schedule, request.accuracy, request.literal)
    return with_laplacian(basis, request.laplacian, "--laplacian")


def _points(request: FunctionsRequest, kinds: tuple[str, ...], control: ControlMesh) -> IndexArray:
    """Control vertices that kernels start from; none without kernels."""
    if not any(kind.endswith("kernels") for kind in kinds):
        return np.zeros(0, dtype=np.int64)
    try:
        numbers = [int(word) for word in (request.points or "").split(",")]
    except ValueError:
        numbers = []
    if not numbers or min(numbers) < 0 or max(numbers) >= control.n_vertices:
        raise ParameterError(
            f"--points: expected control vertices from 0 to {control.n_vertices - 1}, such as 0,12,40, for kernels to "
            f"start from, got {request.points!r}."
        )
    return np.array(numbers, dtype=np.int64)


def _names(kinds: tuple[str, ...]) -> list[str]:
    return [kind.replace("-", "_") for kind in kinds]


def _most_columns(request: FunctionsRequest, basis: BasisConfig, kind: str, points: int) -> int:
    """Largest number of functions of a kind; a small mesh has fewer eigenfunctions."""
    if kind == EIGENFUNCTIONS:
        return max(basis.count, sum(basis.schedule or ()))
    filters = request.heat if kind.startswith("heat") else request.wave
    return filters * points if kind.endswith("kernels") else filters


def _require_column(request: FunctionsRequest, count: int) -> None:
    if request.column is not None and request.column >= count:
        raise ParameterError(f"--column: expected a function from 0 to {count - 1}, got {request.column}")


def _write_colors(request: FunctionsRequest, surface: Surface, level: int, values: FloatArray) -> int:
    """Write the mesh of a level with one function as vertex colours; returns the function's column."""
    signed = values.min() < 0.0
    spread = np.ptp(values, axis=0) > 1e-6 * max(float(np.abs(values).max()), np.finfo(float).tiny)
    _require_column(request, values.shape[1])
    column = int(np.argmax(spread)) if request.column is None else request.column
    shown = values[:, column]
    most = float(np.abs(shown).max())
    ends = (-most, most, BALANCE_SCALE) if signed else (float(shown.min()), float(shown.max()), AMOUNT_SCALE)
    net = surface.refinement.levels[level]
    mesh = surface.control if net.faces is None else ControlMesh.from_faces(net.positions, net.faces)
    write_mesh(request.output, replace(mesh, vertex_colors=scalar_colors(shown, *ends)), force=request.force)
    return column
