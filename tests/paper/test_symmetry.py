"""Self-symmetries: detection, propagation from level to level, projection (paper, section 5.2)."""

from dataclasses import replace

import numpy as np
import pytest
from examples import shapes
from tests.fixtures.vertex_pairs import pair_at

from cagemap.errors import ParameterError
from cagemap.files.meshes.obj import read_obj
from cagemap.mesh import ControlMesh
from cagemap.mesh.mirrors import is_symmetry, mirror_symmetries, reflect
from cagemap.operators import build_operators
from cagemap.paper.symmetries import check_symmetry, paired_mirrors, propagate_symmetry, symmetry_at, symmetry_operator
from cagemap.spectral import BasisConfig, Surface, hierarchical_basis
from cagemap.subdivision import refine

from refusals import refuses


def skewed(mesh):
    """The same mesh turned and moved to a place where no coordinate plane helps."""
    rotation, _ = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))
    return mesh.with_positions(mesh.positions @ rotation.T + [3.0, -2.0, 0.7])


@pytest.mark.parametrize("place", [lambda mesh: mesh, skewed])
def test_mirror_is_found_and_is_an_involution(place):
    mesh = place(shapes.creature())
    mirror = mirror_symmetries(mesh)[0]
    assert mirror.exact
    np.testing.assert_array_equal(mirror.image[mirror.image], np.arange(mesh.n_vertices))
    np.testing.assert_allclose(
        reflect(mesh.positions, mirror.normal, mirror.offset), mesh.positions[mirror.image], atol=1e-9
    )
    check_symmetry(mirror.image, mesh)


def test_bent_mesh_has_no_mirror():
    mesh = shapes.creature()
    positions = mesh.positions.copy()
    positions[:, 0] += 0.1 * positions[:, 0] ** 2 + 0.05 * positions[:, 1]
    assert mirror_symmetries(mesh.with_positions(positions)) == ()


def test_a_wider_tolerance_finds_planes_that_are_farther_off(monkeypatch):
    mesh = shapes.creature()
    off = np.random.default_rng(0).standard_normal(mesh.positions.shape)
    off *= 0.008 * np.linalg.norm(np.ptp(mesh.positions, axis=0)) / np.linalg.norm(off, axis=1, keepdims=True)
    moved = mesh.with_positions(mesh.positions + off)
    assert mirror_symmetries(moved) == ()
    monkeypatch.setattr("cagemap.mesh.mirrors.MOST_WITHIN", 0.02)
    assert len(mirror_symmetries(moved)) == 1


def test_box_has_three_planes_and_a_cut_lid_makes_them_inexact():
    """Vertices mirror, faces do not, once the lid is cut along one diagonal; the planes are found all the same."""
    box = shapes.cube()
    box = box.with_positions(box.positions * [1.0, 2.0, 3.5])
    faces = [box.face(i) for i in range(box.n_faces)]
    lid = faces.pop()
    cut = [lid[[0, 1, 2]], lid[[2, 3, 0]]]
    assert [mirror.exact for mirror in mirror_symmetries(box)] == [True] * 3
    mirrors = mirror_symmetries(ControlMesh.from_faces(box.positions, [*faces, *cut]))
    assert len(mirrors) == 3
    assert sum(mirror.exact for mirror in mirrors) < 3
    assert not is_symmetry(box, np.roll(np.arange(8), 1))
    # A hole in one side: two planes cut it, the third one would move it to the other side.
    assert sum(mirror.exact for mirror in mirror_symmetries(replace(box, hole_faces=np.array([2])))) == 2


@pytest.mark.parametrize("turned", [(0, 1, 2), (1, 0, 2), (2, 0, 1)])
def test_planes_of_both_sides_are_paired_as_landmarks_say(turned):
    """A box has three; which of them belong together, only landmarks tell; planes that they do not tell of are left."""
    box = shapes.cube()
    box = box.with_positions(box.positions * [1.0, 2.0, 3.5])
    surface = Surface(refine(box, 1), BasisConfig(count=6))
    corners = np.sign(box.positions)
    partner = [int(np.flatnonzero((corners == corner[list(turned)]).all(axis=1))[0]) for corner in corners]
    vertices = np.arange(8)
    pairs = paired_mirrors(pair_at(surface, surface, vertices, np.array(partner)))
    assert len(pairs) == 3
    for at_target, at_source in pairs:
        np.testing.assert_array_equal(at_source[partner], np.array(partner)[at_target])
    scrambled = np.array([0, 3, 5, 6, 1, 7, 2, 4])[partner]
    assert paired_mirrors(pair_at(surface, surface, vertices, scrambled)) == ()


def test_without_landmarks_only_single_planes_belong_together():
    """A box has three planes, and nothing says which of one side is which of the other; a creature has one."""
    for shape, count in ((shapes.cube, 0), (shapes.creature, 1)):
        surface = Surface(refine(shape(), 1), BasisConfig(count=6))
        none = np.zeros(0, dtype=np.int64)
        assert len(paired_mirrors(pair_at(surface, surface, none, none))) == count


def test_a_landmark_that_every_plane_keeps_tells_no_planes_apart():
    box = shapes.cube()
    sides = [
        Surface(refine(box.with_positions(box.positions * lengths), 1), BasisConfig(count=6))
        for lengths in ([1.0, 2.0, 3.5], [3.5, 1.0, 2.0])
    ]
    one = np.zeros(1, dtype=np.int64)
    assert paired_mirrors(pair_at(*sides, one, one)) == ()
    creature = Surface(refine(shapes.creature(), 1), BasisConfig(count=6))
    assert len(paired_mirrors(pair_at(creature, creature, one, one))) == 1


def test_symmetry_propagates_with_the_positions():
    """At every level the mirrored vertex is the mirror image of the vertex."""
    mesh = shapes.creature()
    refinement = refine(mesh, 3)
    mirror = mirror_symmetries(mesh)[0]
    for level, mesh_level in enumerate(refinement.levels):
        image = symmetry_at(refinement, mirror.image, level)
        np.testing.assert_allclose(
            reflect(mesh_level.positions, mirror.normal, mirror.offset), mesh_level.positions[image], atol=1e-9
        )


def test_nearly_symmetric_cages_propagate_by_nearest_neighbours():
    """One face cut in two: no permutation sends faces to faces, and the images still are the nearest vertices."""
    mesh = shapes.creature()
    faces = [mesh.face(i) for i in range(mesh.n_faces)]
    place = next(i for i, face in enumerate(faces) if len(face) == 4)
    face = faces.pop(place)
    cut = ControlMesh.from_faces(mesh.positions, [*faces, face[[0, 1, 2]], face[[2, 3, 0]]])
    mirror = mirror_symmetries(cut)[0]
    assert not mirror.exact
    refinement = refine(cut, 2)
    image = symmetry_at(refinement, mirror.image, 2)
    positions = refinement.finest.positions
    missed = np.linalg.norm(reflect(positions, mirror.normal, mirror.offset) - positions[image], axis=1)
    assert np.mean(missed < 1e-9) > 0.8  # where the faces mirror, the answer is exact
    edges = np.linalg.norm(np.diff(positions[refinement.finest.faces[:, :2]], axis=1), axis=2)
    assert missed.max() < edges.max()


def test_unknown_images_stay_unknown():
    """A vertex of the next level is known where all that it depends on is."""
    mesh = shapes.creature()
    refinement = refine(mesh, 1)
    whole = mirror_symmetries(mesh)[0].image
    part = whole.copy()
    part[:5] = -1
    check_symmetry(part, mesh)
    image = symmetry_at(refinement, part, 1)
    depends = abs(refinement.matrices[0])[:, :5].sum(axis=1) > 0
    np.testing.assert_array_equal(image == -1, depends)
    np.testing.assert_array_equal(image[~depends], symmetry_at(refinement, whole, 1)[~depends])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["zebra", "spot", "cow", "fish1"])
def test_exact_symmetry_is_plus_or_minus_one_on_every_level(shared_data, name):
    """It commutes with the Laplacian: +-1 on the diagonal, nothing beside it, on the basis of each level."""
    mesh = read_obj(shared_data / "animals" / f"{name}.obj")
    refinement = refine(mesh, 2)
    operators = build_operators(refinement)
    basis = hierarchical_basis(refinement, operators, BasisConfig(schedule=(40, 60, 50), accuracy=1e-10))
    image = mirror_symmetries(mesh)[0].image
    operator = symmetry_operator(basis, symmetry_at(refinement, image, basis.last_level))
    for level in range(3):
        size = basis.size(level)
        block, eigenvalues = operator[:size, :size], basis.eigenvalues[:size]
        # Eigenvectors converged to 1e-10 of a spectrum whose closest eigenvalues lie about 1e-4 apart.
        np.testing.assert_allclose(abs(np.diag(block)), 1.0, atol=1e-6)
        commutator = block * eigenvalues - eigenvalues[:, None] * block
        assert abs(commutator).max() < 1e-6 * eigenvalues.max()


def test_wrong_maps_are_refused():
    mesh = shapes.creature()
    refuses(ParameterError, "expected the image of each of the", check_symmetry, np.zeros(3, dtype=np.int64), mesh)
    refuses(ParameterError, "whole numbers", check_symmetry, np.zeros(mesh.n_vertices), mesh)
    with pytest.raises(ParameterError, match="or -1 where the image is not known"):
        check_symmetry(np.full(mesh.n_vertices, mesh.n_vertices), mesh)


def test_rows_that_mirror_are_told_apart_without_positions():
    """Two coinciding vertices: positions cannot tell which is the image, connectivity can."""
    mesh = shapes.creature()
    mirror = mirror_symmetries(mesh)[0]
    collapsed = mesh.with_positions(np.zeros_like(mesh.positions))
    refinement = refine(collapsed, 1)
    expected = propagate_symmetry(
        refine(mesh, 1).matrices[0], mirror.image, mesh.positions, refine(mesh, 1).finest.positions
    )
    found = propagate_symmetry(refinement.matrices[0], mirror.image, collapsed.positions, refinement.finest.positions)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.slow
def test_planes_of_all_human_cages_are_found(shared_data):
    for path in sorted((shared_data / "humans").glob("*.obj")):
        mirrors = mirror_symmetries(read_obj(path))
        assert len(mirrors) == 1, path.name
        assert abs(mirrors[0].normal[0]) > 0.9999, path.name
