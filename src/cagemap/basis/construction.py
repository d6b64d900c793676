"""Computing the hierarchical basis from the control mesh upwards (paper, sections 4.3 and 4.4)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cagemap.basis.eigen import EigenPairs, band_pairs, residual_norms
from cagemap.basis.error_estimate import Prediction, predict_next_level
from cagemap.basis.gram import extend_gram, products_with_bands
from cagemap.basis.hierarchical import HierarchicalBasis
from cagemap.basis.overlap import new_directions
from cagemap.basis.products import multiply
from cagemap.basis.schedule import BasisConfig, choose_split, plausible_count, relative_errors
from cagemap.errors import ParameterError
from cagemap.operators import Operators
from cagemap.refinement import Refinement

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Pairs computed below the start of a band, to see which of them the prolonged basis has already.
OVERLAP = 12
_START_COLUMNS = 32
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

    @property
    def count(self) -> int:
        return len(self.gram)

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
    config: BasisConfig = BasisConfig(),  # noqa: B008 - frozen
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
            prediction = _predict(pairs, level, refinement, operators)
            _append(growing, level, pairs, prediction, config.schedule[level], refinement, operators)
            growing.pairs = pairs
    return HierarchicalBasis(
        tuple(growing.bands), growing.values, growing.residuals, growing.indices, growing.gram, growing.errors
    )


def _add_controlled(
    growing: _Growing, level: int, refinement: Refinement, operators: Operators, config: BasisConfig
) -> None:
    """Add the pairs of one level that meet the tolerance there."""
    sizes = [mass.shape[0] for mass in operators.mass]
    last = config.count
    if level < operators.finest:
        seen = growing.good * sizes[level] / sizes[level - 1] if level > 0 else 0.0
        last = min(last, plausible_count(sizes[level], config.tolerance, seen))
    if last <= growing.count:
        growing.bands.append(np.zeros((sizes[level], 0)))
        growing.pairs = None
        return
    pairs = _window(operators, level, growing, last, config, refinement)
    _take_back(growing, pairs, config.tolerance)
    prediction = _predict(pairs, level, refinement, operators)
    good, wanted = choose_split(pairs, prediction, growing.count, config)
    _append(growing, level, pairs, prediction, wanted, refinement, operators)
    growing.pairs, growing.good = pairs, good


def _window(
    operators: Operators, level: int, growing: _Growing, last: int, config: BasisConfig, refinement: Refinement
) -> EigenPairs:
    """Eigenpairs of a level from a few below the end of the basis so far up to ``last``."""
    first = max(0, growing.count - OVERLAP)
    start = None
    previous = growing.pairs
    if previous is not None and first < previous.last_index:
        # The coarser level's pairs in that range, mixed at random, are a block rich in what is sought.
        useful = previous.vectors[:, max(0, first - previous.first_index) :]
        mixing = np.random.default_rng(_SEED).standard_normal((useful.shape[1], min(_START_COLUMNS, useful.shape[1])))
        start = refinement.prolong(useful @ mixing, level - 1, level)
    return band_pairs(
        operators.stiffness[level], operators.mass[level], first, last, start=start, tolerance=config.accuracy
    )


def _take_back(growing: _Growing, pairs: EigenPairs, tolerance: float) -> None:
    """Drop functions whose eigenvalue turns out too high, now that the next level has computed it too."""
    first = pairs.first_index
    known = growing.values[first:]
    exact = pairs.values[: len(known)]
    wrong = np.flatnonzero(np.sort(known) - exact > tolerance * np.maximum(exact, 1e-3 * pairs.values[-1]))
    if len(wrong):
        growing.drop_last(len(known) - int(wrong[0]))


def _predict(pairs: EigenPairs, level: int, refinement: Refinement, operators: Operators) -> Prediction | None:
    """What the next level would make of the pairs of this one; None at the finest."""
    if level == operators.finest:
        return None
    stiffness, mass = operators.stiffness[level + 1], operators.mass[level + 1]
    return predict_next_level(refinement.matrices[level], stiffness, mass, pairs.values, pairs.vectors)


def _append(
    growing: _Growing,
    level: int,
    pairs: EigenPairs,
    prediction: Prediction | None,
    wanted: int,
    refinement: Refinement,
    operators: Operators,
) -> None:
    """Append the first ``wanted`` new directions of a window of eigenpairs as the band of a level (eq. 8)."""
    mass, stiffness = operators.mass[level], operators.stiffness[level]
    present = growing.count - pairs.first_index
    overlap = products_with_bands(tuple(growing.bands), refinement, multiply(mass, pairs.vectors), level)
    rotation, positions = new_directions(pairs.values, overlap, growing.gram, present)
    rotation, positions = rotation[:, :wanted], positions[:wanted]
    band = np.ascontiguousarray(pairs.vectors @ rotation)
    values = np.einsum("ij,i,ij->j", rotation, pairs.values, rotation)
    areas = np.asarray(mass.sum(axis=1), dtype=np.float64)
    residuals = residual_norms(values, band, multiply(stiffness, band), multiply(mass, band), areas)
    growing.gram = extend_gram(growing.gram, tuple(growing.bands), refinement, operators, band, level)
    growing.bands.append(band)
    growing.values = np.concatenate([growing.values, values])
    growing.residuals = np.concatenate([growing.residuals, residuals])
    growing.errors = np.concatenate([growing.errors, relative_errors(pairs, prediction)[positions]])
    growing.indices = np.concatenate([growing.indices, pairs.first_index + positions])


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
