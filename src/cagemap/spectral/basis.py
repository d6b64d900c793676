"""Spectral basis: functions of one level, or the paper's bands of several levels (Definition 2, 4.3, 4.4)."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import linalg, sparse

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, finite_numbers, read_only, whole_numbers
from cagemap.numerics.kinds import Config, kinds_checked
from cagemap.numerics.sparse_algebra import multiply
from cagemap.numerics.threads import ROW_BLOCK, row_slices
from cagemap.operators import Operators, lumped_areas
from cagemap.operators.laplacian import named_laplacian
from cagemap.spectral.eigenpairs import SOLVER, band_pairs, count_below, residual_norms
from cagemap.subdivision import Refinement

_log = logging.getLogger(__name__)

# Least vertices, and least vertices per function, of the level at which a basis is computed. Maps of six human pairs
# are then those of a basis with eigenvalues within 5 % of the finest level's (docs/lab/spectral.md).
MIN_VERTICES = 3000
VERTICES_PER_FUNCTION = 20
HFM_FUNCTIONS = 150  # number of functions of the method "hfm"
# Functions per level of "paper". With 100 on level 0, as in Table 1, eqs. 14-16 have no effect (docs/paper/blocks.md).
PAPER_SCHEDULE = (50, 100)


@dataclass(frozen=True)
class BasisConfig(Config):
    """Parameters of a spectral basis: ``count`` functions of one level, or bands of several levels."""

    RANGES: ClassVar = {"count": (1, np.inf), "vertices": (1, np.inf)}

    #: number of functions k; the default is reduced on smaller meshes. They are computed at the coarsest level with at
    #: least ``MIN_VERTICES`` and ``VERTICES_PER_FUNCTION * count`` vertices; eigenvalues there are 0.1 to 4 % above the
    #: finest level's.
    count: int = 100
    schedule: tuple[int, ...] | None = None  #: instead: numbers k_l that levels add, from level 0 (Definition 2)
    accuracy: float = 1e-5  #: convergence of the eigensolver, relative to the eigenvalues of the inverted problem
    #: only with a schedule. True: a band is the k_l eigenvectors above the largest eigenvalue so far (Definition 2); it
    #: starts a few indices too high, as eigenvalues of finer levels are lower. False: a band continues at the index
    #: after the last band, without the directions that the refined coarser bands span already.
    literal: bool = False
    vertices: int | None = None  #: operators are built at the coarsest level with so many; None: at the finest one
    #: Laplacian of quads: "mean" of both triangulations, "alexa-wardetzky" (the paper's) or "de-goes-butts-desbrun";
    #: see `cagemap.operators.laplacian`
    laplacian: str = "mean"
    stabilisation: float = 1.0  #: stabilisation weight lambda of the last two Laplacians

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.accuracy <= 1e-3:
            raise ParameterError(f"accuracy: expected a residual between 0 and 1e-3, got {self.accuracy}")
        if self.schedule is not None and not any(self.schedule):
            raise ParameterError(f"schedule: expected counts, such as (100, 50), level 0 first, got {self.schedule}")
        named_laplacian(self.laplacian, self.stabilisation)
        if self.literal and self.schedule is None:
            raise ParameterError("literal: expected a schedule with it (Definition 2), got none; give schedule")

    def bands(self, refinement: Refinement, finest: int) -> tuple[int, ...]:
        """Number of functions that each level adds: the schedule, or all at one level up to ``finest``."""
        if self.schedule is not None:
            return self.schedule
        level = min(refinement.coarsest_level(max(MIN_VERTICES, VERTICES_PER_FUNCTION * self.count)), finest)
        return (*(0,) * level, self.count)


# Basis of the default method. Operators of 20 000 vertices and this accuracy change eigenvalues by less than 1 %; more
# functions do not improve maps (docs/lab/spectral.md).
MAP_BASIS = BasisConfig(accuracy=1e-3, vertices=20_000)


@dataclass(frozen=True, eq=False, repr=False)
class HierarchicalBasis:
    """Basis of eigenfunctions of several levels, Phi~^{l+1} = [S^l Phi~^l, band^{l+1}] (eqs. 7, 8).

    The dense matrix of the finest level is not stored: `at`, `rows` and `row_blocks` compute parts of it.
    """

    hierarchy: Refinement
    operators: Operators  #: mass and stiffness of all levels, or of the first ones
    bands: tuple[FloatArray, ...]  #: (n_l, k_l) new eigenvectors of levels 0 to the last with any, each M^l-orthonormal
    eigenvalues: FloatArray  #: (k,) Lambda~, band after band, computed at each pair's own level. Unit area.
    residuals: FloatArray  #: (k,) relative residual of every pair at its own level, see `residual_norms`
    indices: IndexArray  #: (k,) index of every pair in the whole spectrum of its own level, from 0
    gram: FloatArray  #: (k, k) Phi~^T M Phi~, the same at every level that has all the bands (Lemma 5)

    def __post_init__(self) -> None:
        sizes = [level.n_vertices for level in self.hierarchy.levels]
        found = [band.shape[0] for band in self.bands]
        known = [mass.shape[0] for mass in self.operators.mass]
        if found != sizes[: len(found)] or known != sizes[: len(known)] or len(found) > len(known):
            raise ParameterError(
                f"expected bands and operators of levels with {sizes} vertices, got bands with {found} rows; give the "
                "hierarchy and the operators that the basis was computed from"
            )
        object.__setattr__(self, "bands", tuple(read_only(band) for band in self.bands))
        for name in ("eigenvalues", "residuals", "indices", "gram"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def schedule(self) -> tuple[int, ...]:
        """Number k_l of functions that each level adds."""
        return tuple(band.shape[1] for band in self.bands)

    @property
    def count(self) -> int:
        """Total number k of basis functions."""
        return len(self.eigenvalues)

    @property
    def last_level(self) -> int:
        """Finest level that adds functions; the whole basis can be evaluated from this level on."""
        return len(self.bands) - 1

    @property
    def condition(self) -> float:
        """Condition number of the Gram matrix; near 1 if bands are nearly orthogonal."""
        squares = linalg.eigvalsh(self.gram)
        return float(squares[-1] / max(squares[0], np.finfo(float).tiny))

    def size(self, level: int) -> int:
        """Number k~_l of functions in the bands up to a level."""
        return sum(self.schedule[: level + 1])

    @kinds_checked
    def at(self, level: int) -> FloatArray:
        """Dense matrix Phi~^level (n_level, k~_level) of the bands up to a level (eq. 8), else ParameterError."""
        self._check_level(level)
        values = np.zeros((self.hierarchy.levels[0].n_vertices, 0))
        for finer in range(level + 1):
            if finer > 0:
                values = multiply(self.hierarchy.matrices[finer - 1], values)
            if finer <= self.last_level:
                values = np.hstack([values, self.bands[finer]])
        return values

    @kinds_checked
    def rows(self, level: int, vertices: IndexArray) -> FloatArray:
        """Rows (q, k~_level) of Phi~^level at vertices (q,), in time linear in q; ParameterError for missing ones."""
        self._check_level(level)
        vertices = whole_numbers(vertices, "vertices")
        bands = [(coarser, band) for coarser, band in enumerate(self.bands[: level + 1]) if band.shape[1]]
        rows = [multiply(self.hierarchy.rows(vertices, level, coarser), band) for coarser, band in bands]
        return np.hstack([np.zeros((len(vertices), 0)), *rows])

    def row_blocks(self, level: int) -> Iterator[tuple[slice, FloatArray]]:
        """Yield blocks of vertices and rows of Phi~^level, for levels with too many rows for memory."""
        self._check_level(level)
        for part in row_slices(self.hierarchy.levels[level].n_vertices, ROW_BLOCK):
            yield part, self.rows(level, np.arange(part.start, part.stop))

    @kinds_checked
    def project(self, values: FloatArray, level: int, *, count: int | None = None) -> FloatArray:
        """Coefficients (k,) or (k, q) of functions: (Phi~^T M Phi~)^{-1} Phi~^T M f (paper, section 4.4).

        The functions (n_level,) or (n_level, q) are refined first if the basis has finer bands. With ``count`` only so
        many leading functions of the basis are used. ParameterError if there is no such level, or rows are missing.
        """
        self._check_level(level)
        size = self.count if count is None else count
        if not 1 <= size <= self.count:
            raise ParameterError(f"expected 1 to {self.count} basis functions, got {size}")
        n = self.hierarchy.levels[level].n_vertices
        functions = finite_numbers(values, "functions")
        if functions.shape[:1] != (n,):
            raise ParameterError(f"expected functions with {n} rows, level {level}'s vertices, got {functions.shape}")
        if level > self.operators.finest_level:
            raise ParameterError(
                f"expected functions of a level up to {self.operators.finest_level}, the last with operators, got "
                f"level {level}; prepare the surface with a basis without `vertices`"
            )
        columns = functions.reshape(n, -1)
        needed = int(np.searchsorted(np.cumsum(self.schedule), size))  # the last of these functions' level
        if level < needed:
            columns, level = self.hierarchy.prolong(columns, level, needed), needed
        dual = multiply(self.operators.mass[level], columns)
        moments = products_with_bands(self.bands[: needed + 1], self.hierarchy, dual, level)[:size]
        coefficients = linalg.cho_solve(linalg.cho_factor(self.gram[:size, :size]), moments)
        return coefficients.reshape(size, *functions.shape[1:])

    def _check_level(self, level: int) -> None:
        if not 0 <= level <= self.hierarchy.finest_level:
            raise ParameterError(
                f"expected a level from 0 to {self.hierarchy.finest_level}, got {level}; refine further to have it"
            )

    def __repr__(self) -> str:
        bands = ", ".join(f"{k} at level {level}" for level, k in enumerate(self.schedule))
        return f"HierarchicalBasis({self.count} functions: {bands})"


def hierarchical_basis(
    hierarchy: Refinement, operators: Operators, config: BasisConfig = BasisConfig()
) -> HierarchicalBasis:
    """Compute a basis: ``config.count`` functions of one level, or ``config.schedule[l]`` of each level.

    Logs a warning if functions of different levels are nearly dependent (``condition``). ParameterError if more
    functions are asked for than a level has vertices.
    """
    counts, sizes = config.bands(hierarchy, operators.finest_level), [mass.shape[0] for mass in operators.mass]
    if config.schedule is None:
        size = sizes[len(counts) - 1]
        if config.count > size and config.count != BasisConfig.count:
            raise ParameterError(
                f"count: expected at most {size} basis functions, the vertices of the finest level, got {config.count};"
                " refine further or ask for fewer"
            )
        counts = (*counts[:-1], min(config.count, size))
    elif len(counts) > len(sizes) or np.any(np.cumsum(counts) > sizes[: len(counts)]):
        raise ParameterError(
            f"schedule: expected at most {len(sizes)} counts, one for each level, with sums up to every level of "
            f"at most its vertices {sizes}, got {counts}; refine further, move counts to finer levels, or give count"
        )
    while not counts[-1]:
        counts = counts[:-1]
    none = np.zeros(0)
    basis = HierarchicalBasis(hierarchy, operators, (), none, none, none.astype(np.int64), np.zeros((0, 0)))
    for level, count in enumerate(counts):
        basis = _with_band(basis, level, *_new_band(basis, level, count, config))
    if basis.condition > SOLVER.ill_conditioned:
        _log.warning(
            "%s: the Gram matrix has condition %.0f: functions of different levels nearly repeat each other, since "
            "coarse levels were asked for more than they resolve; take fewer there, or count instead of schedule",
            basis,
            basis.condition,
        )
    return basis


def _new_band(basis: HierarchicalBasis, level: int, count: int, config: BasisConfig) -> tuple[FloatArray, IndexArray]:
    """Next eigenvectors (n_l, k_l) of a level after those in the basis (Definition 2), and their indices."""
    stiffness, mass = basis.operators.stiffness[level], basis.operators.mass[level]
    if not count:
        return np.zeros((mass.shape[0], 0)), np.zeros(0, dtype=np.int64)
    if config.literal and basis.count:
        first = count_below(stiffness, mass, float(basis.eigenvalues.max()))
        if first + count > mass.shape[0]:
            raise ParameterError(
                f"schedule: expected at most {mass.shape[0] - first} functions at level {level}, which has so many "
                f"above the largest eigenvalue so far, got {count}; move counts to finer levels"
            )
        pairs = band_pairs(stiffness, mass, first, first + count, accuracy=config.accuracy)
        return _orthonormal(pairs.vectors, mass), first + np.arange(count)
    first = max(0, basis.count - SOLVER.overlap)
    pairs = band_pairs(stiffness, mass, first, basis.count + count, accuracy=config.accuracy)
    vectors = _orthonormal(pairs.vectors, mass)
    if not basis.count:
        return vectors, np.arange(count)
    overlap = products_with_bands(basis.bands, basis.hierarchy, multiply(mass, vectors), level)
    rotation, positions = new_directions(pairs.values, overlap, basis.gram, basis.count - first)
    return np.ascontiguousarray(vectors @ rotation), first + positions


def new_directions(
    values: FloatArray, overlap: FloatArray, gram: FloatArray, present: int
) -> tuple[FloatArray, IndexArray]:
    """Directions in a window of eigenvectors (m, m - present) that the refined basis lacks, and their indices.

    ``values`` (m,) ascend; ``overlap`` (k, m) and ``gram`` (k, k) are inner products of the refined basis with the
    M-orthonormal window and with itself. As many directions as ``present``, those of largest overlap, are left out.
    Eigenvectors of a repeated eigenvalue that a band's end splits are first rotated, to be inside or outside the
    refined span if possible.
    """
    m = len(values)
    # In an orthonormal basis of the refined span, squared column norms are the shares of vectors inside that span.
    inside = linalg.solve_triangular(linalg.cholesky(gram, lower=True), overlap, lower=True)
    rotation = np.eye(m)
    share = np.sum(inside**2, axis=0)
    labels = label_clusters(values)
    for label in np.flatnonzero(np.bincount(labels) > 1):
        members = np.flatnonzero(labels == label)
        squares, axes = linalg.eigh(inside[:, members].T @ inside[:, members])
        if squares[0] > 0.5 or squares[-1] < 0.5:  # not split by the band's end
            continue
        # Descending shares: missing directions come last, next to the following pairs.
        share[members] = squares[::-1]
        rotation[np.ix_(members, members)] = axes[:, ::-1]
    positions = np.sort(np.argsort(-share, kind="stable")[present:])
    return rotation[:, positions], positions


def label_clusters(values: FloatArray) -> IndexArray:
    """(m,) cluster number of every eigenvalue of an ascending list; nearly equal ones form a cluster."""
    steps = np.diff(values) > SOLVER.cluster * np.maximum(np.abs(values[1:]), 1e-3 * abs(values[-1]))
    return np.concatenate([[0], np.cumsum(steps)])


def _orthonormal(vectors: FloatArray, mass: sparse.csr_array) -> FloatArray:
    """M-orthonormalise eigenvectors in double precision; they may be in single."""
    band = np.array(vectors, dtype=np.float64)
    factor = linalg.cholesky(band.T @ multiply(mass, band))
    return np.ascontiguousarray(linalg.solve_triangular(factor, band.T, trans="T").T)


def _with_band(basis: HierarchicalBasis, level: int, band: FloatArray, indices: IndexArray) -> HierarchicalBasis:
    """Append the band of the next level; the Gram matrix becomes [[G, E], [E^T, I]] (eqs. 8, 9)."""
    mass, stiffness = basis.operators.mass[level], basis.operators.stiffness[level]
    dual, energy = multiply(mass, band), multiply(stiffness, band)
    values = np.einsum("ij,ij->j", band, energy)
    residuals = residual_norms(values, energy, dual, lumped_areas(mass))
    cross = products_with_bands(basis.bands, basis.hierarchy, dual, level)
    return HierarchicalBasis(
        basis.hierarchy,
        basis.operators,
        (*basis.bands, band),
        np.concatenate([basis.eigenvalues, values]),
        np.concatenate([basis.residuals, residuals]),
        np.concatenate([basis.indices, indices]),
        np.block([[basis.gram, cross], [cross.T, np.eye(len(values))]]),
    )


def products_with_bands(
    bands: tuple[FloatArray, ...], hierarchy: Refinement, dual: FloatArray, level: int
) -> FloatArray:
    """Phi~^T y (k, q) for functionals y = M^level f (n_level, q), restricted level by level (Lemma 5)."""
    products: list[FloatArray] = []
    for coarser in reversed(range(level + 1)):
        if coarser < len(bands):
            products.append(bands[coarser].T @ dual)
        if coarser > 0:
            dual = hierarchy.matrices[coarser - 1].T @ dual
    return np.concatenate(products[::-1]) if products else np.zeros((0, dual.shape[1]))
