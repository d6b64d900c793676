"""Skinning weights, joints, blend shapes and maps: unchanged under the identity, refused where they do not fit."""

from pathlib import Path

import numpy as np
import pytest
from examples.shapes import torus, voxels
from scipy import sparse
from scipy.io import mmwrite

from cagemap.deform.graph import mesh_graph
from cagemap.errors import FormatError, ParameterError
from cagemap.files.meshes.mhclo import Binding, bind, write_mhclo
from cagemap.files.npz import write_npz
from cagemap.files.result.maps import dense_map, read_images, source_level, write_map
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.subdivision import Refinement, refine
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.transfer import control_weights
from cagemap.transfer.blend_shapes import carry_shape, contacts, moved_share, prepare_shapes
from cagemap.transfer.skin import (
    carry_joints,
    carry_skin,
    fill_unknown,
    normalise_skin,
    symmetrize_skin,
    with_chosen_joints,
)

from refusals import refuses
from transfer_scenes import same_vertices, surface_of


def net_of(control: ControlMesh):
    split = cage_triangles(control)[0]
    return mesh_graph(TriangleSurface(control.positions, split), split)


@pytest.fixture(scope="module")
def ring() -> Refinement:
    return refine(torus(12, 8), 2)


def test_pruned_rows_of_skin_sum_to_one(ring: Refinement) -> None:
    weights = control_weights(same_vertices(ring, ring), ring, ring)
    n = ring.control.n_vertices
    rng = np.random.default_rng(5)
    skin = rng.dirichlet(np.full(6, 0.3), n)
    everywhere = np.ones(n, dtype=bool)
    pruned = carry_skin(weights, skin, net_of(ring.control), everywhere, influences=2)
    assert (pruned > 0).sum(axis=1).max() <= 2
    np.testing.assert_allclose(pruned.sum(axis=1), 1, rtol=0, atol=1e-9)
    for row in (0, 17, 40):
        assert set(np.flatnonzero(pruned[row])) <= set(np.argsort(-skin[row])[:2])


def test_untrusted_vertices_are_filled_in_between_their_neighbours(ring: Refinement) -> None:
    n = ring.control.n_vertices
    known = np.ones(n, dtype=bool)
    known[20:40] = False
    values = np.random.default_rng(1).dirichlet(np.ones(3), n)
    filled = fill_unknown(np.where(known[:, None], values, np.nan), net_of(ring.control), known)
    np.testing.assert_array_equal(filled[known], values[known])
    assert filled.min() >= 0
    np.testing.assert_allclose(filled.sum(axis=1), 1, rtol=0, atol=1e-6)
    refuses(ParameterError, "trusted nowhere", fill_unknown, values, net_of(ring.control), np.zeros(n, dtype=bool))


def test_skin_that_is_none_is_refused(ring: Refinement) -> None:
    n = ring.control.n_vertices
    weights, everywhere, net = sparse.csr_array(sparse.eye_array(n)), np.ones(n, dtype=bool), net_of(ring.control)
    unknown = np.ones((n, 1))
    unknown[3] = np.nan
    for skin, message in (
        (np.ones((n, 2)), "sum to 1"),
        (np.ones((n - 1, 1)), "one a vertex"),
        (unknown, r"first \[3\]"),
    ):
        refuses(ParameterError, message, carry_skin, weights, skin, net, everywhere)
    refuses(ParameterError, "influences", carry_skin, weights, np.ones((n, 1)), net, everywhere, influences=0)


def test_weights_whose_sums_are_a_little_off_are_normalised_and_said(ring: Refinement) -> None:
    n = ring.control.n_vertices
    skin = np.random.default_rng(2).dirichlet(np.ones(4), n)
    skin[5] = 0.0
    given = skin * np.where(np.arange(n) < 10, 0.999, 1.0)[:, None]
    given[7] *= 1.06
    kept, said = normalise_skin(given)
    np.testing.assert_allclose(kept, skin, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(kept[10:], skin[10:])
    assert f"9 of {n} vertices" in said
    assert "from 0.999 to 1.059" in said
    assert normalise_skin(skin) == (pytest.approx(skin, abs=0), "")
    for wrong in (0.85 * skin, 2 * skin, 100 * skin):
        refuses(ParameterError, r"0\.9 to 1\.1 is normalised", normalise_skin, wrong)


def test_joints_follow_an_affine_map_exactly(ring: Refinement) -> None:
    control = ring.control
    linear = np.array([[1.5, 0.2, 0], [-0.3, 0.8, 0.1], [0, 0.4, 2.0]])
    moved = refine(control.with_positions(control.positions @ linear.T + (3, -1, 2)), 2)
    joints = np.array([[2.0, 0, 0], [0, 2.0, 0.3], [-1.7, 0.4, 0]])
    carried, turns = carry_joints(same_vertices(moved, ring), joints)
    np.testing.assert_allclose(carried, joints @ linear.T + (3, -1, 2), rtol=0, atol=1e-6)
    u, _, vt = np.linalg.svd(linear.T)
    np.testing.assert_allclose(turns, np.tile(u @ vt, (3, 1, 1)), atol=1e-6)


def test_a_shape_of_zeros_stays_zero(ring: Refinement) -> None:
    carrier = prepare_shapes(ring, ring, same_vertices(ring, ring))
    shape = 0.2 * np.random.default_rng(3).normal(size=ring.control.positions.shape)
    np.testing.assert_allclose(carry_shape(carrier, 0 * shape), 0, rtol=0, atol=1e-12)
    # Constants have no gradient, so that the sum is the anchor's: the ridge is nothing beside it.
    assert 0 < carrier.ridge.sum() < 1e-6 * carrier.mass.sum()
    refuses(ParameterError, "one a control vertex", carry_shape, carrier, shape[1:])


def test_shapes_turn_and_scale_with_the_target(ring: Refinement) -> None:
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    control = ring.control
    target = refine(control.with_positions(3 * control.positions @ turn.T), 2)
    carrier = prepare_shapes(target, ring, same_vertices(target, ring))
    shape = 0.2 * np.sin(2 * control.positions[:, [1, 2, 0]])
    np.testing.assert_allclose(carry_shape(carrier, shape), 3 * shape @ turn.T, rtol=0, atol=1e-8)


def test_the_share_of_the_area_that_a_shape_moves() -> None:
    masses = np.array([1.0, 2.0, 3.0, 2.0])
    moves = np.array([[0.0, 3.0, 4.0], [5.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert moved_share(moves, masses) == pytest.approx(3 / 8)
    assert moved_share(1e-200 * moves, masses) == pytest.approx(3 / 8)
    assert moved_share(np.ones((4, 3)), masses) == pytest.approx(1.0)
    assert moved_share(np.zeros((4, 3)), masses) == 1.0


def beside_itself(control: ControlMesh) -> ControlMesh:
    """A mesh and another one of the same shape, far away."""
    far = control.positions + np.array([20.0, 0.0, 0.0])
    faces = [face.tolist() for face in np.split(control.face_indices, control.face_offsets[1:-1])]
    others = [[vertex + control.n_vertices for vertex in face] for face in faces]
    return ControlMesh.from_faces(np.concatenate([control.positions, far]), faces + others)


def lid() -> tuple[ControlMesh, np.ndarray]:
    """A slot in a plate, and the shape that closes it."""
    plate = voxels([(x, y, 0) for x in range(8) for y in range(3) if y != 1 or x in (0, 7)])
    x, y, _ = plate.positions.T
    return plate, np.where(((x > 2) & (x < 6) & (y > 1))[:, None], [0.0, -1.0, 0.0], 0.0)


@pytest.mark.parametrize("closes", [False, True])
def test_lengths_of_shapes_do_not_depend_on_parts_that_only_the_source_has(closes: bool) -> None:
    control, shape = lid() if closes else (torus(12, 8), np.array([1.0, 2.0, -1.0]))
    alone, both = refine(control, 2), refine(beside_itself(control), 2)
    target, source = surface_of(alone), surface_of(both)
    nearest = SurfacePoints.nearest(source, source.scale / target.scale * target.positions)
    carrier = prepare_shapes(alone, both, PointMap(target, nearest))
    given = np.zeros((2 * control.n_vertices, 3))
    given[: control.n_vertices] = shape
    assert (len(contacts(carrier, source.scale * both.prolong(given, 0, 2))[0]) > 0) == closes
    np.testing.assert_allclose(carry_shape(carrier, given), given[: control.n_vertices], rtol=0, atol=1e-9)


def test_an_upper_lid_that_closes_meets_the_lower_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slot in a plate, taller in the target: the upper rim comes down, corners stay; without contacts it gapes."""
    plate, shape = lid()
    target, source = refine(plate.with_positions(plate.positions * (1, 1.4, 1)), 3), refine(plate, 3)
    carrier = prepare_shapes(target, source, same_vertices(target, source))
    first, second, closing = contacts(carrier, carrier.point_map.source.scale * source.prolong(shape, 0, 3))
    heights = carrier.point_map.source.positions[:, 1] / carrier.point_map.source.scale
    assert len(first) > 20
    assert ((heights[first] > 1) != (heights[second] > 1)).all()  # one of each lid

    def missed() -> float:
        carried = target.prolong(carry_shape(carrier, shape), 0, 3) * carrier.point_map.target.scale
        return float(np.linalg.norm(carried[first] - carried[second] - closing, axis=1).mean())

    edge = np.sqrt(2 * carrier.masses).mean()
    assert missed() < 0.2 * edge
    monkeypatch.setattr("cagemap.transfer.blend_shapes._CONTACT", 0.0)
    assert missed() > edge


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".mtx", ".vts"])
def test_maps_come_back_from_files(tmp_path: Path, ring: Refinement, suffix: str) -> None:
    surface = surface_of(ring)
    rng = np.random.default_rng(2)
    t = rng.integers(0, len(surface.triangles), surface.n)
    point_map = PointMap.from_arrays(surface, surface, t, rng.dirichlet(np.ones(3), surface.n))
    file = tmp_path / f"map{suffix}"
    write_map(file, point_map)
    again = read_images(file, surface)
    atol = 0.2 if suffix in (".npy", ".vts") else 1e-12  # those hold vertices only
    np.testing.assert_allclose(again.positions, point_map.images.positions, rtol=0, atol=atol)
    refuses(FormatError, "each vertex of the target", dense_map, again.at(slice(100)), ring, surface)


def test_a_map_file_says_which_level_its_triangles_are_of(tmp_path: Path, ring: Refinement) -> None:
    surface, file = surface_of(ring), tmp_path / "map.npz"
    write_map(file, PointMap.from_vertices(surface, surface, np.zeros(surface.n, dtype=np.int64)))
    assert source_level(file, ring) == ring.finest_level  # though coarser levels have these triangles as well
    coarse = surface_of(ring.up_to(1))
    write_map(file, PointMap.from_vertices(coarse, coarse, np.arange(coarse.n)))
    assert source_level(file, ring) == 1
    refuses(FormatError, f"those of the file are of one with {coarse.n}", read_images, file, surface)
    (tmp_path / "dense.mtx").write_text(f"%%MatrixMarket matrix array real general\n{surface.n} {coarse.n}\n0\n")
    assert source_level(tmp_path / "dense.mtx", ring) == 1
    for damaged in ({"shape": np.zeros(0)}, {"triangle": np.zeros(0), "source_size": np.zeros(0)}):
        write_npz(file, damaged)
        assert source_level(file, ring) is None


@pytest.mark.slow
def test_dense_matrices_are_read_where_they_are_small(tmp_path, ring, monkeypatch):
    surface, file = surface_of(ring), tmp_path / "map.mtx"
    t = np.random.default_rng(3).integers(0, len(surface.triangles), surface.n)
    point_map = PointMap.from_arrays(surface, surface, t, np.tile([0.5, 0.25, 0.25], (surface.n, 1)))
    mmwrite(file, point_map.to_sparse().toarray(), comment="from elsewhere")
    monkeypatch.setattr("cagemap.files.result.maps._PIECE", 1000)  # so that it is read in many
    np.testing.assert_allclose(read_images(file, surface).positions, point_map.images.positions, atol=1e-12)
    head = "%%MatrixMarket matrix array real general\n"
    for text, found in (
        ("100000 100000\n1\n", "at most .* numbers of a dense matrix, found 100000 x 100000"),
        ("2 2\n1\n0\n0\n", "not 2 x 2 finite numbers"),
        ("2 2\n1\n0\nnan\n1\n", "not 2 x 2 finite numbers"),
        ("2 2\n1\n0\nx\n1\n", "could not convert"),
        ("2 2\n1\n0\n0\n1\n1\n", "more than 2 x 2 numbers"),
        ("-2 2\n1\n", "a size of -2 x 2"),
        ("", "found not enough values"),
    ):
        file.write_text(head + text)
        refuses(FormatError, found, read_images, file, surface)


def test_a_map_of_control_vertices_is_refined(ring: Refinement) -> None:
    surface = surface_of(ring)
    images = SurfacePoints.from_vertices(surface, np.arange(ring.control.n_vertices))
    dense = dense_map(images, ring, surface)
    off = np.linalg.norm(dense.images.positions - surface.positions, axis=1)
    assert off.max() < 0.1
    assert off[: ring.control.n_vertices].max() == 0


def test_what_is_no_map_is_refused(tmp_path: Path, ring: Refinement) -> None:
    surface = surface_of(ring)
    np.save(tmp_path / "far.npy", np.array([0, surface.n]))
    refuses(ParameterError, "vertices 0 to", read_images, tmp_path / "far.npy", surface)
    np.save(tmp_path / "floats.npy", np.ones(3))
    (tmp_path / "a.vts").write_text("1\ntwo\n")
    np.savez(tmp_path / "a.npz", x=np.ones(3))
    (tmp_path / "a.mtx").write_text("no matrix")
    for name, words in (
        ("floats.npy", "list of whole numbers, .* float64"),
        ("a.vts", "one vertex number a line, .* 'two'"),
        ("a.npz", "'triangle' and 'barycentric', .* found x"),
        ("a.mtx", "a sparse matrix .*'no matrix'"),
        ("a.txt", r"\.vts, got \.txt"),
        ("missing.npy", "no such file"),
    ):
        refuses(FormatError, words, read_images, tmp_path / name, surface)


def test_a_bound_mesh_follows_its_base(tmp_path: Path) -> None:
    base = torus(12, 8)
    rng = np.random.default_rng(4)
    faces = rng.integers(0, base.n_faces, 30)
    corners = base.face_indices[base.face_offsets[faces][:, None] + np.arange(4)]
    positions = base.positions[corners].mean(axis=1) + 0.02 * rng.normal(size=(30, 3))
    fitting = bind(positions, base, faces)
    np.testing.assert_allclose(fitting.positions(base.positions), positions, rtol=0, atol=1e-12)
    stretched = base.positions * (2, 2, 2)
    np.testing.assert_allclose(fitting.positions(stretched), 2 * positions, rtol=0, atol=1e-12)
    write_mhclo(tmp_path / "a.mhclo", fitting, Path("a.obj"))
    # Read as MakeHuman does: three lines of scales, and nine numbers a vertex.
    lines = [line.split() for line in (tmp_path / "a.mhclo").read_text().splitlines()]
    table = np.array([line for line in lines if len(line) == 9], dtype=float)
    scales = np.array([line[1:] for line in lines if line and line[0][1:] == "_scale"], dtype=float)
    ends = scales[:, :2].astype(int)
    again = Binding(table[:, :3].astype(int), table[:, 3:6], table[:, 6:], ends, scales[:, 2])
    np.testing.assert_array_equal(again.positions(stretched), fitting.positions(stretched))
    refuses(FormatError, "mhclo", write_mhclo, tmp_path / "a.txt", fitting, Path("a.obj"))


def test_chosen_joints_are_carried_and_others_share_the_rest() -> None:
    rng = np.random.default_rng(2)
    carried, own = rng.dirichlet(np.ones(5), 40), rng.dirichlet(np.ones(5), 40)
    own[3] = (0.25, 0.75, 0, 0, 0)  # all of chosen joints
    mixed = with_chosen_joints(carried, own, np.array([0, 1]))
    np.testing.assert_allclose(mixed.sum(axis=1), 1, atol=1e-12)
    np.testing.assert_array_equal(mixed[:, :2], carried[:, :2])
    np.testing.assert_array_equal(mixed[3], carried[3])
    others = np.arange(40) != 3
    shares = mixed[others, 2:] / mixed[others, 2:].sum(axis=1, keepdims=True)
    np.testing.assert_allclose(shares, own[others, 2:] / own[others, 2:].sum(axis=1, keepdims=True), atol=1e-12)
    np.testing.assert_array_equal(with_chosen_joints(carried, own, np.arange(5)), carried)
    refuses(ParameterError, r"joints: expected 0 to 4, got \[5\]", with_chosen_joints, carried, own, np.array([5]))
    refuses(ParameterError, "one shape", with_chosen_joints, carried, own[1:], np.array([0]))


def test_mirrored_weights_are_symmetric() -> None:
    skin = np.random.default_rng(2).dirichlet(np.ones(3), 4)
    vertices, joints = np.array([1, 0, 2, 3]), np.array([0, 2, 1])
    even = symmetrize_skin(skin, vertices, joints)
    np.testing.assert_allclose(even, even[vertices][:, joints], atol=1e-15)
    np.testing.assert_allclose(even.sum(axis=1), 1)
    np.testing.assert_allclose(symmetrize_skin(even, vertices, joints), even, atol=1e-15)
