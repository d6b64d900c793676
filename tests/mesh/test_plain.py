"""Plain meshes (scheme none): mended and set aside by name, coarse levels below them, matched as they are."""

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import cube, grid, torus
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.errors import InvalidMeshError
from cagemap.mesh import ControlMesh, Plain
from cagemap.mesh.checks import check_mesh, require_valid
from cagemap.mesh.faces import face_areas, signed_volume
from cagemap.mesh.parts import extract_faces, join_meshes
from cagemap.mesh.plain import plain_mesh, turn_faces
from cagemap.mesh.topology import mesh_topology
from cagemap.surface.closest_points import closest_among

from closest_reference import closest_points_slowly
from plain_meshes import ball, soup
from refusals import refuses


def test_a_sound_mesh_keeps_its_numbers() -> None:
    sphere = ball()
    plain = plain_mesh(sphere)
    assert plain.notes == ()
    assert plain.repairs.summary() == {}
    assert np.array_equal(plain.mesh.positions, sphere.positions)
    assert np.array_equal(plain.mesh.face_indices, sphere.face_indices)
    assert np.array_equal(plain.vertex_of, np.arange(sphere.n_vertices))
    assert isinstance(plain.mesh.scheme, Plain)
    assert plain.mesh.file_vertices is None


def test_vertices_that_a_file_repeats_are_joined() -> None:
    sphere = ball()
    plain = plain_mesh(soup(sphere))
    assert plain.mesh.n_vertices == sphere.n_vertices
    assert plain.repairs.joined_vertices == 3 * sphere.n_faces - sphere.n_vertices
    assert np.array_equal(plain.mesh.positions[plain.vertex_of], sphere.positions[sphere.face_indices])
    require_valid(plain.mesh)


def test_what_scans_have_is_mended_or_set_aside_and_said() -> None:
    sphere = ball()
    faces = sphere.face_indices.reshape(-1, 3)
    n = sphere.n_vertices
    away = sphere.positions.max() + 1.0
    positions = np.vstack([sphere.positions, [[0, 0, away]], away + np.eye(3), [[9 * away] * 3]])
    fin, stray, copy, twice = [*faces[0, :2], n], [n + 1, n + 2, n + 3], faces[5], [*faces[9, :2], faces[9, 0]]
    broken = np.vstack([faces, [fin], [stray], [copy], [twice]])
    broken[20] = broken[20, ::-1]
    plain = plain_mesh(replace(ControlMesh.from_faces(positions, broken), name="scan"))
    found = plain.repairs
    assert (found.fins, found.pieces, found.pieces_vertices, found.dropped_faces) == (1, 1, 3, 2)
    assert (found.turned_faces, found.loose_vertices) == (1, 1)
    assert np.array_equal(plain.mesh.positions, sphere.positions)
    assert np.array_equal(plain.vertex_of, [*range(n), -1, -1, -1, -1, -1])
    assert np.array_equal(np.unique(plain.mesh.file_faces), plain.mesh.file_faces)
    assert all(note.startswith("scan: ") for note in plain.notes)
    assert len(plain.notes) == 5
    require_valid(plain.mesh)


@pytest.mark.parametrize(
    ("kind", "names", "scale", "kept"),
    [
        ("object", ("body", "jeans"), 2.0, 0),
        ("group", ("body", "jeans"), 2.0, 0),
        ("material", ("skin", "jeans"), 2.0, 0),
        ("object", ("body", "jeans"), 9.0, 1),  # a button
        ("object", ("hat", "jeans"), 2.0, 1),
        ("object", ("hat", "body"), 0.8, 1),
        ("object", ("suit", "head"), 0.4, 0),  # the body is deleted
    ],
)
def test_the_piece_that_is_kept_is_not_named_like_clothes(kind, names, scale, kept):
    small, large = ball(), cube()
    scene = join_meshes([small, large.with_positions(scale * large.positions)])
    labels = {f"face_{kind}s": np.repeat([0, 1], [small.n_faces, 6]), f"{kind}_names": names}
    plain = plain_mesh(replace(scene, **labels))
    assert np.array_equal(np.flatnonzero(plain.vertex_of >= 0) >= small.n_vertices, [kept == 1] * plain.mesh.n_vertices)
    assert plain.notes[-1].partition(" ")[2].startswith("1 other piece set aside")


def test_materials_are_ignored_where_an_object_is_named_like_clothes() -> None:
    """A man whose body has the material of a suit, a hat and a ball."""
    toy, man = ball(), cube()
    hat = toy.with_positions(0.5 * toy.positions)
    scene = join_meshes([toy, man.with_positions(2.0 * man.positions), hat])
    of_face = np.repeat([0, 1, 2], [toy.n_faces, 6, hat.n_faces])
    objects = {"face_objects": of_face, "object_names": ("ball", "man", "hat")}
    scene = replace(scene, **objects, face_materials=of_face, material_names=("red", "suit", "felt"))
    assert plain_mesh(scene).mesh.n_vertices == man.n_vertices


def test_sheets_that_share_an_edge_or_a_point_are_cut_apart() -> None:
    one, other = ball(), ball(2)
    other = other.with_positions(0.5 * other.positions)
    rows = one.face(0)
    # The smaller ball touches the larger one in two vertices of an edge, then in one.
    for shared in (2, 1):
        faces = other.face_indices.reshape(-1, 3) + one.n_vertices
        glued = other.face(0)[:shared] + one.n_vertices
        for vertex, own in zip(glued, rows[:shared], strict=True):
            faces = np.where(faces == vertex, own, faces)
        both = ControlMesh.from_faces(
            np.vstack([one.positions, other.positions]), np.vstack([one.face_indices.reshape(-1, 3), faces])
        )
        plain = plain_mesh(both)
        assert plain.repairs.cut_vertices == shared
        assert plain.repairs.pieces == 1
        assert plain.mesh.n_faces == one.n_faces
        require_valid(plain.mesh)


def test_inwards_is_turned_and_faces_of_all_sizes_are_split() -> None:
    sphere = ball()
    corners = sphere.face_indices.reshape(-1, 3)[:, [0, 2, 1]]
    plain = plain_mesh(ControlMesh.from_faces(sphere.positions, corners))
    assert plain.repairs.turned_faces == sphere.n_faces
    assert np.array_equal(plain.mesh.face_indices, sphere.face_indices)
    mixed = cube()
    lids = [mixed.face(0)[[0, 1, 2]], mixed.face(0)[[0, 2, 3]], *(mixed.face(i) for i in range(1, 6))]
    split = plain_mesh(ControlMesh.from_faces(mixed.positions, lids))
    assert split.mesh.is_triangle_mesh
    assert split.mesh.n_faces == 12
    assert split.repairs.split_faces == 2
    quads = plain_mesh(mixed)
    assert quads.mesh.n_faces == 6
    assert quads.notes == ()


def test_faces_turned_round_are_counted_on_the_piece_that_is_kept() -> None:
    sphere = ball()
    faces = sphere.face_indices.reshape(-1, 3)
    strip = np.array([(k, k + 1, k + 2) if k % 2 else (k + 1, k, k + 2) for k in range(6)]) + sphere.n_vertices
    strip[1::2] = strip[1::2, ::-1]  # three of six are turned against the others
    points = np.array([(k, 3.0 + k % 2, 9.0) for k in range(8)]) * 0.1
    positions = np.vstack([sphere.positions, points])
    aside = plain_mesh(ControlMesh.from_faces(positions, np.vstack([faces, strip])))
    assert aside.repairs.pieces == 1
    assert aside.repairs.turned_faces == 0
    inwards = plain_mesh(ControlMesh.from_faces(positions, np.vstack([faces[:, ::-1], strip])))
    assert inwards.repairs.turned_faces == sphere.n_faces


def test_colours_of_joined_vertices_are_averaged_and_said() -> None:
    sphere = soup(ball())
    colors = np.full((sphere.n_vertices, 3), 0.5)
    plain = plain_mesh(replace(sphere, vertex_colors=colors))
    assert not any("colours" in note for note in plain.notes)
    first, second = np.flatnonzero(plain.vertex_of == 0)[:2]
    colors[first] = np.nan
    found = plain_mesh(replace(sphere, vertex_colors=colors)).mesh.vertex_colors
    np.testing.assert_allclose(found, 0.5)
    colors[first], colors[second] = 0.5, 1.0
    count = int((plain.vertex_of == 0).sum())
    averaged = plain_mesh(replace(sphere, vertex_colors=colors))
    assert f"{sphere.name}: colours of {count} joined vertices differ and are averaged" in averaged.notes
    assert averaged.repairs.averaged_colors == count
    np.testing.assert_allclose(averaged.mesh.vertex_colors[0], 0.5 + 0.5 / count)


def test_concave_polygons_are_split_inside() -> None:
    """A prism over a U: the fan from its first corner covers the gap, and its triangles overlap."""
    outline = [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]
    positions = [(x, y, z) for z in (0, 1) for x, y in outline]
    sides = [[k, (k + 1) % 8, (k + 1) % 8 + 8, k + 8] for k in range(8)]
    prism = ControlMesh.from_faces(positions, [list(range(8))[::-1], list(range(8, 16)), *sides])
    found = plain_mesh(prism).mesh
    assert face_areas(found).sum() == pytest.approx(2 * 7.0 + 16.0)
    assert signed_volume(found) == pytest.approx(7.0)


def test_a_polygon_that_crosses_itself_gets_no_more_area_than_its_fan() -> None:
    crossing = np.array([(0, 0, 0), (4, 0, 0), (4, 3, 0), (1, -1, 0), (0, 3, 0)], dtype=float)
    found = plain_mesh(ControlMesh.from_faces(crossing, [list(range(5))])).mesh
    corners = crossing[[[0, 1, 2], [0, 2, 3], [0, 3, 4]]]
    fan = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert face_areas(found).sum() <= 1.000001 * fan


def test_polygons_with_collinear_corners_are_split_without_a_loss() -> None:
    box = cube()
    faces = np.split(box.face_indices, box.face_offsets[1:-1])
    ends = np.unique(np.sort(np.concatenate([np.column_stack([f, np.roll(f, -1)]) for f in faces]), axis=1), axis=0)
    middle = {(a, b): box.n_vertices + k for k, (a, b) in enumerate(ends.tolist())}
    halved = [
        [v for a, b in zip(f, np.roll(f, -1), strict=True) for v in (int(a), middle[min(a, b), max(a, b)])]
        for f in faces
    ]
    positions = np.concatenate([box.positions, box.positions[ends].mean(axis=1)])
    plain = plain_mesh(ControlMesh.from_faces(positions, halved))
    assert plain.mesh.n_vertices == 20
    assert list(plain.repairs.summary()) == ["split_faces"]
    np.testing.assert_allclose(face_areas(plain.mesh).reshape(6, 6).sum(axis=1), 4.0)
    bent = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [1, 3, 0], [0, 3, 0], [0, 1, 0]]
    flat = plain_mesh(ControlMesh.from_faces(bent, [list(range(9))])).mesh
    assert flat.n_faces == 7
    assert face_areas(flat).sum() == pytest.approx(4.0)


def test_holes_stay_and_uv_sets_come_along() -> None:
    sheet = grid(6, 5)
    sheet = sheet.with_uvs(sheet.positions[:, :2] / 6.0, sheet.face_indices)
    plain = plain_mesh(extract_faces(sheet, np.delete(np.arange(sheet.n_faces), [7, 8])))
    assert plain.repairs.openings == 2
    assert plain.mesh.uvs is not None
    pair = plain_mesh(join_meshes([sheet, replace(sheet, positions=sheet.positions + 9.0)]))
    assert pair.repairs.pieces == 1
    assert pair.repairs.pieces_share == pytest.approx(0.5)
    assert np.array_equal(pair.mesh.uvs[pair.mesh.uv_indices], sheet.uvs[sheet.uv_indices])


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ([[0, 1, 9]], "vertex numbers"),
        ([[0, 0, 1], [1, 1, 2]], "visit a vertex twice"),
        ([[0, 1], [1, 2]], "three corners or more"),
        ([[0, 1, 3], [1, 4, 3], [1, 2, 4], [2, 5, 4], [2, 3, 5], [3, 0, 5]], "inside and an outside"),
    ],
)
def test_what_is_no_surface_is_refused_by_name(faces: list[list[int]], message: str) -> None:
    positions = np.random.default_rng(0).normal(size=(6, 3))
    refuses(InvalidMeshError, message, plain_mesh, ControlMesh.from_faces(positions, faces))
    with pytest.raises(InvalidMeshError, match="no holes, got none"):
        plain_mesh(replace(ControlMesh.from_faces(positions, [[0, 1, 2]]), hole_faces=np.array([0])))
    positions[2] = np.nan
    refuses(InvalidMeshError, "finite positions", plain_mesh, ControlMesh.from_faces(positions, [[0, 1, 2]]))
    line = ControlMesh.from_faces(np.arange(4.0)[:, None] * [1.0, 0.0, 0.0], [(0, 1, 2), (2, 1, 3)], name="scan.obj")
    with pytest.raises(
        InvalidMeshError, match=r"scan\.obj: expected a surface with an area, got 2 faces.*Repair it in"
    ):
        plain_mesh(line)
    for scale in (1e200, 1e-200):
        huge = ControlMesh.from_faces(scale * np.eye(3), [[0, 1, 2]])
        refuses(InvalidMeshError, "expected an extent between 1e-60 and 1e\\+60", plain_mesh, huge)


def test_a_mesh_of_skew_quads_looks_outwards_once_it_is_turned_round() -> None:
    """Quads turned round by another corner are split otherwise: here both ways round enclosed less than nothing."""
    corners = np.array([[0, 0, 0], [1, 1, 1], [1, 0, 1], [0, 1, 1], [1, 0, 0], [1, 0, 1], [1, 1, 0], [1, 1, 1]])
    faces = [[4, 5, 1, 0], [1, 3, 2, 0], [2, 3, 7, 6], [4, 6, 7, 5], [2, 6, 4, 0], [1, 5, 7, 3]]
    given_mesh = ControlMesh.from_faces(2.0 * corners - 1.0, faces)
    whole = turn_faces(given_mesh, np.ones(6, dtype=bool))
    assert signed_volume(whole) == pytest.approx(-signed_volume(given_mesh))
    ready = plain_mesh(given_mesh).mesh
    assert signed_volume(ready) > 0
    assert not check_mesh(ready).problems


@pytest.mark.slow
@settings(max_examples=60)
@given(st.data())
def test_whatever_comes_out_can_be_matched_or_is_refused(data: st.DataObject) -> None:
    """Random damage: faces on random vertices, moved onto each other, dropped and repeated."""
    mesh = data.draw(st.sampled_from([ball(1), torus(6, 4), grid(5, 4), cube()]))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    faces = [mesh.face(i) for i in range(mesh.n_faces)]
    faces += [rng.integers(mesh.n_vertices, size=rng.integers(3, 5)) for _ in range(data.draw(st.integers(0, 6)))]
    faces += [faces[i] for i in rng.integers(len(faces), size=data.draw(st.integers(0, 2)))]
    faces = [faces[i] for i in rng.permutation(len(faces))[data.draw(st.integers(0, 4)) :]]
    positions = mesh.positions.copy()
    onto = rng.integers(mesh.n_vertices, size=(data.draw(st.integers(0, 3)), 2))
    positions[onto[:, 0]] = positions[onto[:, 1]]
    given_mesh = ControlMesh.from_faces(positions, faces)
    try:
        plain = plain_mesh(given_mesh)
    except InvalidMeshError:
        return
    ready = plain.mesh
    kept = plain.vertex_of >= 0
    assert np.array_equal(ready.positions[plain.vertex_of[kept]], positions[kept])
    faults = {problem.kind for problem in check_mesh(ready).problems}
    assert faults <= {"no volume", "no area"}  # what is folded flat or a line is not mended, and refused later


def test_closest_points_among_few_triangles_are_those_of_plain_numpy() -> None:
    rng = np.random.default_rng(1)
    corners, points = rng.normal(size=(40, 3, 3)), rng.normal(size=(200, 3))
    corners[:4, 2] = 0.3 * corners[:4, 0] + 0.7 * corners[:4, 1]  # without area
    starts = rng.integers(0, 100, size=200)
    ranges = np.column_stack([starts, starts + rng.integers(1, 9, size=200)])
    candidates = rng.integers(0, 40, size=120)
    places, up = corners.reshape(-1, 3), np.zeros((1, 3))
    triangle, barycentric = closest_among(places, np.arange(120).reshape(40, 3), ranges, candidates, points)
    assert barycentric.min() >= 0
    assert np.allclose(barycentric.sum(axis=1), 1)
    for i, (first, last) in enumerate(ranges):
        mine = candidates[first:last]
        assert triangle[i] in mine
        if mine.min() < 4:
            continue
        of_mine = np.unique(mine)[:, None] * 3 + np.arange(3)
        nearest, weights, distance = closest_points_slowly(places, of_mine, points[i : i + 1], up)
        foot = barycentric[i] @ corners[triangle[i]]
        assert np.isclose(np.linalg.norm(foot - points[i]), distance[0], atol=1e-9)
        assert np.allclose(weights[0] @ places[of_mine[nearest[0]]], foot, atol=1e-6)


def test_with_a_vertex_for_each_fan_no_edge_has_three_faces() -> None:
    """Triangles between random vertices, most of them on edges of many."""
    random = np.random.default_rng(8)
    for count in (5, 6, 8):
        faces = [random.choice(count, 3, replace=False).tolist() for _ in range(40)]
        mesh = ControlMesh.from_faces(random.normal(size=(count, 3)), faces)
        assert mesh_topology(plain_mesh(mesh).mesh).face_counts.max() <= 2
