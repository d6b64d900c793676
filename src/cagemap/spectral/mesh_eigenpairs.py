"""Lowest eigenpairs of a mesh's Laplacian to a given residual, and operators for DiffusionNet."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.csgraph import connected_components

from cagemap.errors import InvalidMeshError, ParameterError, SolverError
from cagemap.mesh.faces import cage_triangles, faces_of_one_size
from cagemap.mesh.inputs import MeshLike, arrays_accepted
from cagemap.mesh.structure_checks import require_structure
from cagemap.numerics.arrays import FloatArray, members_of, offsets_of
from cagemap.numerics.factorization import Factorization, factor, multiply
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import in_threads, one_blas_thread, row_slices
from cagemap.operators.laplacian import stiffness, vertex_areas
from cagemap.spectral.eigenpairs import (
    SOLVER,
    EigenPairs,
    band_pairs,
    combined,
    inner_products,
    residual_norms,
    shifted_matrix,
)
from cagemap.spectral.surface import Surface
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import corner_sums, normalize_rows

COLUMN_BLOCK = 32  # columns that are solved and multiplied at a time, two blocks side by side
MAX_INVERSE_ITERATIONS = 4  # most inverse iterations after Lanczos; one suffices unless the accuracy is near rounding
# Most parts that are solved together: Lanczos finds an eigenvalue, such as 0, about 64 times (the block's width).
MAX_JOINT_PARTS = 100
# For DiffusionNet: residual of eigenpairs, constant added to norms, largest cosine of normal and first axis.
DIFFUSION_NET_ACCURACY = 1e-7
ADDED_TO_NORMS = 1e-6
MAX_COSINE = 0.9


@arrays_accepted
def eigenpairs(mesh: MeshLike, k: int, accuracy: float = 1e-5) -> EigenPairs:
    """The k lowest eigenpairs W x = lambda M x of a mesh, without subdivision.

    InvalidMeshError if the arrays are no mesh, or a vertex has no area around it; ParameterError if k or the accuracy
    is out of range; SolverError if the residual is not reached.

    The mesh has triangles, quads (mean of both triangulations) or polygons (fans), and may have boundaries, several
    parts and edges of more than two faces. Values (k,) ascend; vectors (n, k) float64 are M-orthonormal, in the mesh's
    unit of length.

    W is the cotangent matrix `cagemap.operators.stiffness`, M = diag `cagemap.operators.vertex_areas`. Every pair has
    ``||W x - lambda M x||_{M^-1} <= accuracy max(lambda, 4 pi / area)`` with ``||x||_M = 1``, so that an eigenvalue of
    (W, M) is within that bound of lambda, and within its square divided by the gap to the next eigenvalue (Kato and
    Temple). The accuracy is from 1e-12 to 1e-2. The inertia of W - tau M proves that none below the last was missed.
    """
    if not 1e-12 <= accuracy <= 1e-2:
        raise ParameterError(f"accuracy: expected a residual from 1e-12 to 1e-2, got {accuracy:g}")
    require_structure(mesh)
    faces = faces_of_one_size(mesh)
    faces = cage_triangles(mesh)[0] if faces is None else faces
    weights, areas = stiffness(mesh.positions, faces), vertex_areas(mesh.positions, faces)
    with one_blas_thread():
        return mass_lumped_pairs(weights, areas, k, accuracy)


def mass_lumped_pairs(weights: sparse.csr_array, areas: FloatArray, k: int, accuracy: float) -> EigenPairs:
    """`eigenpairs` from a stiffness matrix (n, n) and vertex areas (n,)."""
    empty = np.flatnonzero(~(areas > 0))
    if len(empty):
        raise InvalidMeshError(
            f"eigenpairs: expected an area around every vertex, found none at {len(empty)} of them, such as "
            f"{empty[:3].tolist()}; remove vertices without faces (cagemap.plain_mesh does)"
        )
    if not 1 <= k <= len(areas):
        raise ParameterError(f"k: expected 1 to {len(areas)} pairs, the mesh's vertices, got {k}")
    area = float(areas.sum())
    count, labels = connected_components(weights, directed=False)
    if count <= MAX_JOINT_PARTS:
        try:
            return _pairs(weights, areas, k, accuracy, area)
        except SolverError:
            if count == 1:
                raise
    # With many parts 0 is repeated too often for one Lanczos iteration: each part is solved alone.
    parts = members_of(labels)
    order, offsets = np.concatenate(parts), offsets_of([len(part) for part in parts])
    blocks = sparse.csr_array(weights[order][:, order])
    found = [
        _pairs(sparse.csr_array(blocks[begin:end, begin:end]), areas[part], min(k, len(part)), accuracy, area)
        for part, (begin, end) in zip(parts, pairwise(offsets), strict=True)
    ]
    values = np.concatenate([pairs.values for pairs in found])
    lowest = np.argsort(values, kind="stable")[:k]
    vectors, start = np.zeros((len(areas), k)), 0
    for part, pairs in zip(parts, found, strict=True):
        columns = np.flatnonzero((lowest >= start) & (lowest < start + len(pairs.values)))
        vectors[np.ix_(part, columns)] = pairs.vectors[:, lowest[columns] - start]
        start += len(pairs.values)
    return EigenPairs(values[lowest], vectors, 0)


def _pairs(weights: sparse.csr_array, areas: FloatArray, k: int, accuracy: float, area: float) -> EigenPairs:
    """Lowest pairs of a mesh or a part of it; ``area`` is that of the whole mesh."""
    mass = sparse.csr_array(sparse.diags_array(areas))
    shift = -4.0 * np.pi / float(areas.sum())
    shifted = factor(shifted_matrix(weights, mass, shift))
    # Lanczos may be in single precision; inverse iterations remove its rounding error.
    krylov_accuracy = max(min(accuracy, SOLVER.single_accuracy), 1e-10)
    initial = band_pairs(weights, mass, 0, k, accuracy=krylov_accuracy, like=shifted, inverse_iteration=True)
    values, vectors = np.array(initial.values), np.array(initial.vectors, order="C")
    parts = row_slices(k, COLUMN_BLOCK)
    for iteration in range(MAX_INVERSE_ITERATIONS):
        improve = partial(_improve, shifted, areas, values - shift, vectors)
        # Lanczos has made one at a shift within the spectrum, far from the lowest pairs: at first these need another.
        for first in range(0, len(parts) if iteration else 1, 2):
            in_threads(improve, parts[first : first + 2] if iteration else parts[:1])
        # M-orthonormal in order, as inverse iteration amplifies the lower vectors in each.
        combined(vectors, linalg.inv(linalg.cholesky(inner_products(vectors, vectors, areas))), out=vectors)
        worst = 0.0
        for part in parts:
            energy, dual = multiply(weights, vectors[:, part]), areas[:, None] * vectors[:, part]
            values[part] = np.einsum("ij,ij->j", vectors[:, part], energy)  # Rayleigh quotients
            worst = max(worst, float(residual_norms(values[part], energy, dual, areas, area).max()))
        if worst <= accuracy:
            if (np.diff(values) < 0.0).any():  # equal ones differ by rounding
                order = np.argsort(values, kind="stable")
                values, vectors = values[order], vectors.take(order, axis=1)
            return EigenPairs(values, vectors, 0)
    raise SolverError(
        f"eigenpairs: expected residuals up to {accuracy:g}, reached {worst:.1e}; remove triangles of almost no area, "
        "or ask `cagemap.eigenpairs` for a lower accuracy, at most 0.01"
    )


def _improve(shifted: Factorization, areas: FloatArray, factors: FloatArray, vectors: FloatArray, part: slice) -> None:
    """One inverse iteration of some columns of vectors (n, k), in place."""
    vectors[:, part] = factors[part] * shifted.solve(areas[:, None] * vectors[:, part])


@kinds_checked
def operators_for_diffusion_net(
    surface: Surface, level: int | None = None, count: int = 128, regularisation: float = 1e-5
) -> tuple[FloatArray, sparse.csr_array, FloatArray, FloatArray, sparse.csr_array, sparse.csr_array]:
    """DiffusionNet's operators of a level's triangles: mass, L, evals, evecs, gradX, gradY.

    The network takes them in this order (`diffusion_net.geometry.get_operators`, Sharp et al. 2022). The level is one
    of ``surface.hierarchy``, by default the finest. ``regularisation`` is added to the 2 x 2 least-squares matrix of
    every gradient, in squared lengths at unit area; the default is DiffusionNet's and reduces gradients where edges are
    shorter than about 0.005. ParameterError if the level or count is out of range.

    mass (n,) are the triangles' vertex areas, of sum 1 on the finest level (nearly 1 if quads are not flat, as the area
    of a quad is the mean of both triangulations). L (n, n) is the cotangent matrix, positive semi-definite. evals
    (count,) and mass-orthonormal evecs (n, count) solve L x = lambda diag(mass) x. gradX and gradY (n, n) are
    least-squares gradients over the edges at a vertex, in tangent axes: X is the projection of the first axis of space,
    or of the second where the normal is within 26 degrees of the first; Y = normal x X.
    """
    triangles = surface.finest_triangles if level is None else surface.triangles(level)
    if not 0.0 < regularisation < np.inf:
        raise ParameterError(f"regularisation: expected a number above 0, got {regularisation}; 1e-5 is DiffusionNet's")
    weights = stiffness(triangles.positions, triangles.triangles)
    areas = vertex_areas(triangles.positions, triangles.triangles)
    with one_blas_thread():
        pairs = mass_lumped_pairs(weights, areas, count, DIFFUSION_NET_ACCURACY)
    gradients = _edge_gradients(triangles, regularisation)
    return areas, weights, np.maximum(pairs.values, 0.0), np.asarray(pairs.vectors), *gradients


def _edge_gradients(triangles: TriangleSurface, regularisation: float) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Least-squares gradients in tangent axes: at vertex i, (sum_j e_j e_j^T + eps)^-1 sum_j e_j (f_j - f_i)."""
    ends = triangles.triangles[:, [0, 1, 1, 2, 2, 0, 1, 0, 2, 1, 0, 2]].reshape(-1, 2)
    rows, columns = np.unique(ends, axis=0).T
    along = triangles.positions[columns] - triangles.positions[rows]
    components = np.stack([np.einsum("ed,ed->e", along, axis[rows]) for axis in _tangent_axes(triangles)], axis=1)
    n = triangles.n
    squares = np.zeros((n, 2, 2))
    for i, j in ((0, 0), (0, 1), (1, 1)):
        squares[:, i, j] = squares[:, j, i] = np.bincount(rows, components[:, i] * components[:, j], n)
    squares[:, [0, 1], [0, 1]] += regularisation
    entries = np.einsum("eij,ej->ei", np.linalg.inv(squares)[rows], components)
    diagonal = np.arange(n)
    places = np.concatenate([rows, diagonal]), np.concatenate([columns, diagonal])
    x, y = (
        sparse.csr_array((np.concatenate([part, -np.bincount(rows, part, n)]), places), shape=(n, n))
        for part in entries.T
    )
    return x, y


def _tangent_axes(triangles: TriangleSurface) -> tuple[FloatArray, FloatArray]:
    """(n, 3) X and Y axes of tangent planes, normal to the mean of adjacent faces' normals."""
    doubled = 2.0 * triangles.areas[:, None]
    of_faces = triangles.normals * doubled / (doubled + ADDED_TO_NORMS)
    normals = normalize_rows(corner_sums(triangles.triangles, of_faces, triangles.n))
    axis = np.where(np.abs(normals[:, :1]) < MAX_COSINE, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    x = axis - normals * np.einsum("nd,nd->n", axis, normals)[:, None]
    x /= np.linalg.norm(x, axis=1, keepdims=True) + ADDED_TO_NORMS
    return x, np.cross(normals, x)
