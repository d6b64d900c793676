"""Passengers: unchanged under the identity, moved as a rigid body is, outside where they were, near the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, cube, icosahedron, torus, triangulated
from scipy.spatial.transform import Rotation

from cagemap.character.body_frames import BodyFrames, FrameConfig
from cagemap.character.contact import Contact
from cagemap.character.passengers import (
    _strain,
    _torn_meshes,
    carry_passenger,
    carry_passengers,
    hidden_passenger,
    unit_factor,
)
from cagemap.errors import ParameterError
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import write_result
from cagemap.files.result.manifest import stated_inputs
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles, face_centres
from cagemap.mesh.parts import extract_faces, join_meshes
from cagemap.subdivision import refine
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import vertex_normals

from command_line import Run
from example_result import identity_result
from refusals import refuses

KINDS = (None, "cloth", "rigid", "similarity")


def surface(positions: np.ndarray, triangles: np.ndarray) -> TriangleSurface:
    return TriangleSurface.from_faces(positions, triangles)


@pytest.fixture(scope="module")
def body() -> ControlMesh:
    level = refine(torus(12, 8), 2).finest
    return ControlMesh.from_faces(level.positions, level.faces, name="body")


@pytest.fixture(scope="module")
def ball() -> ControlMesh:
    level = refine(icosahedron(), 2).finest
    centred = level.positions - level.positions.mean(axis=0)
    return ControlMesh.from_faces(0.1 * centred / np.linalg.norm(centred, axis=1).max(), level.faces, name="ball")


def dressed(body: ControlMesh, height: float = 0.1) -> ControlMesh:
    """All faces of one half of the body, moved out along the normals."""
    split = cage_triangles(body)[0]
    out = body.positions + height * vertex_normals(body.positions, split)
    faces = body.face_indices.reshape(-1, 4)
    kept = faces[(body.positions[faces][:, :, 0] > 0).all(axis=1)]
    used, own = np.unique(kept, return_inverse=True)
    return ControlMesh.from_faces(out[used], own.reshape(-1, 4), name="cloth")


def moved(mesh: ControlMesh, shift: tuple[float, float, float]) -> ControlMesh:
    return mesh.with_positions(mesh.positions + shift)


def signed(body: TriangleSurface, places: np.ndarray) -> np.ndarray:
    """(n,) distances of places in the file's unit from a body, negative inside, of sqrt(area)."""
    triangle, inside, distance = closest_points(body.tree, places * body.scale)
    corners = body.triangles[triangle]
    feet, normals = (np.einsum("nc,ncd->nd", inside, of[corners]) for of in (body.positions, body.vertex_normals))
    return np.copysign(distance, np.einsum("nd,nd->n", places * body.scale - feet, normals))


def all_of(body: ControlMesh, ball: ControlMesh) -> list[ControlMesh]:
    """Cloth, a ball on the body, a strip of two vertices wide, a box far away."""
    strip = ControlMesh.from_faces(
        [[2, 0.9, 0], [2.3, 0.9, 0], [2.3, 1.5, 0], [2, 1.5, 0]], [[0, 1, 2, 3]], name="strip"
    )
    return [
        dressed(body),
        replace(moved(ball, (2.03, 0.85, 0.07)), name="ball"),
        strip,
        replace(moved(cube(), (9, 9, 9)), name="prop"),
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_a_moved_and_scaled_body_moves_its_passengers_along(body, ball, kind):
    turn, triangles = Rotation.from_euler("xyz", [0.4, 1.1, -2.0]).as_matrix(), cage_triangles(body)[0]
    target = surface(0.1 * body.positions @ turn + [5.0, -2.0, 1.0], triangles)
    point_map = PointMap.from_vertices(target, surface(body.positions, triangles), np.arange(target.n))
    for mesh in all_of(body, ball):
        carried = carry_passenger(point_map, mesh, kind=kind)
        np.testing.assert_allclose(carried.positions, 0.1 * mesh.positions @ turn + [5.0, -2.0, 1.0], rtol=0, atol=1e-8)
        offsets = np.random.default_rng(0).standard_normal(mesh.positions.shape)
        np.testing.assert_allclose(carried.carry_offsets(offsets), 0.1 * offsets @ turn, rtol=0, atol=1e-8)


def swollen(body: ControlMesh) -> PointMap:
    """Onto a body that is thicker on one side, bent and stretched."""
    x, y, z = body.positions.T
    bulge = 1.0 + 0.5 * np.exp(-((x - 2) ** 2) - z**2)
    grown = np.column_stack([x * 1.3, y * bulge * 1.5 + 0.2 * x**2, z])
    triangles = cage_triangles(body)[0]
    target = surface(grown, triangles)
    return PointMap.from_vertices(target, surface(body.positions, triangles), np.arange(target.n))


def test_clothes_of_a_coarse_body_stretch_as_the_body_does() -> None:
    """154 vertices that change their width several times: the samples around a shoe reached up to the hips."""
    cage = triangulated(creature())
    finest = refine(cage, 3).finest
    low, size = finest.positions[:, 1].min(), float(np.ptp(finest.positions[:, 1]))

    def widened(places: np.ndarray) -> np.ndarray:
        factor = 1.0 + 0.5 * np.sin(9.0 * (places[:, 1:2] - low) / size)
        return places * np.hstack([factor, np.ones_like(factor), factor])

    source, vertices = surface(finest.positions, finest.faces), finest.positions[: cage.n_vertices]
    target = surface(widened(vertices), cage.face_indices.reshape(-1, 3))
    point_map = PointMap(target, SurfacePoints.nearest(source, source.scale * vertices))
    skin = ControlMesh.from_faces(finest.positions + 0.05 * source.vertex_normals, finest.faces, name="cloth")
    heights = face_centres(skin)[:, 1]
    cloth = extract_faces(skin, np.flatnonzero(heights < np.quantile(heights, 0.3)))
    made, triangles = carry_passenger(point_map, cloth).positions, cage_triangles(cloth)[0]
    true, found = (_strain(cloth.positions, places, triangles) for places in (widened(cloth.positions), made))
    assert found < 1.2 * true


def test_a_rigid_passenger_inside_a_body_that_is_larger_there_is_named(body: ControlMesh) -> None:
    cloth, triangles = dressed(body, 0.05), cage_triangles(body)[0]
    half = 0.2 * np.clip(2.0 * body.positions[:, :1], 0.0, 1.0)
    larger = body.positions + half * vertex_normals(body.positions, triangles)
    source = surface(body.positions, triangles)
    point_map = PointMap(surface(larger, triangles), SurfacePoints.from_vertices(source, np.arange(source.n)))
    (note,) = hidden_passenger(point_map, cloth, carry_passenger(point_map, cloth, kind="rigid").positions)
    assert note.startswith("cloth: ")
    assert "% of it is inside the body; if it is not kept rigid, it stays outside" in note
    assert hidden_passenger(point_map, cloth, carry_passenger(point_map, cloth).positions) == []


def test_what_was_outside_stays_outside(body: ControlMesh) -> None:
    point_map = swollen(body)
    for height in (0.01, 0.1):
        mesh = dressed(body, height)
        before = signed(point_map.source, mesh.positions)
        after = signed(point_map.target, carry_passenger(point_map, mesh).positions)
        assert before.min() > 0
        assert after.min() > 0
        assert np.median(after / before) == pytest.approx(1.0, abs=0.2)


def test_what_was_outside_stays_outside_where_the_body_nearly_touches_itself(body: ControlMesh) -> None:
    """The hole of the torus becomes a slit that is narrower than the cloth's heights, as between thighs."""
    closed, triangles = body.positions.copy(), cage_triangles(body)[0]
    hole, end = np.hypot(closed[:, 0], closed[:, 1]).min(), closed[:, 0].max()
    closed[:, 0] = np.interp(closed[:, 0], [-end, -hole, hole, end], [-end, -0.05, 0.05, end])
    target = surface(closed, triangles)
    point_map = PointMap.from_vertices(target, surface(body.positions, triangles), np.arange(target.n))
    cloth = body.with_positions(body.positions + 0.1 * vertex_normals(body.positions, triangles))
    assert signed(target, carry_passenger(point_map, cloth).positions).min() > 0


def test_the_body_beside_a_card_does_not_push_it() -> None:
    """A brow is above an eye's socket on the source, but not over it; the target has no socket."""
    along, across = np.meshgrid(np.linspace(0.0, 1.0, 41), np.linspace(0.0, 1.0, 41), indexing="ij")
    flat = np.column_stack([along.ravel(), across.ravel(), np.zeros(along.size)])
    socket = flat - np.where(flat[:, :1] > 0.5, [[0.0, 0.0, 0.02]], 0.0)
    start = np.add.outer(41 * np.arange(40), np.arange(40)).ravel()
    triangles = np.concatenate([start[:, None] + [0, 41, 42], start[:, None] + [0, 42, 1]])
    target, source = TriangleSurface(flat, triangles), TriangleSurface(socket, triangles)
    frames = BodyFrames(PointMap.from_vertices(target, source, np.arange(target.n)))
    card = np.array([[0.3, 0.3, 0.01], [0.5, 0.3, 0.01], [0.5, 0.7, 0.01], [0.3, 0.7, 0.01]])
    above = np.tile([0.0, 0.0, 1.0], (4, 1))
    contact = Contact.find(frames, card, [np.array([[0, 1, 2], [0, 2, 3]])], above, np.tile(np.eye(3), (4, 1, 1)))
    low, high = (card[k, :2] for k in (0, 2))
    is_below = ((flat[:, :2] >= low) & (flat[:, :2] <= high)).all(axis=1)
    assert len(contact.body_vertices) > 50
    assert is_below[contact.body_vertices].all()


def test_frames_do_not_stretch_where_the_map_collapses(body: ControlMesh) -> None:
    """A character's feet may be pieces of their own: the feet of the target are then on the edge of its legs."""
    stub, triangles = body.positions.copy(), cage_triangles(body)[0]
    stub[:, 0] = np.where(stub[:, 0] > 0.5, 0.5 + 0.01 * (stub[:, 0] - 0.5), stub[:, 0])
    target = surface(body.positions, triangles)
    point_map = PointMap.from_vertices(target, surface(stub, triangles), np.arange(target.n))
    matrices = BodyFrames(point_map, FrameConfig(smoothing_rounds=0)).matrices
    stretches = np.linalg.svd(matrices, compute_uv=False)
    # Elsewhere the map keeps lengths; where it collapses, it is as elsewhere.
    assert np.median(stretches) == pytest.approx(1.0, rel=0.2)
    assert 0.5 < stretches[:, 0].min()
    assert stretches[:, 0].max() <= 1.1 * FrameConfig().max_stretch


def test_a_small_part_keeps_its_shape_where_the_map_would_tear_it(body: ControlMesh) -> None:
    """Teeth in an open mouth, on a body whose mouth is closed."""
    triangles, centre = cage_triangles(body)[0], body.positions[0]
    around = np.linalg.norm(body.positions - centre, axis=1) < 0.15
    noise = np.random.default_rng(0).uniform(-1.0, 1.0, body.positions.shape)
    source = surface(body.positions, triangles)
    target = surface(body.positions + around[:, None] * noise, triangles)
    point_map = PointMap.from_vertices(target, source, np.arange(target.n))
    along, across = np.meshgrid(np.linspace(-0.2, 0.2, 9), np.linspace(-0.03, 0.03, 3))  # a strip: no rigid piece
    row = np.arange(8)[:, None] + [0, 1, 10, 9]
    strip = ControlMesh.from_faces(
        centre + np.column_stack([along.ravel(), across.ravel(), 0.02 + 0 * along.ravel()]),
        np.concatenate([row, row + 9]),
    )
    carried, corners = carry_passenger(point_map, strip), strip.face_indices.reshape(-1, 4)
    lengths = [np.linalg.norm(np.diff(of[corners], axis=1), axis=2) for of in (strip.positions, carried.positions)]
    ratio = lengths[1].sum() / lengths[0].sum()
    np.testing.assert_allclose(lengths[1], ratio * lengths[0], rtol=1e-6)
    assert ratio == pytest.approx(1.0, abs=0.3)
    offsets = np.linalg.norm(carried.carry_offsets(strip.positions), axis=1)
    np.testing.assert_allclose(offsets, ratio * np.linalg.norm(strip.positions, axis=1), rtol=1e-6)


def test_lashes_keep_their_shape_where_the_eyes_are_torn() -> None:
    """Lashes alone may look whole where the map takes them off the eyes."""
    ring = np.array([[0, 1, 2], [2, 3, 0]])
    eyes, lashes, brows = (size * np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]) for size in (3, 3.2, 5))
    points = 0.01 * np.concatenate([eyes, lashes, brows])
    places = points + 1.0
    places[0, 0] += 0.3
    triangles, parts = [ring, ring + 4, ring + 8], [slice(0, 4), slice(4, 8), slice(8, 12)]
    assert _torn_meshes(points, places, triangles, parts) == [True, True, False]
    assert _torn_meshes(points, points, triangles, parts) == [False] * 3


def test_layers_keep_their_order(body: ControlMesh) -> None:
    point_map = swollen(body)
    layers = carry_passengers(point_map, [dressed(body, height) for height in (0.04, 0.08, 0.12)])
    heights = np.array([signed(point_map.target, layer.positions) for layer in layers])
    assert (np.diff(heights, axis=0) > 0).all()


def test_small_round_things_stay_round_and_cloth_does_not(body: ControlMesh, ball: ControlMesh) -> None:
    point_map = swollen(body)
    on_skin = moved(ball, (2.2, 0.8, 0.0))

    def roundness(kind: str | None) -> float:
        places = carry_passenger(point_map, on_skin, kind=kind).positions
        radii = np.linalg.norm(places - places.mean(axis=0), axis=1)
        return float(np.ptp(radii) / radii.mean())

    assert roundness(None) < 0.02 + np.ptp(np.linalg.norm(ball.positions, axis=1)) / 0.1
    assert roundness("similarity") == pytest.approx(roundness(None))
    assert roundness("cloth") > 0.1


def test_rigid_keeps_the_size_of_the_whole_body(body: ControlMesh, ball: ControlMesh) -> None:
    point_map = swollen(body)
    places = carry_passenger(point_map, moved(ball, (2.2, 0.8, 0.0)), kind="rigid").positions
    radii = [np.linalg.norm(at - at.mean(axis=0), axis=1) for at in (places, ball.positions)]
    np.testing.assert_allclose(radii[0], radii[1] * point_map.source.scale / point_map.target.scale, rtol=1e-9)


def test_pieces_of_one_mesh_move_on_their_own_and_concentric_ones_together(body, ball):
    point_map, count = swollen(body), ball.n_vertices
    shells = np.concatenate([ball.positions, 1.1 * ball.positions]) + np.array([2.2, 0.8, 0.0])
    faces = ball.face_indices.reshape(-1, 3)
    eye = ControlMesh.from_faces(shells, np.concatenate([faces, faces + count]), name="eye")
    places = carry_passenger(point_map, eye).positions
    np.testing.assert_allclose(places[:count].mean(axis=0), places[count:].mean(axis=0), rtol=0, atol=1e-9)
    ratio = np.linalg.norm(places[count:] - places[count:].mean(axis=0), axis=1)
    ratio /= np.linalg.norm(places[:count] - places[:count].mean(axis=0), axis=1)
    np.testing.assert_allclose(ratio, 1.1, rtol=1e-9)


def test_an_iris_of_its_own_mesh_moves_with_the_eyeball_that_it_lies_in(body: ControlMesh, ball: ControlMesh) -> None:
    eye = moved(ball, (2.2, 0.8, 0.0))
    disc = ball.with_positions(ball.positions * [0.5, 0.1, 0.5])
    iris = replace(moved(disc, (2.2, 0.885, 0.0)), name="iris")
    carried = carry_passengers(swollen(body), [eye, iris])
    offsets = eye.positions - eye.positions[0]
    matrix = np.linalg.lstsq(offsets, carried[0].positions - carried[0].positions[0], rcond=None)[0]
    for mesh, one in zip((eye, iris), carried, strict=True):
        expected = carried[0].positions[0] + (mesh.positions - eye.positions[0]) @ matrix
        np.testing.assert_allclose(one.positions, expected, rtol=0, atol=1e-9)


def test_offsets_of_a_small_mesh_keep_their_directions(body: ControlMesh, ball: ControlMesh) -> None:
    """Teeth around a bend of the body stay in a row when the jaw opens."""
    teeth = join_meshes([moved(ball.with_positions(0.2 * ball.positions), (2.2, y, 0.0)) for y in (0.7, 0.8, 0.9)])
    carried = carry_passenger(swollen(body), replace(teeth, name="teeth"))
    opened = carried.carry_offsets(np.tile([0.0, -1.0, 0.0], (teeth.n_vertices, 1)))
    np.testing.assert_allclose(opened, opened[:1].repeat(len(opened), axis=0), rtol=0, atol=1e-12)
    assert np.linalg.norm(opened[0]) > 0.5


def test_passengers_carried_together_arrive_as_each_alone(body: ControlMesh, ball: ControlMesh) -> None:
    point_map, meshes = swollen(body), all_of(body, ball)
    for mesh, carried in zip(meshes, carry_passengers(point_map, meshes), strict=True):
        np.testing.assert_allclose(carried.positions, carry_passenger(point_map, mesh).positions, rtol=0, atol=1e-4)
    assert carry_passengers(point_map, []) == []


def test_a_prop_far_away_keeps_its_shape_and_says_how_far_it_is(body: ControlMesh) -> None:
    prop = moved(cube(), (30.0, 0.0, 0.0))
    carried = carry_passenger(swollen(body), prop)
    edges = np.ptp(prop.positions, axis=0), np.sort(np.linalg.norm(carried.positions - carried.positions[0], axis=1))
    rest = np.sort(np.linalg.norm(prop.positions - prop.positions[0], axis=1))
    np.testing.assert_allclose(edges[1] / edges[1][-1], rest / rest[-1], rtol=1e-9)
    assert carried.distance > 1.0


@pytest.mark.parametrize(("factor", "expected"), [(0.01, 100.0), (0.0254, 1 / 0.0254), (1.0, 1.0), (100.0, 0.01)])
def test_clothes_in_another_unit_are_recognised(factor: float, expected: float, body: ControlMesh) -> None:
    """Clothes a hundred times too small lie near the origin, which is not far from the body."""
    cloth = dressed(body)
    worn = cloth.with_positions(factor * cloth.positions)
    assert unit_factor(swollen(body).source, worn.positions) == pytest.approx(expected)


def test_what_is_no_passenger_is_refused_by_name(body: ControlMesh) -> None:
    point_map = swollen(body)
    empty = replace(ControlMesh.from_faces(np.zeros((0, 3)), []), name="nothing.obj")
    refuses(ParameterError, r"nothing\.obj: expected a passenger with faces", carry_passenger, point_map, empty)
    holes = cube().with_positions(np.where(np.arange(24).reshape(8, 3) == 4, np.nan, 1.0))
    refuses(ParameterError, r"cube.*finite positions.*\[1\]", carry_passenger, point_map, holes)
    with pytest.raises(ParameterError, match="expected cloth, rigid or similarity, got 'silk'"):
        carry_passenger(point_map, cube(), kind="silk")
    with pytest.raises(ParameterError, match="hat: expected one of the passengers, cube"):
        carry_passengers(point_map, [cube()], kinds={"hat": "rigid"})
    with pytest.raises(ParameterError, match=r"expected offsets \(8, 3\)"):
        carry_passenger(point_map, cube()).carry_offsets(np.zeros((2, 3)))


def test_a_passenger_without_extent_is_moved_as_a_point(body: ControlMesh) -> None:
    point = cube().with_positions(np.tile([2.0, 1.2, 0.0], (8, 1)))
    for kind in KINDS:
        assert np.isfinite(carry_passenger(swollen(body), point, kind=kind).positions).all()


@pytest.mark.parametrize(
    ("part", "bar"), [("shirt", 0.45), ("trousers", 0.45), ("skirt", 0.6), ("shoes", 0.6), ("hat", 1.0), ("eyes", 0.35)]
)
def test_true_map_brings_parts_to_where_they_are_made_for(shared_data: Path, part: str, bar: float) -> None:
    folder = shared_data / "characters" / "passengers"
    if not folder.is_dir():
        pytest.skip("characters are not among the shared data")
    sides = []
    for identity in ("female_old_heavy", "male_young"):
        control = read_mesh(shared_data / "humans" / f"base_{identity}.obj")
        sides.append(surface(control.positions, cage_triangles(control)[0]))
    target, source = sides
    point_map = PointMap.from_vertices(target, source, np.arange(target.n))
    given, true = (read_mesh(folder / f"{part}_{identity}.obj") for identity in ("male_young", "female_old_heavy"))
    places = carry_passenger(point_map, given).positions * target.scale
    goal = TriangleSurface(true.positions * target.scale, cage_triangles(true)[0])
    assert 100 * closest_points(goal.tree, places)[2].mean() <= bar
    inside = [signed(body, at) < 0 for body, at in ((source, given.positions), (target, places / target.scale))]
    if part != "eyes":  # within their sockets
        assert np.count_nonzero(inside[1]) <= np.count_nonzero(inside[0])
    else:
        firm = [at - at.mean(axis=0) for at in (given.positions[:256], places[:256])]
        lengths = [np.linalg.norm(at, axis=1) for at in firm]
        np.testing.assert_allclose(lengths[1] / lengths[1].max(), lengths[0] / lengths[0].max(), rtol=1e-9)


def test_the_command_writes_the_mesh_with_its_uvs_and_materials(tmp_path: Path, run: Run) -> None:
    write_result(tmp_path / "R", identity_result())
    patch = cube().with_uvs(np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]), np.tile([0, 1, 2, 3], 6))
    shirt = replace(patch, face_materials=np.array([0, 0, 1, 1, 0, 1]), material_names=("red", "blue"))
    write_mesh(tmp_path / "shirt.obj", shirt)
    run.done("transfer R --passenger shirt.obj --as rigid -o on.obj")
    given, carried = (read_mesh(tmp_path / name) for name in ("shirt.obj", "on.obj"))
    np.testing.assert_allclose(carried.positions, 2.0 * given.positions, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(carried.uvs, given.uvs)
    assert carried.material_names == given.material_names
    np.testing.assert_array_equal(carried.face_materials, given.face_materials)


def test_the_matched_piece_of_its_own_file_is_no_passenger(tmp_path: Path, run: Run) -> None:
    body, hat = cube(), moved(cube(), (0.0, 0.0, 1.1))
    whole = replace(join_meshes([body, hat]), face_objects=np.repeat([0, 1], 6), object_names=("body", "hat"))
    file = tmp_path / "figure.obj"
    write_mesh(file, whole)
    source = extract_faces(read_mesh(file), np.arange(5))  # a face of the body was left out
    result = identity_result(controls=(source.with_positions(2.0 * source.positions), source))
    inputs = stated_inputs({"source": file}, tmp_path / "R")
    write_result(tmp_path / "R", replace(result, provenance={**result.provenance, "inputs": inputs}))
    said = run.done("transfer R --passenger figure.obj --as rigid -o on.obj")
    assert "6 faces of figure.obj were matched, and are left out" in said.err
    carried = read_mesh(tmp_path / "on.obj")
    np.testing.assert_allclose(carried.positions, 2.0 * hat.positions, rtol=0, atol=1e-6)
    assert carried.object_names == ("hat",)
    file.write_text(file.read_text() + "# edited\n")
    said = run.done("transfer R --passenger figure.obj --as rigid -o all.obj")
    assert "figure.obj has changed since the match" in said.err
    assert read_mesh(tmp_path / "all.obj").n_faces == 12


def test_the_command_refuses_idle_options_and_warns_of_a_passenger_elsewhere(tmp_path: Path, run: Run) -> None:
    write_result(tmp_path / "R", identity_result())
    write_mesh(tmp_path / "far.obj", moved(cube(), (99.0, 0.0, 0.0)))
    np.save(tmp_path / "v.npy", np.arange(8.0))
    run.refused("transfer R --attribute v.npy --as rigid -o o.npy", says="--as: expected with --passenger only")
    warned = run.done("transfer R --passenger far.obj -o on.obj")
    assert "same units and place" in warned.err + warned.out
    write_mesh(tmp_path / "small.obj", cube().with_positions(0.01 * cube().positions))
    warned = run.done("transfer R --passenger small.obj -o small_on.obj")
    assert "times as large it would lie on it): check that both have the same units" in warned.err + warned.out
    run.refused("transfer R --passenger far.obj -o far.obj", says="is an input too")
