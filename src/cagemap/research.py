"""The steps of the method one at a time, for research: bring your own meshes, descriptors, operators, maps.

Everything here is a short name for what the rooms do; docs/researchers.md walks through it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cagemap.basis import BasisConfig, Surface
from cagemap.descriptors import Filters, choose_filters, landmark_descriptors
from cagemap.errors import ParameterError
from cagemap.functional_map import Constraints, MapWeights, extend_functional_map, solve_functional_map
from cagemap.maps.elastic.method import functional_map_of as _functional_map_of
from cagemap.maps.pair import LevelPair, Pair, SymmetryPair
from cagemap.maps.point_map import PointMap
from cagemap.maps.spectral.constraints import DescriptorConfig, gather_constraints, signature_functions
from cagemap.maps.spectral.hierarchical import HierarchyConfig, hierarchical_map
from cagemap.maps.spectral.levels import (
    LevelMap,
    basis_sizes,
    ladder,
    recover_points,
    search_full,
    search_level,
    search_levels,
)
from cagemap.maps.spectral.paper import PaperConfig, paper_map
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.pipeline import MAP_BASIS, MatchResult, judge, prepare_surface

__all__ = [
    "Constraints",
    "DescriptorConfig",
    "HierarchyConfig",
    "MapWeights",
    "PaperConfig",
    "control_mesh",
    "eigenfunctions",
    "functional_map",
    "functional_map_of",
    "gather_constraints",
    "heat_and_wave_filters",
    "hierarchical_map",
    "landmark_functions",
    "make_pair",
    "paper_map",
    "point_map",
    "prepare",
    "recover_points",
    "result_of_map",
    "signature_functions",
    "transport",
]


# As many functions as a match reads, and operators of every level.
EVERY_LEVEL = replace(MAP_BASIS, vertices=None)


def control_mesh(mesh: Any, name: str = "mesh") -> ControlMesh:
    """A control mesh from what one has.

    Parameters
    ----------
    mesh : ControlMesh, or (vertices, faces), or an object with ``vertices`` and ``faces`` such as trimesh's
        Faces as an (m, s) array or as lists of vertices.
    name : str
    """
    if isinstance(mesh, ControlMesh):
        return mesh
    if isinstance(mesh, Sequence) and len(mesh) == 2:
        return ControlMesh.from_faces(*mesh, name=name)
    if hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        return ControlMesh.from_faces(np.asarray(mesh.vertices), np.asarray(mesh.faces), name=name)
    raise ParameterError(
        "expected a ControlMesh, a pair (vertices, faces), or an object with vertices and faces, "
        f"got {type(mesh).__name__}"
    )


def prepare(mesh: Any, level: int, basis: BasisConfig = EVERY_LEVEL, name: str = "mesh") -> Surface:
    """Refine a mesh, build its operators and its basis, see `control_mesh` and `cagemap.prepare_surface`."""
    return prepare_surface(control_mesh(mesh, name), level, basis)


def make_pair(
    target: Surface,
    source: Surface,
    landmarks: tuple[object, object] = ((), ()),
    symmetries: tuple[SymmetryPair, ...] = (),
) -> Pair:
    """Two prepared surfaces, corresponding control vertices (target's, source's), and corresponding self-maps."""
    vertices = [np.asarray(side, dtype=np.int64) for side in landmarks]
    if vertices[0].shape != vertices[1].shape or vertices[0].ndim != 1:
        raise ParameterError(
            f"expected as many target as source landmarks, got {vertices[0].shape} and {vertices[1].shape}"
        )
    return Pair.of_vertices(target, source, vertices[0], vertices[1], symmetries)


def eigenfunctions(surface: Surface, level: int) -> tuple[FloatArray, FloatArray]:
    """Basis functions at the vertices of a level, (n, k), and their eigenvalues, (k,), of unit area."""
    return surface.basis.at(level), surface.basis.eigenvalues[: surface.basis.size(level)]


def heat_and_wave_filters(target: Surface, source: Surface, heat: int = 10, wave: int = 20) -> Filters:
    """Filters rho_t for two surfaces; `signature_functions` and `landmark_functions` take them."""
    return choose_filters(target.basis.eigenvalues, source.basis.eigenvalues, heat, wave)


def landmark_functions(surface: Surface, filters: Filters, vertices: IndexArray, level: int) -> FloatArray:
    """Landmark descriptors Phi~ rho_t(Lambda~) Phi~^T delta_v (Definition 3) at a level's vertices; (n, p q)."""
    rows = surface.basis.rows(level, np.asarray(vertices, dtype=np.int64))
    at_eigenvalues = filters.at(surface.basis.eigenvalues[: surface.basis.size(level)])
    return surface.basis.at(level) @ landmark_descriptors(rows, at_eigenvalues)


def functional_map(
    pair: Pair, constraints: Constraints, weights: MapWeights = MapWeights(), levels: LevelPair | None = None
) -> FloatArray:
    """C12 from constraints alone: eq. 13 on level 0, eqs. 14-16 for every band of the levels above.

    Parameters
    ----------
    pair : Pair
    constraints : Constraints
        `gather_constraints`, with what one adds; or one's own.
    weights : MapWeights
    levels : (int, int), optional
        Up to which; default: the finest.
    """
    last = (pair.target.finest, pair.source.finest) if levels is None else levels
    steps = [(min(l1, last[0]), min(l2, last[1])) for l1, l2 in [(0, 0), *ladder(pair, (0, 0))]]
    found = solve_functional_map(constraints.leading(*basis_sizes(pair, (0, 0))), weights)
    for step in steps[1:]:
        sizes = basis_sizes(pair, step)
        if sizes != found.shape:
            found = extend_functional_map(found, constraints.leading(*sizes), weights)
    return found


def point_map(pair: Pair, matrix: FloatArray) -> PointMap:
    """T12 from a functional map as it is: full search on a coarse level, candidates below, vertex to point (5.4).

    Parameters
    ----------
    pair : Pair
        Its landmarks are not used.
    matrix : (k1, k2) array
        C12 on the leading basis functions of both surfaces.
    """
    k1, k2 = matrix.shape
    if k1 > pair.target.basis.count or k2 > pair.source.basis.count:
        raise ParameterError(
            f"expected a functional map of at most {(pair.target.basis.count, pair.source.basis.count)}, "
            f"got {matrix.shape}"
        )
    start = search_levels(pair.target, pair.source, HierarchyConfig().search_vertices)
    found = LevelMap(start, matrix, search_full(pair, matrix, start))
    for levels in ladder(pair, start):
        found = LevelMap(levels, matrix, search_level(pair, matrix, levels, found))
    return recover_points(pair, found)


def functional_map_of(pair: Pair, found: PointMap) -> FloatArray:
    """C12 = Phi~1^+ P12 Phi~2 of a point map of the finest levels (2.1.2), on a sample of its vertices; (k1, k2)."""
    return _functional_map_of(pair.target, pair.source, found)


def transport(pair: Pair, matrix: FloatArray, values: FloatArray, level: int, to: int) -> FloatArray:
    """Functions from source to target through C alone (5.4), smoothed to what the bases can say.

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
    k1, k2 = matrix.shape
    coefficients = matrix @ pair.source.basis.project(values, level, count=k2)
    rows = pair.target.basis.at(to)
    if rows.shape[1] < k1:
        raise ParameterError(f"level {to} of the target has {rows.shape[1]} of {k1} functions: take a finer one")
    return np.asarray(rows[:, :k1] @ coefficients)


def result_of_map(pair: Pair, found: PointMap, names: Sequence[str] = ()) -> MatchResult:
    """A result from anyone's point map of the finest levels: judged, to be written, baked and reported.

    Parameters
    ----------
    pair : Pair
    found : PointMap
        See its ``from_vertices``, ``from_arrays`` and ``from_matrix``.
    names : sequence of str
        Of the pair's landmarks.
    """
    labels = tuple(names) or tuple(f"point {i}" for i in range(len(pair.target_landmarks)))
    landmarks = Landmarks(
        labels, pair.target_landmarks, pair.source_landmarks, pair.target.control.name, pair.source.control.name
    )
    quality = judge(pair.target, found, pair.landmarks, labels)
    return MatchResult(pair.target, pair.source, landmarks, found, quality)
