"""Single steps of the method, for research with own meshes, descriptors, operators and maps.

docs/researchers.md explains the functions, docs/recipes.md has short programs. A map is a `PointMap` of the finest
levels, a functional map C12 of any size, a `LevelMap`, or a finest source vertex for every target vertex of a level:
`zoomout`, `elastic`, `project`, `unfold`, `judge`, `point_map`, `functional_map_of` and the ``start`` of `paper_map`
and `hfm_map` take all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse

from cagemap.deform.problem import PreparedPair, Problem
from cagemap.errors import ParameterError
from cagemap.maps.functional_maps import (
    LevelMap,
    MapLike,
    check_map,
    from_bases,
    image_positions,
    to_bases,
    zoomout_of_map,
)
from cagemap.maps.functional_maps import functional_map_from as functional_map_of
from cagemap.maps.hypotheses.search import search_placements
from cagemap.maps.pair import LevelPair, Pair, SymmetryPair, cage_points_of, point_pairs, symmetry_pairs
from cagemap.maps.point_map import PointMap
from cagemap.maps.projection.project import held_vertices, map_of_places
from cagemap.maps.projection.project import project as _project
from cagemap.maps.projection.project import unfold as _unfold
from cagemap.maps.quality import QualityFigures
from cagemap.maps.quality import judge as _judge
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.inputs import LandmarksLike, arrays_accepted, control_mesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import FloatArray, IndexArray, array_of, whole_numbers
from cagemap.numerics.kinds import kinds_checked
from cagemap.paper.constraints import (
    ConstraintConfig,
    Constraints,
    Filters,
    choose_filters,
    gather_constraints,
    landmark_descriptors,
    signature_functions,
)
from cagemap.paper.equations import extend_functional_map, solve_functional_map
from cagemap.paper.hfm import HfmConfig, hfm_map
from cagemap.paper.method import (
    PaperConfig,
    basis_sizes,
    finer_level_pairs,
    paper_map,
    recover_points,
    search_level,
    search_levels,
)
from cagemap.paper.symmetries import check_symmetry
from cagemap.pipeline import MAP_BASIS, MatchResult, prepare_pair, prepare_surface
from cagemap.spectral import BasisConfig, Surface
from cagemap.spectral.zoomout import ZoomOutSchedule
from cagemap.surface.triangle_surface import SurfacePoints

__all__ = [
    "ConstraintConfig",
    "Constraints",
    "HfmConfig",
    "PaperConfig",
    "ZoomOutSchedule",
    "control_mesh",
    "eigenfunctions",
    "elastic",
    "from_bases",
    "functional_map",
    "functional_map_of",
    "gather_constraints",
    "heat_and_wave_filters",
    "hfm_map",
    "judge",
    "landmark_functions",
    "make_pair",
    "paper_map",
    "point_map",
    "prepare",
    "project",
    "recover_points",
    "result_of_map",
    "signature_functions",
    "tensors",
    "to_bases",
    "transport",
    "unfold",
    "zoomout",
]


# As many functions as a match uses, and operators of every level.
FULL_BASIS = replace(MAP_BASIS, vertices=None)


@kinds_checked
def prepare(mesh: Any, level: int, basis: BasisConfig = FULL_BASIS, name: str = "mesh") -> Surface:
    """Refine a mesh, build its operators and its basis, see `control_mesh` and `cagemap.prepare_surface`."""
    return prepare_surface(control_mesh(mesh, name), level, basis)


@arrays_accepted
def make_pair(
    target: Surface,
    source: Surface,
    landmarks: LandmarksLike | None = None,
    symmetries: Sequence[SymmetryPair] = (),
) -> Pair:
    """Make a pair of prepared surfaces with landmarks and self-maps.

    Parameters
    ----------
    target, source : Surface
    landmarks : Landmarks or (p, 2) array, optional
        As in `cagemap.match`; an array has rows (target vertex, source vertex).
    symmetries : sequence of ((n_0 target,), (n_0 source,)) arrays
        As in `Pair`; `cagemap.mesh.mirrors.mirror_symmetries` finds some.

    Raises
    ------
    ParameterError, InvalidLandmarksError
        If the landmarks are no pairs of vertices, a self-map is not one of control vertices, or a mesh with
        symmetries is plain.
    """
    self_maps = symmetry_pairs(symmetries)
    for on_target, on_source in self_maps:
        check_symmetry(on_target, target.control)
        check_symmetry(on_source, source.control)
    return Pair(target, source, point_pairs(target, source, landmarks or Landmarks.none()), self_maps)


@kinds_checked
def eigenfunctions(surface: Surface, level: int) -> tuple[FloatArray, FloatArray]:
    """Basis functions (n, k) at a level's vertices, and eigenvalues (k,) at unit area."""
    return surface.basis.at(level), surface.basis.eigenvalues[: surface.basis.size(level)]


@kinds_checked
def heat_and_wave_filters(target: Surface, source: Surface, heat: int = 10, wave: int = 20) -> Filters:
    """Filters rho_t for two surfaces; `signature_functions` and `landmark_functions` take them."""
    return choose_filters(target.basis.eigenvalues, source.basis.eigenvalues, heat, wave)


@kinds_checked
def landmark_functions(surface: Surface, filters: Filters, vertices: IndexArray, level: int) -> FloatArray:
    """Landmark descriptors Phi~ rho_t(Lambda~) Phi~^T delta_v (Definition 3) at a level's vertices; (n, p q)."""
    rows = surface.basis.rows(level, whole_numbers(vertices, "vertices"))
    at_eigenvalues = filters.at(surface.basis.eigenvalues[: surface.basis.size(level)])
    return surface.basis.at(level) @ landmark_descriptors(rows, at_eigenvalues)


@kinds_checked
def functional_map(
    pair: Pair, constraints: Constraints, config: ConstraintConfig = ConstraintConfig(), levels: LevelPair | None = None
) -> FloatArray:
    """C12 from constraints alone: eq. 13 on level 0, then eqs. 14-16 for every band.

    Parameters
    ----------
    pair : Pair
    constraints : Constraints
        From `gather_constraints`, or others.
    config : ConstraintConfig
        ``laplacian``, ``operators`` and ``decay`` are read.
    levels : (int, int), optional
        Last levels; default: the finest. ParameterError for others than the pair has.
    """
    last = pair.levels(levels)
    level_pairs = [(min(l1, last[0]), min(l2, last[1])) for l1, l2 in [(0, 0), *finer_level_pairs(pair, (0, 0))]]
    matrix = solve_functional_map(constraints.leading(*basis_sizes(pair, (0, 0))), config)
    for level_pair in level_pairs[1:]:
        sizes = basis_sizes(pair, level_pair)
        if sizes != matrix.shape:
            matrix = extend_functional_map(matrix, constraints.leading(*sizes), config)
    return matrix


@kinds_checked
def point_map(pair: Pair, map_like: MapLike) -> PointMap:
    """T12 of a functional map without refinement (5.4).

    Full search on a coarse level, search among candidates on finer levels, then vertex to point.

    Parameters
    ----------
    pair : Pair
        Its landmarks are not used.
    map_like : map
        C12 on the leading basis functions of both surfaces. Vertex maps of the finest level and point maps are kept;
        vertex maps of coarser levels are converted to C12 first.
    """
    checked_map = check_map(pair, map_like)
    if isinstance(checked_map, PointMap):
        return checked_map
    if checked_map.ndim == 1 and len(checked_map) == len(pair.target.vertices):
        return PointMap.from_vertices(pair.target.finest_triangles, pair.source.finest_triangles, checked_map)
    matrix = functional_map_of(pair, checked_map)
    start = search_levels(pair.target, pair.source, HfmConfig().search_vertices)
    level_map = LevelMap(start, matrix, search_level(pair, matrix, start))
    for levels in finer_level_pairs(pair, start):
        level_map = LevelMap(levels, matrix, search_level(pair, matrix, levels, level_map))
    return recover_points(pair, level_map)


@kinds_checked
def zoomout(pair: Pair, start: MapLike, schedule: ZoomOutSchedule = ZoomOutSchedule()) -> FloatArray:
    """C12 (k1, k2) by ZoomOut from any map, on sampled vertices."""
    return zoomout_of_map(pair, start, schedule)


@kinds_checked
def elastic(pair: Pair, start: MapLike | None = None, prepared: PreparedPair | None = None) -> PointMap:
    """T12 by the elastic fit from any map: deform, project, unfold; landmarks are constraints.

    Parameters
    ----------
    pair : Pair
        With at least three landmarks, a fit from these competes with the fit from the start.
    start : map, optional
        Default: as in `cagemap.match`.
    prepared : PreparedPair, optional
        From `cagemap.prepare_pair`, for several calls.

    Raises
    ------
    ParameterError
        If the start is not a map of this pair, or ``prepared`` is of other surfaces.
    """
    problem = Problem(prepare_pair(pair.target, pair.source) if prepared is None else prepared, pair.landmarks)
    places = None
    if start is not None:
        places = image_positions(pair, start, problem.prepared.vertices[problem.coarse_clusters.vertices])
    return map_of_places(problem, search_placements(problem, start=places)[0].map_positions)


@kinds_checked
def project(pair: Pair, start: MapLike, prepared: PreparedPair | None = None) -> PointMap:
    """T12 of closest points to a subdivision surface through the images of about 3000 vertices.

    Parameters
    ----------
    pair : Pair
    start : map, or (n, 3) array
        Or positions, at the source's unit area, of the vertices of ``prepared.mesh``.
    prepared : PreparedPair, optional
        As in `elastic`; ParameterError if it is of other surfaces.
    """
    prepared = prepare_pair(pair.target, pair.source) if prepared is None else prepared
    prepared = Problem(prepared, pair.landmarks).prepared  # of the same surfaces
    places = None if isinstance(start, PointMap) else array_of(start)
    if places is None or places.shape != (prepared.mesh.n, 3):
        places = image_positions(pair, start, prepared.vertices)
    return _project(prepared, places, pair.landmarks)


@kinds_checked
def unfold(pair: Pair, map_like: MapLike) -> PointMap:
    """T12 without most of its folds, see `cagemap.unfold`; images of landmarks stay."""
    return _unfold(point_map(pair, map_like), held_vertices(pair.landmarks))


@kinds_checked
def judge(pair: Pair, map_like: MapLike) -> QualityFigures:
    """Quality figures of any map without ground truth, see `cagemap.judge`."""
    return _judge(pair.target, point_map(pair, map_like), pair.landmarks)


@kinds_checked
def transport(pair: Pair, matrix: FloatArray, values: FloatArray, level: int, to: int) -> FloatArray:
    """Functions from source to target through C alone (5.4), smoothed by the bases.

    Parameters
    ----------
    pair : Pair
    matrix : (k1, k2) array
    values : (n2,) or (n2, q) array
        At the source's vertices of ``level``.
    level, to : int
        Levels of the source and of the target.

    Returns
    -------
    (n1,) or (n1, q) array
    """
    matrix = functional_map_of(pair, matrix)
    k1, k2 = matrix.shape
    coefficients = matrix @ pair.source.basis.project(values, level, count=k2)
    rows = pair.target.basis.at(to)
    if rows.shape[1] < k1:
        raise ParameterError(f"level {to} of the target has {rows.shape[1]} of {k1} functions: take a finer one")
    return np.asarray(rows[:, :k1] @ coefficients)


@kinds_checked
def result_of_map(pair: Pair, point_map: PointMap, names: Sequence[str] = ()) -> MatchResult:
    """A result, with quality figures, of any point map of the finest levels.

    Parameters
    ----------
    pair : Pair
    point_map : PointMap
        See its ``from_vertices``, ``from_arrays`` and ``from_matrix``.
    names : sequence of str
        Of the pair's landmarks, instead of its own. Its curves are not in the result.

    Raises
    ------
    ParameterError
        If the map is not of the finest levels of the pair, or there is not a name for each landmark.
    """
    check_map(pair, point_map)
    target, source = pair.target, pair.source
    named = replace(pair.landmarks, names=tuple(names) or pair.landmarks.names)
    points = _cage_points(target, named.target), _cage_points(source, named.source)
    landmarks = Landmarks.of_points(named.names, *points, target.control.name, source.control.name)
    return MatchResult(target, source, landmarks, point_map, _judge(target, point_map, named))


def tensors(*values: Any, dtype: Any = None, device: Any = None) -> Any:
    """Torch tensors of arrays, and coalesced COO tensors of SciPy's sparse matrices.

    Integers stay integers. Functions that take arrays take tensors too.

    Parameters
    ----------
    *values : arrays or sparse arrays
    dtype : torch.dtype, optional
        Of real numbers; default: theirs.
    device : torch.device or str, optional

    Returns
    -------
    tensor, or tuple of tensors

    Raises
    ------
    ParameterError
        If torch is not installed.
    """
    try:
        import torch
    except ImportError as error:
        raise ParameterError("tensors: expected torch to be installed, found none; `pip install torch`") from error

    def to_tensor(value: Any) -> Any:
        if sparse.issparse(value):
            matrix: Any = sparse.coo_array(value)  # type: ignore[call-overload]
            indices = torch.as_tensor(np.stack(matrix.coords).astype(np.int64))
            data = torch.as_tensor(np.array(matrix.data))
            tensor = torch.sparse_coo_tensor(indices, data, matrix.shape, check_invariants=False).coalesce()
        else:
            tensor = torch.as_tensor(np.array(value))  # a copy: ours are read-only
        return tensor.to(device=device, dtype=dtype if tensor.is_floating_point() else None)

    tensor = tuple(to_tensor(value) for value in values)
    return tensor[0] if len(tensor) == 1 else tensor


def _cage_points(surface: Surface, points: SurfacePoints) -> CagePoints:
    """Points of the control mesh for points of the finest surface."""
    vertices = points.vertices
    exact = np.flatnonzero((vertices >= 0) & (vertices < surface.control.n_vertices))
    found, at_vertices = cage_points_of(surface, points), CagePoints.of_vertices(vertices[exact])
    found.corners[exact], found.weights[exact] = at_vertices.corners, at_vertices.weights
    return found
