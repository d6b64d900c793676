"""The wrap's linear systems and its mending of faces."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from cagemap.mesh import torus
from cagemap.refinement import refine
from cagemap.wrap.fit import WrapConfig, _NormalSystem, fit_data, fit_net
from cagemap.wrap.mend import mend
from cagemap.wrap.net import control_net, face_aspects, folded_faces
from test_wrap import dented, same_vertices


def test_the_system_is_what_it_says_and_keeps_its_pattern() -> None:
    rng = np.random.default_rng(1)
    samples = sparse.random_array((60, 12), density=0.3, rng=rng, format="csr")
    graph = sparse.random_array((12, 12), density=0.2, rng=rng)
    weights = graph + graph.T
    laplacian = sparse.csr_array(sparse.diags_array(weights.sum(axis=1)) - weights)
    system = _NormalSystem.build(samples, laplacian)
    patterns = set()
    for seed in range(3):
        tensors = np.random.default_rng(seed).normal(size=(60, 3, 3))
        tensors += tensors.transpose(0, 2, 1)
        tensors[rng.random(60) < 0.7] = 0.0  # whole rows without a sample that pulls
        matrix = system.matrix(tensors, 0.3)
        dense = samples.toarray()
        expected = np.einsum("si,sab,sj->aibj", dense, tensors, dense)
        expected += 0.3 * np.einsum("ab,ij->aibj", np.eye(3), laplacian.toarray())
        np.testing.assert_allclose(matrix.toarray(), expected.reshape(36, 36), atol=1e-12)
        patterns.add((matrix.indices.tobytes(), matrix.indptr.tobytes()))
    assert len(patterns) == 1


def test_mending_a_thin_face_moves_nothing_far_from_it() -> None:
    target = refine(torus(24, 12), 2)
    source = refine(dented(torus(24, 12), 0.25), 2)
    point_map = same_vertices(target, source)
    net = control_net(target, 0, point_map.target.scale)
    count = target.finest.n_vertices
    data = fit_data(net, point_map.images, np.ones(count), np.zeros(count, dtype=bool))
    fitted = fit_net(net, data, WrapConfig())
    spoilt = fitted.copy()
    face = net.mesh.face_indices[net.mesh.face_offsets[40] : net.mesh.face_offsets[41]]
    spoilt[face[0]] += 0.95 * (fitted[face[1]] - fitted[face[0]])
    rest = face_aspects(net.mesh, net.graph.positions)
    assert face_aspects(net.mesh, spoilt).max() > 3.0 * rest.max()
    mended = mend(net, data, WrapConfig(), spoilt)
    assert not folded_faces(net, mended).any()
    assert face_aspects(net.mesh, mended).max() < 2.0 * np.percentile(rest, 99)
    distance = np.linalg.norm(net.graph.positions - net.graph.positions[face[0]], axis=1)
    away = distance > np.quantile(distance, 0.75)  # beyond the rings that move
    np.testing.assert_array_equal(mended[away], spoilt[away])
    assert np.abs(mended - fitted).max() < 0.02 * np.ptp(fitted, axis=0).max()


def test_what_is_sound_is_left_as_it_is() -> None:
    target = refine(torus(12, 8), 3)
    point_map = same_vertices(target, refine(dented(torus(12, 8), 0.2), 3))
    net = control_net(target, 0, point_map.target.scale)
    count = target.finest.n_vertices
    data = fit_data(net, point_map.images, np.ones(count), np.zeros(count, dtype=bool))
    fitted = fit_net(net, data, WrapConfig())
    np.testing.assert_array_equal(mend(net, data, WrapConfig(), fitted), fitted)
