"""Maps that the paper's methods cannot compute: every message says of what, what is wrong, and what to do."""

import numpy as np
import pytest
from examples.shapes import creature

from cagemap import BasisConfig, MatchConfig, match, prepare_surface
from cagemap.paper.constraints import ConstraintConfig, Constraints, SpectralData
from cagemap.paper.equations import solve_functional_map

from refusals import Refusal

pytestmark = pytest.mark.slow


def matched(method: str, basis: BasisConfig) -> None:
    surface, vertices = prepare_surface(creature(), 1, basis), np.arange(0, 40, 5)
    match(surface, surface, np.column_stack([vertices, vertices]), MatchConfig(method=method))


def enormous(_: object) -> None:
    """Operators that are a million times as large as the descriptors."""
    rng = np.random.default_rng(5)
    sides = (
        SpectralData(np.arange(float(k)), rng.standard_normal((k, 4)), (1e6 * rng.standard_normal((k, k)),))
        for k in (40, 30)
    )
    solve_functional_map(Constraints(*sides), ConstraintConfig(laplacian=0.1, operators=1e6, decay=0.0))


REFUSED = {
    "operators out of scale": Refusal(
        enormous,
        "descriptor operators: ",
        "no functional map was found",
        "Scale them to norms of about 1",
    ),
    "two functions for hfm": Refusal(
        lambda _: matched("hfm", BasisConfig(count=2)),
        "basis: ",
        "expected at least 3 functions on both surfaces, got 2",
        "Give a larger count.",
    ),
    "two functions of level 0": Refusal(
        lambda _: matched("paper", BasisConfig(schedule=(2, 20))),
        "expected at least 3 basis functions on level 0 of both surfaces",
        "got (2, 2)",
        "give a schedule such as 100,50,50",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_map_that_cannot_be_computed_is_refused(name: str) -> None:
    REFUSED[name].check(None)
