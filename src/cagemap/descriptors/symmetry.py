"""Self-symmetries: found on the control mesh, propagated to every level, projected on the basis (paper, 5.2)."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.errors import ParameterError
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray

# Two control vertices are mirror images of each other within this fraction of the bounding box diagonal.
MIRROR_TOLERANCE = 1e-3


def detect_mirror_symmetry(control: ControlMesh, tolerance: float = MIRROR_TOLERANCE) -> IndexArray | None:
    """Find the mirror symmetry of a control mesh about a coordinate-free plane, if it has one.

    The plane passes through the centroid; its normal is tried along the coordinate axes and the principal axes. The
    map must be an involution that sends faces to faces, and creases and corners to others as sharp.

    Returns
    -------
    (n,) array or None
        Vertex i's mirror image, or None if no plane maps the mesh to itself.
    """
    positions = control.positions - control.positions.mean(axis=0)
    diagonal = float(np.linalg.norm(np.ptp(positions, axis=0)))
    _, principal = np.linalg.eigh(positions.T @ positions)
    tree = cKDTree(positions)
    for normal in (*np.eye(3), *principal.T):
        mirrored = positions - 2.0 * np.outer(positions @ normal, normal)
        # Farther than the bound nothing is looked for, and the index is n.
        _, found = tree.query(mirrored, distance_upper_bound=np.nextafter(tolerance * diagonal, np.inf))
        image = np.atleast_1d(found).astype(np.int64)
        if image.max() == len(image) or not np.array_equal(image[image], np.arange(len(image))):
            continue
        if np.array_equal(image, np.arange(len(image))):
            continue  # a flat mesh mirrored onto itself says nothing
        if _sends_faces_to_faces(control, image) and _sends_creases_to_creases(control, image):
            return image
    return None


def check_symmetry(symmetry: IndexArray, control: ControlMesh) -> None:
    """Refuse a symmetry map that is not a permutation of the control vertices sending faces to faces.

    Raises
    ------
    ParameterError
    """
    n = control.n_vertices
    if symmetry.shape != (n,) or not np.array_equal(np.sort(symmetry), np.arange(n)):
        raise ParameterError(f"symmetry: expected a permutation of the {n} control vertices of {control.name}")
    if not _sends_faces_to_faces(control, symmetry):
        raise ParameterError(f"symmetry: it does not send the faces of {control.name} to faces")
    if not _sends_creases_to_creases(control, symmetry):
        raise ParameterError(f"symmetry: it does not send the creases of {control.name} to creases as sharp")


def propagate_symmetry(subdivision: sparse.csr_array, symmetry: IndexArray) -> IndexArray:
    """Symmetry of the next level: the row of S^l that has a vertex's mirrored weights is its mirror image.

    The paper searches nearest neighbours between X^{l+1} and S^l S^l_sym X^l; comparing rows of S^l with those whose
    columns are permuted is the same search without geometry, so it also serves intrinsic symmetries and coinciding
    vertices.

    Parameters
    ----------
    subdivision : (n_{l+1}, n_l) CSR array
        S^l.
    symmetry : (n_l,) array

    Returns
    -------
    (n_{l+1},) array
    """
    rng = np.random.default_rng(20190707)
    probes = rng.standard_normal((subdivision.shape[1], 3))  # generic functions tell all rows of S^l apart
    rows = subdivision @ probes
    mirrored = subdivision @ probes[symmetry]
    distances, image = (np.atleast_1d(found) for found in cKDTree(rows).query(mirrored))
    if distances.max() > 1e-9:
        raise ParameterError("symmetry: the refined mesh is not symmetric; is the given map one of the control mesh?")
    return np.asarray(image, dtype=np.int64)


def symmetry_operator(
    basis_rows: FloatArray, mirrored_rows: FloatArray, areas: FloatArray, gram: FloatArray
) -> FloatArray:
    """Projected self-symmetry O~ = Phi~^+ S Phi~, cut to its three main diagonals (paper, section 5.2).

    Parameters
    ----------
    basis_rows, mirrored_rows : (n, k) arrays
        Phi~ and S Phi~: the same vertices and their mirror images.
    areas : (n,) array
        Weights of the vertices in the inner product.
    gram : (k, k) array
        Phi~^T M Phi~ with these weights.

    Returns
    -------
    (k, k) array, tridiagonal
    """
    operator = np.linalg.solve(gram, basis_rows.T @ (areas[:, None] * mirrored_rows))
    return np.triu(np.tril(operator, 1), -1)


def _sends_faces_to_faces(control: ControlMesh, image: IndexArray) -> bool:
    """Whether the faces are the same sets of vertices after renaming the vertices by a permutation."""
    renamed = image[control.face_indices]
    for size in np.unique(control.face_sizes):
        corners = control.face_offsets[:-1][control.face_sizes == size, None] + np.arange(size)
        if not np.array_equal(_ordered_rows(renamed[corners]), _ordered_rows(control.face_indices[corners])):
            return False
    return True


def _sends_creases_to_creases(control: ControlMesh, image: IndexArray) -> bool:
    """Whether edges and vertices are as sharp as their images."""
    if control.crease_edges is not None and control.crease_sharpness is not None:
        edges, sharpness = control.crease_edges, control.crease_sharpness
        before, after = (_with_values(np.sort(pairs, axis=1), sharpness) for pairs in (edges, image[edges]))
        if not np.array_equal(before, after):
            return False
    if control.corner_vertices is not None and control.corner_sharpness is not None:
        corners, sharpness = control.corner_vertices[:, None], control.corner_sharpness
        before, after = (_with_values(vertices, sharpness) for vertices in (corners, image[corners]))
        return np.array_equal(before, after)
    return True


def _with_values(elements: IndexArray, values: FloatArray) -> FloatArray:
    """Elements and their values side by side, those of value 0 left out, in lexicographic order."""
    table = np.column_stack([elements, values])[values > 0]
    return np.asarray(table[np.lexsort(table.T[::-1])])


def _ordered_rows(rows: IndexArray) -> IndexArray:
    """Every row ascending, rows in lexicographic order."""
    ascending = np.sort(rows, axis=1)
    return np.asarray(ascending[np.lexsort(ascending.T[::-1])])
