"""Lowest eigenpairs of a mesh's Laplacian to a given residual."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.csgraph import connected_components

from cagemap.errors import InvalidMeshError, ParameterError, SolverError
from cagemap.mesh.faces import cage_triangles, faces_of_one_size
from cagemap.mesh.inputs import MeshLike, arrays_accepted
from cagemap.mesh.structure_checks import require_structure
from cagemap.numerics.arrays import FloatArray, members_of, offsets_of, read_only
from cagemap.numerics.sparse_algebra import factor, multiply
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

COLUMN_BLOCK = 32  # columns that are solved and multiplied at a time, two blocks side by side
MAX_INVERSE_ITERATIONS = 4  # most inverse iterations after Lanczos; one suffices unless the accuracy is near rounding
# Most parts that are solved together: Lanczos finds an eigenvalue, such as 0, about 64 times (the block's width).
MAX_JOINT_PARTS = 100


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
    return EigenPairs(read_only(values[lowest]), read_only(vectors))


def _pairs(weights: sparse.csr_array, areas: FloatArray, k: int, accuracy: float, area: float) -> EigenPairs:
    """Lowest pairs of a mesh or a part of it; ``area`` is that of the whole mesh."""
    mass = sparse.csr_array(sparse.diags_array(areas))
    shift = -4.0 * np.pi / float(areas.sum())
    shifted = factor(shifted_matrix(weights, mass, shift))
    # Lanczos may be in single precision; the inverse iterations below remove its rounding error.
    krylov_accuracy = max(min(accuracy, SOLVER.single_accuracy), 1e-10)
    initial = band_pairs(weights, mass, 0, k, accuracy=krylov_accuracy, like=shifted)
    values, vectors = np.array(initial.values), np.array(initial.vectors, dtype=np.float64, order="C")
    parts = row_slices(k, COLUMN_BLOCK)

    def improve(part: slice) -> None:
        """One inverse iteration of some vectors."""
        vectors[:, part] = (values[part] - shift) * shifted.solve(areas[:, None] * vectors[:, part])

    for iteration in range(MAX_INVERSE_ITERATIONS + 1):
        worst = np.inf
        if iteration or initial.vectors.dtype == np.float64:
            worst = 0.0
            for part in parts:
                energy, dual = multiply(weights, vectors[:, part]), areas[:, None] * vectors[:, part]
                values[part] = np.einsum("ij,ij->j", vectors[:, part], energy)  # Rayleigh quotients
                worst = max(worst, float(residual_norms(values[part], energy, dual, areas, area).max()))
        if worst <= accuracy:
            if (np.diff(values) < 0.0).any():  # equal ones differ by rounding
                order = np.argsort(values, kind="stable")
                values, vectors = values[order], vectors.take(order, axis=1)
            return EigenPairs(read_only(values), read_only(vectors))
        if iteration == MAX_INVERSE_ITERATIONS:
            break
        for first in range(0, len(parts), 2):
            in_threads(improve, parts[first : first + 2])
        # M-orthonormal in order, as inverse iteration amplifies the lower vectors in each.
        combined(vectors, linalg.inv(linalg.cholesky(inner_products(vectors, vectors, areas))), out=vectors)
    raise SolverError(
        f"eigenpairs: expected residuals up to {accuracy:g}, reached {worst:.1e}; remove triangles of almost no area, "
        "or ask `cagemap.eigenpairs` for a lower accuracy, at most 0.01"
    )
