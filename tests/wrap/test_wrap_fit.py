"""The wrap's linear systems and its mending of faces."""

from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import torus
from test_wrap import dented, ring_and_ball, same_vertices, surface_of

from cagemap.deform.config import GraphConfig
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.files.meshes.obj import read_obj
from cagemap.maps.point_map import PointMap
from cagemap.pipeline import match, prepare_surfaces
from cagemap.subdivision import Refinement, refine
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.wrap import wrap
from cagemap.wrap.fit import fit_net, mend
from cagemap.wrap.net import (
    ControlNet,
    MendConfig,
    NetTerms,
    Samples,
    WrapConfig,
    control_net,
    face_aspects,
    folded_faces,
)

from quick_match import QUICK


def samples_of(net: ControlNet, images: SurfacePoints) -> Samples:
    """All of the net's surface follows the map."""
    count = net.refinement.finest.n_vertices
    return Samples.choose(net, images, np.ones(count), np.zeros(count, dtype=bool), WrapConfig())


def net_of(target: Refinement, point_map: PointMap) -> tuple[ControlNet, Samples]:
    """The net of the target's cage, all of which follows the map."""
    net = control_net(target, 0, point_map.target.scale)
    return net, samples_of(net, point_map.images)


def test_the_net_has_the_users_graph() -> None:
    weights = [
        control_net(refine(torus(12, 8), 1), 0, 1.0, WrapConfig(graph=GraphConfig(min_weight=least))).graph.weights
        for least in (1e-2, 1.0)
    ]
    assert not np.allclose(*weights)


@pytest.mark.slow
def test_a_round_solves_its_system() -> None:
    """Planes, images and energy, written out densely; points that do not move keep their places."""
    target = refine(torus(12, 8), 2)
    point_map = same_vertices(target, refine(dented(torus(12, 8), 0.25), 2))
    net = control_net(target, 0, point_map.target.scale)
    count = target.finest.n_vertices
    pinned = np.arange(count) % 7 == 0
    data = Samples.choose(net, point_map.images, np.linspace(0.0, 1.0, count), pinned, WrapConfig())
    config = WrapConfig(anchor=0.1, fairness=1e-2)
    moving = np.arange(net.graph.n // 2)
    for part in (None, moving):
        terms = NetTerms.build(net.graph, data, config, part)
        positions = net.graph.positions
        found: Future[tuple[np.ndarray, np.ndarray]] = Future()
        system = terms.at(positions, found, config.fairness, None)
        right = system.right + config.fairness * net.graph.divergence(net.energy.maps(positions))
        dense, normals = data.rows.toarray(), system.closest.normals
        away = np.linalg.norm(system.closest.positions - data.images.positions, axis=1) > data.max_slide
        free = ~(data.pinned | away)
        tensors = (free * data.weights)[:, None, None] * normals[:, :, None] * normals[:, None, :]
        tensors += (data.weights * np.where(free, 0.1, 1.0))[:, None, None] * np.eye(3)
        matrix = np.einsum("si,sab,sj->iajb", dense, tensors, dense)
        matrix += 1e-2 * np.einsum("ab,ij->iajb", np.eye(3), terms.laplacian.toarray())
        moved = np.random.default_rng(0).normal(size=positions.shape)
        np.testing.assert_allclose(system.times(moved), np.einsum("iajb,jb->ia", matrix, moved), atol=1e-12)
        solved = system.solve(right, positions)
        left = (right - system.times(solved))[terms.moving]
        before = (right - system.times(positions))[terms.moving]
        assert np.linalg.norm(left) <= 3.3e-2 * np.linalg.norm(before)
        still = np.setdiff1d(np.arange(net.graph.n), terms.moving)
        np.testing.assert_array_equal(solved[still], positions[still])


@pytest.mark.parametrize("many", [0, 10_000])
def test_mending_a_thin_face_moves_nothing_far_from_it(many: int) -> None:
    """Whether the differentials around it are its own or those of the net as a whole, as in nets of many points."""
    config = WrapConfig(mending=MendConfig(many=many))
    target = refine(torus(24, 12), 2)
    source = refine(dented(torus(24, 12), 0.25), 2)
    point_map = same_vertices(target, source)
    net, data = net_of(target, point_map)
    fitted = fit_net(net, data, WrapConfig())
    spoilt = fitted.copy()
    face = net.mesh.face_indices[net.mesh.face_offsets[40] : net.mesh.face_offsets[41]]
    spoilt[face[0]] += 0.95 * (fitted[face[1]] - fitted[face[0]])
    rest = face_aspects(net.mesh, net.graph.positions)
    assert face_aspects(net.mesh, spoilt).max() > 3.0 * rest.max()
    mended = mend(net, data, config, spoilt)
    assert not folded_faces(net, mended).any()
    assert face_aspects(net.mesh, mended).max() < 2.0 * np.percentile(rest, 99)
    distance = np.linalg.norm(net.graph.positions - net.graph.positions[face[0]], axis=1)
    away = distance > np.quantile(distance, 0.75)  # beyond the rings that move
    np.testing.assert_array_equal(mended[away], spoilt[away])
    assert np.abs(mended - fitted).max() < 0.02 * np.ptp(fitted, axis=0).max()


def test_what_is_sound_is_left_as_it_is() -> None:
    target = refine(torus(12, 8), 3)
    point_map = same_vertices(target, refine(dented(torus(12, 8), 0.2), 3))
    net, data = net_of(target, point_map)
    fitted = fit_net(net, data, WrapConfig())
    np.testing.assert_array_equal(mend(net, data, WrapConfig(), fitted), fitted)


@pytest.mark.slow
@pytest.mark.parametrize(("small", "many"), [(0.0005, 10_000), (1.0, 10_000), (1.0, 0)])
def test_where_the_map_folds_the_net_does_not(small: float, many: int) -> None:
    """A patch of the map is turned over: its faces become stiff, or are carried along if they count as small."""
    config = WrapConfig(mending=MendConfig(small=small, many=many))
    target, source = refine(torus(24, 12), 2), refine(dented(torus(24, 12), 0.2), 2)
    point_map = same_vertices(target, source)
    images = point_map.images.positions
    offsets = images - images[100]
    near = np.linalg.norm(offsets, axis=1) < 0.14
    axis = offsets[near][np.argmax(np.linalg.norm(offsets[near], axis=1))]
    axis = axis / np.linalg.norm(axis)
    turned = np.where(near[:, None], images - 2.0 * (offsets @ axis)[:, None] * axis, images)
    folding = SurfacePoints.nearest(point_map.source, turned)
    net = control_net(target, 0, point_map.target.scale)
    data = samples_of(net, folding)
    fitted = fit_net(net, data, WrapConfig())
    assert folded_faces(net, fitted).any()
    mended = mend(net, data, config, fitted)
    assert not folded_faces(net, mended).any()
    size = np.ptp(mended, axis=0).max()
    true = fit_net(net, replace(data, images=point_map.images), WrapConfig())
    assert np.abs(mended - true).max() < 0.25 * size  # the map is off by 0.38


def test_what_still_folds_in_the_end_is_laid_flat() -> None:
    """Two corners have changed places, and nothing is fitted anew: the means of their neighbours unfold them."""
    config = WrapConfig(mending=MendConfig(rounds=0, max_flat=0.1))
    target = refine(torus(24, 12), 1)
    point_map = same_vertices(target, target)
    net, data = net_of(target, point_map)
    spoilt = net.graph.positions.copy()
    one, two = net.mesh.face_indices[:2]
    spoilt[[one, two]] = spoilt[[two, one]]
    assert folded_faces(net, spoilt).any()
    mended = mend(net, data, config, spoilt)
    assert not folded_faces(net, mended).any()
    moved = np.flatnonzero((mended != spoilt).any(axis=1))
    assert np.linalg.norm(net.graph.positions[moved] - net.graph.positions[one], axis=1).max() < 0.25


@pytest.mark.slow
def test_faces_of_a_body_neither_fold_nor_grow_thin(shared_data: Path) -> None:
    """Along the true map between bodies whose fingers, toes and mouths differ; unmended, 25 faces fold."""

    def surfaces(*identities: str) -> list[tuple[Refinement, TriangleSurface]]:
        found = []
        for name, level, identity in zip(("proxy741", "base"), (3, 1), identities, strict=True):
            body = refine(read_obj(shared_data / "humans" / f"{name}_{identity}.obj"), level)
            found.append((body, surface_of(body)))
        return found

    (_, there), (_, here) = surfaces("neutral", "neutral")  # these lie on each other
    images = SurfacePoints.nearest(here, there.positions, there.vertex_normals, normal_weight=0.03)
    (target, surface), (_, source) = surfaces("female_old_heavy", "male_young")
    wrapped = wrap(target, PointMap.from_arrays(surface, source, images.triangle, images.barycentric))
    assert not len(wrapped.folded)
    assert wrapped.aspect <= 1.4
    assert wrapped.distance[wrapped.has_counterpart].mean() <= 1.2e-3


@pytest.mark.slow
def test_a_mouth_bag_stays_in_the_head(shared_data: Path) -> None:
    humans = shared_data / "humans"
    names = ("base_male_young.obj", "female1605_female_old_heavy.obj")
    bodies = [read_obj(humans / name) for name in names]
    target, source = prepare_surfaces(bodies[0], bodies[1], (1, 1))
    path = humans / "landmarks" / "base__female1605_fps14.json"
    pairs = read_landmarks(path, "female1605_neutral.obj", "base_neutral.obj")[0].reversed()
    point_map = match(target, source, pairs, QUICK).point_map
    wrapped = wrap(target.refinement, point_map)
    assert wrapped.distance[wrapped.has_counterpart].max() <= 0.01  # parts of sqrt(area); it was at 0.023
    # The face looks along z: what is in front of the closest point of the source is outside.
    in_front = wrapped.surface[:, 2] > wrapped.closest.images.positions[:, 2] / point_map.source.scale
    assert np.count_nonzero(in_front & (wrapped.distance > 0.01)) == 0  # of 53 514 vertices
    assert wrapped.distance.max() > 0.03  # it was squashed to 0.006


def test_a_small_piece_of_its_own_that_folds_goes_with_what_is_around_it() -> None:
    config = WrapConfig(mending=MendConfig(small=1.0, max_small_fold=0.0, release_rings=3))
    control, n = ring_and_ball(0.05)
    target = refine(control, 2)
    point_map = same_vertices(target, target)
    net, data = net_of(target, point_map)
    spoilt = net.graph.positions.copy()
    spoilt[n : n + 2] = spoilt[[n + 1, n]]  # two corners change places
    assert folded_faces(net, spoilt).any()
    mended = mend(net, data, config, spoilt)
    np.testing.assert_allclose(mended, net.graph.positions, atol=1e-12)
