"""Coarse levels below plain meshes, and maps between plain meshes as they are."""

from dataclasses import replace
from pathlib import Path

import fast_simplification
import numpy as np
import pytest
from examples.shapes import creature, cube, torus
from scipy.spatial import Delaunay

from cagemap.deform.config import ElasticConfig
from cagemap.deform.placement import Placement
from cagemap.errors import InvalidMeshError, ParameterError
from cagemap.files.result.folder import read_result, write_result
from cagemap.maps.hypotheses.confidence import Confidence, prolong_answers
from cagemap.maps.masks import Masks
from cagemap.maps.pair import near_vertices
from cagemap.mesh import ControlMesh, Plain
from cagemap.mesh.checks import require_valid
from cagemap.numerics.arrays import read_only
from cagemap.numerics.threads import in_threads
from cagemap.operators import build_operators
from cagemap.operators.coarse_levels import build_coarse_levels, flip_to_delaunay, prolongation, simplify_mesh
from cagemap.pipeline import MatchConfig, choose_level, match, prepare_pair, prepare_surface, update_match
from cagemap.spectral import Surface
from cagemap.subdivision import Refinement, finest_mesh, refine
from cagemap.surface.triangle_surface import SurfacePoints
from cagemap.surface.triangles import triangle_normals, triangles
from cagemap.transfer.matched import transfer_of

from cotangents import triangle_cotangents
from plain_meshes import animal, far_apart, marks_at
from refusals import refuses


@pytest.fixture(scope="module")
def scan() -> Surface:
    """A plain mesh of two coarse levels."""
    return prepare_surface(animal(3), 0)


@pytest.fixture(scope="module")
def levels() -> Refinement:
    """The same with its coarse levels, as they are made."""
    return build_coarse_levels(refine(animal(3), 0))


def test_levels_below_a_plain_mesh_are_nested(levels: Refinement) -> None:
    mesh, found = animal(3), levels
    assert found.is_plain
    assert found.finest_level >= 1
    assert [level.n_vertices for level in found.levels] == sorted(level.n_vertices for level in found.levels)
    alone, again = refine(mesh, 0), found.without_coarse_levels()
    assert again.finest_level == 0
    assert again.coarse_vertices is None
    for name in ("positions", "faces", "face_parents"):
        assert np.array_equal(getattr(again.finest, name), getattr(alone.finest, name))
        assert np.array_equal(getattr(found.finest, name), getattr(alone.finest, name))
    size = np.ptp(mesh.positions, axis=0).max()
    for level, (coarse, fine, matrix) in enumerate(zip(found.levels, found.levels[1:], found.matrices, strict=False)):
        assert np.array_equal(fine.positions[found.vertices_on(level + 1, level)], coarse.positions)
        assert np.array_equal(mesh.positions[found.on_finest(level)], coarse.positions)
        assert np.allclose(matrix.sum(axis=1), 1.0)
        assert matrix.data.min() >= 0.0
        # Coarse levels lie near the mesh: within a fifth of their edges' length, on average.
        miss = np.linalg.norm(matrix @ coarse.positions - fine.positions, axis=1)
        assert miss.mean() < 0.2 * size / np.sqrt(coarse.n_vertices)


def test_vertices_of_levels_are_found_among_the_finest(levels: Refinement) -> None:
    plain, cage = levels, refine(creature(), 2)
    assert plain.finest_level == 2
    for refinement in (plain, cage):
        for level, mesh in enumerate(refinement.levels):
            own = np.arange(mesh.n_vertices)
            on_finest = refinement.on_finest(level)
            np.testing.assert_array_equal(refinement.on_level(level, on_finest), own)
            others = np.setdiff1d(np.arange(refinement.finest.n_vertices), on_finest)
            assert (refinement.on_level(level, np.append(others, -1)) == -1).all()
            for finer in range(level, refinement.finest_level + 1):
                through = refinement.on_finest(finer)[refinement.vertices_on(finer, level)]
                np.testing.assert_array_equal(through, on_finest)
        below = refinement.up_to(1)
        np.testing.assert_array_equal(below.on_finest(0), np.arange(refinement.levels[0].n_vertices))


@pytest.mark.slow
def test_two_meshes_are_simplified_in_threads_as_alone() -> None:
    finest = [finest_mesh(refine(mesh, 3)) for mesh in (creature(), torus())]
    meshes = [refine(replace(mesh, scheme=Plain()), 0) for mesh in finest]
    alone = [build_coarse_levels(mesh) for mesh in meshes]
    for _ in range(3):
        for once, again in zip(alone, in_threads(build_coarse_levels, meshes), strict=True):
            for one, other in zip(once.levels, again.levels, strict=True):
                np.testing.assert_array_equal(one.positions, other.positions)
                np.testing.assert_array_equal(one.faces, other.faces)


def test_a_coarse_vertex_without_triangles_is_none(monkeypatch) -> None:
    """Vertices that collapses leave alone go to the coarse vertex of their neighbours, not to triangle 0."""
    finest = refine(creature(), 2).finest
    positions, faces = finest.positions, triangles(finest.faces)
    replay = fast_simplification.replay_simplification
    far = int(np.argmax(np.linalg.norm(positions - positions[faces[0]].mean(axis=0), axis=1)))

    def left_alone(*given):
        places, coarse, cluster = replay(*given)
        cluster[far] = len(places)
        return np.vstack([places, given[0][far]]), coarse, cluster

    monkeypatch.setattr(fast_simplification, "replay_simplification", left_alone)
    step = simplify_mesh(positions, faces, 600)
    np.testing.assert_array_equal(np.unique(step.triangles), np.arange(len(step.kept)))
    places = prolongation(positions, faces, step) @ positions[step.kept]
    # Smoothing moves the tip of a limb by less than the length of a coarse edge.
    assert np.linalg.norm(places[far] - positions[far]) < np.ptp(positions, axis=0).max() / np.sqrt(600)


def test_coarse_levels_know_the_mesh_s_low_frequencies(levels: Refinement) -> None:
    """Rayleigh quotients of coordinates, which vary slowly: prolonging them from a coarse level adds little energy."""
    found = levels
    operators = build_operators(found)
    stiffness, mass, places = operators.stiffness, operators.mass, found.finest.positions.T
    exact = [x @ stiffness[-1] @ x / (x @ mass[-1] @ x) for x in places]
    for level, mesh in enumerate(found.levels[:-1]):
        coarse = [x @ stiffness[level] @ x / (x @ mass[level] @ x) for x in mesh.positions.T]
        # 17 % on this creature of thin legs; without the smoothing step of the prolongation 100 %.
        assert coarse == pytest.approx(exact, rel=0.25)


def test_only_level_0_of_a_plain_mesh_exists() -> None:
    mesh = animal(1)
    assert choose_level(mesh, 100_000) == 0
    for wrong in (lambda: prepare_surface(mesh, 1), lambda: refine(mesh, 1)):
        refuses(ParameterError, "plain mesh", wrong)
    mixed = ControlMesh.from_faces(cube().positions, [[0, 1, 2], *(cube().face(i) for i in range(1, 6))])
    refuses(InvalidMeshError, "different sizes", build_coarse_levels, refine(replace(mixed, scheme=Plain()), 0))


@pytest.mark.slow
def test_a_plain_result_that_is_read_has_no_coarse_levels_until_a_match_asks(tmp_path: Path) -> None:
    surface = prepare_surface(animal(2), 0)
    marks = far_apart(creature().positions, 6)
    landmarks = marks_at(marks)
    write_result(tmp_path / "RESULT", match(surface, surface, landmarks))
    result = read_result(tmp_path / "RESULT")
    np.testing.assert_allclose(result.image(), surface.vertices, atol=1e-9)
    assert transfer_of(result).point_map is result.point_map
    assert result.manifest["quality"]
    assert str(result.target)
    for side in (result.target, result.source):
        assert "hierarchy" not in vars(side)
    again = update_match(result, landmarks)
    assert again.target is result.target
    assert vars(again.target)["hierarchy"].finest_level == 1


@pytest.mark.slow
def test_a_prepared_plain_pair_has_masks_of_its_levels(scan: Surface) -> None:
    surface, mesh, cage = scan, scan.control, prepare_surface(creature(), 2)
    masks = Masks(np.linspace(0, 1, mesh.n_vertices), np.linspace(1, 0, len(cage.vertices)))
    pair = prepare_pair(surface, cage, MatchConfig(masks=masks))
    assert pair.mesh.n < mesh.n_vertices
    level = surface.hierarchy.levels[pair.levels[0]]
    np.testing.assert_allclose(pair.mesh.positions, surface.scale * level.positions, atol=1e-12)
    np.testing.assert_array_equal(pair.level_masks.target, masks.target[pair.vertices])
    back = prepare_pair(cage, surface, MatchConfig(masks=masks.reversed(), elastic=ElasticConfig(source_vertices=3000)))
    for one in (back, pair.reverse_pair.reverse_pair, back.reverse_pair):
        assert one.masks.any
    np.testing.assert_array_equal(back.level_masks.source, masks.target[pair.vertices])
    np.testing.assert_array_equal(back.reverse_pair.level_masks.target, masks.target[pair.vertices])


def test_landmarks_of_a_plain_mesh_are_found_on_coarse_levels_by_place(scan: Surface) -> None:
    surface = scan
    levels, finest = surface.hierarchy, surface.finest_triangles
    for vertices in (levels.on_finest(0)[:5], np.arange(0, 900, 100)):
        points = SurfacePoints.from_vertices(finest, vertices)
        for level in range(levels.finest_level + 1):
            near = near_vertices(points, surface, level)
            assert len(np.unique(near)) == len(vertices)
            places = surface.triangles(level).positions[near]
            apart = np.linalg.norm(places - points.positions, axis=1)
            assert (apart[levels.on_level(0, vertices) >= 0] == 0).all()
            assert apart.max() < 0.15  # of sqrt(area)


def test_answers_for_a_plain_mesh_are_in_its_own_numbers(scan: Surface) -> None:
    surface, mesh = scan, scan.control
    prepared = prepare_pair(surface, surface)
    known = Placement(prepared.mesh.positions, 1e-4, name="as the files stand")
    assert len(known.positions) < mesh.n_vertices
    prolonged = prolong_answers(Confidence("sure", (known,), deciding=3), prepared)
    assert prolonged.file_vertex == mesh.file_vertex(3)
    told = prolonged.answers[0]
    apart = np.linalg.norm(told.positions - surface.scale * mesh.positions, axis=1)
    assert apart.mean() < 0.01  # rounded by smooth prolongation; of sqrt(area)
    np.testing.assert_array_equal(told.positions[prepared.vertices], known.positions)
    whole = replace(prepared, levels=(surface.finest_level, prepared.levels[1]))
    known = replace(known, positions=read_only(surface.finest_triangles.positions))
    told = prolong_answers(Confidence("sure", (known,)), whole).answers[0]
    np.testing.assert_allclose(told.positions, surface.scale * mesh.positions, atol=1e-12)


def test_flips_make_better_triangles_between_the_same_vertices() -> None:
    """On a plane they end at Delaunay's triangulation; on a surface they keep its border, its area and its faces."""
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(size=(60, 2)), np.zeros(60)])
    wanted = Delaunay(points[:, :2]).simplices.astype(np.int64)
    turned = (
        np.cross(points[wanted[:, 1]] - points[wanted[:, 0]], points[wanted[:, 2]] - points[wanted[:, 0]])[:, 2] < 0
    )
    wanted[turned] = wanted[turned, ::-1]
    # Other heights shear the triangulation: that of the sheared points is not Delaunay's of the points.
    sheared = Delaunay(points[:, :2] @ [[1.0, 0.0], [0.9, 0.4]]).simplices.astype(np.int64)
    hull = {tuple(sorted(edge)) for edge in Delaunay(points[:, :2]).convex_hull.tolist()}
    assert {tuple(sorted(edge)) for edge in Delaunay(points[:, :2] @ [[1, 0], [0.9, 0.4]]).convex_hull.tolist()} == hull
    for faces in (wanted, sheared):
        inwards = triangle_normals(points, faces)[:, 2] < 0
        faces[inwards] = faces[inwards, ::-1]
    found = flip_to_delaunay(points, sheared)
    assert {tuple(sorted(face)) for face in found.tolist()} == {tuple(sorted(face)) for face in wanted.tolist()}
    assert not np.array_equal(np.sort(sheared, axis=1), np.sort(found, axis=1))
    mesh = animal(2)
    faces = mesh.face_indices.reshape(-1, 3)
    better = flip_to_delaunay(mesh.positions, faces)
    require_valid(replace(mesh, face_indices=better.ravel()))
    smallest = [np.percentile(_angles(mesh.positions, one).min(axis=1), 5) for one in (faces, better)]
    assert smallest[1] >= smallest[0]


def _angles(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    return np.arctan2(1.0, triangle_cotangents(positions, faces))
