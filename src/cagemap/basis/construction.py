"""Computing the hierarchical basis from the control mesh upwards (paper, sections 4.3 and 4.4)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cagemap.basis.eigen import EigenPairs, band_pairs, residual_norms
from cagemap.basis.error_estimate import eigenvalue_excess
from cagemap.basis.gram import extend_gram, products_with_bands
from cagemap.basis.hierarchical import HierarchicalBasis
from cagemap.basis.overlap import new_directions
from cagemap.basis.products import multiply
from cagemap.basis.schedule import BasisConfig, choose_split, plausible_count
from cagemap.errors import ParameterError
from cagemap.operators import Operators
from cagemap.refinement import Refinement

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Pairs computed below the start of a band, to see which of them the prolonged basis has already.
OVERLAP = 8
# What the estimate at the next level leaves out: the energy of unfinished conjugate gradients and of all finer levels.
SAFETY = 1.6


@dataclass
class _Growing:
    """The basis so far, while it is built."""

    bands: list[FloatArray] = field(default_factory=list)
    values: list[FloatArray] = field(default_factory=list)
    residuals: list[FloatArray] = field(default_factory=list)
    indices: list[IndexArray] = field(default_factory=list)
    errors: list[FloatArray] = field(default_factory=list)
    gram: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def count(self) -> int:
        return len(self.gram)


def hierarchical_basis(
    refinement: Refinement,
    operators: Operators,
    config: BasisConfig = BasisConfig(),  # noqa: B008 - frozen
) -> HierarchicalBasis:
    """Hierarchical basis of a surface, by the paper's fixed schedule or by a tolerance.

    Error-controlled (default): every level, from the control mesh up, keeps those of its eigenpairs whose eigenvalues are
    within ``config.tolerance`` of the finest level's; the rest are left to the next level. Fixed: every level adds
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
            pairs = _window(operators, level, growing.count, last, config)
            excess = _excess(pairs, level, refinement, operators)
            _append(growing, level, pairs, excess, config.schedule[level], refinement, operators)
    return HierarchicalBasis(
        tuple(growing.bands),
        np.concatenate(growing.values),
        np.concatenate(growing.residuals),
        np.concatenate(growing.indices),
        growing.gram,
        np.concatenate(growing.errors),
    )


def _add_controlled(
    growing: _Growing, level: int, refinement: Refinement, operators: Operators, config: BasisConfig
) -> None:
    """Add the pairs of one level that meet the tolerance there."""
    n = operators.mass[level].shape[0]
    last = config.count
    if level < operators.finest:
        last = min(last, plausible_count(n, config.tolerance))
    if last <= growing.count:
        growing.bands.append(np.zeros((n, 0)))
        return
    pairs = _window(operators, level, growing.count, last, config)
    excess = _excess(pairs, level, refinement, operators)
    new = slice(growing.count - pairs.first_index, None)
    wanted = choose_split(pairs.values[new], excess[new], config.tolerance)
    _append(growing, level, pairs, excess, wanted, refinement, operators)


def _window(operators: Operators, level: int, first: int, last: int, config: BasisConfig) -> EigenPairs:
    """Eigenpairs first..last-1 of a level, and a few below them."""
    start = max(0, first - OVERLAP)
    return band_pairs(operators.stiffness[level], operators.mass[level], start, last, tolerance=config.accuracy)


def _excess(pairs: EigenPairs, level: int, refinement: Refinement, operators: Operators) -> FloatArray:
    """Estimated error of the eigenvalues of a level against the finest one; none at the finest."""
    if level == operators.finest:
        return np.zeros(len(pairs.values))
    following = level + 1
    return SAFETY * eigenvalue_excess(
        refinement.matrices[level],
        operators.stiffness[following],
        operators.mass[following],
        pairs.values,
        pairs.vectors,
    )


def _append(
    growing: _Growing,
    level: int,
    pairs: EigenPairs,
    excess: FloatArray,
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
    growing.gram = extend_gram(growing.gram, tuple(growing.bands), refinement, operators, band, level)
    growing.residuals.append(residual_norms(values, band, multiply(stiffness, band), multiply(mass, band), areas))
    growing.errors.append(excess[positions] / np.maximum(values, 1e-3 * pairs.values[-1]))
    growing.bands.append(band)
    growing.values.append(values)
    growing.indices.append(pairs.first_index + positions)


def _check_sizes(operators: Operators, config: BasisConfig) -> None:
    finest = operators.mass[-1].shape[0]
    if config.schedule is None:
        if config.count > finest:
            raise ParameterError(
                f"count: expected at most {finest} basis functions, the vertices of the finest level, got {config.count}; "
                "refine further or ask for fewer"
            )
        return
    if len(config.schedule) > operators.finest + 1:
        raise ParameterError(
            f"schedule: expected at most {operators.finest + 1} counts, one for each level, got {len(config.schedule)}: "
            f"{config.schedule}; refine further or shorten it"
        )
    totals = np.cumsum(config.schedule)
    sizes = [mass.shape[0] for mass in operators.mass]
    for level, total in enumerate(totals):
        if total > sizes[level]:
            raise ParameterError(
                f"schedule: expected at most {sizes[level]} functions up to level {level}, which has so many vertices, got "
                f"{total} from {config.schedule}; move counts to finer levels, or give count and tolerance instead"
            )
