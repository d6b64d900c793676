"""Nets that cannot be fitted: every message says by what, what is wrong, and what to do."""

from __future__ import annotations

import numpy as np
import pytest
from examples.shapes import cube

from cagemap import refine
from cagemap.surface.surface_points import SurfacePoints
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.wrap.config import MendConfig, WrapConfig
from cagemap.wrap.fit import fit_net, mend
from cagemap.wrap.net import ControlNet, Samples, control_net

from refusals import Refusal


def box(follow: float) -> tuple[ControlNet, Samples]:
    """A box on itself, with one weight for all of its samples."""
    target = refine(cube(), 2)
    surface = TriangleSurface.from_faces(target.finest.positions, target.finest.faces)
    net, images = control_net(target, 0, surface.scale), SurfacePoints.from_vertices(surface, np.arange(surface.n))
    return net, Samples.choose(net, images, np.full(surface.n, follow), np.zeros(surface.n, dtype=bool), WrapConfig())


def free_everywhere(_: object) -> None:
    fit_net(*box(0.0), WrapConfig())


def released_everywhere(_: object) -> None:
    """Two corners of a small box change places, and mending releases all that is near a fold."""
    net, samples = box(1.0)
    folded = net.graph.positions.copy()
    folded[[0, 1]] = folded[[1, 0]]
    mend(net, samples, WrapConfig(mending=MendConfig(small=1.0, max_small_fold=0.0, release_rings=3)), folded)


REFUSED = {
    "a net that nothing holds": Refusal(
        free_everywhere, "weights: ", "expected a part of the target that follows the source", "Give weights above 0."
    ),
    "a net that folds everywhere": Refusal(
        released_everywhere,
        "wrap: expected a net that folds in few places",
        "got folds at all of its points, so that none follows the source",
        "Look at the map",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_net_that_cannot_be_fitted_is_refused(name: str) -> None:
    REFUSED[name].check(None)
