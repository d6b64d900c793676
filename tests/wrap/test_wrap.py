"""Wrapping: the target's cage in the source's shape, such that the refined surface lies on the source."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube, disk, grid, torus

from cagemap.errors import FormatError, ParameterError
from cagemap.files.images.image import read_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.meshes.obj_write import write_obj_positions
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.mirrors import mirror_symmetries
from cagemap.subdivision import Refinement, refine
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.tasks.wrap_figures import wrap_figures
from cagemap.transfer.rays import intersect_normals
from cagemap.wrap import WrapConfig, level_mesh, missing_detail, wrap, wrapped_transfer
from cagemap.wrap.fit import detached_pieces, fit_net
from cagemap.wrap.net import control_net, counterpart_mask

from command_line import Run
from example_result import identity_result
from transfer_scenes import crossed_cube, same_vertices, surface_of


def nearest_map(target: Refinement, source: Refinement, places: np.ndarray | None = None) -> PointMap:
    """Every finest target vertex to the source's nearest point, from ``places`` in the source's units."""
    given, receiving = surface_of(source), surface_of(target)
    positions = target.finest.positions if places is None else places
    return PointMap(receiving, SurfacePoints.nearest(given, given.scale * positions))


def dented(control: ControlMesh, amount: float, seed: int = 3) -> ControlMesh:
    """The same mesh with a smooth, affine-free deformation."""
    x = control.positions
    wave = np.column_stack([np.sin(1.3 * x[:, 1]), np.sin(1.1 * x[:, 2]), np.sin(1.7 * x[:, 0])])
    return control.with_positions(x + amount * wave)


def subdivided(control: ControlMesh, level: int) -> ControlMesh:
    return level_mesh(refine(control, level), level)


@pytest.fixture
def ring() -> tuple[Refinement, Refinement]:
    """A torus, and a dented one of the same connectivity: the true wrapped cage is the source's own."""
    target = torus(12, 8)
    return refine(target, 3), refine(dented(target, 0.25), 3)


def test_under_the_true_map_the_source_s_own_cage_comes_back(ring: tuple[Refinement, Refinement]) -> None:
    target, source = ring
    wrapped = wrap(target, same_vertices(target, source), WrapConfig(fairness=1e-9))
    np.testing.assert_allclose(wrapped.mesh.positions, source.control.positions, rtol=0, atol=1e-4)
    assert wrapped.distance.max() < 1e-4
    assert wrapped.left_out == 0
    assert len(wrapped.folded) == 0


def test_all_but_positions_is_the_target_s(ring: tuple[Refinement, Refinement]) -> None:
    target, source = ring
    wrapped = wrap(target, same_vertices(target, source))
    assert wrapped.mesh.face_indices is target.control.face_indices
    assert wrapped.mesh.n_vertices == target.control.n_vertices
    np.testing.assert_allclose(target.prolong(wrapped.mesh.positions, 0, 3), wrapped.surface, rtol=0, atol=1e-12)


def test_the_refined_surface_lies_on_the_source_and_closer_than_images_do() -> None:
    # Another connectivity, other scale and place: a cube's sphere-like surface onto a dented, finer one.
    target, source = refine(subdivided(cube(), 1), 3), refine(dented(subdivided(cube(), 2), 0.15), 2)
    point_map = nearest_map(target, source)
    wrapped = wrap(target, point_map)
    images = point_map.images.positions[: target.control.n_vertices]
    _, _, put = closest_points(point_map.source.tree, target.prolong(images, 0, 3))
    assert wrapped.distance.mean() < 0.1 * put.mean()
    assert wrapped.distance.mean() < 1e-3
    finer = wrap(target, point_map, WrapConfig(level=1))
    assert finer.distance.mean() < 0.5 * wrapped.distance.mean()
    assert finer.mesh.n_vertices == target.levels[1].n_vertices


def test_a_similarity_of_the_source_is_one_of_the_wrapped_cage(ring: tuple[Refinement, Refinement]) -> None:
    target, source = ring
    first = wrap(target, same_vertices(target, source)).mesh.positions
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    moved = refine(source.control.with_positions(7 * source.control.positions @ turn.T + (1, 2, 3)), 3)
    second = wrap(target, same_vertices(target, moved)).mesh.positions
    np.testing.assert_allclose(second, 7 * first @ turn.T + (1, 2, 3), rtol=0, atol=1e-5)


def test_weights_hold_a_part_back_and_it_follows_its_surroundings(ring: tuple[Refinement, Refinement]) -> None:
    target, source = ring
    point_map = same_vertices(target, source)
    spoilt = point_map.images.positions.copy()
    follow = np.where(target.control.positions[:, 0] > 1.0, 0.0, 1.0)
    side = target.prolong(follow, 0, 3) == 0
    # The map is nonsense where the weights are zero: all to one point.
    bad = SurfacePoints.nearest(point_map.source, np.where(side[:, None], spoilt[0], spoilt))
    held = wrap(target, PointMap(point_map.target, bad), follow=follow)
    true = wrap(target, point_map).mesh.positions
    size = np.ptp(true, axis=0).max()
    assert np.abs(held.mesh.positions - true).max() < 0.15 * size
    assert 0.1 < held.left_out < 0.5
    # What merely follows its surroundings counts, and so does what of the source nothing of the wrap lies on.
    triangles = point_map.target.triangles
    there = closest_points(
        TriangleSurface(surface_of(source).positions / point_map.source.scale, point_map.source.triangles).tree,
        held.surface,
    )[2]
    back = closest_points(TriangleSurface(held.surface, triangles).tree, source.finest.positions)[2]
    figures = wrap_figures(held)
    for name, found, distance in (
        ("residual", held.distance, there),
        ("residual_from_source", held.source_distance, back),
    ):
        parts = distance * point_map.source.scale
        np.testing.assert_allclose(found, parts, rtol=1e-6, atol=1e-9)
        shown = figures[name]
        np.testing.assert_allclose(
            [shown["mean"], shown["p99"], shown["max"], parts[shown["where"]]],
            [parts.mean(), np.percentile(parts, 99), parts.max(), parts.max()],
            rtol=1e-6, atol=1e-9,
        )  # fmt: skip
    assert figures["residual_with_counterpart"]["mean"] < figures["residual"]["mean"]


@pytest.mark.slow
def test_a_part_without_counterpart_is_found() -> None:
    """A quarter of the torus squeezed into a spot is carried along, not pulled there."""
    target = refine(torus(12, 8), 3)
    x = target.finest.positions
    angle = np.arctan2(x[:, 1], x[:, 0])
    point_map = same_vertices(target, target)
    quarter = (angle > 0) & (angle < np.pi / 2)
    squeezed = np.where(quarter[:, None], x[np.argmin(np.abs(angle))] + 0.01 * (x - x[0]), x) * point_map.source.scale
    wrapped = wrap(target, PointMap(point_map.target, SurfacePoints.nearest(point_map.source, squeezed)))
    assert 0.1 < wrapped.left_out < 0.3
    assert wrapped.distance[wrapped.has_counterpart].mean() < 5e-3


def pitted(lid: bool) -> tuple[PointMap, np.ndarray]:
    """A ball on itself, with a ring around a pole squeezed; and what lies within that ring.

    With a lid the ring is squeezed onto the pole, what is around it takes its place, and what lies within is laid over
    that; else it stays, alone where it is.
    """
    ball = surface_of(refine(subdivided(cube(), 2), 3))
    x = ball.positions / np.linalg.norm(ball.positions, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(x[:, 2]))
    start = 0.0 if lid else 30.0
    images = np.radians(np.interp(angle, [30.0, 45.0, 80.0, 180.0], [start, start + 0.2, 80.0, 180.0]))
    flat = x[:, :2] / np.maximum(np.linalg.norm(x[:, :2], axis=1, keepdims=True), 1e-12)
    within = angle < 30.0
    places = np.column_stack([np.sin(images)[:, None] * flat, np.cos(images)])
    if lid:
        height = 1.0 - (angle / 30.0) ** 2
        places[within] = np.column_stack([0.6 * height, 0.6 * height * x[:, 1], np.ones(len(x))])[within]
    else:
        places[within] = x[within]
    size = np.linalg.norm(ball.positions, axis=1).mean()
    return PointMap(ball, SurfacePoints.nearest(ball, size * places)), within


@pytest.mark.parametrize("lid", [True, False])
def test_what_lies_behind_a_squeezed_part_follows_where_nothing_else_is(lid: bool) -> None:
    """The back of a mouth bag on a face without one, and the palm behind a squeezed wrist."""
    point_map, within = pitted(lid)
    follow = counterpart_mask(point_map)
    if lid:
        assert (follow[within] == 0).all()
    else:
        assert (follow[within] == 1).mean() > 0.8
    assert (follow[point_map.target.positions[:, 2] < 0] == 1).all()


def in_place(side: int, of: int) -> tuple[Refinement, PointMap]:
    """A square of some columns of a larger square grid, and its exact map to its place there."""
    part, whole = grid(side, side), grid(of, of)
    target, source = refine(part, 2), refine(whole, 2)
    return target, nearest_map(target, source)


@pytest.mark.parametrize("side", [2, 3, 5])
def test_a_small_part_has_a_counterpart_everywhere(side: int) -> None:
    """Parts of 1, 2.2 and 6.2 % of the whole, on their own places."""
    target, point_map = in_place(side, 20)
    np.testing.assert_array_equal(counterpart_mask(point_map), 1.0)
    np.testing.assert_array_equal(wrap(target, point_map).follow, 1.0)


def test_what_a_small_part_squeezes_has_no_counterpart() -> None:
    _, point_map = in_place(5, 20)
    places = point_map.images.positions.copy()
    x = places[:, 0] - places[:, 0].min()
    half = x.max() / 2
    places[:, 0] -= np.maximum(x - half, 0.0) * 0.999  # the other half on a line
    mask = counterpart_mask(PointMap(point_map.target, SurfacePoints.nearest(point_map.source, places)))
    assert (mask[x < 0.8 * half] == 1).all()
    assert (mask[x > 1.5 * half] == 0).all()


def ring_and_ball(size: float) -> tuple[ControlMesh, int]:
    """A ball in the hole of a ring, in one mesh, and the ball's first vertex."""
    ring, ball = torus(12, 8), cube()
    n = ring.n_vertices
    faces = [*(ring.face(i) for i in range(ring.n_faces)), *(ball.face(i) + n for i in range(ball.n_faces))]
    return ControlMesh.from_faces(np.concatenate([ring.positions, size * ball.positions]), faces), n


def test_a_piece_that_nothing_pulls_at_goes_with_what_is_around_it() -> None:
    """The source is bent, scaled, turned and elsewhere; the map of the ball is nonsense and its weights are 0."""
    control, n = ring_and_ball(0.3)
    moved = 3.0 * dented(control, 0.02).positions @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + 5.0
    target, source = refine(control, 2), refine(control.with_positions(moved), 2)
    follow = (np.arange(control.n_vertices) < n).astype(float)
    point_map = same_vertices(target, source)
    nowhere = np.where(target.prolong(follow, 0, 2)[:, None] > 0, point_map.images.positions, 0.0)
    point_map = PointMap(point_map.target, SurfacePoints.nearest(point_map.source, nowhere))
    wrapped = wrap(target, point_map, follow=follow).mesh.positions
    assert np.abs(wrapped[n:] - moved[n:]).max() < 0.05 * np.ptp(moved, axis=0).max()
    with pytest.raises(ParameterError, match="got 0 everywhere"):
        wrap(target, point_map, follow=0 * follow)


def test_boundaries_lie_on_boundaries() -> None:
    target = refine(disk(6), 3)
    source = refine(dented(disk(6), 0.2), 3)
    wrapped = wrap(target, same_vertices(target, source))
    edges = surface_of(target)
    triangle, opposite = np.nonzero(edges.neighbors < 0)
    rim = np.unique(edges.triangles[triangle, (opposite + 1) % 3])
    off = np.linalg.norm(wrapped.surface[rim] - source.finest.positions[rim], axis=1)
    assert off.max() < 2e-3 * np.ptp(source.finest.positions, axis=0).max()


def test_symmetric_stays_symmetric() -> None:
    target = refine(torus(12, 8), 2)
    symmetry = mirror_symmetries(target.control)[0].image
    source = refine(dented(torus(12, 8), 0.2), 2)
    wrapped = wrap(target, same_vertices(target, source), symmetry=symmetry)
    x = wrapped.mesh.positions
    # Distances to mirror images: a mirror symmetric shape has equal ones on both sides.
    some = np.array([0, 5, 17, 30])
    between = np.linalg.norm(x[:, None] - x[some], axis=2)
    mirrored = np.linalg.norm(x[symmetry][:, None] - x[symmetry[some]], axis=2)
    np.testing.assert_allclose(between, mirrored, rtol=0, atol=1e-9)


def test_wrapped_surface_and_what_is_missing_are_the_source() -> None:
    target, source = refine(subdivided(cube(), 1), 3), refine(dented(subdivided(cube(), 2), 0.15), 2)
    wrapped = wrap(target, nearest_map(target, source))
    transfer, detail, fine = missing_detail(wrapped, target, source)
    ground = surface_of(refine(source.control, 4))
    np.testing.assert_allclose(fine.finest.positions, ground.positions / ground.scale, rtol=0, atol=1e-12)
    own = transfer.point_map.source
    _, _, before = closest_points(detail.surface.tree, own.positions)
    hits = intersect_normals(detail.surface, own.positions, own.vertex_normals)
    _, _, after = closest_points(ground.tree, ground.scale / own.scale * hits.foot.positions)
    assert after.max() < 1e-12
    assert before.mean() > 1e-5
    # Nearly everywhere the normal meets the source, so that heights alone lead there as well.
    off = np.linalg.norm(own.positions + hits.heights[:, None] * own.vertex_normals - hits.foot.positions, axis=1)
    assert np.mean(off < 1e-6) > 0.999


def test_hole_faces_of_a_wrapped_cage_get_no_texels() -> None:
    cage = replace(crossed_cube(), hole_faces=np.array([2]))
    target = refine(cage, 2)
    transfer, _ = wrapped_transfer(wrap(target, same_vertices(target, target)), target)
    assert transfer.target.holes is not None
    faces = transfer.target.face_parents[transfer.target.triangle_faces]
    np.testing.assert_array_equal(transfer.target.holes, faces == 2)


def test_what_does_not_fit_is_refused(ring: tuple[Refinement, Refinement]) -> None:
    target, source = ring
    point_map = same_vertices(target, source)
    with pytest.raises(ParameterError, match="level below"):
        wrap(target, point_map, WrapConfig(level=3))
    with pytest.raises(ParameterError, match="other levels"):
        wrap(refine(target.control, 2), point_map)
    with pytest.raises(ParameterError, match="one a control vertex"):
        wrap(target, point_map, follow=np.ones(5))
    with pytest.raises(ParameterError, match="0 to 1"):
        wrap(target, point_map, follow=np.full(target.control.n_vertices, 2.0))
    with pytest.raises(ParameterError, match="fairness"):
        WrapConfig(fairness=0)
    graph = control_net(target, 0, 1.0).graph
    with pytest.raises(ParameterError, match=r"weights: .*a part of the target that follows the source.* above 0"):
        detached_pieces(graph, np.arange(graph.n))


def test_an_obj_keeps_all_but_positions(tmp_path: Path) -> None:
    text = (
        "# by hand\nmtllib a.mtl\no thing\nv 0 0 0 0.1 0.2 0.3\nv 1 0 \\\n 0\nv 1 1 0\nv 0 1 0\n"
        "vt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\ng left\nusemtl red\ns 1\nf 1/1/1 2/2/1 3/3/1\nf 1/1/1 3//1 4//1 # last\n"
    ).replace("3//1 4//1", "3/3/1 4/2/1")
    (tmp_path / "a.obj").write_text(text)
    mesh = read_mesh(tmp_path / "a.obj")
    moved = mesh.with_positions(mesh.positions + np.array([0, 0, 1.5]))
    write_obj_positions(tmp_path / "b.obj", tmp_path / "a.obj", moved)
    lines = (tmp_path / "b.obj").read_text().splitlines()[1:]
    assert lines == [
        "# by hand", "mtllib a.mtl", "o thing", "v 0.0 0.0 1.5 0.1 0.2 0.3", "v 1.0 0.0 1.5", "v 1.0 1.0 1.5",
        "v 0.0 1.0 1.5", "vt 0 0", "vt 1 0", "vt 1 1", "g left", "usemtl red", "s 1", "f 1/1 2/2 3/3",
        "f 1/1 3/3 4/2 # last",
    ]  # fmt: skip
    with pytest.raises(FormatError, match="Match again"):
        write_obj_positions(
            tmp_path / "c.obj", tmp_path / "a.obj", replace(moved, face_indices=mesh.face_indices[::-1])
        )


def test_the_command_writes_cage_and_displacement(run: Run, result_folder: Path) -> None:
    place = result_folder.parent
    outcome = run.done("wrap R -o new.obj --vector-displacement v.exr --displacement d.exr --size 32")
    assert "of the wrap to the source: mean 0.00" in outcome.out
    assert "of the source to the wrap: mean 0.00" in outcome.out
    (entry,) = (
        one for one in json.loads((place / "R" / "manifest.json").read_text())["transfers"] if one["kind"] == "wrap"
    )
    assert entry["residual"]["max"] < 1e-4
    assert entry["residual_from_source"]["max"] < 1e-4
    result = identity_result()
    # The target is the source twice as large, vertex by vertex: its cage in the source's shape is the source's.
    np.testing.assert_allclose(read_mesh(place / "new.obj").positions, result.source.control.positions, atol=1e-4)
    assert np.abs(read_image(place / "v.exr").pixels).max() < 1e-3
    assert read_image(place / "d.exr").pixels.shape == (32, 32, 1)
    run.done("wrap R -o half.obj --amount 0.5")
    np.testing.assert_allclose(
        read_mesh(place / "half.obj").positions, 1.5 * result.source.control.positions, atol=1e-4
    )
    run.done("wrap R --blend-shapes -o shapes")
    np.testing.assert_allclose(read_mesh(place / "shapes/large.obj").positions, result.target.control.positions)
    assert (place / "shapes/small.obj").is_file()


def test_a_fit_that_went_astray_is_tried_with_more_pull_of_the_map(
    ring: tuple[Refinement, Refinement], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The closer one counts: never a worse one than without the second try."""
    target, source = ring
    point_map = same_vertices(target, source)
    tried: list[float] = []

    def seen(*given: object) -> np.ndarray:
        config = given[2]
        assert isinstance(config, WrapConfig)
        tried.append(config.anchor)
        return fit_net(*given)  # type: ignore[arg-type]

    monkeypatch.setattr("cagemap.wrap.wrapping.fit_net", seen)
    once = wrap(target, point_map, WrapConfig(anchor=0.02))
    twice = wrap(target, point_map, WrapConfig(anchor=0.02, max_distance=0.0))
    np.testing.assert_allclose(tried, [0.02, 0.02, 0.06])
    assert twice.distance.mean() <= once.distance.mean()


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["npy", "npz"])  # vertices, and points of triangles
def test_anyone_s_map_wraps_without_a_match(run: Run, result_folder: Path, suffix: str) -> None:
    """Our own map, written out and given back as a file; no level is named, and the match's is not the default one."""
    place = result_folder.parent
    result = identity_result()
    for side, name in ((result.target, "t.obj"), (result.source, "s.obj")):
        write_mesh(place / name, side.control)
    assert not run("transfer R --write-map -o", f"map.{suffix}").code
    pair = ("--target", "t.obj", "--source", "s.obj", "--map", f"map.{suffix}")
    run.done("wrap", *pair, "-o", "new.obj")
    places = read_mesh(place / "new.obj").positions
    np.testing.assert_allclose(places, result.source.control.positions, atol=2e-2 * np.ptp(places))
    run.refused("wrap", *pair, "-o", "other.obj", "--scheme", "loop", says="--map")
    assert not (place / "other.obj").exists()


@pytest.mark.slow
def test_the_report_shows_the_wrapped_cage_while_it_is_there(
    run: Run,
    result_folder: Path,
) -> None:
    pytest.importorskip("embreex")
    assert not run("wrap R -o new.obj").code
    assert not run("report R -o page.html").code
    page = result_folder.parent / "page.html"
    assert "wrapped cage, not smoothed" in page.read_text()
    (result_folder.parent / "new.obj").unlink()
    assert not run("report R -o page.html").code
    assert "wrapped cage" not in page.read_text()
