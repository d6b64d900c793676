"""Computing the hierarchical basis from the control mesh upwards (paper, sections 4.3 and 4.4)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import linalg, sparse

from cagemap.basis.correction import Correction, corrected_pairs
from cagemap.basis.eigen import EigenPairs, band_pairs, residual_norms
from cagemap.basis.error_estimate import ErrorEstimate, estimate_errors
from cagemap.basis.finish import split_isolated
from cagemap.basis.gram import extend_gram, overlaps_with_bands
from cagemap.basis.guess import SINGLE_TOLERANCE, pairs_from_guess, working_type
from cagemap.basis.hierarchical_basis import HierarchicalBasis, evaluate
from cagemap.basis.overlap import new_directions
from cagemap.basis.ritz import gram, subtract
from cagemap.basis.schedule import BasisConfig, choose_split, plausible_count
from cagemap.basis.smoothing import Block
from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.factorization import Precision
from cagemap.numerics.products import multiply
from cagemap.operators import Operators, lumped_areas
from cagemap.refinement import Refinement

# Pairs computed below the start of a band, to see which of them the prolonged basis has already.
OVERLAP = 12
# Levels larger than this start from the pairs of the level below, if those are good to this relative error (safety
# included) and reach half this many places beyond what is wanted.
GUESS_ROWS = 12_000
GUESS_ERROR = 5e-1
GUARDS = 30
# How many pairs below a window take part in its Rayleigh-Ritz step, in widths of the window; all where it is tight.
BELOW = 1
# A correction leaves about the square of an error, a hundred times: where the estimate, safety included, is below this
# times the root of the tolerance, it meets its share.
CORRECTION_REACH = 0.4
# Largest tolerance at which a correction is faster than inverse iteration of all pairs.
CORRECTION_TOLERANCE = 1e-3
# By how much an error falls at most from one level to the next.
LEVEL_GAIN = 20.0
# Largest error, safety included, of a pair that the finest level is asked to mend alone.
SPLIT_REACH = 1e-2
# Share of the tolerance that unfinished iterations may take there.
GUESS_SHARE = 0.25
NEARLY_DOUBLE = 1e-4
START_COLUMNS = 16
_SEED = 2019


@dataclass
class _Growing:
    """The basis so far, while it is built."""

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

    def basis(self) -> HierarchicalBasis:
        """The basis so far as a value."""
        return HierarchicalBasis(tuple(self.bands), self.values, self.residuals, self.indices, self.gram, self.errors)

    def drop_last(self, count: int) -> None:
        """Take back the last functions, all of them in the last band that has any."""
        for level in reversed(range(len(self.bands))):
            dropped = min(count, self.bands[level].shape[1])
            self.bands[level] = self.bands[level][:, : self.bands[level].shape[1] - dropped]
            count -= dropped
            size = self.count - dropped
            self.gram = self.gram[:size, :size]
        self.values, self.residuals = self.values[: self.count], self.residuals[: self.count]
        self.indices, self.errors = self.indices[: self.count], self.errors[: self.count]


def hierarchical_basis(
    refinement: Refinement,
    operators: Operators,
    config: BasisConfig = BasisConfig(),
) -> HierarchicalBasis:
    """Hierarchical basis of a surface, by the paper's fixed schedule or by a tolerance.

    Error-controlled (default): every level, from the control mesh up, keeps those of its eigenpairs whose eigenvalues
    are within ``config.tolerance`` of the finest level's; the rest are left to the next level. Fixed: every level adds
    ``config.schedule[l]`` pairs.

    Parameters
    ----------
    refinement : Refinement
    operators : Operators
        Of the same refinement.
    config : BasisConfig

    Returns
    -------
    HierarchicalBasis

    Raises
    ------
    ParameterError
        If more functions are asked for than a level has vertices.
    """
    _check_sizes(operators, config)
    growing = _Growing()
    for level in range(operators.finest + 1):
        if growing.count >= config.total:
            break
        if config.schedule is None:
            _add_controlled(growing, level, refinement, operators, config)
        elif level < len(config.schedule):
            last = growing.count + config.schedule[level]
            pairs = _window(operators, level, growing, last, config, refinement)
            # Any error will do here: the estimate is for the record, and a sample of pairs is enough.
            estimate = _estimate(pairs, level, refinement, operators, tolerance=np.inf)
            _append(growing, level, pairs, estimate, config.schedule[level], refinement, operators)
            growing.pairs = pairs
    return growing.basis()


def _add_controlled(
    growing: _Growing, level: int, refinement: Refinement, operators: Operators, config: BasisConfig
) -> None:
    """Add the pairs of one level that meet the tolerance there."""
    sizes = [mass.shape[0] for mass in operators.mass]
    last = reach = config.count
    if level < operators.finest:
        seen = growing.good * sizes[level] / sizes[level - 1] if level > 0 else 0.0
        plausible = plausible_count(sizes[level], config.tolerance, seen)
        last = reach = min(last, plausible)
        if sizes[level + 1] > GUESS_ROWS and 3 * (config.count + GUARDS) < sizes[level]:
            # The next level is large: should it be needed, pairs that are no use here are a guess for it.
            reach = config.count + GUARDS
    if last <= growing.count and reach <= last:
        growing.bands.append(np.zeros((sizes[level], 0)))
        growing.pairs = None
        return
    pairs = _window(operators, level, growing, reach, config, refinement)
    # A level started from a guess has all pairs below the window too, not as accurate.
    candidates = pairs.part(max(0, growing.count - OVERLAP), min(pairs.last_index, config.count))
    _take_back(growing, candidates, config.tolerance)
    growing.pairs = pairs
    # Where the level below was far too coarse, this one will be too coarse for some: the split has its own estimate.
    clear = (
        config.tolerance <= CORRECTION_TOLERANCE and LEVEL_GAIN * config.tolerance < growing.top_error <= SPLIT_REACH
    )
    if clear and _add_split(growing, level, refinement, operators, config):
        return
    estimate = _estimate(candidates, level, refinement, operators, config.tolerance)
    present = growing.count - candidates.first_index
    good, kept = choose_split(estimate, present, config.count - growing.count, config.tolerance)
    growing.good = growing.count + good
    growing.top_error = float(estimate.errors[-1])
    too_few = kept < config.count - growing.count and not clear  # or it has been tried
    if too_few and _add_split(growing, level, refinement, operators, config):
        return
    _append(growing, level, candidates, estimate, kept, refinement, operators)


def _add_split(
    growing: _Growing, level: int, refinement: Refinement, operators: Operators, config: BasisConfig
) -> bool:
    """Finish the basis at the last two levels, the finest taking isolated pairs only; False where that is no use."""
    pairs = growing.pairs
    assert pairs is not None
    if (
        level + 1 != operators.finest
        or operators.mass[-1].shape[0] <= GUESS_ROWS
        or growing.top_error > SPLIT_REACH
        or pairs.last_index < config.count + GUARDS // 2
    ):
        return False
    window = pairs.part(max(pairs.first_index, growing.count - OVERLAP), pairs.last_index)
    vectors, positions = _missing(growing, level, window, None, refinement, operators)
    finest = level + 1
    split = split_isolated(
        Correction.between(refinement.matrices[level], operators.stiffness[finest], operators.mass[finest]),
        vectors,
        window.values[positions],
        evaluate(growing.basis(), refinement, level) if growing.count else np.zeros((len(vectors), 0)),
        growing.count,
        config.count - growing.count,
        config.tolerance,
        SPLIT_REACH,
    )
    if split is None:
        return False
    first = growing.count
    indices = window.first_index + positions[split.kept]
    _append_band(growing, level, vectors[:, split.kept], indices, split.errors, refinement, operators)
    if len(split.places):
        errors = np.zeros(len(split.places))
        _append_band(growing, finest, split.vectors, first + split.places, errors, refinement, operators)
    return True


def _window(
    operators: Operators, level: int, growing: _Growing, last: int, config: BasisConfig, refinement: Refinement
) -> EigenPairs:
    """Eigenpairs of a level from a few below the end of the basis so far up to ``last``, or more."""
    stiffness, mass = operators.stiffness[level], operators.mass[level]
    first = max(0, growing.count - OVERLAP)
    guards = max(0, last - config.total)
    previous = growing.pairs
    if previous is None or previous.last_index <= first:
        return band_pairs(stiffness, mass, first, last, tolerance=config.solver_accuracy, guards=guards)
    if _guess_is_good(growing, first, last, mass.shape[0], config):
        accuracy = GUESS_SHARE * config.tolerance
        kept, end = (first, min(last, config.count)), min(previous.last_index, last + GUARDS)
        close = growing.top_error < CORRECTION_REACH * np.sqrt(config.tolerance)
        if close and config.tolerance <= CORRECTION_TOLERANCE and previous.first_index <= first:
            correction = Correction.between(refinement.matrices[level - 1], stiffness, mass)
            coarse = previous.part(first, end)
            fixed = _lowest(growing, first, level - 1, refinement)
            pairs = corrected_pairs(correction, coarse, fixed, kept=kept, tolerance=accuracy)
            if pairs is not None:
                return pairs
        # Where the tolerance is near what single precision resolves, double precision is next to try.
        precisions = [working_type(accuracy)] + [np.float64] * (SINGLE_TOLERANCE <= accuracy < NEARLY_DOUBLE)
        start = max(0, first - BELOW * (end - first)) if config.tolerance > CORRECTION_TOLERANCE else 0
        for dtype in precisions:
            guess, values = _guess(growing, level, start, end, refinement, dtype)
            pairs = pairs_from_guess(
                stiffness, mass, guess, values, first_index=start, kept=kept, tolerance=accuracy, dtype=dtype
            )
            if pairs is not None:
                return pairs
    # The coarser level's pairs in that range, mixed at random, are a block rich in what is sought; a little noise makes
    # it a full one.
    useful = previous.vectors[:, max(0, first - previous.first_index) :]
    rng = np.random.default_rng(_SEED)
    block = refinement.prolong(useful @ rng.standard_normal((useful.shape[1], START_COLUMNS)), level - 1, level)
    block += 0.01 * np.abs(block).mean() * rng.standard_normal(block.shape)
    return band_pairs(stiffness, mass, first, last, start=block, tolerance=config.solver_accuracy, guards=guards)


def _guess_is_good(growing: _Growing, first: int, last: int, rows: int, config: BasisConfig) -> bool:
    """Whether to start a level from the pairs of the one below: it is large, and they are good and reach far enough."""
    return (
        config.schedule is None
        and growing.pairs is not None
        and rows > GUESS_ROWS
        and growing.top_error < GUESS_ERROR
        and growing.pairs.last_index >= min(last, config.count) + GUARDS // 2
    )


def _guess(
    growing: _Growing, level: int, start: int, end: int, refinement: Refinement, dtype: Precision
) -> tuple[Block, FloatArray]:
    """Pairs start..end of the level below, refined: what it has computed, and below that the basis itself.

    More than are wanted at the lower end, so that what the iteration mixes into a pair can only come from above.
    """
    assert growing.pairs is not None
    pairs = growing.pairs.part(growing.pairs.first_index, end)
    vectors, values = _lowest(growing, end, level - 1, refinement)[:, start:], pairs.values
    if pairs.first_index > 0:
        values = np.concatenate([np.sort(growing.values[: pairs.first_index]), values])
    return multiply(refinement.matrices[level - 1], vectors.astype(dtype, copy=False)), values[start:]


def _lowest(growing: _Growing, last: int, level: int, refinement: Refinement) -> Block:
    """(n, last) eigenvectors of a level: what it has computed, and below that the basis itself."""
    assert growing.pairs is not None
    pairs = growing.pairs
    if pairs.first_index == 0:
        return pairs.vectors[:, :last]
    lower = evaluate(growing.basis(), refinement, level)[:, : min(pairs.first_index, last)]
    return np.hstack([lower, pairs.vectors[:, : last - lower.shape[1]]])


def _take_back(growing: _Growing, pairs: EigenPairs, tolerance: float) -> None:
    """Drop functions whose eigenvalue turns out too high, now that the next level has computed it too."""
    first = pairs.first_index
    known = growing.values[first:]
    exact = pairs.values[: len(known)]
    wrong = np.flatnonzero(np.sort(known) - exact > tolerance * np.maximum(exact, 1e-3 * pairs.values[-1]))
    if len(wrong):
        growing.drop_last(len(known) - int(wrong[0]))


def _estimate(
    pairs: EigenPairs, level: int, refinement: Refinement, operators: Operators, tolerance: float
) -> ErrorEstimate:
    """Errors of the pairs of a level against the finest one; none at the finest."""
    if level == operators.finest:
        return ErrorEstimate(np.zeros(len(pairs.values)), np.zeros(len(pairs.values) + 1))
    stiffness, mass = operators.stiffness[level + 1], operators.mass[level + 1]
    return estimate_errors(refinement.matrices[level], stiffness, mass, pairs.values, pairs.vectors, tolerance)


def _append(
    growing: _Growing,
    level: int,
    pairs: EigenPairs,
    estimate: ErrorEstimate,
    wanted: int,
    refinement: Refinement,
    operators: Operators,
) -> None:
    """Append the first ``wanted`` new directions of a window of eigenpairs as the band of a level (eq. 8)."""
    vectors, positions = _missing(growing, level, pairs, wanted, refinement, operators)
    indices = pairs.first_index + positions
    _append_band(growing, level, vectors, indices, estimate.errors[positions], refinement, operators)


def _missing(
    growing: _Growing,
    level: int,
    pairs: EigenPairs,
    wanted: int | None,
    refinement: Refinement,
    operators: Operators,
) -> tuple[Block, IndexArray]:
    """The first ``wanted`` eigenvectors of a window that the basis does not have yet, and their places in it."""
    present = growing.count - pairs.first_index
    if present == 0:
        return pairs.vectors[:, :wanted], np.arange(len(pairs.values))[:wanted]
    vectors = pairs.vectors
    overlap = overlaps_with_bands(tuple(growing.bands), refinement, operators.mass[level], vectors, level)
    rotation, positions = new_directions(pairs.values, overlap, growing.gram, present)
    rotation, positions = rotation[:, :wanted], positions[:wanted]
    if np.array_equal(rotation, np.eye(len(rotation))[:, positions]):  # no cluster was cut
        return vectors[:, positions], positions
    return vectors @ rotation.astype(vectors.dtype), positions


def _append_band(
    growing: _Growing,
    level: int,
    vectors: Block,
    indices: IndexArray,
    errors: FloatArray,
    refinement: Refinement,
    operators: Operators,
) -> None:
    """Append eigenvectors of a level as its band."""
    mass, stiffness = operators.mass[level], operators.stiffness[level]
    band = _orthonormal(vectors, mass)
    dual, energy = multiply(mass, band), multiply(stiffness, band)
    values = np.einsum("ij,ij->j", band, energy)
    residuals = residual_norms(values, band, energy, dual, lumped_areas(mass))
    growing.gram = extend_gram(growing.gram, tuple(growing.bands), refinement, dual, level)
    growing.bands.append(band)
    growing.values = np.concatenate([growing.values, values])
    growing.residuals = np.concatenate([growing.residuals, residuals])
    growing.errors = np.concatenate([growing.errors, errors])
    growing.indices = np.concatenate([growing.indices, indices])


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
