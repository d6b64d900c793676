"""Integrated Laplacians and vertex areas of a polygon surface, and of all its levels (paper, 2.1.1 and 2.2.2).

Each Laplacian is given by the terms of one face. On triangles all three are the cotangent Laplacian. They are exact for
linear functions on flat polygons and differ by some per cent on coarse, bent quads.

Sign convention: the stiffness matrix W is positive semi-definite, W 1 = 0, and the eigenproblem reads
W phi = lambda M phi.

All levels take their geometry from the finest one, by subdivision exterior calculus (SEC):
W^l = (S^{f,l})^T W_f S^{f,l}, and M^l likewise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numba import njit
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, read_only
from cagemap.numerics.kinds import kinds_checked
from cagemap.subdivision import Refinement
from cagemap.surface.triangles import mesh_arrays

# Least doubled area of a triangle, as a share of its longest squared edge. Smaller triangles get this area in
# cotangents, which stay finite; it only reduces their energy, so that W stays positive semi-definite.
SLIVER = 1e-5

# Corner pairs that are edges of a face's triangulations: sides, then both diagonals of a quad.
TRIANGLE_PAIRS = ((1, 2), (2, 0), (0, 1))
QUAD_PAIRS = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3))
# For every triangle of a face's triangulations: its corners a, b, c, and the columns of the pairs bc, ca, ab.
TRIANGLE_TABLE = np.array([[0, 1, 2, 0, 1, 2]])
QUAD_TABLE = np.array([[0, 1, 2, 1, 4, 0], [0, 2, 3, 2, 3, 4], [0, 1, 3, 5, 3, 0], [1, 2, 3, 2, 5, 1]])

# A Laplacian: from positions (n, 3) and faces (m, 4) or (m, 3) to weights of the edges and diagonals of each face, and
# vertex areas (n,).
Laplacian = Callable[[FloatArray, IndexArray], tuple[FloatArray, FloatArray]]
# Inner products M_f (m, k, k) of 1-forms on polygons, from edges and centred midpoints (m, k, 3), areas (m,), unit
# normals (m, 3), and the weight lambda of functions without gradient in the polygon's plane.
InnerProducts = Callable[[FloatArray, FloatArray, FloatArray, FloatArray, float], FloatArray]


def stiffness(positions: FloatArray, faces: IndexArray) -> sparse.csr_array:
    """Integrated cotangent Laplacian W (n, n); on quads (m, 4) the mean over both triangulations.

    Symmetric, positive semi-definite, rows sum to 0. Unitless (invariant to scale). ParameterError for other arrays.
    """
    positions, faces = mesh_arrays(positions, faces)
    return assemble_stiffness(face_terms(positions, faces)[0], faces, len(positions))


def vertex_areas(positions: FloatArray, faces: IndexArray) -> FloatArray:
    """(n,) diagonal of the mass matrix: a third of the areas of the triangles around each vertex.

    Sums to the area of faces (m, 4) or (m, 3), for quads the mean over both triangulations. Unit: length squared.
    ParameterError for other arrays.
    """
    return face_terms(*mesh_arrays(positions, faces))[1]


def face_terms(positions: FloatArray, faces: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Half cotangent sums of every face's corner pairs, (m, 6) or (m, 3), and `vertex_areas`.

    Pairs are in the order of `QUAD_PAIRS` or `TRIANGLE_PAIRS`; weights of quads are means over both triangulations.
    """
    quads = faces.shape[1] == 4
    weights, areas = np.zeros((len(faces), 6 if quads else 3)), np.zeros(len(positions))
    table, share = (QUAD_TABLE, 0.5) if quads else (TRIANGLE_TABLE, 1.0)
    contiguous = read_only(np.ascontiguousarray(positions, dtype=np.float64)), read_only(np.ascontiguousarray(faces))
    _face_terms(*contiguous, table, share, weights, areas)
    return weights, areas


@njit(cache=True, error_model="numpy", nogil=True)
def _face_terms(positions, faces, table, share, weights, areas):  # type: ignore[no-untyped-def]
    """Add every triangle's half cotangents to its opposite corner pairs, and its area to its corners."""
    for m in range(len(faces)):
        for t in range(len(table)):
            a, b, c = faces[m, table[t, 0]], faces[m, table[t, 1]], faces[m, table[t, 2]]
            ux = positions[b, 0] - positions[a, 0]
            uy = positions[b, 1] - positions[a, 1]
            uz = positions[b, 2] - positions[a, 2]
            vx = positions[c, 0] - positions[a, 0]
            vy = positions[c, 1] - positions[a, 1]
            vz = positions[c, 2] - positions[a, 2]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            uu = ux * ux + uy * uy + uz * uz
            vv = vx * vx + vy * vy + vz * vz
            uv = ux * vx + uy * vy + uz * vz
            doubled = np.sqrt(nx * nx + ny * ny + nz * nz)
            third = share * doubled / 6.0
            areas[a] += third
            areas[b] += third
            areas[c] += third
            doubled = max(doubled, SLIVER * max(uu, vv, uu + vv - 2.0 * uv))
            if doubled > 0.0:
                half = 0.5 * share / doubled
                weights[m, table[t, 3]] += half * uv
                weights[m, table[t, 4]] += half * (uu - uv)
                weights[m, table[t, 5]] += half * (vv - uv)


@dataclass(frozen=True, eq=False)
class Operators:
    """Mass and stiffness matrices of every level of a refinement, at unit surface area."""

    #: (n_l, n_l) M^l, symmetric positive definite; all entries sum to 1. Diagonal at the finest level only.
    #: `build_operators` makes the values read-only: change a ``copy()``.
    mass: tuple[sparse.csr_array, ...]
    stiffness: tuple[sparse.csr_array, ...]  #: (n_l, n_l) W^l, symmetric positive semi-definite, W^l 1 = 0; read-only
    scale: float  #: factor from the mesh's lengths to lengths at unit area

    def __repr__(self) -> str:
        return f"Operators({', '.join(str(mass.shape[0]) for mass in self.mass)} vertices, scale {self.scale:.6g})"

    @property
    def finest_level(self) -> int:
        """Number of the finest level."""
        return len(self.mass) - 1

    def areas(self, level: int) -> FloatArray:
        """(n_l,) vertex areas of a level: the row sums M^l 1 of its mass matrix."""
        return lumped_areas(self.mass[level])


@kinds_checked
def build_operators(refinement: Refinement, laplacian: Laplacian = face_terms) -> Operators:
    """Operators of every level of a refinement, at unit area of the finest level (2.2.2, Lemma 5).

    The ``laplacian`` of the finest level is `face_terms` or another of `named_laplacian`. O(n_f) time and memory.
    Restricted matrices have about 25 nonzeros per row just below the finest level, 50 on coarser levels. ParameterError
    if ``laplacian`` is no function.
    """
    if not callable(laplacian):
        raise ParameterError(f"laplacian: expected one of `named_laplacian`, got {laplacian!r}")
    finest = refinement.levels[-1]
    faces = refinement.faces(refinement.finest_level)
    weights, areas = laplacian(finest.positions, faces)
    area = float(areas.sum())
    # One complex matrix W + i M: one product restricts both, and they keep the same pattern.
    both = sparse.csr_array(
        assemble_stiffness(weights, faces, len(finest.positions)) + sparse.diags_array(1j * areas / area)
    )
    masses, stiffnesses = [sparse.csr_array(sparse.diags_array(areas / area))], [_with_values(both, both.data.real)]
    for subdivision in reversed(refinement.matrices):
        both = sparse.csr_array(subdivision.T @ (both @ subdivision))
        both.sort_indices()
        masses.append(_with_values(both, both.data.imag))
        stiffnesses.append(_with_values(both, both.data.real))
    for matrix in (*masses, *stiffnesses):
        matrix.data.flags.writeable = False
    return Operators(tuple(reversed(masses)), tuple(reversed(stiffnesses)), 1.0 / float(np.sqrt(area)))


def assemble_stiffness(weights: FloatArray, faces: IndexArray, n: int) -> sparse.csr_array:
    """Stiffness matrix (n, n) from the weights of every face's corner pairs (`face_terms`)."""
    size = faces.shape[1]
    pairs = QUAD_PAIRS if size == 4 else TRIANGLE_PAIRS
    rows, columns = (faces[:, side].ravel().astype(np.int32) for side in np.transpose(pairs))
    of_corner = [[k for j in range(size) for k, pair in enumerate(pairs) if {i, j} == {*pair}] for i in range(size)]
    diagonal = np.bincount(np.repeat(faces.ravel(), size - 1), weights[:, of_corner].ravel(), minlength=n)
    every = np.arange(n, dtype=np.int32)
    # Summed by entries, as sums of matrices drop entries of 0: graphs take their edges from this pattern.
    values = np.concatenate([-weights.ravel(), -weights.ravel(), diagonal])
    places = np.concatenate([rows, columns, every]), np.concatenate([columns, rows, every])
    return sparse.csr_array(sparse.coo_array((values, places), shape=(n, n)))


def _with_values(matrix: sparse.csr_array, values: FloatArray) -> sparse.csr_array:
    """A matrix with the same pattern and other values."""
    arrays = np.ascontiguousarray(values), matrix.indices, matrix.indptr
    return sparse.csr_array(arrays, shape=matrix.shape)


def lumped_areas(mass: sparse.csr_array) -> FloatArray:
    """(n,) vertex areas: the row sums M 1 of a mass matrix."""
    return np.asarray(mass.sum(axis=1), dtype=np.float64).ravel()


def named_laplacian(name: str, stabilisation: float = 1.0) -> Laplacian:
    """The Laplacian of a name in `LAPLACIANS`; ParameterError for other names.

    "mean": of the cotangent Laplacians of both triangulations of every quad. The others are stabilised: without a
    ``stabilisation`` above 0, functions such as +1 and -1 in turn over a quad's corners cost nothing.
    """
    if name not in LAPLACIANS:
        raise ParameterError(f"laplacian: expected one of {', '.join(LAPLACIANS)}, got {name!r}")
    if not 0.0 < stabilisation < np.inf:
        raise ParameterError(f"stabilisation: expected a finite number above 0, got {stabilisation}; 1 is usual")
    inner_products = LAPLACIANS[name]
    return face_terms if inner_products is None else partial(stabilised_terms, inner_products, stabilisation)


def stabilised_terms(
    inner_products: InnerProducts, stabilisation: float, positions: FloatArray, faces: IndexArray
) -> tuple[FloatArray, FloatArray]:
    """Terms, as `face_terms`, of W_f = d^T M_f d, with d the differences along the edges and inner products M_f."""
    k, corners = faces.shape[1], positions[faces]
    corners = corners - corners.mean(axis=1, keepdims=True)
    following = np.roll(corners, -1, axis=1)
    edges, midpoints = following - corners, 0.5 * (corners + following)
    vectors = 0.5 * np.cross(corners, following).sum(axis=1)
    sizes = np.linalg.norm(vectors, axis=1)
    # Bounded so that energies stay finite (`SLIVER`). A polygon of one point gets area 1, and has no energy.
    areas = np.maximum(sizes, 0.5 * SLIVER * np.einsum("fid,fid->fi", edges, edges).max(axis=1))
    areas = np.where(areas == 0.0, 1.0, areas)
    normals = vectors / np.where(sizes == 0.0, 1.0, sizes)[:, None]
    inner = inner_products(edges, midpoints, areas, normals, stabilisation)
    # (d^T M d)_ij = M_(i-1)(j-1) - M_(i-1)j - M_i(j-1) + M_ij, with edge i from corner i to corner i + 1.
    rows = np.roll(inner, 1, axis=1) - inner
    energy = np.roll(rows, 1, axis=2) - rows
    pairs = np.array(QUAD_PAIRS if k == 4 else TRIANGLE_PAIRS)
    weights = -energy[:, pairs[:, 0], pairs[:, 1]]
    vertex_areas = np.bincount(faces.ravel(), np.repeat(sizes / k, k), minlength=len(positions))
    return np.ascontiguousarray(weights), np.asarray(vertex_areas, dtype=np.float64)


def alexa_wardetzky(
    edges: FloatArray, midpoints: FloatArray, areas: FloatArray, normals: FloatArray, stabilisation: float
) -> FloatArray:
    """The paper's Laplacian: Alexa and Wardetzky, *Discrete Laplacians on general polygonal meshes*, 2011.

    M_f = B B^T / ``|f|`` + lambda C C^T, with B the edges' midpoints, ``|f|`` the size of the vector area, and C an
    orthonormal basis of the complement of the edges projected to the polygon's plane.
    """
    inner = np.einsum("fid,fjd->fij", midpoints, midpoints) / areas[:, None, None]
    flat = edges - np.einsum("fid,fd,fe->fie", edges, normals, normals)
    # Axes of the span of the projected edges; their third singular value is 0.
    axes, spans, _ = np.linalg.svd(flat, full_matrices=False)
    axes = axes[:, :, :2] * (spans[:, None, :2] > SLIVER * spans[:, None, :1])
    complement = np.eye(edges.shape[1]) - np.einsum("fia,fja->fij", axes, axes)
    return np.asarray(inner + stabilisation * complement)


def de_goes_butts_desbrun(
    edges: FloatArray, midpoints: FloatArray, areas: FloatArray, normals: FloatArray, stabilisation: float
) -> FloatArray:
    """Laplacian of De Goes, Butts and Desbrun, *Discrete differential operators on polygonal meshes*, 2020.

    M_f = ``|f|`` U^T U + lambda P^T P, with U the sharp operator (the mean gradient of a 1-form), V the flat one and
    P = 1 - V U.
    """
    sharp = np.cross(normals[:, None, :], midpoints) / areas[:, None, None]  # (m, k, 3): U^T
    flat = edges - normals[:, None, :] * np.einsum("fid,fd->fi", edges, normals)[:, :, None]
    unseen = np.eye(edges.shape[1]) - np.einsum("fid,fjd->fij", flat, sharp)
    inner = np.einsum("fid,fjd->fij", sharp, sharp) * areas[:, None, None]
    return np.asarray(inner + stabilisation * np.einsum("fki,fkj->fij", unseen, unseen))


LAPLACIANS: dict[str, InnerProducts | None] = {
    "mean": None,
    "alexa-wardetzky": alexa_wardetzky,
    "de-goes-butts-desbrun": de_goes_butts_desbrun,
}
