"""Landmarks anywhere on a mesh, kept per mesh and by name, in the forms of other programs."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, cube
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap import Surface, match, prepare_surface, update_match
from cagemap.deform.config import StartConfig
from cagemap.errors import DirectionError, FormatError, InvalidLandmarksError
from cagemap.files.landmarks.point_formats import POINT_FORMS, write_points
from cagemap.files.landmarks.points import read_points
from cagemap.files.ownership import mark
from cagemap.maps.pair import NEAR_VERTICES
from cagemap.mesh.cage_points import CagePoints, NamedCurve, NamedPoints, on_cage
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.landmarks import Landmarks, check_landmarks, pair_by_name

from plain_meshes import bent
from quick_match import QUICK
from refusals import refuses

NOWHERE = (np.nan,) * 3


def some_points() -> NamedPoints:
    return NamedPoints(("tip & end", "side"), np.array([4, -1]), np.array([NOWHERE, (0.5, 0.25, -1.0)]), "cube.obj")


NAMES = st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=6).filter(lambda name: name.strip())


@pytest.mark.slow
@settings(max_examples=20)
@given(st.data())
@pytest.mark.parametrize("form", POINT_FORMS, ids=lambda form: form.ending)
def test_what_is_written_reads_back(tmp_path_factory, form, data):
    mesh = creature()
    names = tuple(data.draw(st.lists(NAMES, unique=True, max_size=6)))
    some = st.lists(st.integers(0, mesh.n_vertices - 1), min_size=len(names), max_size=len(names), unique=True)
    vertices = np.array(data.draw(some), dtype=np.int64)
    vertices[data.draw(st.lists(st.booleans(), min_size=len(names), max_size=len(names)))] = -1
    corners = cage_triangles(mesh)[0][data.draw(st.integers(0, 20)) + np.arange(len(names))]
    between = mesh.positions[corners].mean(axis=1).reshape(-1, 3)
    points = NamedPoints(names, vertices, np.where(vertices[:, None] >= 0, np.nan, between), "creature.obj")
    along = mesh.positions[mesh.face_indices[:4]]
    free = np.arange(4) == 1
    line = NamedCurve("a line", np.where(free, -1, mesh.face_indices[:4]), np.where(free[:, None], along, np.nan), True)
    if form.curves:
        points = replace(points, curves=(line,))
    file = tmp_path_factory.mktemp("points") / f"a.target{form.ending}"
    write_points(file, points, mesh)
    found = read_points(file, mesh)
    assert found.names == (names if form.names else tuple(f"point {k}" for k in range(len(names))))
    ours, theirs = on_cage(points, mesh), on_cage(found, mesh)
    np.testing.assert_allclose(ours.of(mesh.positions), theirs.of(mesh.positions), atol=1e-9)
    np.testing.assert_array_equal(theirs.vertices, vertices)
    assert [(curve.name, curve.closed) for curve in found.curves] == [("a line", True)] * form.curves
    for curve in found.curves:
        places = np.where(curve.vertices[:, None] >= 0, mesh.positions[np.maximum(curve.vertices, 0)], curve.positions)
        np.testing.assert_allclose(places, along, atol=1e-9)
    # What it wrote it may write again, where the form has a place for a mark.
    if form.ending == ".txt":
        with pytest.raises(FormatError):
            write_points(file, points, mesh)
    else:
        write_points(file, points, mesh)
    assert bool(form.lost(replace(points, curves=(line,)))) == (not form.curves)


def test_markups_say_what_they_are(tmp_path: Path) -> None:
    """The word that 3D Slicer looks for (vtkMRMLMarkupsJsonStorageNode), and LPS, in which it reads meshes."""
    write_points(tmp_path / "a.mrk.json", some_points(), cube())
    content = json.loads((tmp_path / "a.mrk.json").read_text())
    assert re.fullmatch(r".*markups-schema-v1\.[0-9]+\.[0-9]+\.json#*", content["@schema"])
    assert [markup["coordinateSystem"] for markup in content["markups"]] == ["LPS"]


def test_a_form_that_is_not_known_is_refused(tmp_path: Path) -> None:
    for name in ("points.md", "points"):
        refuses(FormatError, r"\.fcsv", write_points, tmp_path / name, some_points(), cube())
    assert not list(tmp_path.iterdir())


def test_other_programs_forms(tmp_path: Path) -> None:
    place = [1.0, 2.0, 3.0]
    slicer = {"markups": [{"coordinateSystem": "RAS", "controlPoints": [{"label": "nose", "position": [-1, -2, 3]}]}]}
    forms = {
        "a.mrk.json": json.dumps(slicer),
        "b.mrk.json": json.dumps(slicer).replace("RAS", "LPS").replace("[-1, -2, 3]", "[1, 2, 3]"),
        "c.fcsv": "# Markups fiducial file version = 4.10\n# CoordinateSystem = 0\nvtk0,-1,-2,3,0,0,0,1,1,1,0,nose,,\n",
        "d.fcsv": "# CoordinateSystem = LPS\nvtk0,1,2,3,0,0,0,1,1,1,0,nose,,\n",
        "e.csv": "name,x,y,z\nnose,1,2,3\n",
        "f.csv": "nose,1,2,3\n",
        "g.pp": '<!DOCTYPE PickedPoints>\n<PickedPoints><point x="1" y="2" z="3" name="nose" active="1"/>'
        '<point x="9" y="9" z="9" name="off" active="0"/></PickedPoints>',
    }
    for name, text in forms.items():
        (tmp_path / name).write_text(text)
        found = read_points(tmp_path / name)
        assert found.names == ("nose",), name
        np.testing.assert_allclose(found.positions, [place], err_msg=name)
    (tmp_path / "v.csv").write_text("name,vertex\nnose,7\n")
    assert read_points(tmp_path / "v.csv").vertices.tolist() == [7]


def test_names_of_a_table_may_begin_as_comments_do(tmp_path: Path) -> None:
    table = tmp_path / "a.csv"
    table.write_text(f"# made by hand\nname,x,y,z\n#1,1,2,3\n# of, the skull\nnose,1,2,4\n#2,1,2,5\n# {mark()}\n")
    assert read_points(table).names == ("#1", "nose", "#2")
    table.write_text(f"name,vertex\n#1,7\n# {mark()}\n")
    assert read_points(table).vertices.tolist() == [7]
    table.write_text("# x,1,2,3\nnose,1,2,3\n")
    assert read_points(table).names == ("nose",)


def test_wrap_s_points_are_triangles_of_the_mesh(tmp_path: Path) -> None:
    (tmp_path / "wrap.json").write_text("[[3, 0.25, 0.5], [0, 0, 0]]")
    mesh = cube()
    found = read_points(tmp_path / "wrap.json", mesh)
    a, b, c = mesh.positions[cage_triangles(mesh)[0][3]]
    np.testing.assert_allclose(found.positions[0], 0.25 * a + 0.25 * b + 0.5 * c)
    (tmp_path / "far.json").write_text("[[99, 0, 0]]")
    refuses(FormatError, "triangle from 0 to 11", read_points, tmp_path / "far.json", mesh)
    refuses(FormatError, "the mesh beside", read_points, tmp_path / "wrap.json")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.json", "{"),
        ("a.json", "{}"),
        ("a.json", '{"points": [{"name": "x"}]}'),
        ("a.json", '{"points": [{"name": "x", "position": [1, 2]}]}'),
        ("a.csv", "name,x,y,z\nnose,1,2,nan\n"),
        ("a.csv", "name,vertex\nnose,99999999999999999999\n"),
        ("a.csv", "name,vertex\nnose,\u00b2\n"),
        ("a.json", '{"markups": [[]]}'),
        ("a.json", '{"markups": [{"controlPoints": [7]}]}'),
        ("a.pp", "<PickedPoints><point"),
        ("a.pp", '<!DOCTYPE p [<!ENTITY a "b">]><PickedPoints/>'),
        ("a.pp", '<PickedPoints><point x="1" y="2"/></PickedPoints>'),
    ],
)
def test_what_is_broken_is_refused_by_name(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    refuses(FormatError, name, read_points, tmp_path / name)


@pytest.mark.parametrize(
    "text",
    [
        r'{"mesh": "\ud800", "points": [{"name": "ear \ud800", "vertex": 3}]}',
        r'{"markups": [{"controlPoints": [{"label": "ear \ud800", "position": [0, 0, 0]}]},'
        r' {"type": "Curve", "name": "\ud800", "controlPoints": [{"position": [0, 0, 0]}, {"position": [1, 0, 0]}]}]}',
    ],
)
def test_half_a_character_is_a_question_mark(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    found = read_points(tmp_path / "a.json")
    assert found.names == ("ear ?",)
    assert {found.mesh_name, *(curve.name for curve in found.curves)} <= {"", "?"}


@settings(max_examples=30)
@given(st.lists(st.integers(0, 11), min_size=1, max_size=5), st.integers(0, 2**32 - 1))
def test_places_on_the_mesh_are_found_where_they_are(triangles: list[int], seed: int) -> None:
    mesh = cube()
    weights = np.random.default_rng(seed).dirichlet([1, 1, 1], len(triangles))
    places = np.einsum("qk,qkd->qd", weights, mesh.positions[cage_triangles(mesh)[0][triangles]])
    names = tuple(map(str, range(len(triangles))))
    found = on_cage(NamedPoints(names, np.full(len(triangles), -1), places), mesh)
    np.testing.assert_allclose(found.of(mesh.positions), places, atol=1e-9)
    np.testing.assert_allclose(found.weights.sum(axis=1), 1.0)


def test_points_of_two_meshes_are_matched_by_name() -> None:
    target = NamedPoints(("a", "only here", "b"), np.array([1, 2, 3]), np.full((3, 3), np.nan))
    source = NamedPoints(("b", "a", "only there"), np.array([5, 6, 7]), np.full((3, 3), np.nan))
    landmarks, notes = pair_by_name(target, source, cube(), creature())
    assert landmarks.names == ("a", "b")
    assert (landmarks.target.tolist(), landmarks.source.tolist()) == ([1, 3], [6, 5])
    assert len(notes) == 2
    assert "only here" in notes[0]
    assert "only there" in notes[1]
    with pytest.raises(
        InvalidLandmarksError, match="names that both sides have, got a, only here, b on the target and A"
    ):
        pair_by_name(target, replace(source, names=("A", "B", "C")), cube(), creature())


def test_points_that_say_they_are_the_other_meshs_are_refused() -> None:
    """Where both meshes have as many vertices, nothing else tells."""
    target, source = replace(cube(), name="deer.obj"), replace(cube(), name="folder/pony.ply")
    both = NamedPoints(("a", "b"), np.array([0, 3]), np.full((2, 3), np.nan))
    of_target, of_source = replace(both, mesh_name="Deer"), replace(both, mesh_name="pony.obj")
    assert len(pair_by_name(of_target, of_source, target, source)[0]) == 2
    assert len(pair_by_name(both, replace(both, mesh_name="base"), target, source)[0]) == 2
    assert len(pair_by_name(of_target, of_target, target, replace(target))[0]) == 2
    for exchanged in ((of_source, of_target), (both, of_target), (of_source, both)):
        refuses(DirectionError, "the other mesh", pair_by_name, *exchanged, target, source)


def test_points_far_away_and_wrong_vertices_are_refused() -> None:
    with pytest.raises(InvalidLandmarksError, match=r"on or near cube.*x \("):
        on_cage(NamedPoints(("x",), np.array([-1]), np.full((1, 3), 50.0)), cube())
    with pytest.raises(InvalidLandmarksError, match=r"0 to 7.*x \(8\)"):
        on_cage(NamedPoints(("x",), np.array([8]), np.full((1, 3), np.nan)), cube())


def test_points_in_another_unit_are_refused_where_all_of_them_are_near() -> None:
    # Metres beside a body in decimetres that stands about its origin: every place is inside it, and near to it.
    body = replace(cube(), positions=cube().positions * [0.12, 1.0, 0.12])
    names, between = ("a", "b", "c"), np.full(3, -1)
    places = body.positions[[0, 3, 6]]
    assert on_cage(NamedPoints(names, between, places), body).vertices.tolist() == [0, 3, 6]
    for scale in (0.1, 0.01):
        refuses(InvalidLandmarksError, "in another unit", on_cage, NamedPoints(names, between, scale * places), body)
    # Three places beside each other, picked a little off the surface, are what they are.
    close = places[:1] + 0.004 * np.eye(3)
    on_cage(NamedPoints(names, between, close), body)


def test_landmarks_keep_their_points_through_reversal_and_selection() -> None:
    between = CagePoints(np.array([[0, 1, 2], [3, 3, 3]]), np.array([[0.5, 0.25, 0.25], [1.0, 0, 0]]))
    corners = CagePoints.of_vertices(np.array([4, 5]))
    landmarks = Landmarks.of_points(("p", "q"), between, corners, "t", "s")
    assert landmarks.target.tolist() == [-1, 3]
    check_landmarks(landmarks, cube(), cube())
    back = landmarks.reversed()
    assert back.source_points is between
    assert landmarks.without([1]).target_points.weights.tolist() == [[0.5, 0.25, 0.25]]
    wrong = Landmarks(("p",), np.array([-1]), np.array([0]))
    refuses(InvalidLandmarksError, "target vertices from 0 to 7", check_landmarks, wrong, cube(), cube())


@pytest.fixture(scope="module")
def twins() -> tuple[Surface, Surface]:
    """A creature and the same one bent."""
    return prepare_surface(creature(), 2), prepare_surface(bent(creature()), 2)


def some_corners() -> np.ndarray:
    """(10, 3) corners of ten triangles of the creature."""
    triangles = cage_triangles(creature())[0]
    return triangles[np.linspace(0, len(triangles) - 1, 10).astype(int)]


@pytest.mark.slow
def test_the_map_meets_landmarks_between_vertices(twins: tuple[Surface, Surface]) -> None:
    chosen = some_corners()
    weights = np.random.default_rng(8).dirichlet([2, 2, 2], len(chosen))
    points = CagePoints(chosen, weights)
    names = tuple(map(str, range(10)))
    config = replace(QUICK, start=StartConfig(search_vertices=600))
    between = match(*twins, Landmarks.of_points(names, points, points, "t", "s"), config)
    assert between.suspects == ()
    # Rounding alone is left: each lies in a triangle whose corners are moved until it is met.
    assert between.quality.landmark_errors.max() < 1e-10
    assert between.quality.flipped_area < 5e-3
    # Every vertex keeps its meaning, so the map of true points leads to where it is itself.
    errors = np.linalg.norm(between.point_map.images.positions - between.point_map.source.positions, axis=1)
    assert errors.mean() < 0.01
    moved = CagePoints(chosen, weights[:, [1, 0, 2]])
    updated = update_match(between, Landmarks.of_points(names, points, moved, "t", "s"), config)
    assert updated.quality.landmark_errors.max() < 1e-10


@pytest.mark.slow
def test_coarse_search_levels_have_landmarks_between_vertices(twins: tuple[Surface, Surface]) -> None:
    chosen = some_corners()
    points = CagePoints(chosen, np.full((len(chosen), 3), 1 / 3))
    landmarks = Landmarks.of_points(tuple(map(str, range(10))), points, points, "t", "s")
    config = replace(QUICK, start=StartConfig(search_vertices=100))
    found = match(*twins, landmarks, config)
    assert found.prepared.mesh.n < NEAR_VERTICES
    assert found.quality.landmark_errors.max() < 1e-3
    moved = CagePoints(chosen, np.tile([0.5, 0.3, 0.2], (len(chosen), 1)))
    updated = update_match(found, Landmarks.of_points(landmarks.names, points, moved, "t", "s"), config)
    assert updated.quality.landmark_errors.max() < 1e-3


@pytest.mark.slow
def test_vertices_given_as_points_are_vertices() -> None:
    cage = creature()
    target, source = prepare_surface(cage, 1), prepare_surface(bent(cage), 1)
    vertices = np.arange(0, cage.n_vertices, 9)
    names = tuple(map(str, vertices))
    given = Landmarks(names, vertices, vertices)
    corners = np.column_stack([np.roll(vertices, 1), vertices, np.roll(vertices, 2)])
    points = CagePoints(corners, np.tile([0.0, 1.0, 0.0], (len(vertices), 1)))
    both = given, Landmarks.of_points(names, points, points, "", "")
    maps = [match(target, source, one, QUICK).point_map for one in both]
    np.testing.assert_array_equal(maps[0].images.positions, maps[1].images.positions)
