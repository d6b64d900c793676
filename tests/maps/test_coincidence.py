"""Surfaces that lie on each other: the identity or closest points, unless landmarks or masks want something else."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import voxels
from scipy import sparse
from scipy.spatial.transform import Rotation

from cagemap import ControlMesh, Landmarks, Surface, match, prepare_surface, read_mesh, refine, update_match
from cagemap.deform.problem import Problem
from cagemap.maps import coincidence
from cagemap.maps.coincidence import SAME, Coincidence, unit_ratio
from cagemap.maps.coincident_map import coincident_map, same_surface
from cagemap.maps.hypotheses.confidence import LOOK, SURE
from cagemap.maps.masks import Masks
from cagemap.maps.pair import Pair, point_pairs
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import landmark_errors
from cagemap.maps.result import MatchResult
from cagemap.mesh import Bilinear, Plain
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.parts import extract_faces
from cagemap.pipeline import MatchConfig, choose_level, pair_of, prepare_pair
from cagemap.subdivision import finest_mesh
from cagemap.surface.triangles import triangle_areas
from cagemap.transfer import combine, control_weights

from example_once import example_pair
from plain_meshes import animal, renumbered

MARKS = np.array([3, 50, 120, 200, 260])


@pytest.fixture(scope="module")
def pony() -> ControlMesh:
    return example_pair(8).source


@pytest.fixture(scope="module")
def surface(pony: ControlMesh) -> Surface:
    return prepare_surface(pony, 1)


def marked(target: np.ndarray, source: np.ndarray) -> Landmarks:
    return Landmarks(tuple(f"mark {k}" for k in range(len(target))), target, source)


def is_identity(found: MatchResult) -> bool:
    images = found.point_map.images.positions
    return np.array_equal(images, found.point_map.source.positions)


@pytest.mark.slow
@pytest.mark.parametrize("count", [0, 1, 5])
def test_a_surface_on_itself_is_the_identity_with_and_without_landmarks(surface: Surface, count: int) -> None:
    found = match(surface, surface, marked(MARKS[:count], MARKS[:count]))
    assert is_identity(found)
    assert found.confidence.verdict == SURE
    more = update_match(found, marked(MARKS, MARKS))
    assert is_identity(more)


@pytest.mark.slow
def test_another_shape_other_faces_or_contrary_landmarks_are_matched(pony: ControlMesh, surface: Surface) -> None:
    thicker = prepare_surface(pony.with_positions(pony.positions * [1.05, 1.0, 1.0]), 1)
    faces = np.split(pony.face_indices, pony.face_offsets[1:-1])[::-1]
    others = prepare_surface(ControlMesh.from_faces(pony.positions, [face.tolist() for face in faces]), 1)
    elsewhere = MARKS + np.array([1, 0, 0, 0, 0])
    same = marked(MARKS, MARKS)
    rounded = prepare_surface(pony.with_positions(np.round(pony.positions, 6) + np.array([5.0, 0.0, -2.0])), 1)
    assert same_surface(pair_of(surface, surface, same).landmarks)
    assert same_surface(pair_of(rounded, surface, same).landmarks)
    assert not same_surface(pair_of(thicker, surface, same).landmarks)
    assert not same_surface(pair_of(others, surface, same).landmarks)
    assert not same_surface(pair_of(surface, surface, marked(MARKS, elsewhere)).landmarks)


def test_masks_that_keep_different_parts_are_no_identity(surface: Surface) -> None:
    pair = pair_of(surface, surface, marked(MARKS[:0], MARKS[:0]))
    left = (surface.refinement.finest.positions[:, 0] > 0).astype(float)
    assert same_surface(pair.landmarks, Masks(left, left))
    assert same_surface(pair.landmarks, Masks(left, None))
    assert not same_surface(pair.landmarks, Masks(left, 1.0 - left))


def unprepared(mesh: ControlMesh, vertices: int = 6000) -> Surface:
    """Without a basis, which closest points do not need."""
    return Surface(refine(mesh, choose_level(mesh, vertices)))


def closest(target: Surface, source: Surface) -> sparse.csr_array:
    """Weights of the source's control vertices at the target's, of surfaces that lie on each other."""
    found = Coincidence.find(target, source)
    point_map = PointMap(target.triangles(target.finest_level), found.images(source.triangles(source.finest_level)))
    sides = target.refinement, source.refinement
    return control_weights(point_map, *sides)


@pytest.fixture(scope="module")
def retopology(pony: ControlMesh) -> Surface:
    """The pony under four times as many faces, its vertices on those of the first cage: it is smoothed less."""
    finer = replace(finest_mesh(refine(pony, 1, Bilinear())), name="retopology")
    return prepare_surface(finer, 1)


@pytest.mark.slow
def test_values_between_cages_that_lie_on_each_other_are_those_of_the_same_places(pony, surface, retopology):
    for target, source in ((surface, retopology), (retopology, surface)):
        found = match(target, source)
        assert found.confidence.verdict == SURE
        assert "as it stands, 0.0" in found.confidence.message
        sides = target.refinement, source.refinement
        weights = control_weights(found.point_map, *sides)
        carried = combine(weights, source.control.positions)
        np.testing.assert_allclose(carried, target.control.positions, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("hole", "lies"), [(0.09, True), (0.35, False)])
def test_a_scan_with_a_hole_lies_on_its_retopology(retopology: Surface, hole: float, lies: bool) -> None:
    """The area in front of a small hole does not count. The scan lies on the retopology with any hole."""
    mesh = finest_mesh(retopology.refinement)
    areas = triangle_areas(mesh.positions, cage_triangles(mesh)[0]).reshape(-1, 2).sum(axis=1)
    centres = mesh.positions[mesh.face_indices.reshape(-1, 4)].mean(axis=1)
    order = np.argsort(np.linalg.norm(centres - centres[np.argmax(centres[:, 1])], axis=1))
    kept = np.sort(order[np.searchsorted(np.cumsum(areas[order]), hole * areas.sum()) :])
    scan = prepare_surface(replace(extract_faces(mesh, kept), scheme=Plain()), 0)
    assert scan.finest_triangles.is_open
    assert (Coincidence.find(retopology, scan) is not None) == lies
    assert Coincidence.find(scan, retopology) is not None


@pytest.mark.slow
@pytest.mark.parametrize("factor", [100.0, 1 / 25.4])
def test_a_retopology_in_other_units_lies_on_the_same_places(surface, retopology, factor):
    control = retopology.control
    found = match(prepare_surface(control.with_positions(control.positions / factor), 1), surface)
    assert found.confidence.verdict == SURE
    assert f"as it stands, at {factor:.6g} times its size, 0.0" in found.confidence.message
    expected = match(retopology, surface).point_map.images.positions
    # Points on the mirror plane are snapped to one side of it or the other.
    np.testing.assert_allclose(found.point_map.images.positions, expected, rtol=0, atol=2 * SAME)


MOVED = Rotation.from_euler("xyz", [90, 20, -50], degrees=True)


def moved(mesh: ControlMesh) -> ControlMesh:
    return mesh.with_positions(2.5 * MOVED.apply(np.array(mesh.positions)) + [3.0, -5.0, 1.0])


@pytest.mark.slow
def test_a_copy_that_was_turned_moved_and_scaled_is_the_identity(pony: ControlMesh, surface: Surface) -> None:
    """With other numbers, so that only closest points tell which vertex is which."""
    copy, number = renumbered(pony, 4)
    found = match(prepare_surface(moved(copy), 1), surface)
    assert found.confidence.verdict == SURE
    assert f"turned by {np.degrees(MOVED.magnitude()):.0f} degrees and moved, at 0.4 times" in found.confidence.message
    nearest = found.point_map.nearest_vertices()[: pony.n_vertices]
    np.testing.assert_array_equal(nearest[number], np.arange(pony.n_vertices))
    np.testing.assert_allclose(found.point_map.barycentric[: pony.n_vertices].max(axis=1), 1.0)


def test_a_box_that_was_turned_lies_on_itself_in_several_ways() -> None:
    """Its sides are all alike: which one is which is left to landmarks. One with a peg on a side has one answer."""
    cells = [(x, y, z) for x in range(5) for y in range(3) for z in range(2)]
    for more, lies in (([], False), ([(1, 2, 2)], True)):
        box = voxels(cells + more)
        found = Coincidence.find(unprepared(moved(box), 2000), unprepared(box, 2000))
        assert (found is not None) == lies
        if found is not None:
            np.testing.assert_allclose(found.motion.rotation, MOVED.inv().as_matrix(), atol=1e-9)


@pytest.mark.filterwarnings("error")
def test_flat_surfaces_and_tiny_triangles_have_finite_images() -> None:
    """A sheet has no extent along its normal, and every coordinate in a triangle of 1e-6 is near a side."""
    sheet = ControlMesh.from_faces(
        [[0, 0, 0], [3, 0, 0], [3, 2, 0], [0, 1, 0], [1e-6, 0, 0], [0, 1e-6, 0]],
        [[0, 4, 5], [4, 1, 5], [1, 2, 5], [2, 3, 5]],
    )
    source = unprepared(replace(sheet, scheme=Plain()), 100)
    for target in (sheet, moved(sheet)):
        found = Coincidence.find(unprepared(replace(target, scheme=Plain()), 100), source)
        images = found.images(source.finest_triangles)
        np.testing.assert_allclose(images.barycentric.sum(axis=1), 1.0)
        np.testing.assert_allclose(images.positions, source.finest_triangles.positions, atol=SAME)


@pytest.mark.parametrize(("level", "times"), [(0, 1), (1, 2)])
def test_plain_meshes_are_compared_once(level, times, pony, monkeypatch):
    compared = []
    monkeypatch.setattr(coincidence, "_gap", lambda *given: compared.append(given) or 0.0)
    surface = prepare_surface(pony if level else animal(1), level)
    assert Coincidence.find(surface, surface) is not None
    assert len(compared) == times


@pytest.mark.parametrize(("ratio", "expected"), [(1.3, 1.0), (0.0102, 0.01), (38.0, 1 / 0.0254), (0.3, 0.3048)])
def test_units_are_guessed_from_sizes(ratio: float, expected: float) -> None:
    assert unit_ratio(ratio) == pytest.approx(expected)


@pytest.mark.slow
def test_landmarks_move_closest_points_or_contradict_them(surface: Surface, retopology: Surface) -> None:
    """One is half an edge off, and met exactly; others are on other limbs, and a map is fitted."""
    prepared = prepare_pair(retopology, surface)
    vertex, middle = retopology.control.face_indices[:2]

    def known(targets: np.ndarray, sources: np.ndarray) -> np.ndarray | None:
        landmarks = point_pairs(prepared.target, prepared.source, marked(targets, sources))
        pair = Pair(prepared.target, prepared.source, landmarks)
        found = coincident_map(Problem(prepared, pair.landmarks))
        return None if found is None else landmark_errors(found[0], landmarks)

    off = known(np.array([*MARKS, middle]), np.array([*MARKS, vertex]))
    assert off.max() < 1e-9
    assert (
        np.linalg.norm(retopology.control.positions[middle] - surface.control.positions[vertex]) * surface.scale > 0.01
    )
    assert known(MARKS, np.roll(MARKS, 1)) is None


@pytest.mark.slow
def test_masks_that_keep_different_parts_contradict_closest_points(surface: Surface, retopology: Surface) -> None:
    left, right = (
        side * side_of.refinement.finest.positions[:, 0] > 0 for side, side_of in ((1.0, retopology), (-1.0, surface))
    )
    for source, lies in ((right, False), (~right, True)):
        masks = Masks(left.astype(float), source.astype(float))
        prepared = prepare_pair(retopology, surface, MatchConfig(masks=masks))
        pair = Pair(retopology, surface, point_pairs(retopology, surface, Landmarks.none()))
        assert (coincident_map(Problem(prepared, pair.landmarks)) is not None) == lies


def test_a_target_in_a_larger_unit_does_not_lie_on_the_wall_around_it(pony: ControlMesh) -> None:
    """As a cup in metres inside the floor of one in millimetres: all its faces are near, and say nothing."""
    plate = voxels([(x, y, 0) for x in range(6) for y in range(4)])
    wall = plate.with_positions((plate.positions - [3.0, 2.0, 0.5]) * [1.0, 1.0, 0.1])
    small = pony.with_positions(0.003 * (pony.positions - pony.positions.mean(axis=0)) / np.ptp(pony.positions))
    assert Coincidence.find(unprepared(small, 2000), unprepared(wall, 2000)) is None


def test_a_target_that_closest_points_squeeze_is_not_sure() -> None:
    """A block as thick as the wall that it is in, without its sides: those go to the wall's two sides."""
    plate = voxels([(x, y, 0) for x in range(6) for y in range(4)])
    wall = plate.with_positions(plate.positions * [1.0, 1.0, 0.1])
    block = voxels([(0, 0, 0)])
    block = block.with_positions(0.1 * block.positions + [2.5, 1.5, 0.0])
    target, source = (prepare_surface(replace(mesh, scheme=Bilinear()), 3) for mesh in (block, wall))
    found = coincident_map(Problem.of_landmarks(prepare_pair(target, source), Landmarks.none()))
    assert found is not None
    assert found[1].verdict == LOOK
    assert "the closest points stretch or compress half of the target" in found[1].message


def test_both_sides_of_a_thin_part_stay_apart() -> None:
    """A plate of a thousandth of its width, under two layouts: nearest points alone are as often on the other side."""
    plate = voxels([(x, y, 0) for x in range(6) for y in range(4)])
    plate = replace(plate.with_positions(plate.positions * [1.0, 1.0, 0.01]), scheme=Bilinear())
    other = finest_mesh(refine(plate, 1))
    x, y, z = other.positions.T
    inside = (x > x.min()) & (x < x.max()) & (y > y.min()) & (y < y.max())
    lift = np.random.default_rng(3).uniform(-0.02, 0.02, other.n_vertices)  # up to twice the thickness
    target = unprepared(
        replace(other.with_positions(np.column_stack([x, y, z + inside * lift])), scheme=Bilinear()), 2000
    )
    upper = np.sign(plate.positions[:, 2] - plate.positions[:, 2].mean())
    carried = combine(closest(target, unprepared(plate, 2000)), upper)
    np.testing.assert_allclose(carried[inside], np.sign(z - z.mean())[inside], atol=1e-9)


@cache
def body(file: Path) -> Surface:
    """Read once for all pairs that it is in."""
    return unprepared(read_mesh(file))


HUMANS = "female1605 male1591", "anny10pc anny5pc", "proxy741 base"


@pytest.mark.slow
@pytest.mark.parametrize("pair", HUMANS)
def test_bodies_lie_on_their_own_other_meshes_and_not_on_other_bodies(shared_data: Path, pair: str) -> None:
    mine, theirs = pair.split()
    bodies = ("male_young", "female_old_heavy", "neutral")

    def lies(target: str, source: str) -> bool:
        return (
            Coincidence.find(*(body(shared_data / "humans" / f"{name}.obj") for name in (target, source))) is not None
        )

    assert lies(f"{mine}_male_young", f"{theirs}_male_young")
    assert not any(
        lies(f"{mine}_{one}", f"{theirs}_{other}") for one, other in zip(bodies, np.roll(bodies, 1), strict=True)
    )
    assert not lies(f"{mine}_male_young", f"{theirs}_female_old_heavy")


@pytest.mark.slow
def test_clothes_lie_on_the_body_that_wears_them(shared_data: Path) -> None:
    folder = shared_data / "characters" / "passengers"
    shirt = unprepared(read_mesh(folder / "shirt_neutral.obj"))
    for shape, lies in (("neutral", True), ("male_young", False)):
        wearer = body(shared_data / "humans" / f"base_{shape}.obj")
        assert (Coincidence.find(shirt, wearer) is not None) == lies


@pytest.mark.slow
@pytest.mark.parametrize("posed", ["female1605_male_young_crouch", "proxy741_female_old_heavy_sit"])
def test_weights_of_a_posed_body_under_another_mesh_are_as_good_as_of_its_nearest_faces(shared_data, posed):
    """MakeHuman's rig; by the map that was fitted, weights differed by 0.10. Truth is the nearest point at rest."""
    mesh, rest = posed.split("_", 1)
    target, source = (
        unprepared(read_mesh(shared_data / "humans" / "posed" / f"{name}_{rest}.obj"), 25_000)
        for name in (mesh, "base")
    )
    with np.load(shared_data / "characters" / "rigs" / "weights_body.npz", allow_pickle=True) as rig:
        given = sparse.csr_array((rig["data"], rig["indices"], rig["indptr"]), shape=tuple(rig["shape"])).toarray()
    with np.load(shared_data / "humans" / "ground_truth" / f"base__{mesh}.npz") as truth:
        expected = np.einsum("nk,nkj->nj", truth["b_to_a_bary"], given[truth["b_to_a_verts"]])
    variation = 0.5 * np.abs(closest(target, source) @ given - expected).sum(axis=1)
    assert variation.mean() < 0.02  # measured: 0.010 and 0.010; nearest faces have 0.014 and 0.013
