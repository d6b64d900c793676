"""Self-symmetries as operators that a functional map commutes with (paper, 5.2)."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.errors import ParameterError
from cagemap.maps.pair import Pair, SymmetryPair
from cagemap.mesh import ControlMesh
from cagemap.mesh.mirrors import Mirror, mirror_symmetries
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads
from cagemap.spectral.basis import HierarchicalBasis
from cagemap.subdivision import Refinement

# Rows of S^l that generic functions tell apart by less than this are the same row.
SAME_ROW = 1e-9
UNKNOWN = -1
# Basis functions that an operator is applied to at once: at a million vertices 256 MB.
OPERATOR_COLUMNS = 32


def check_symmetry(symmetry: IndexArray, control: ControlMesh) -> None:
    """ParameterError if images (n,), -1 where not known, are no self-map of the control vertices.

    A permutation that sends faces to faces is propagated exactly, anything else by nearest neighbours.
    """
    n = control.n_vertices
    array = np.asarray(symmetry)
    if array.shape != (n,) or not np.issubdtype(array.dtype, np.integer):
        raise ParameterError(
            f"symmetry: expected the image of each of the {n} control vertices of {control.name}, whole numbers, "
            f"got {array.dtype} of shape {array.shape}"
        )
    if array.min() < UNKNOWN or array.max() >= n or array.max() == UNKNOWN:
        raise ParameterError(
            f"symmetry: expected vertices 0 to {n - 1} of {control.name}, or -1 where the image is not known, "
            f"got {array.min()} to {array.max()}"
        )


def symmetry_at(refinement: Refinement, symmetry: IndexArray, level: int) -> IndexArray:
    """Self-map of a level from that of the control mesh, level by level; (n_level,), -1 where it is not known."""
    for i in range(level):
        coarse, fine = refinement.levels[i].positions, refinement.levels[i + 1].positions
        symmetry = propagate_symmetry(refinement.matrices[i], symmetry, coarse, fine)
    return symmetry


def propagate_symmetry(
    subdivision: sparse.csr_array, symmetry: IndexArray, coarse_positions: FloatArray, fine_positions: FloatArray
) -> IndexArray:
    """Self-map (n_{l+1},) of the next level: nearest neighbours between X^{l+1} and S^l S_sym X^l (paper, 5.2).

    Where a row of S^l with permuted columns is again a row of S^l, that row is the answer: the same search without
    geometry, which cannot take one of two coinciding vertices for the other. Elsewhere the positions decide. The image
    is -1 where it is not known, and for all vertices that depend on such a one.
    """
    rng = np.random.default_rng(20190707)
    probes = rng.standard_normal((subdivision.shape[1], 3))  # generic functions tell all rows of S^l apart
    distances, nearest = cKDTree(subdivision @ probes).query(subdivision @ probes[symmetry])
    image = np.array(nearest, dtype=np.int64)
    rest = np.flatnonzero(np.asarray(distances) > SAME_ROW)
    if len(rest):
        mirrored = subdivision[rest] @ coarse_positions[symmetry]
        image[rest] = cKDTree(fine_positions).query(mirrored)[1]
    if symmetry.min() == UNKNOWN:
        unknown = abs(subdivision) @ (symmetry == UNKNOWN).astype(np.float64)
        image[unknown > 0.0] = UNKNOWN
    return image


def symmetry_operator(basis: HierarchicalBasis, symmetry: IndexArray) -> FloatArray:
    """Self-symmetry S (n,) of the basis' last level as O~ = Phi~^+ S Phi~, cut to three diagonals (paper, 5.2); (k, k).

    The pseudo-inverse is that of the inner product M: only so has an exact symmetry +-1 on its diagonal. S g is 0 where
    the image is not known, so both surfaces should know it on the same parts. The leading blocks are the operators of
    the coarser levels.
    """
    level, columns = basis.last_level, []
    for i, band in enumerate(basis.bands):
        for start in range(0, band.shape[1], OPERATOR_COLUMNS):
            values = basis.refinement.prolong(band[:, start : start + OPERATOR_COLUMNS], i, level)
            columns.append(basis.project(np.where(symmetry[:, None] == UNKNOWN, 0.0, values[symmetry]), level))
    return np.triu(np.tril(np.hstack(columns), 1), -1)


# Share of landmarks that two mirror planes must take to the same landmarks.
AGREEMENT = 0.5


def paired_mirrors(pair: Pair) -> tuple[SymmetryPair, ...]:
    """Mirror planes that both control meshes have and that the landmarks agree with.

    A plane takes landmark i near landmark j on either side, or it is another plane. Where too few landmarks tell planes
    of one side apart, these are left; where each side has one plane only, the two belong together unless landmarks say
    otherwise. A plain mesh has none.
    """
    if pair.target.refinement.is_plain or pair.source.refinement.is_plain:
        return ()  # the vertices of a scan mirror no vertices
    sides = [(pair.target.control, pair.landmarks.target), (pair.source.control, pair.landmarks.source)]
    mirrors = in_threads(lambda side: mirror_symmetries(side[0]), sides)
    partners = [
        [(mirror, _partners(mirror, landmarks.positions / landmarks.surface.scale)) for mirror in planes]
        for planes, (_, landmarks) in zip(mirrors, sides, strict=True)
    ]
    found: list[SymmetryPair] = []
    taken: set[int] = set()
    for target, at_target in partners[0]:
        if sum(np.array_equal(at_target, others) for _, others in partners[0]) > 1:
            continue
        agreement = [np.mean(at_target == at_source) if len(at_target) else 1.0 for _, at_source in partners[1]]
        order = [int(i) for i in np.argsort(agreement)[::-1] if int(i) not in taken]
        told = len(order) == 1 or (len(order) > 1 and agreement[order[0]] > agreement[order[1]])
        if told and agreement[order[0]] >= AGREEMENT:
            taken.add(order[0])
            found.append((target.image, partners[1][order[0]][0].image))
    return tuple(found)


def _partners(mirror: Mirror, places: FloatArray) -> IndexArray:
    """Which landmark every landmark's mirror image is nearest to; (p,)."""
    squared = np.sum((mirror.reflect(places)[:, None] - places[None, :]) ** 2, axis=2)
    return np.asarray(np.argmin(squared, axis=1)) if len(places) else np.zeros(0, dtype=np.int64)
