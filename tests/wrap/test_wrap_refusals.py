"""Nets that cannot be fitted: every message says by what, what is wrong, and what to do."""

from __future__ import annotations

import numpy as np
import pytest
from examples.shapes import cube

from cagemap import refine
from cagemap.wrap.fit import detached_pieces
from cagemap.wrap.net import control_net

from refusals import Refusal


def free_everywhere(_: object) -> None:
    graph = control_net(refine(cube(), 2), 0, 1.0).graph
    detached_pieces(graph, np.arange(graph.n))


REFUSED = {
    "a net that nothing holds": Refusal(
        free_everywhere, "weights: ", "expected a part of the target that follows the source", "Give weights above 0."
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_net_that_cannot_be_fitted_is_refused(name: str) -> None:
    REFUSED[name].check(None)
