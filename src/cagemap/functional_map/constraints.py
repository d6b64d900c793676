"""What a functional map is asked for, in coefficients of the hierarchical bases (paper, 5.1 - 5.3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray

# Mean distance of neighbouring eigenvalues of a surface of unit area (Weyl's law). With eigenvalues in this unit,
# Lambda~ counts places in the spectrum, and one weight serves all k and all surfaces.
SPACING = 4.0 * np.pi


@dataclass(frozen=True, eq=False)
class SpectralData:
    """Descriptors and operators of one surface; the leading blocks are those of the coarser levels (eq. 15).

    Attributes
    ----------
    eigenvalues : (k,) array
        Lambda~, in the order of the basis: bands of level 0, 1, ... Unit area.
    descriptors : (k, q) array
        F~, the same q descriptors on both surfaces, weighted.
    operators : tuple of (k, k) arrays
        O~ beside the Laplacian, such as self-symmetries (paper, 5.2); those of both surfaces in the same order.
    """

    eigenvalues: FloatArray
    descriptors: FloatArray
    operators: tuple[FloatArray, ...] = ()

    @property
    def count(self) -> int:
        """Number k of basis functions."""
        return len(self.eigenvalues)

    def leading(self, count: int) -> SpectralData:
        """Keep the first basis functions only."""
        operators = tuple(operator[:count, :count] for operator in self.operators)
        return SpectralData(self.eigenvalues[:count], self.descriptors[:count], operators)


@dataclass(frozen=True)
class MapWeights:
    """Weights of eq. 13, one number each for the whole hierarchy, beside descriptors of unit norm.

    Attributes
    ----------
    laplacian : float
        alpha(Lambda~), for eigenvalues counted in their mean spacing (see `SPACING`).
    operators : float
        alpha(O) of every other operator.
    decay : float
        Weight of ||C||^2. Rows of C that no descriptor speaks about then vanish, and so have no say in a nearest
        neighbour, where eq. 13 leaves noise. 0 is eq. 13 as printed.
    match : float
        Weight of ||C - Phi1^+ P12 Phi2||^2, instead of the decay, where a point map is given beside the descriptors.
    """

    laplacian: float = 0.003
    operators: float = 1.0
    decay: float = 1.0
    match: float = 50.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise ParameterError(f"weights: expected {name} of at least 0, got {value}")


@dataclass(frozen=True)
class Constraints:
    """What both surfaces bring to eq. 13: the same descriptors and operators on either side."""

    target: SpectralData
    source: SpectralData

    def __post_init__(self) -> None:
        """Refuse data that cannot be compared."""
        target, source = self.target, self.source
        if target.descriptors.shape[1] != source.descriptors.shape[1]:
            raise ParameterError(
                "expected as many target as source descriptors, got "
                f"{target.descriptors.shape[1]} and {source.descriptors.shape[1]}"
            )
        if len(target.operators) != len(source.operators):
            raise ParameterError(
                f"expected as many target as source operators, got {len(target.operators)} and {len(source.operators)}"
            )
        for side, data in (("target", target), ("source", source)):
            sizes = {(len(data.descriptors), data.count), *(matrix.shape for matrix in data.operators)}
            if sizes != {(data.count, data.count)}:
                raise ParameterError(
                    f"{side}: expected {data.count} rows of descriptors and operators, one for each basis function, "
                    f"got {sorted(sizes)}"
                )

    @property
    def shape(self) -> tuple[int, int]:
        """(k1, k2), the shape of C12."""
        return self.target.count, self.source.count

    def leading(self, k1: int, k2: int) -> Constraints:
        """Those of a coarser level: the leading basis functions of both sides."""
        return Constraints(self.target.leading(k1), self.source.leading(k2))

    def with_descriptors(self, target: FloatArray, source: FloatArray, weight: float = 1.0) -> Constraints:
        """Add descriptors of one's own.

        Parameters
        ----------
        target, source : (k1, q), (k2, q) arrays
            Coefficients of corresponding functions; each column is scaled to norm ``weight`` on either side.
        weight : float
            A landmark kernel weighs 1.
        """
        sides = []
        for data, columns in ((self.target, target), (self.source, source)):
            norms = np.linalg.norm(columns, axis=0)
            scaled = weight * columns / np.where(norms > 0.0, norms, 1.0)
            sides.append(replace(data, descriptors=np.hstack([data.descriptors, scaled])))
        return Constraints(*sides)

    def with_operators(self, target: FloatArray, source: FloatArray) -> Constraints:
        """Add a pair of operators that the map shall commute with, (k1, k1) and (k2, k2); of norms of about 1."""
        sides = ((self.target, target), (self.source, source))
        return Constraints(*(replace(data, operators=(*data.operators, operator)) for data, operator in sides))
