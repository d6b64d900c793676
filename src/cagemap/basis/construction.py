"""Computing the hierarchical basis from the control mesh upwards (paper, sections 4.3 and 4.4)."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

import numpy as np
from scipy import linalg, sparse

from cagemap.basis.constants import (
    BELOW,
    FIXED_GUESS,
    GUARDS,
    GUESS_ERROR,
    GUESS_ROWS,
    GUESS_SHARE,
    ILL_CONDITIONED,
    NEARLY_DOUBLE,
    OVERLAP,
    SEED,
    SINGLE_STORAGE,
    SINGLE_TOLERANCE,
    START_COLUMNS,
    TIGHT,
)
from cagemap.basis.eigen import EigenPairs, band_pairs, count_below, residual_norms
from cagemap.basis.error_estimate import ErrorEstimate, estimate_errors
from cagemap.basis.gram import extend_gram, overlaps_with_bands
from cagemap.basis.guess import pairs_from_guess, working_type
from cagemap.basis.hierarchical_basis import HierarchicalBasis
from cagemap.basis.overlap import new_directions
from cagemap.basis.ritz import gram, subtract
from cagemap.basis.schedule import BasisConfig, certain_count, choose_split, plausible_count
from cagemap.basis.smoothing import Block
from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import Precision
from cagemap.numerics.products import multiply
from cagemap.operators import Operators, lumped_areas
from cagemap.refinement import Refinement

_log = logging.getLogger(__name__)


def hierarchical_basis(
    refinement: Refinement, operators: Operators, config: BasisConfig = BasisConfig()
) -> HierarchicalBasis:
    """Hierarchical basis of a surface, by the paper's fixed schedule or by a tolerance.

    Error-controlled (default): every level, from the control mesh up, keeps those of its eigenpairs whose eigenvalues
    are within ``config.tolerance`` of the finest level's; the rest are left to the next level. Fixed: every level adds
    ``config.schedule[l]`` pairs. A basis whose functions nearly repeat each other is warned of (``condition``).

    Parameters
    ----------
    refinement : Refinement
    operators : Operators
        Of the same refinement.
    config : BasisConfig

    Raises
    ------
    ParameterError
        If more functions are asked for than a level has vertices.
    """
    _check_sizes(operators, config)
    return _Growth(refinement, operators, config).grown()


@dataclass
class _Growth:
    """A basis while it is computed, level by level."""

    refinement: Refinement
    operators: Operators
    config: BasisConfig
    bands: list[FloatArray] = field(default_factory=list)
    values: FloatArray = field(default_factory=lambda: np.zeros(0))
    residuals: FloatArray = field(default_factory=lambda: np.zeros(0))
    indices: IndexArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    errors: FloatArray = field(default_factory=lambda: np.zeros(0))
    gram: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    # The last level's pairs, kept or not, and how many of them met the tolerance: a start for the next level.
    pairs: EigenPairs | None = None
    good: int = 0
    top_error: float = np.inf

    @property
    def count(self) -> int:
        return len(self.gram)

    @property
    def basis(self) -> HierarchicalBasis:
        """The basis so far as a value."""
        return HierarchicalBasis(
            self.refinement,
            self.operators,
            tuple(self.bands),
            self.values,
            self.residuals,
            self.indices,
            self.gram,
            self.errors,
        )

    def rows(self, level: int) -> int:
        """Number of vertices of a level."""
        return int(self.operators.mass[level].shape[0])

    def grown(self) -> HierarchicalBasis:
        """The whole basis, after all levels have added what they have."""
        for level in range(self.operators.finest + 1):
            if self.count >= self.config.total:
                break
            if self.config.schedule is None:
                self.add_controlled(level)
            elif level < len(self.config.schedule):
                self.add_scheduled(level, self.config.schedule[level])
        basis = self.basis
        if basis.condition > ILL_CONDITIONED:
            _log.warning(
                "%s: the Gram matrix has condition %.0f: functions of different levels nearly repeat each other, since "
                "coarse levels were asked for more than they resolve; take fewer there, or count and tolerance",
                basis,
                basis.condition,
            )
        return basis

    def add_scheduled(self, level: int, wanted: int) -> None:
        """Add the pairs that the fixed schedule wants of a level."""
        if self.config.literal and level > 0:
            self.add_literal(level, wanted)
            return
        last = self.count + wanted
        pairs = self.window(level, last if level == self.last_scheduled else self.ahead(level, last), wanted=last)
        candidates = pairs.part(max(pairs.first_index, self.count - OVERLAP), last)
        # Any error will do here: the estimate is for the record, and a sample of pairs is enough.
        estimate = self.estimate(candidates, level, tolerance=np.inf)
        self.top_error = float(estimate.errors[-1])
        self.append(level, candidates, estimate, wanted)
        self.pairs = pairs

    @property
    def last_scheduled(self) -> int:
        """The last level that a fixed schedule asks for functions."""
        assert self.config.schedule is not None
        return int(np.flatnonzero(self.config.schedule)[-1])

    @property
    def guesses(self) -> bool:
        """Whether large levels may start from the pairs of the one below: not where a schedule is to be exact."""
        config = self.config
        return config.schedule is None or (config.solver_accuracy >= SINGLE_STORAGE and not config.literal)

    def ahead(self, level: int, last: int) -> int:
        """How far a level computes pairs that it does not keep, as a guess for the next one where that is large."""
        total = self.config.total + GUARDS
        large = self.guesses and self.rows(level + 1) > GUESS_ROWS and 3 * total < self.rows(level)
        return max(last, total) if large else last

    def add_literal(self, level: int, wanted: int) -> None:
        """Add the pairs of a level that follow the largest eigenvalue so far: eq. 8 with Definition 2 to the letter."""
        if not wanted:
            self.bands.append(np.zeros((self.rows(level), 0)))
            return
        stiffness, mass = self.operators.stiffness[level], self.operators.mass[level]
        first = count_below(stiffness, mass, float(self.values.max()))
        if first + wanted > self.rows(level):
            raise ParameterError(
                f"schedule: expected at most {self.rows(level) - first} functions at level {level}, which has so many "
                f"above the largest eigenvalue so far, got {wanted}; move counts to finer levels"
            )
        pairs = band_pairs(stiffness, mass, first, first + wanted, tolerance=self.config.solver_accuracy)
        estimate = self.estimate(pairs, level, tolerance=np.inf)
        self.append_band(level, pairs.vectors, first + np.arange(wanted), estimate.errors)

    def add_controlled(self, level: int) -> None:
        """Add the pairs of one level that meet the tolerance there."""
        config, rows = self.config, self.rows(level)
        last = reach = config.count
        if level < self.operators.finest:
            seen = self.good * rows / self.rows(level - 1) if level > 0 else 0.0
            plausible = plausible_count(rows, config.tolerance, seen)
            last = reach = min(last, plausible)
            if config.count > certain_count(rows, config.tolerance):
                # Should the next level be needed, pairs that are no use here are a guess for it.
                reach = self.ahead(level, reach)
        if last <= self.count and reach <= last:
            self.bands.append(np.zeros((rows, 0)))
            self.pairs = None
            return
        pairs = self.window(level, reach)
        # A level started from a guess has all pairs below the window too, not as accurate.
        candidates = pairs.part(max(0, self.count - OVERLAP), min(pairs.last_index, config.count))
        self.take_back(candidates)
        self.pairs = pairs
        estimate = self.estimate(candidates, level, config.tolerance)
        present = self.count - candidates.first_index
        good, kept = choose_split(estimate, present, config.count - self.count, config.tolerance)
        self.good = self.count + good
        self.top_error = float(estimate.errors[-1])
        self.append(level, candidates, estimate, kept)

    def window(self, level: int, last: int, wanted: int | None = None) -> EigenPairs:
        """Eigenpairs of a level from a few below the end of the basis so far up to ``last``, or more.

        Those from ``wanted`` on (default: the size of the whole basis) need not be accurate.
        """
        stiffness, mass, config = self.operators.stiffness[level], self.operators.mass[level], self.config
        first = max(0, self.count - OVERLAP)
        wanted = config.total if wanted is None else wanted
        guards = max(0, last - wanted)
        previous = self.pairs
        if previous is None or previous.last_index <= first:
            return band_pairs(stiffness, mass, first, last, tolerance=config.solver_accuracy, guards=guards)
        if self.guess_is_good(level, last):
            accuracy = GUESS_SHARE * config.tolerance if config.schedule is None else FIXED_GUESS
            kept, end = (first, min(last, wanted)), min(previous.last_index, last + GUARDS)
            # Where the tolerance is near what single precision resolves, double precision is next to try.
            precisions = [working_type(accuracy)] + [np.float64] * (SINGLE_TOLERANCE <= accuracy < NEARLY_DOUBLE)
            start = max(0, first - BELOW * (end - first)) if config.tolerance > TIGHT else 0
            for dtype in precisions:
                guess, values = self.guess(level, start, end, dtype)
                pairs = pairs_from_guess(
                    stiffness, mass, guess, values, first_index=start, kept=kept, tolerance=accuracy, dtype=dtype
                )
                if pairs is not None:
                    return pairs
        # The coarser level's pairs in that range, mixed at random, are a block rich in what is sought; a little noise
        # makes it a full one.
        useful = previous.vectors[:, max(0, first - previous.first_index) :]
        rng = np.random.default_rng(SEED)
        mixed = useful @ rng.standard_normal((useful.shape[1], START_COLUMNS))
        block = self.refinement.prolong(mixed, level - 1, level)
        block += 0.01 * np.abs(block).mean() * rng.standard_normal(block.shape)
        return band_pairs(stiffness, mass, first, last, start=block, tolerance=config.solver_accuracy, guards=guards)

    def guess_is_good(self, level: int, last: int) -> bool:
        """Whether to start a level from the pairs of the one below: it is large, and they are good and reach far."""
        return (
            self.guesses
            and self.pairs is not None
            and self.rows(level) > GUESS_ROWS
            and self.top_error < GUESS_ERROR
            and self.pairs.last_index >= min(last, self.config.total) + GUARDS // 2
        )

    def guess(self, level: int, start: int, end: int, dtype: Precision) -> tuple[Block, FloatArray]:
        """Pairs start..end of the level below, refined: what it has computed, and below that the basis itself.

        More than are wanted at the lower end, so that what the iteration mixes into a pair can only come from above.
        """
        assert self.pairs is not None
        pairs = self.pairs.part(self.pairs.first_index, end)
        vectors, values = pairs.vectors, pairs.values
        if pairs.first_index > 0:
            lower = self.basis.at(level - 1)[:, : pairs.first_index]
            vectors = np.hstack([lower, vectors])
            values = np.concatenate([np.sort(self.values[: pairs.first_index]), values])
        vectors = vectors[:, start:].astype(dtype, copy=False)
        return multiply(self.refinement.matrices[level - 1], vectors), values[start:]

    def take_back(self, pairs: EigenPairs) -> None:
        """Drop functions whose eigenvalue turns out too high, now that the next level has computed it too."""
        known = self.values[pairs.first_index :]
        exact = pairs.values[: len(known)]
        excess = np.sort(known) - exact
        wrong = np.flatnonzero(excess > self.config.tolerance * np.maximum(exact, 1e-3 * pairs.values[-1]))
        if not len(wrong):
            return
        size = pairs.first_index + int(wrong[0])
        remaining = size
        for level, band in enumerate(self.bands):
            self.bands[level] = band[:, :remaining]
            remaining -= self.bands[level].shape[1]
        self.gram = self.gram[:size, :size]
        self.values, self.residuals = self.values[:size], self.residuals[:size]
        self.indices, self.errors = self.indices[:size], self.errors[:size]

    def estimate(self, pairs: EigenPairs, level: int, tolerance: float) -> ErrorEstimate:
        """Errors of the pairs of a level against the finest one; none at the finest."""
        if level == self.operators.finest:
            return ErrorEstimate(np.zeros(len(pairs.values)), np.zeros(len(pairs.values) + 1))
        stiffness, mass = self.operators.stiffness[level + 1], self.operators.mass[level + 1]
        subdivision = self.refinement.matrices[level]
        return estimate_errors(subdivision, stiffness, mass, pairs.values, pairs.vectors, tolerance)

    def append(self, level: int, pairs: EigenPairs, estimate: ErrorEstimate, wanted: int) -> None:
        """Append the first ``wanted`` new directions of a window of eigenpairs to the band of a level (eq. 8)."""
        vectors, positions = self.missing(level, pairs, wanted)
        self.append_band(level, vectors, pairs.first_index + positions, estimate.errors[positions])

    def append_band(self, level: int, vectors: Block, indices: IndexArray, errors: FloatArray) -> None:
        """Append eigenvectors of a level, with their places in its spectrum, to its band."""
        mass, stiffness = self.operators.mass[level], self.operators.stiffness[level]
        band = _orthonormal(vectors, mass)
        dual, energy = multiply(mass, band), multiply(stiffness, band)
        values = np.einsum("ij,ij->j", band, energy)
        residuals = residual_norms(values, band, energy, dual, lumped_areas(mass))
        self.gram = extend_gram(self.gram, tuple(self.bands), self.refinement, dual, level)
        self.bands.append(band)
        self.values = np.concatenate([self.values, values])
        self.residuals = np.concatenate([self.residuals, residuals])
        self.errors = np.concatenate([self.errors, errors])
        self.indices = np.concatenate([self.indices, indices])

    def missing(self, level: int, pairs: EigenPairs, wanted: int) -> tuple[Block, IndexArray]:
        """The first ``wanted`` eigenvectors of a window that the basis does not have yet, and their places in it."""
        present = self.count - pairs.first_index
        if present == 0:
            return pairs.vectors[:, :wanted], np.arange(len(pairs.values))[:wanted]
        vectors = pairs.vectors
        overlap = overlaps_with_bands(tuple(self.bands), self.refinement, self.operators.mass[level], vectors, level)
        rotation, positions = new_directions(pairs.values, overlap, self.gram, present)
        rotation, positions = rotation[:, :wanted], positions[:wanted]
        if np.array_equal(rotation, np.eye(len(rotation))[:, positions]):  # no cluster was cut
            return vectors[:, positions], positions
        return vectors @ rotation.astype(vectors.dtype), positions


def _orthonormal(vectors: Block, mass: sparse.csr_array) -> FloatArray:
    """Eigenvectors, orthonormal but for the rounding of single precision perhaps, made so in double."""
    band = np.array(vectors, dtype=np.float64, order="C")
    if not band.shape[1]:
        return band
    turn = linalg.inv(linalg.cholesky(gram(band, multiply(mass, band))))
    # What is to be taken is small: the precision of the vectors is enough for it.
    subtract(band, vectors, np.eye(len(turn)) - turn)
    return band


def _check_sizes(operators: Operators, config: BasisConfig) -> None:
    finest = operators.mass[-1].shape[0]
    if config.schedule is None:
        if config.count > finest:
            raise ParameterError(
                f"count: expected at most {finest} basis functions, the vertices of the finest level, got "
                f"{config.count}; refine further or ask for fewer"
            )
        return
    if len(config.schedule) > operators.finest + 1:
        raise ParameterError(
            f"schedule: expected at most {operators.finest + 1} counts, one for each level, got "
            f"{len(config.schedule)}: {config.schedule}; refine further or shorten it"
        )
    totals = np.cumsum(config.schedule)
    sizes = [mass.shape[0] for mass in operators.mass]
    for level, total in enumerate(totals):
        if total > sizes[level]:
            raise ParameterError(
                f"schedule: expected at most {sizes[level]} functions up to level {level}, which has so many vertices, "
                f"got {total} from {config.schedule}; move counts to finer levels, or give count and tolerance instead"
            )
