"""Configuration of a wrap."""

from __future__ import annotations

from dataclasses import dataclass

from cagemap.deform.config import GraphConfig
from cagemap.errors import ParameterError
from cagemap.numerics.kinds import Config


@dataclass(frozen=True)
class MendConfig(Config):
    """Mending of faces that fold or grow thin; a face is small where all of its corners are."""

    rounds: int = 20  #: most rounds of mending
    small_rounds: int = 6  #: most rounds for small faces
    stiffening: float = 10.0  #: factor on the stiffness at corners of bad faces in each round
    small: float = 0.0005  #: share of the area below which a point's ring is small; in a coarse cage it is a limb
    thin: float = 1.5  #: a face is thin above this times its aspect (longest by shortest edge) at rest
    small_thin: float = 1.35  #: the same for small faces, which are many
    max_thin: float = 99.0  #: stiffness from which thin faces stay thin: more costs distance to the source
    small_max_thin: float = 999.0  #: the same for small faces, which cost less distance
    max_small_fold: float = 1e3  #: stiffness above which small faces that still fold are released
    max_fold: float = 1e8  #: largest stiffness; other faces that still fold are kept
    share: float = 0.05  #: samples that depend on released points by more than this have no weight
    release_rounds: int = 5  #: rounds around released points, which move further
    release_rings: int = 1  #: rings around folded corners that are released
    rings: int = 2  #: rings around bad faces that move
    many_rings: int = 1  #: the same for nets of many points
    many: int = 10_000  #: points of such a net: its bad faces are small, and their surroundings shape them
    flattenings: int = 8  #: most rounds of flattening faces that still fold at the end
    max_flat: float = 0.01  #: largest share of the area that is flattened


@dataclass(frozen=True)
class WrapConfig(Config):
    """Configuration of a wrap: how closely the net follows the source (docs/lab/elastic.md).

    Areas are shares of the whole, lengths are of sqrt(area).
    """

    level: int = 0  #: level whose points are fitted; 0 is the control mesh
    fairness: float = 1e-4  #: weight of the net's energy against squared distances to the source
    anchor: float = 0.003  #: weight of distances to the map's images, against distances to the surface
    rounds: int = 3  #: rounds of closest-point searches
    max_distance: float = 0.01  #: 99th percentile of distances above which a second fit with a stronger anchor is tried
    stronger_anchor: float = 3.0  #: factor on ``anchor`` of the second fit; the closer fit is kept
    weight_power: float = 0.5  #: exponent of an edge's squared length in its weight: 0 alike, 1 as squared distances
    smoothing: float = 0.01  #: epsilon of the energy, see `cagemap.deform.config.Stage`
    levels_below: int = 2  #: samples are vertices this many levels finer: about 16 for each point of the net
    max_samples: int = 60_000  #: most samples, unless the net's next level has more
    max_slide: float = 2.0  #: distance from the image, in edges of the net, from which a point is on another part
    normal_weight: float = 0.03  #: weight of normals in closest points, of sqrt(area)
    accuracy: float = 3e-2  #: relative residual of a round's solution; the terms change more between rounds
    max_steps: int = 200  #: most conjugate gradient steps of a round
    min_weight: float = 1e-6  #: a point with a smaller share of its largest possible sample weight is free
    carrying_rounds: int = 30  #: rounds of the energy alone that place free points before the first fit
    energy_rings: int = 3  #: rings around the points of a local fit that are part of its energy
    nearest_points: int = 30  #: nearest points whose motion a detached piece follows: some rings of a coarse cage
    #: area ratio (source to target; of an open target relative to the typical one) below which a part has no
    #: counterpart; measured up to 0.01
    squeezed: float = 0.03
    whole: float = 0.1  #: the same ratio above which a part has a counterpart; measured 0.2 or more
    #: distance, in roots of the typical ratio, within which images of the area behind such a part are on the others
    overlap_distance: float = 0.01
    min_area: float = 0.002  #: share of the target's area below which such a part is ignored
    min_follow: float = 0.5  #: weight below which a vertex has no counterpart, and its distance is no error
    graph: GraphConfig = GraphConfig()
    mending: MendConfig = MendConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.fairness:
            raise ParameterError("fairness: expected a number above 0, got 0; the default is 1e-4")
