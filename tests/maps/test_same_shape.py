"""One shape under different control cages: the map is the identity, up to the cages' own disagreement.

The truth is the closest point of the other cage's surface; it is known to the gap between the two refined surfaces,
which is measured beside the map's error. Lengths are of sqrt(area).
"""

import numpy as np
import pytest
from scipy import sparse

from cagemap import BasisConfig, ControlMesh, Surface, match, prepare_surface, refine
from cagemap.maps.projection.project import control_points
from cagemap.subdivision import level_triangles
from cagemap.surface.closest_points import build_tree, closest_points

from example_once import example_pair
from plain_meshes import marks_at

SEED = 17
FITTED_LEVELS = 2


def requadded(mesh: ControlMesh, share: float) -> ControlMesh:
    """The first refinement of a quad cage as a cage of another connectivity and nearly the same surface.

    A share of its quads is split along a diagonal chosen at random; control points are solved for, so that the refined
    vertices of both cages agree where both have one. A cage of triangles alone is subdivided by Loop's scheme.
    """
    refinement = refine(mesh, 1 + FITTED_LEVELS)
    rng = np.random.default_rng(SEED)
    quads = np.asarray(refinement.levels[1].faces)
    rolled = np.where(rng.random(len(quads))[:, None] < 0.5, np.roll(quads, 1, axis=1), quads)
    split = rng.random(len(quads)) < share
    corners = [*rolled[~split], *rolled[split][:, [0, 1, 2]], *rolled[split][:, [0, 2, 3]]]
    offsets = np.concatenate([[0], np.cumsum([len(face) for face in corners])])
    places = refinement.finest.positions[: refinement.levels[1].n_vertices]
    other = ControlMesh(places, offsets, np.concatenate(corners), name="requadded.obj")
    sampling = sparse.csr_array(refine(other, FITTED_LEVELS).product(FITTED_LEVELS, 0)[: len(places)])
    return other.with_positions(control_points(sampling, places, steps=40))


def gap_and_error(target: Surface, source: Surface, vertices: np.ndarray) -> tuple[float, float]:
    """Mean distance between the surfaces, and of the map from the identity; vertices have the same numbers in both."""
    found = match(target, source, marks_at(vertices))
    assert found.suspects == ()
    assert found.quality.flipped_area < 0.002
    own = target.operators.scale * target.refinement.finest.positions
    other = source.operators.scale * source.refinement.finest.positions
    triangles = level_triangles(source.refinement, source.finest_level)
    gap = closest_points(build_tree(other, triangles), own)[2]
    error = np.linalg.norm(found.point_map.pull_back(other) - own, axis=1)
    areas = target.operators.mass[-1].diagonal()
    return float(areas @ gap / areas.sum()), float(areas @ error / areas.sum())


@pytest.mark.slow
def test_a_pony_under_a_cage_of_triangles_is_the_same_pony():
    pair, basis = example_pair(texture_size=64), BasisConfig(count=100)
    other = prepare_surface(requadded(pair.source, 1.0), 1, basis)
    own = prepare_surface(pair.source, 2, basis)
    for sides in ((own, other), (other, own)):
        gap, error = gap_and_error(*sides, pair.landmarks.source)
        assert gap < 3e-4
        assert error < 1.5e-3  # a seventh of the spacing of the pony's vertices
