"""Operators for DiffusionNet, as its own `diffusion_net.geometry.get_operators` computes them."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import one_blas_thread
from cagemap.operators.laplacian import stiffness, vertex_areas
from cagemap.spectral.mesh_eigenpairs import mass_lumped_pairs
from cagemap.spectral.surface import Surface
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import corner_sums, normalize_rows

ACCURACY = 1e-7  # residual of eigenpairs
ADDED_TO_NORMS = 1e-6
MAX_COSINE = 0.9  # largest cosine of a normal and the first axis from which tangent axes are made


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
        pairs = mass_lumped_pairs(weights, areas, count, ACCURACY)
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
