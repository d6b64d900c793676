"""Creases, corners and holes: by hand, under relabelling, and through the whole method."""

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import creature, cube, grid, icosahedron, poles, pyramid, tetrahedron

from cagemap.errors import InvalidMeshError
from cagemap.mesh import Bilinear, CatmullClark, ControlMesh, Loop
from cagemap.mesh.checks import check_mesh
from cagemap.mesh.mirrors import mirror_symmetries
from cagemap.pipeline import match, prepare_surface
from cagemap.spectral import BasisConfig
from cagemap.subdivision import finest_mesh, refine

from plain_meshes import marks_at


def _edges_of_face(mesh: ControlMesh, face: int) -> np.ndarray:
    corners = mesh.face(face)
    return np.column_stack([corners, np.roll(corners, -1)])


def test_infinite_crease_and_corner_masks_by_hand() -> None:
    mesh = cube()
    ring = mesh.face(0)
    creased = refine(mesh.with_creases(_edges_of_face(mesh, 0), 10), 1)
    positions = mesh.positions
    # The four vertices follow 1/8, 3/4, 1/8 along the loop, its edges get midpoints.
    expected = 0.75 * positions[ring] + 0.125 * (positions[np.roll(ring, 1)] + positions[np.roll(ring, -1)])
    np.testing.assert_allclose(creased.finest.positions[ring], expected, atol=1e-15)
    middles = 0.5 * (positions[ring] + positions[np.roll(ring, -1)])
    gaps = np.linalg.norm(creased.finest.positions[:, None] - middles, axis=2).min(axis=0)
    np.testing.assert_allclose(gaps, 0, atol=1e-15)
    corner = refine(mesh.with_corners([3], 10), 3)
    np.testing.assert_array_equal(corner.finest.positions[3], positions[3])


@pytest.mark.parametrize("sharpness", [0.25, 0.75])
def test_a_fractional_crease_is_between_smooth_and_sharp(sharpness: float) -> None:
    mesh = cube()
    edges = _edges_of_face(mesh, 2)
    smooth, partly, sharp = (refine(mesh.with_creases(edges, s), 1).finest.positions for s in (0, sharpness, 1))
    np.testing.assert_allclose(partly, (1 - sharpness) * smooth + sharpness * sharp, atol=1e-15)


def test_rows_sum_to_one_with_creases() -> None:
    mesh = poles(5).with_creases(_edges_of_face(poles(5), 1), [0.4, 1.7, 10, 3]).with_corners([0], 1.5)
    for scheme in (CatmullClark(), CatmullClark(creasing="chaikin")):
        refinement = refine(mesh, 3, scheme)
        for matrix in refinement.matrices:
            np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=4e-15)
            assert matrix.data.min() > 0
            assert matrix.indices.dtype == np.int32


def test_numbering_does_not_matter_with_creases() -> None:
    rng = np.random.default_rng(4711)
    mesh = icosahedron().with_positions(icosahedron().positions + 0.1 * rng.standard_normal((12, 3)))
    creases, sharpness = _edges_of_face(mesh, 4)[:2], np.array([0.6, 2.2])
    mesh = mesh.with_creases(creases, sharpness).with_corners([7, 2], [1.2, 10])
    new = rng.permutation(12)
    positions = np.empty_like(mesh.positions)
    positions[new] = mesh.positions
    faces = [np.roll(new[mesh.face(f)], rng.integers(9)) for f in rng.permutation(mesh.n_faces)]
    other = ControlMesh.from_faces(positions, faces).with_creases(new[creases][::-1, ::-1], sharpness[::-1])
    other = other.with_corners(new[[2, 7]], [10, 1.2])
    for scheme in (Loop(), CatmullClark(creasing="chaikin")):
        mine, theirs = refine(mesh, 3, scheme), refine(other, 3, scheme)
        np.testing.assert_allclose(theirs.finest.positions[new], mine.finest.positions[:12], atol=1e-13)


def test_creases_beside_the_mesh_are_refused() -> None:
    mesh = cube()
    diagonal = mesh.with_creases([[mesh.face(0)[0], mesh.face(0)[2]]], 2)
    assert any("no edge" in problem.found for problem in check_mesh(diagonal).problems)
    with pytest.raises(InvalidMeshError, match="no edge"):
        refine(diagonal, 1)
    for broken in (
        mesh.with_creases([[0, 99]], 1),
        mesh.with_creases([_edges_of_face(mesh, 0)[0]], np.nan),
        mesh.with_creases([_edges_of_face(mesh, 0)[0]], -1),
        replace(mesh, crease_edges=np.zeros((1, 2), dtype=int)),
        mesh.with_corners([-1], 1),
        replace(mesh.with_corners([1], 1), corner_sharpness=np.ones(3)),
        replace(mesh, hole_faces=np.array([6])),
    ):
        assert [problem.kind for problem in check_mesh(broken).problems] == ["broken data"]


def test_a_mirror_symmetry_has_to_keep_the_creases() -> None:
    """A crease on one side only: the plane is there still, but no longer exact."""
    mesh = creature()
    whole = mirror_symmetries(mesh)[0]
    assert whole.exact
    image = whole.image
    edge = next(
        np.sort(mesh.face(i)[:2]) for i in range(mesh.n_faces) if set(mesh.face(i)[:2]) != set(image[mesh.face(i)[:2]])
    )
    assert mirror_symmetries(mesh.with_creases([edge, image[edge]], 2))[0].exact
    assert not mirror_symmetries(mesh.with_creases([edge], 2))[0].exact
    assert not mirror_symmetries(mesh.with_creases([edge, image[edge]], [2, 1]))[0].exact


def test_holes_shape_the_surface_and_are_no_part_of_it() -> None:
    mesh = cube()
    holed = refine(replace(mesh, hole_faces=np.array([1, 4])), 2)
    np.testing.assert_array_equal(holed.finest.positions, refine(mesh, 2).finest.positions)
    np.testing.assert_array_equal(holed.holes(2), np.isin(holed.finest.face_parents, [1, 4]))
    opened = refine(grid(3, 3), 1, CatmullClark("none"))
    assert (~opened.holes(0)).sum() == 1  # all but the middle face touch the boundary


@pytest.mark.parametrize(("sharpness", "shown"), [(10.0, [4, 8]), (9.9, [4])])
def test_a_boundary_face_is_no_hole_if_all_boundary_edges_at_it_are_infinitely_sharp(sharpness, shown):
    """As in OpenSubdiv: the last face of nine, of which four boundary edges are creases."""
    mesh = grid(3, 3)
    boundary = np.array([[11, 15], [7, 11], [14, 15], [13, 14]])
    opened = refine(mesh.with_creases(boundary, sharpness), 1, CatmullClark("none"))
    np.testing.assert_array_equal(np.flatnonzero(~opened.holes(0)), shown)


def test_smooth_triangles_weigh_more_in_edge_points() -> None:
    # 0.47 for each of the two face points, 0.03 for each end: face points are a third of each corner.
    row = refine(tetrahedron(), 1, CatmullClark(triangles="smooth")).matrices[0][[4]].toarray()[0]
    np.testing.assert_allclose(np.sort(row), [0.47 / 3, 0.47 / 3, 0.03 + 0.94 / 3, 0.03 + 0.94 / 3])
    mixed = refine(pyramid(), 1, CatmullClark(triangles="smooth")).matrices[0]
    np.testing.assert_allclose(mixed.sum(axis=1), 1, atol=1e-15)


def test_bilinear_keeps_the_control_mesh() -> None:
    mesh = pyramid()
    refinement = refine(mesh, 2, Bilinear())
    np.testing.assert_array_equal(refinement.finest.positions[: mesh.n_vertices], mesh.positions)
    np.testing.assert_allclose(
        refinement.levels[1].positions[-1], mesh.positions[mesh.face(mesh.n_faces - 1)].mean(axis=0)
    )


def test_the_file_says_how_to_subdivide() -> None:
    mesh = replace(cube(), scheme=CatmullClark("edge_only", uv_interpolation="boundaries"))
    assert refine(mesh, 1).scheme == mesh.scheme
    assert refine(replace(icosahedron(), scheme=Bilinear()), 1).finest.faces.shape[1] == 4


@pytest.mark.slow
def test_a_creased_surface_goes_through_the_whole_method() -> None:
    mesh = creature()
    edges = np.column_stack([mesh.face_indices, mesh.face_indices[mesh.next_corners]])
    edges = np.unique(np.sort(edges, axis=1), axis=0)[::5]
    creased = mesh.with_creases(edges, np.resize([0.7, 2.3, 10], len(edges))).with_corners([0, 5], [1.5, 10])
    bent = creased.with_positions(creased.positions * [1.1, 0.95, 1.05])
    picked = np.unique(np.linspace(0, mesh.n_vertices - 1, 9).astype(int))
    target, source = (prepare_surface(control, 1, BasisConfig(count=40)) for control in (bent, creased))
    result = match(target, source, marks_at(picked))
    gaps = np.linalg.norm(result.point_map.images.positions - source.triangles(1).positions, axis=1)
    # The same cage, stretched a little, at unit area: vertices map to themselves but for what stretching moves.
    assert np.median(gaps) < 0.01
    assert result.quality.flipped_area < 0.01
    np.testing.assert_allclose(result.quality.landmark_errors, 0, atol=1e-9)


def test_holes_of_mixed_faces_are_numbered_as_their_triangles() -> None:
    holed = refine(replace(pyramid(), hole_faces=np.array([0, 2])), 1)
    assert len(holed.holes(0)) == len(holed.faces(0))
    np.testing.assert_array_equal(holed.holes(0), [True, True, False, True, False, False])


def test_a_mesh_of_holes_alone_is_refused() -> None:
    strip = refine(grid(1, 3), 1, CatmullClark("none"))
    with pytest.raises(InvalidMeshError, match="grid: expected a face that is no hole"):
        finest_mesh(strip)
    assert finest_mesh(refine(grid(3, 3), 1, CatmullClark("none"))).n_faces == 4
