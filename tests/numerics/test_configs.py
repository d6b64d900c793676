"""Configurations refuse numbers outside their ranges where they are made."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from cagemap.character.self_collision import CollisionConfig
from cagemap.deform.config import ElasticConfig, GraphConfig, LandmarkConfig, ProjectionConfig, Stage, StartConfig
from cagemap.errors import ParameterError
from cagemap.match_config import MatchConfig
from cagemap.numerics.kinds import Config
from cagemap.paper.hfm import HfmConfig
from cagemap.spectral.eigenpairs import SOLVER
from cagemap.wrap.net import MendConfig, WrapConfig

REFUSED: dict[str, Callable[[], object]] = {
    "min_cell: expected a number from 0 to 0.5, got 0.9": lambda: GraphConfig(min_cell=0.9, joining_rounds=9),
    "neighbours: expected a whole number of at least 1, got 0": lambda: GraphConfig(neighbours=0),
    "cell_counts: expected numbers of at least 0": lambda: GraphConfig(cell_counts=(-0.1, 1.2)),
    "flat: expected a number of at least 0, got nan": lambda: GraphConfig(flat=np.nan),
    "factored: expected a whole number of at least 1": lambda: Stage(3, (1.0, 1.0), 0.1, factored=0),
    "coarse_vertices: expected a whole number of at least 4": lambda: ElasticConfig(coarse_vertices=3),
    "min_cosine: expected a number from -1 to 1": lambda: ProjectionConfig(min_cosine=-1.1),
    "min_side_gain: expected a number of at least -1": lambda: LandmarkConfig(min_side_gain=-2.0),
    "answer: expected a whole number": lambda: MatchConfig(answer=True),
    "rounds: expected a whole number of at least 0, got 2.5": lambda: MendConfig(rounds=2.5),  # type: ignore[arg-type]
    "search_vertices: expected a whole number of at least 0, got -1": lambda: StartConfig(search_vertices=-1),
    "search_vertices: expected a whole number of at least 0, got -2": lambda: HfmConfig(search_vertices=-2),
    "source_search_vertices: expected a whole number of at least 0, got -1": lambda: StartConfig(
        source_search_vertices=-1
    ),
    "source_search_vertices: expected a whole number of at least 0, got -2": lambda: HfmConfig(
        source_search_vertices=-2
    ),
    "smoothing: expected a finite number of at least 0, got inf": lambda: WrapConfig(smoothing=np.inf),
    "seed: expected a whole number of at least 0": lambda: replace(SOLVER, seed=-1),
    "projection_normal_weights: expected numbers of at least 0, got [-1.0]": lambda: ElasticConfig(
        projection_normal_weights=[-1.0]  # type: ignore[arg-type]
    ),
    "projection_normal_weights: expected numbers of at least 0, got ('a',)": lambda: ElasticConfig(
        projection_normal_weights=("a",)  # type: ignore[arg-type]
    ),
    "coarse_vertices: expected a whole number of at least 4, got array(-3)": lambda: ElasticConfig(
        coarse_vertices=np.array(-3)  # type: ignore[arg-type]
    ),
    "coarse_vertices: expected a whole number of at least 4, got 1000": lambda: ElasticConfig(coarse_vertices=10**400),
    "iterations: expected a whole number of at least 1, got 2.5": lambda: Stage(2.5, (1.0, 1.0), 0.1),  # type: ignore[arg-type]
    "search: expected SearchConfig, got None": lambda: ElasticConfig(search=None),  # type: ignore[arg-type]
    "symmetries: expected pairs of arrays": lambda: MatchConfig(symmetries=3),  # type: ignore[arg-type]
    "elastic: expected ElasticConfig, got None": lambda: MatchConfig(elastic=None),  # type: ignore[arg-type]
    "reach: expected a number of at least 0, got '1'": lambda: CollisionConfig(reach="1"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("message", REFUSED)
def test_numbers_out_of_range_are_refused(message: str) -> None:
    with pytest.raises(ParameterError) as found:
        REFUSED[message]()
    assert str(found.value).startswith(message)


def test_numbers_of_numpy_and_infinite_limits_are_accepted() -> None:
    config: Config = GraphConfig(neighbours=np.int64(3), flat=np.float32(0.1))  # type: ignore[arg-type]
    assert config == GraphConfig(neighbours=3, flat=float(np.float32(0.1)))
    assert WrapConfig(max_distance=np.inf).max_distance == np.inf  # no limit


def test_lists_become_tuples() -> None:
    """So that configurations can be keys."""
    vertices = np.arange(3)
    config = MatchConfig(method="hfm", symmetries=[(vertices, vertices)])  # type: ignore[arg-type]
    assert isinstance(config.symmetries, tuple)
    assert ProjectionConfig(rings=[1, 2]).rings == (1, 2)  # type: ignore[arg-type]
