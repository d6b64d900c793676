"""Parameters of the elastic method: of its spectral start and of the fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.errors import ParameterError
from cagemap.functional_map import MapWeights
from cagemap.maps.spectral.constraints import DescriptorConfig
from cagemap.maps.spectral.hierarchical import FEWEST_FUNCTIONS, Growth
from cagemap.maps.spectral.levels import require_search
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.brief import Brief


@dataclass(frozen=True)
class Stage:
    """One run of iterations on one graph.

    Attributes
    ----------
    iterations : int
    stiffness : (float, float)
        Weight alpha of the energy against the data, first and last; it falls geometrically over the first ``ramp`` of
        the iterations. sqrt(alpha) is the length, of sqrt(area), below which the energy outweighs the data. On a mesh
        that lies on the source it rises instead, see `cagemap.maps.elastic.fit.run_stage`.
    smoothing : float
        epsilon: its square root is the length over which differentials are smoothed.
    ramp : float
        See ``stiffness``.
    momentum : float
        Every iteration but the last goes on by this share of its change: x <- x + momentum (x - x_before).
    patience : int
        At most this many iterations more, at the last stiffness, while the deformation would still fold or flatten more
        than `UNSETTLED` of the surface.
    factored : int
        The positions' matrix is factored every so many iterations; those between go on with the factors that are there.
    """

    iterations: int
    stiffness: tuple[float, float]
    smoothing: float
    ramp: float = 0.7
    momentum: float = 0.0
    patience: int = 0
    factored: int = 1

    def __post_init__(self) -> None:
        """Check the counts."""
        if min(self.iterations, self.factored) < 1 or self.patience < 0:
            raise ParameterError(
                "a stage of the elastic fit: expected at least 1 iteration, factored at least every iteration (1), and "
                f"no negative patience, got {self}"
            )

    def ramped(self) -> FloatArray:
        """(iterations + patience,) stiffness alpha of every iteration."""
        first, last = self.stiffness
        steps = np.minimum(np.arange(self.iterations + self.patience) / max(self.ramp * self.iterations, 1e-9), 1.0)
        return np.asarray(first * (last / first) ** steps)


@dataclass(frozen=True, repr=False)
class StartConfig(Brief):
    """Parameters of the spectral map that the elastic fit starts from; the defaults are the measured ones.

    Attributes
    ----------
    descriptors : DescriptorConfig
    weights : MapWeights
    search_vertices : int
        The target is deformed at its coarsest level with at least this many vertices; the source's vertices are sought
        at its own such level.
    source_search_vertices : int
        The same of the source alone; 0: as the target's.
    searched_functions : int
        Basis functions up to which the map grows.
    growth : Growth
        How it grows.
    """

    descriptors: DescriptorConfig = DescriptorConfig()
    weights: MapWeights = MapWeights()
    search_vertices: int = 3000
    source_search_vertices: int = 0
    searched_functions: int = 150
    growth: Growth = Growth(20, 1.5, 1.0, 0.0)

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.searched_functions < FEWEST_FUNCTIONS:
            raise ParameterError(
                f"expected at least {FEWEST_FUNCTIONS} searched functions, got {self.searched_functions}"
            )
        require_search(self.search_vertices, self.source_search_vertices)


@dataclass(frozen=True, repr=False)
class ElasticConfig(Brief):
    """Parameters of the fit; the defaults are the measured ones (docs/accuracy.md).

    Attributes
    ----------
    coarse_vertices : int
        Size of the coarse graph.
    coarse, fine : Stage
    settled : Stage
        Instead of `coarse` where its ends from both starts agree, see `method.fits`: stiffer.
    normal_weight : float
        Closest points count position and this length times the normal.
    fine_normal_weight : float
        The same for those of the fine stage's vertices.
    projection_normal_weights : (float, float)
        The same in the last projection, see `facing_points`.
    landmark_weight : float
        Of a landmark, against a data weight of 1 for the whole surface.
    curve_weight : float
        Of a curve, by its length in sqrt(area), against the same.
    response : Stage
        What changed landmarks do to a map that is there, on the coarse graph (`cagemap.maps.elastic.update`).
    """

    coarse_vertices: int = 1500
    coarse: Stage = Stage(10, (5e-3, 5e-5), 1e-3, momentum=0.6)
    settled: Stage = Stage(10, (5e-2, 2e-4), 1e-2, momentum=0.6)
    fine: Stage = Stage(12, (2e-4, 1e-5), 1e-4, momentum=0.8, patience=12, factored=4)
    normal_weight: float = 0.03
    fine_normal_weight: float = 0.01
    projection_normal_weights: tuple[float, float] = (0.002, 0.02)
    landmark_weight: float = 1e2
    curve_weight: float = 1.0
    response: Stage = Stage(8, (2e-4, 2e-4), 1e-2, momentum=0.6)

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.coarse_vertices < 4:
            raise ParameterError(f"coarse_vertices: expected at least 4, got {self.coarse_vertices}; 1500 is usual")
        weights = (
            *(self.normal_weight, self.fine_normal_weight, self.landmark_weight, self.curve_weight),
            *self.projection_normal_weights,
        )
        if not all(0.0 <= weight < np.inf for weight in weights):
            raise ParameterError(f"weights of the elastic fit: expected numbers of 0 or more, got {weights}")
