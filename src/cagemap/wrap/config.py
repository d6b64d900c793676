"""Every number that decides a wrap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.errors import ParameterError


@dataclass(frozen=True)
class NetConfig:
    """A net's energy, the samples of its surface, and parts that the source lacks (docs/lab/elastic.md).

    Areas are shares of the whole, lengths are of sqrt(area).
    """

    weight_power: float = 0.5  #: exponent of an edge's squared length in its weight: 0 alike, 1 as squared distances
    smoothing: float = 0.01  #: epsilon of the energy, see `cagemap.deform.config.Stage`
    levels_below: int = 2  #: levels below the net whose vertices are samples: about 16 for every point of the net
    max_samples: int = 60_000  #: no level with more vertices, where the next one has 4 for every point
    reach: float = 2.0  #: distance, in edges of the net, from which on a closest point belongs to another part
    normal_weight: float = 0.03  #: length, of sqrt(area), that opposite normals are apart for closest points
    accuracy: float = 3e-2  #: residual of a round, of the first: the next round differs more
    max_steps: int = 200  #: conjugate gradients of a round
    min_weight: float = 1e-6  #: a point with less weight of samples than this share of the largest is free
    carrying_rounds: int = 30  #: rounds of the energy alone that carry free points along before the first fit
    around: int = 3  #: rings around the points of a local fit that their differentials depend on
    nearest_points: int = 30  #: points that a detached piece goes with: some rings of a coarse cage
    squeezed: float = 0.03  #: ratio of areas on source and target of parts without a counterpart: a hundredth and less
    whole: float = 0.1  #: the same of parts with one: a fifth at least
    among: float = 0.01  #: images of what lies behind such a part lie among those of the rest if they are that near
    min_area: float = 0.002  #: share of the target's area below which such a part changes nothing
    followed: float = 0.5  #: weight below which a vertex has no counterpart: its distance is no error


@dataclass(frozen=True)
class MendConfig:
    """Mending of faces that fold or grow thin; a face is small where all of its corners are."""

    rounds: int = 20  #: how often bad faces are mended
    small_rounds: int = 6  #: the same of small ones
    stiffening: float = 10.0  #: factor on the stiffness at the corners of bad faces, each time
    small: float = 0.0005  #: share of the area of a point's ring; of a coarse cage it would be a limb
    thin: float = 1.5  #: longest by shortest edge, of the 99th percentile at rest, beyond which a face is thin
    small_thin: float = 1.35  #: the same of small ones: they are many, and less will do
    max_thin: float = 99.0  #: stiffness from which thin faces stay: it costs distance to the source
    small_max_thin: float = 999.0  #: the same of small ones, which cost less of it
    max_small_fold: float = 1e3  #: stiffness at which small faces that still fold have no room and are released
    max_fold: float = 1e8  #: stiffness at which all others stay as they are
    share: float = 0.05  #: samples that depend on released points by more than this have no weight
    release_rounds: int = 5  #: rounds of released points, which have further to go
    release_rings: int = 1  #: rings around them
    rings: int = 2  #: rings around bad faces that move
    many_rings: int = 1  #: the same in nets of many points
    many: int = 10_000  #: points of such a net: its bad faces are small, and surroundings draw them into shape
    flattenings: int = 8  #: how often faces that fold in the end are laid flat, with a ring of points more each time
    max_flat: float = 0.01  #: share of the area up to which they are


@dataclass(frozen=True)
class WrapConfig:
    """How closely a net follows."""

    level: int = 0  #: level whose points are fitted; 0 is the control mesh
    fairness: float = 1e-4  #: weight of the net's energy against squared distances to the source
    anchor: float = 0.003  #: weight of the map's own images along the surface, against the distance from it
    rounds: int = 3  #: times that closest points are looked for
    #: 99th percentile of distances, of sqrt(area), above which part of the net slid into a wrong place
    max_distance: float = 0.01
    stronger_anchor: float = 3.0  #: factor on ``anchor`` of the second fit that is then tried; the closer one counts
    net: NetConfig = NetConfig()  #: numbers of the parts of the method
    mending: MendConfig = MendConfig()

    def __post_init__(self) -> None:
        if self.level < 0 or self.rounds < 0:
            raise ParameterError(f"level and rounds: expected 0 or more, got {self.level} and {self.rounds}")
        if not 0 < self.fairness < np.inf:
            raise ParameterError(f"fairness: expected a number above 0, got {self.fairness}; the default is 1e-4")
        if not 0 <= self.anchor < np.inf:
            raise ParameterError(f"anchor: expected 0 or more, got {self.anchor}; the default is 0.003")
