"""The last two levels of a tight basis: the finest one takes only the pairs that the level below it resolves badly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.basis.correction import STEPS, Bound, Correction, improved
from cagemap.basis.guess import working_type
from cagemap.basis.smoothing import Block
from cagemap.errors import SolverError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.threads import ThreadPool

# Steps that tell which pairs are clearly good; their gains were 0.7 to 1.2 of the true errors.
_ROUGH_STEPS = 2
_ROUGH_SAFETY = 2.0
# The gains of all steps are 8 % low.
_CAREFUL_SAFETY = 1.25
# Errors by solves were 8 to 25 % high up to this tolerance, and several times too high at 1 %.
_SECOND_ORDER = 1e-3
# Pairs of either number of steps whose errors are checked by solves.
_DOUBTFUL = 6
# Share of the tolerance that the corrected pairs may be off.
_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class Split:
    """Which pairs of the level below the finest are kept, and eigenpairs of the finest in place of the others.

    Attributes
    ----------
    kept : (k,) int64 array
        Places of the pairs kept, ascending.
    errors : (k,) array
        Their relative errors, safety included.
    vectors : (n_f, q) array
        Eigenvectors of the finest level, M-orthonormal and M-orthogonal to the pairs kept.
    places : (q,) int64 array
        Places of their eigenvalues among all, ascending.
    """

    kept: IndexArray
    errors: FloatArray
    vectors: Block
    places: IndexArray


def split_isolated(
    correction: Correction,
    vectors: Block,
    values: FloatArray,
    fixed: Block,
    first_index: int,
    wanted: int,
    tolerance: float,
    reach: float,
) -> Split | None:
    """The lowest ``wanted`` of new pairs, each at the coarsest of the last two levels that meets the tolerance.

    Parameters
    ----------
    correction : Correction
        To the finest level.
    vectors : (n_l, m) array
    values : (m,) array
        Eigenpairs of the level below the finest, ascending, M-orthonormal; guards included.
    fixed : (n_l, q) array
        The pairs below them, which the basis has.
    first_index : int
        Index of the first pair in the spectrum.
    wanted : int
        At most m less a few.
    tolerance : float
        Relative.
    reach : float
        Largest error that a correction can mend.

    Returns
    -------
    Split or None
        None if a pair is too bad to be corrected or the inertia of the finest level counts other eigenvalues.
    """
    scale = np.maximum(values, 1e-3 * values[-1])
    dtype = working_type(tolerance)
    vectors = vectors.astype(dtype, copy=False)
    with ThreadPool(1) as aside:
        analysis = aside.submit(correction.analyzed) if tolerance <= _SECOND_ORDER else None
        errors = _ROUGH_SAFETY * correction.gains(vectors, values, _ROUGH_STEPS) / scale
        unclear = np.flatnonzero(errors > tolerance)
        few = np.ascontiguousarray(vectors[:, unclear])
        errors[unclear] = _CAREFUL_SAFETY * correction.gains(few, values[unclear], STEPS) / scale[unclear]
    if errors.max() > reach:
        return None
    bound: Bound | None = None
    if analysis is not None:
        try:
            bound = correction.bound(values - errors * scale, wanted, analysis.result())
        except SolverError:  # on an eigenvalue
            return None
        # Smoothing does not reach all that slivers lack: solves tell for the least certain of the pairs to keep.
        for group in (unclear, np.setdiff1d(np.arange(len(values)), unclear)):
            clear = group[(errors[group] <= tolerance) & (group < wanted)]
            doubtful = clear[np.argsort(-errors[clear])[:_DOUBTFUL]]
            exact = correction.errors(vectors[:, doubtful], values[doubtful], bound) / scale[doubtful]
            if np.any(exact > tolerance):
                errors[group] *= float(np.max(exact / errors[doubtful]))
    predicted = values - errors * scale
    # Guards as bad as the others take part, or these could not get orthogonal to what guards ought to be.
    bad = np.flatnonzero(errors > tolerance)
    # Pairs that may end below the last one wanted have to be accurate.
    inside = np.flatnonzero(predicted[bad] <= np.sort(predicted)[wanted - 1] + tolerance * scale[wanted - 1])
    good = np.setdiff1d(np.arange(len(values)), bad)
    if not len(inside):
        return Split(np.arange(wanted), errors[:wanted], np.zeros((correction.subdivision.shape[0], 0)), inside)
    held = np.empty((len(vectors), fixed.shape[1] + len(good)), dtype=dtype)
    held[:, : fixed.shape[1]], held[:, fixed.shape[1] :] = fixed, np.take(vectors, good, axis=1)
    found = improved(
        correction,
        np.ascontiguousarray(vectors[:, bad]),
        values[bad],
        held,
        values[good],
        inside,
        first_index,
        first_index + wanted,
        _SHARE * tolerance,
        bound,
    )
    if found is None:
        return None
    order = np.argsort(np.concatenate([values[good], found[0]]), kind="stable")
    places = np.empty(len(order), dtype=np.int64)
    places[order] = np.arange(len(order))
    chosen = places < wanted
    kept, added = chosen[: len(good)], chosen[len(good) :]
    return Split(good[kept], errors[good[kept]], found[1][correction.rank][:, added], places[len(good) :][added])
