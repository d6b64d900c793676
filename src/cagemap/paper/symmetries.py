"""Self-symmetries as operators that a functional map commutes with (paper, 5.2)."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cagemap.errors import ParameterError
from cagemap.maps.pair import Pair, SymmetryPair
from cagemap.mesh import ControlMesh
from cagemap.mesh.mirrors import Mirror, mirror_symmetries, reflect
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import in_threads
from cagemap.spectral.basis import HierarchicalBasis
from cagemap.subdivision import Refinement

SAME_ROW = 1e-9  # rows of S^l are equal if their products with random functions differ by less than this
UNKNOWN = -1
OPERATOR_COLUMNS = 32  # number of basis functions to which an operator is applied at once: 256 MB at a million vertices
AGREEMENT = 0.5  # least share of landmarks that two paired mirror planes map to the same landmarks


def check_symmetry(symmetry: IndexArray, control: ControlMesh) -> None:
    """Raise ParameterError unless images (n,), -1 if unknown, are a self-map of the control vertices."""
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
    """(n_level,) self-map of a level, propagated from the control mesh; -1 if unknown."""
    for i in range(level):
        coarse, fine = refinement.levels[i].positions, refinement.levels[i + 1].positions
        symmetry = propagate_symmetry(refinement.matrices[i], symmetry, coarse, fine)
    return symmetry


def propagate_symmetry(
    subdivision: sparse.csr_array, symmetry: IndexArray, coarse_positions: FloatArray, fine_positions: FloatArray
) -> IndexArray:
    """(n_{l+1},) self-map of the next level: nearest neighbours of S^l S_sym X^l in X^{l+1} (paper, 5.2).

    If a row of S^l with permuted columns is again a row of S^l, that row is the image; unlike positions, this
    distinguishes coinciding vertices. Otherwise the nearest position is taken. The image is -1 for all vertices that
    depend on a vertex with unknown image.
    """
    rng = np.random.default_rng(20190707)
    probes = rng.standard_normal((subdivision.shape[1], 3))  # random functions distinguish all rows of S^l
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
    """(k, k) operator O~ = Phi~^+ S Phi~ of a self-symmetry S (n,), cut to three diagonals (paper, 5.2).

    S is a self-map of the basis's last level. The pseudo-inverse uses the inner product M, so that an exact symmetry
    has +-1 on the diagonal. S g is 0 where the image is unknown, which should be on the same parts of both surfaces.
    """
    level, columns = basis.last_level, []
    for i, band in enumerate(basis.bands):
        for start in range(0, band.shape[1], OPERATOR_COLUMNS):
            values = basis.hierarchy.prolong(band[:, start : start + OPERATOR_COLUMNS], i, level)
            columns.append(basis.project(np.where(symmetry[:, None] == UNKNOWN, 0.0, values[symmetry]), level))
    return np.triu(np.tril(np.hstack(columns), 1), -1)


def paired_mirrors(pair: Pair) -> tuple[SymmetryPair, ...]:
    """Pairs of mirror planes of both control meshes that agree with the landmarks.

    Planes are paired if they map landmarks near the same landmarks. Planes that the landmarks cannot distinguish are
    left out. The only planes of both sides are paired unless landmarks disagree. Plain meshes have no pairs.
    """
    if pair.target.refinement.is_plain or pair.source.refinement.is_plain:
        return ()  # vertices of a scan have no mirror images
    sides = [(pair.target.control, pair.landmarks.target), (pair.source.control, pair.landmarks.source)]
    mirrors = in_threads(lambda side: mirror_symmetries(side[0]), sides)
    partners = [
        [(mirror, _partners(mirror, landmarks.positions / landmarks.surface.scale)) for mirror in planes]
        for planes, (_, landmarks) in zip(mirrors, sides, strict=True)
    ]
    pairs: list[SymmetryPair] = []
    taken: set[int] = set()
    for target, at_target in partners[0]:
        if sum(np.array_equal(at_target, at_other) for _, at_other in partners[0]) > 1:
            continue
        agreement = [np.mean(at_target == at_source) if len(at_target) else 1.0 for _, at_source in partners[1]]
        order = [int(i) for i in np.argsort(agreement)[::-1] if int(i) not in taken]
        distinguished = len(order) == 1 or (len(order) > 1 and agreement[order[0]] > agreement[order[1]])
        if distinguished and agreement[order[0]] >= AGREEMENT:
            taken.add(order[0])
            pairs.append((target.image, partners[1][order[0]][0].image))
    return tuple(pairs)


def _partners(mirror: Mirror, places: FloatArray) -> IndexArray:
    """(p,) landmark nearest to every landmark's mirror image."""
    squared = np.sum((reflect(places, mirror.normal, mirror.offset)[:, None] - places[None, :]) ** 2, axis=2)
    return np.asarray(np.argmin(squared, axis=1)) if len(places) else np.zeros(0, dtype=np.int64)
