"""ZoomOut: alternate functional map and nearest neighbours with more and more functions [Melzi et al. 2019]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.spectral.nearest import nearest_rows
from cagemap.spectral.samples import Samples, embed_source, embed_target, fit_functional_map


@dataclass(frozen=True)
class ZoomOutSchedule:
    """Numbers of basis functions that ZoomOut goes through.

    Attributes
    ----------
    first, last : int
    factor : float
        By which the number grows in every step, at least by 1.
    """

    first: int = 20
    last: int = 150
    factor: float = 1.5

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not (1 <= self.first <= self.last and self.factor > 1.0):
            raise ParameterError(
                f"ZoomOut: expected 1 function or more at first, no fewer at last and a factor above 1, got {self}"
            )

    def sizes(self, most: int) -> list[int]:
        """All numbers of functions, where the larger basis has ``most``."""
        last = min(self.last, most)
        sizes = [min(self.first, last)]
        while sizes[-1] < last:
            sizes.append(min(last, max(sizes[-1] + 1, round(self.factor * sizes[-1]))))
        return sizes


def zoomout(target: Samples, source: Samples, match: IndexArray, schedule: ZoomOutSchedule) -> IndexArray:
    """Refine a match: fit C12 to it, search the nearest embedded source samples, with more functions each time.

    Parameters
    ----------
    target, source : Samples
        Their coordinates stand beside the functions in every search.
    match : (b1,) array
        Source sample of every target sample.
    schedule : ZoomOutSchedule

    Returns
    -------
    (b1,) array
    """
    counts = target.rows.shape[1], source.rows.shape[1]
    for size in schedule.sizes(max(counts)):
        k1, k2 = min(size, counts[0]), min(size, counts[1])
        match = nearest_samples(target, source, fit_functional_map(target, source.rows[match][:, :k2], k1))
    return match


def nearest_samples(target: Samples, source: Samples, functional_map: FloatArray) -> IndexArray:
    """Nearest source sample of every target sample in the embedding of C12 (paper, 5.4); (b1,)."""
    return nearest_rows(embed_target(target, functional_map.shape[0]), embed_source(source, functional_map))


def nearest_coordinates(target: Samples, source: Samples) -> IndexArray:
    """Nearest source sample of every target sample in their shared coordinates alone; (b1,)."""
    return nearest_rows(target.coordinates.astype(np.float32), source.coordinates.astype(np.float32))
