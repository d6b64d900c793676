"""Parameters of a match: the method, and the configuration of each one."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np

from cagemap.deform.config import ElasticConfig, StartConfig
from cagemap.errors import ParameterError
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.pair import SymmetryPair, symmetry_pairs
from cagemap.numerics.kinds import Config
from cagemap.paper.hfm import HfmConfig
from cagemap.paper.method import PaperConfig
from cagemap.spectral.surface import METHODS


@dataclass(frozen=True, repr=False)
class MatchConfig(Config):
    """Parameters of a match of two prepared surfaces; the defaults are the measured ones.

    Attributes
    ----------
    method : str
        "elastic": ZoomOut from landmark coordinates, finished by an elastic fit; landmarks are met exactly.
        "hfm": the paper's method with named improvements, see `cagemap.paper.hfm`.
        "paper": the paper's hierarchical functional map; starts at level 0 and needs a fixed schedule.
    hfm : HfmConfig
        Parameters of "hfm".
    paper : PaperConfig
        Parameters of "paper".
    start : StartConfig
        Starts of "elastic".
    elastic : ElasticConfig
        Parameters of the elastic fit.
    use_symmetry : bool
        "paper" only: find mirror planes that both control meshes have and let the map commute with them (5.2), unless
        symmetries are given.
    symmetries : tuple of ((n_0 target,), (n_0 source,)) arrays
        "hfm" and "paper" only: self-maps of the control meshes that correspond, see `cagemap.maps.pair.Pair`.
    answer : int
        Index of the answer to return if there are several (few or mirrored landmarks); 0 is the best.
    check_landmarks : bool
        Leave out landmark outliers ("elastic" only); otherwise all landmarks are met exactly.
    masks : Masks
        Weights of the finest vertices of both surfaces ("elastic" only); landmarks are met in masked area too.
    """

    method: str = "elastic"
    hfm: HfmConfig = HfmConfig()
    paper: PaperConfig = PaperConfig()
    start: StartConfig = StartConfig()
    elastic: ElasticConfig = ElasticConfig()
    use_symmetry: bool = True
    symmetries: tuple[SymmetryPair, ...] = ()
    answer: int = 0
    check_landmarks: bool = True
    masks: Masks = WHOLE

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.method not in METHODS:
            raise ParameterError(f"method: expected one of {', '.join(METHODS)}, got {self.method!r}")
        symmetry_pairs(self.symmetries)
        if self.answer and self.method != "elastic":
            raise ParameterError(f"answer: expected the method elastic, which alone finds several, got {self.method!r}")
        if self.symmetries and self.method == "elastic":
            raise ParameterError("symmetries: expected the method paper or hfm, which use them, got 'elastic'")
        if self.masks.any and self.method != "elastic":
            raise ParameterError(f"masks: expected the method elastic, which alone knows them, got {self.method!r}")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MatchConfig) and self._values() == other._values()

    def __hash__(self) -> int:
        return hash(self._values())

    def _values(self) -> tuple[object, ...]:
        """Values of all fields; arrays as bytes."""
        masks = (self.masks, self.masks.shared or WHOLE)
        arrays = chain(*((one.target, one.source) for one in masks), *self.symmetries)
        contents = tuple(None if one is None else np.asarray(one).tobytes() for one in arrays)
        return tuple((vars(self) | {"masks": self.masks.shared is None, "symmetries": contents}).values())

    def require_elastic(self, function: str) -> None:
        """Raise ParameterError for another method, for a function of prepared pairs."""
        if self.method != "elastic":
            raise ParameterError(f"{function}: expected the method elastic, got {self.method!r}; use cagemap.match")
