"""Refinement: hand-computed masks, and what must hold on every mesh."""

import itertools
import pickle
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import (
    bipyramid,
    creature,
    cube,
    disk,
    grid,
    icosahedron,
    poles,
    pyramid,
    tetrahedron,
    torus,
    triangulated,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.errors import InvalidMeshError, ParameterError
from cagemap.mesh import CatmullClark, ControlMesh, Loop
from cagemap.mesh.control_mesh import UvSet
from cagemap.mesh.faces import cage_triangles
from cagemap.subdivision import Refinement, default_scheme, finest_mesh, refine, triangles
from cagemap.subdivision.matrices import polygon_matrix, regular_matrix
from cagemap.subdivision.refinement import vertex_counts, with_options
from cagemap.subdivision.topology import control_topology, fixed_boundary_vertices, split_topology

from refusals import refuses

CLOSED = [cube(), tetrahedron(), icosahedron(), torus(5, 4), poles(3), poles(8), bipyramid(7), pyramid(), creature()]
OPEN = [grid(3, 2), grid(1, 1), disk(3), disk(6), triangulated(grid(3, 2)), triangulated(disk(5))]
SHAPES = CLOSED + OPEN
by_name = pytest.mark.parametrize("mesh", SHAPES, ids=lambda mesh: f"{mesh.name}-{mesh.n_faces}")


def _edges(faces: np.ndarray) -> np.ndarray:
    """Distinct edges of (m, d) faces, ascending pairs, sorted: by brute force."""
    pairs = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    return np.unique(np.sort(pairs, axis=1), axis=0)


def _uv_grid() -> ControlMesh:
    """A 2 x 2 grid whose UVs are cut along the middle column."""
    mesh = grid(2, 2)
    right = mesh.positions[mesh.face_indices].reshape(4, 4, 3)[..., 0].mean(axis=1) > 1
    values = np.concatenate([mesh.positions[:, :2], mesh.positions[:, :2] + [5, 0]])
    indices = mesh.face_indices + np.repeat(np.where(right, mesh.n_vertices, 0), 4)
    used, indices = np.unique(indices, return_inverse=True)
    return mesh.with_uvs(values[used], indices)


# Invariants on every shape


@by_name
def test_rows_sum_to_one_and_are_canonical(mesh: ControlMesh) -> None:
    schemes = [CatmullClark("edge_only"), default_scheme(mesh)]
    for matrix in (matrix for scheme in schemes for matrix in refine(mesh, 2, scheme).matrices):
        np.testing.assert_allclose(matrix.sum(axis=1), 1, rtol=0, atol=4e-15)
        assert matrix.has_canonical_format
        assert matrix.indices.dtype == np.int32
        assert matrix.data.min() > 0  # neither scheme has a negative weight


@by_name
def test_euler_characteristic_and_counts(mesh: ControlMesh) -> None:
    refinement = refine(mesh, 3)
    loop = isinstance(refinement.scheme, Loop)
    control = control_topology(mesh)
    n_edges, n_faces = control.n_edges, 4 * mesh.n_faces if loop else len(mesh.face_indices)
    for coarse, fine in itertools.pairwise(refinement.levels):
        assert fine.n_vertices == coarse.n_vertices + n_edges + (0 if loop else coarse.n_faces)
        assert fine.faces.shape == (n_faces, 3 if loop else 4)
        np.testing.assert_array_equal(np.unique(fine.faces), np.arange(fine.n_vertices))
        n_edges, n_faces = len(_edges(fine.faces)), 4 * n_faces
        assert fine.n_vertices - n_edges + fine.n_faces == control.n_vertices - control.n_edges + control.n_faces


@by_name
def test_split_topology_is_the_one_of_the_refined_faces(mesh: ControlMesh) -> None:
    # The definition: sort all edges of the refined mesh again.
    refinement = refine(mesh, 2)
    assert list(itertools.islice(vertex_counts(mesh), 3)) == [level.n_vertices for level in refinement.levels]
    split = control_topology(mesh)
    for level in refinement.levels[1:]:
        split = table = split_topology(split, refinement.scheme)
        again = control_topology(ControlMesh.from_faces(level.positions, level.faces))
        np.testing.assert_array_equal(table.vertices, again.vertices)
        np.testing.assert_array_equal(split.valences, again.valences)
        np.testing.assert_array_equal(split.boundary, again.boundary)
        assert table.n_edges == again.n_edges

        def across(topology: object) -> np.ndarray:
            return topology.edge_corners[topology.edges, topology.forward.astype(int)]

        np.testing.assert_array_equal(across(split), across(again))
        # One counter-clockwise step around a vertex raises the rank by one; boundary fans start at rank 0.
        step = across(split)[table.previous]
        turned = split.ranks[step[step >= 0]] - split.ranks[step >= 0] - 1
        np.testing.assert_array_equal(turned % split.valences[table.vertices[step >= 0]], 0)
        assert np.all(split.ranks[across(split) < 0] == 0)


@by_name
def test_row_order_vertices_edges_faces(mesh: ControlMesh) -> None:
    # A row's largest weights tell which element it belongs to: a midpoint rule has both ends, ascending by edge.
    refinement = refine(mesh, 1)
    matrix = refinement.matrices[0].tolil()
    n, table = mesh.n_vertices, control_topology(mesh)
    ends = np.sort(np.column_stack([table.vertices, table.vertices[table.following]]), axis=1)
    order = np.unique(ends, axis=0)
    for number, (a, b) in enumerate(order):
        row = matrix[[n + number]].toarray()[0]
        assert row[a] == row[b] == row.max()
    for face in range(mesh.n_faces if isinstance(refinement.scheme, CatmullClark) else 0):
        row = matrix[[n + len(order) + face]].toarray()[0]
        np.testing.assert_array_equal(np.flatnonzero(row), np.sort(mesh.face(face)))
        assert np.ptp(row[mesh.face(face)]) == 0


@by_name
def test_children_start_with_their_own_vertex(mesh: ControlMesh) -> None:
    refinement = refine(mesh, 2)
    parents = [mesh.face(face) for face in range(mesh.n_faces)]
    fathers = np.arange(mesh.n_faces)
    for level in refinement.levels[1:]:
        child = 0
        for number, corners in enumerate(parents):
            for k, vertex in enumerate(corners):
                face = level.faces[child + k]
                assert face[0] == vertex
                # The second vertex is the edge point towards the next corner: the next child has it last.
                assert face[1] == level.faces[child + (k + 1) % len(corners)][-1]
            family = len(corners) + isinstance(refinement.scheme, Loop)
            np.testing.assert_array_equal(level.face_parents[child : child + family], fathers[number])
            if isinstance(refinement.scheme, Loop):
                np.testing.assert_array_equal(level.faces[child + 3], level.faces[child : child + 3, 1])
            child += family
        assert child == level.n_faces
        parents, fathers = list(level.faces), level.face_parents


# Symmetry under what does not matter


def _relabelled(mesh: ControlMesh, seed: int) -> tuple[ControlMesh, np.ndarray]:
    """Vertices renumbered, faces shuffled, corners turned; and the new number of each old vertex."""
    rng = np.random.default_rng(seed)
    new = rng.permutation(mesh.n_vertices)
    positions = np.empty_like(mesh.positions)
    positions[new] = mesh.positions
    faces = [np.roll(new[mesh.face(f)], rng.integers(9)) for f in rng.permutation(mesh.n_faces)]
    return ControlMesh.from_faces(positions, faces), new


@settings(max_examples=15, derandomize=True)
@given(st.sampled_from(SHAPES), st.integers(2, 10**6))
def test_numbering_does_not_matter(mesh: ControlMesh, seed: int) -> None:
    mesh = mesh.with_positions(mesh.positions + 0.1 * np.random.default_rng(seed).standard_normal(mesh.positions.shape))
    other, new = _relabelled(mesh, seed)
    mine, theirs = refine(mesh, 2).finest.positions, refine(other, 2).finest.positions
    np.testing.assert_allclose(theirs[new], mine[: mesh.n_vertices], rtol=0, atol=1e-13)
    np.testing.assert_allclose(_sorted(theirs), _sorted(mine), rtol=0, atol=1e-9)


def _sorted(points: np.ndarray) -> np.ndarray:
    return points[np.lexsort(np.round(points, 9).T)]


@settings(max_examples=15, derandomize=True)
@given(st.sampled_from(SHAPES), st.sampled_from([1e-8, 1.0, 1e8]), st.integers(2, 10**6))
def test_rigid_motion_and_scale_commute_with_refinement(mesh: ControlMesh, scale: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, shift = np.linalg.qr(rng.standard_normal((3, 3)))[0], rng.standard_normal(3)
    moved = refine(mesh.with_positions(scale * (mesh.positions @ turn + shift)), 2).finest.positions
    np.testing.assert_allclose(moved / scale, refine(mesh, 2).finest.positions @ turn + shift, rtol=0, atol=1e-13)


def test_a_mirror_symmetric_shape_stays_mirror_symmetric() -> None:
    for mesh in (creature(), pyramid()):
        points = refine(mesh, 2).finest.positions
        np.testing.assert_allclose(_sorted(points * [-1, 1, 1]), _sorted(points), rtol=0, atol=1e-13)


# Products between levels


@pytest.fixture(scope="module")
def refinement() -> Refinement:
    return refine(poles(5), 3)


def test_product_is_the_product_of_the_steps(refinement: Refinement) -> None:
    S = refinement.matrices
    expected = (S[2] @ S[1] @ S[0]).toarray()
    np.testing.assert_allclose(refinement.product(3, 0).toarray(), expected, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(refinement.product(2, 2).toarray(), np.eye(refinement.levels[2].n_vertices))
    refined = refinement.product(3, 0) @ refinement.control.positions
    np.testing.assert_allclose(refined, refinement.finest.positions, rtol=0, atol=1e-15)


@pytest.mark.parametrize("columns", [(), (1,), (4,)])
def test_prolong_applies_the_product(refinement: Refinement, columns: tuple[int, ...]) -> None:
    rng = np.random.default_rng(77)
    coarse = rng.standard_normal((refinement.levels[1].n_vertices, *columns))
    product = refinement.product(3, 1)
    np.testing.assert_allclose(refinement.prolong(coarse, 1, 3), product @ coarse, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(refinement.prolong(coarse, 1, 1), coarse)


def test_printing_shows_the_levels(refinement: Refinement) -> None:
    lines = str(refinement).splitlines()
    assert "CatmullClark" in lines[0]
    assert [line.split()[:3] for line in lines[2:]] == [
        [str(number), str(level.n_vertices), str(level.n_faces)] for number, level in enumerate(refinement.levels)
    ]
    assert lines[2].split()[3] == str(refinement.matrices[0].nnz)
    assert len(repr(refinement)) < 200


@pytest.mark.parametrize("mesh", [torus(48, 48), triangulated(torus(48, 48))], ids=["quads", "triangles"])
def test_memory_is_linear_with_a_small_constant(mesh: ControlMesh) -> None:
    mesh = mesh.with_uvs(mesh.positions[:, :2], mesh.face_indices)
    tracemalloc.start()
    finest = refine(mesh, 3).finest
    peak = tracemalloc.get_traced_memory()[1] / finest.n_vertices
    tracemalloc.stop()
    # Kept: faces, UV faces, positions, UVs and S, 250 to 280 bytes a vertex; working space measured at 40 % of that.
    assert peak < 450


# Faces, triangles, UVs


def test_level_0_faces() -> None:
    assert refine(pyramid(), 0).levels[0].faces is None
    np.testing.assert_array_equal(refine(cube(), 0).levels[0].faces, cube().face_indices.reshape(6, 4))
    np.testing.assert_array_equal(refine(cube(), 0).finest.face_parents, np.arange(6))


def test_triangles_follow_the_one_rule() -> None:
    faces = np.array([[4, 7, 9, 2], [0, 1, 2, 3]])
    np.testing.assert_array_equal(triangles(faces), [[4, 7, 9], [4, 9, 2], [0, 1, 2], [0, 2, 3]])
    np.testing.assert_array_equal(triangles(faces[:, :3]), faces[:, :3])
    np.testing.assert_array_equal(cage_triangles(cube())[0], triangles(refine(cube(), 0).finest.faces))
    mixed = ControlMesh.from_faces(np.zeros((6, 3)), [(0, 1, 2, 3, 4), (0, 4, 5)])
    np.testing.assert_array_equal(cage_triangles(mixed)[0], [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])


@pytest.mark.parametrize("scheme", [CatmullClark(), Loop()], ids=str)
def test_uvs_are_linear_inside_islands_and_cut_between(scheme: CatmullClark | Loop) -> None:
    control = _uv_grid() if isinstance(scheme, CatmullClark) else triangulated(_uv_grid())
    refinement = refine(control, 2, scheme)
    for level in refinement.levels[1:]:
        assert level.uv_indices.shape == level.faces.shape
        # Both islands are the plane itself (one shifted by 5), so the UV of a corner is bilinear in its control face.
        islands = level.uvs[level.uv_indices][..., 0] > 4
        assert np.all(islands == islands[:, :1])
        left_and_right = [np.unique(level.uv_indices[islands[:, 0] == side]) for side in (False, True)]
        assert len(np.intersect1d(*left_and_right)) == 0
        # Each island is a regular grid of its own: no point is doubled inside.
        for points in left_and_right:
            assert len(np.unique(np.round(level.uvs[points], 12), axis=0)) == len(points)
        area = _signed_areas(level.uvs, triangles(level.uv_indices))
        assert area.sum() == pytest.approx(4)
        assert area.min() > 0


def _signed_areas(uvs: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = uvs[faces].transpose(1, 0, 2)
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def test_uvs_on_n_gons_use_the_mean_of_the_corners() -> None:
    mesh = pyramid()
    finest = refine(mesh.with_uvs(mesh.positions[:, :2], mesh.face_indices), 1).finest
    for face in range(mesh.n_faces):
        child = finest.uv_indices[np.flatnonzero(finest.face_parents == face)[0]]
        np.testing.assert_allclose(finest.uvs[child[2]], mesh.positions[mesh.face(face), :2].mean(axis=0))


def test_levels_with_uvs_are_pickled() -> None:
    """Also level 0, the only one of a plain mesh."""
    mesh = cube()
    refinement = refine(mesh.with_uvs(mesh.positions[:, :2], mesh.face_indices), 1)
    for before, after in zip(refinement.levels, pickle.loads(pickle.dumps(refinement)).levels, strict=True):
        np.testing.assert_array_equal(after.uvs, before.uvs)
        np.testing.assert_array_equal(after.uv_indices, before.uv_indices)


# Refusals


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ([(0, 1, 2), (0, 1, 3), (1, 0, 4)], r"edges with more than two faces: \(0, 1\)"),
        ([(0, 1, 2, 3), (0, 1, 4)], r"got 1 .*same direction: \(0, 1\);"),
        ([(0, 1, 2), (0, 3, 4)], "separate fans of faces touch: 0"),
        ([(0, 1, 1, 2), (0, 2, 3, 4)], r"from a vertex to itself: \(1, 1\)"),
        ([(0, 1, 2, 3)], "vertices without a face: 4"),
        ([(0, 1, 2, 7), (3, 4, 0)], "vertex numbers from 0 to 4, got others in 1 face, faces: 0"),
        ([], "at least one face"),
    ],
)
def test_meshes_without_a_surface_are_refused(faces: list[tuple[int, ...]], message: str) -> None:
    mesh = ControlMesh.from_faces(np.random.default_rng(8).standard_normal((5, 3)), faces, name="broken")
    with pytest.raises(InvalidMeshError, match=message) as refusal:
        refine(mesh, 1)
    assert str(refusal.value).startswith("broken: ")


def test_closed_fans_that_touch_in_a_vertex_are_refused() -> None:
    one, other = tetrahedron(), tetrahedron()
    faces = [one.face(f) for f in range(4)] + [np.where(other.face(f) == 0, 0, other.face(f) + 3) for f in range(4)]
    positions = np.concatenate([one.positions, other.positions[1:] + 5])
    refuses(InvalidMeshError, "separate fans of faces touch: 0", refine, ControlMesh.from_faces(positions, faces), 1)


def test_rows_of_some_vertices_are_those_of_the_product(refinement: Refinement) -> None:
    for fine, coarse in ((2, 0), (2, 1), (1, 1)):
        n, product = refinement.levels[fine].n_vertices, refinement.product(fine, coarse)
        for vertices in (np.array([n - 1, 0, 3, 3]), slice(1, 6), np.arange(0)):
            rows = refinement.rows(vertices, fine, coarse)
            assert rows.has_sorted_indices
            assert rows.indices.dtype == np.int32  # as all matrices of a refinement
            # Both are sums of products of a few weights below 1; only their order differs.
            np.testing.assert_allclose(rows.toarray(), product[vertices].toarray(), rtol=0, atol=1e-15)
        for outside in (n, -1):
            with pytest.raises(ParameterError, match=f"expected 0 to {n - 1} of level {fine}, got {outside}"):
                refinement.rows(np.array([outside]), fine, coarse)
    refuses(ParameterError, "got coarse 2 and fine 1", refinement.rows, np.arange(2), 1, 2)


def test_parameters_are_checked(refinement: Refinement) -> None:
    refuses(ParameterError, "got -1", refine, cube(), -1)
    refuses(InvalidMeshError, "triangles only, got 1 other faces: 0", refine, pyramid(), 1, Loop())
    refuses(ParameterError, "edge_only, edge_and_corner, got 'sharp'", CatmullClark, "sharp")
    refuses(ParameterError, "fewer levels", refine, creature(), 20)
    refuses(ParameterError, "got coarse 2 and fine 1", refinement.product, 1, 2)
    refuses(ParameterError, "rows, one per vertex of level 1", refinement.prolong, np.zeros((3, 2)), 1, 2)
    with pytest.raises(InvalidMeshError, match="UV indices from 0 to"):
        refine(replace(_uv_grid(), uv_indices=_uv_grid().uv_indices + 3), 1)


def test_the_finest_mesh_has_all_uv_sets_and_colours() -> None:
    mesh = grid(3, 2)
    corners = np.arange(len(mesh.face_indices))
    flat = mesh.positions[:, :2]
    seamed = UvSet("seamed", flat[mesh.face_indices] + mesh.corner_faces[:, None], corners)
    mesh = replace(mesh.with_uvs(flat, mesh.face_indices), uv_name="st", uv_sets=(seamed,))
    colors = np.column_stack([flat / np.ptp(flat, axis=0), np.zeros(len(flat))])
    mesh = replace(mesh, vertex_colors=colors - colors.min(axis=0))
    refinement = refine(mesh, 2)
    fine = finest_mesh(refinement)
    (other,) = fine.uv_sets
    assert len(other.uv_indices) == len(fine.face_indices)
    np.testing.assert_array_equal(other.uvs, refine(mesh.with_uv_set("seamed"), 2).finest.uvs)
    # Colours that are places stay places.
    np.testing.assert_allclose(
        fine.vertex_colors, np.clip(refinement.prolong(mesh.vertex_colors, 0, 2), 0, 1), atol=1e-12
    )
    assert finest_mesh(refine(replace(mesh, vertex_colors=np.full_like(colors, np.nan)), 1)).vertex_colors is None


def test_uvs_of_a_level_are_made_when_they_are_asked_for():
    level = refine(_uv_grid(), 2).finest
    assert "layout" not in vars(level)
    assert level.uvs is level.uvs is not None
    assert level.uv_indices.max() < len(level.uvs)


def test_a_scheme_that_is_not_known_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"^scheme: expected one of catmull-clark, .*, got 'doo-sabin'"):
        with_options(cube(), "doo-sabin")


def test_quad_masks_are_the_general_rule_written_out() -> None:
    for mesh in (cube(), creature(), poles(3), poles(8), torus(3, 3), grid(3, 2), disk(5)):
        for boundary in ("edge_and_corner", "edge_only"):
            topology, scheme = control_topology(mesh), CatmullClark(boundary)
            corner = fixed_boundary_vertices(topology, scheme)
            general, written_out = (rule(topology, scheme, corner) for rule in (polygon_matrix, regular_matrix))
            assert abs(general - written_out).max() < 1e-15
            assert general.nnz == written_out.nnz


def test_interior_vertex_of_valence_2() -> None:
    # Two quads share the path 0-1-2 and both of vertex 1's edges; it has weight 0 in its own rule.
    positions = [(0, 0, 0), (1, 0.2, 0), (2, 0, 0), (1, -1, 0), (1, 1, 0)]
    mesh = ControlMesh.from_faces(positions, [(0, 3, 2, 1), (0, 1, 2, 4)])
    refinement = refine(mesh, 2)
    np.testing.assert_allclose(refinement.matrices[0][[1]].toarray(), [[3 / 8, 1 / 8, 3 / 8, 1 / 16, 1 / 16]])
    assert all(matrix.has_canonical_format for matrix in refinement.matrices)  # the ring meets some vertices twice
    topology = split_topology(control_topology(mesh), refinement.scheme)
    again = polygon_matrix(topology, CatmullClark(), fixed_boundary_vertices(topology, CatmullClark()))
    assert abs(again - refinement.matrices[1]).max() < 1e-15
