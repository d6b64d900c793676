"""What pictures take for up and front: by the file, by the shape where it is clear, and what they say of it."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube, icosahedron

from cagemap.files.meshes.formats import write_mesh
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.numerics.arrays import FloatArray
from cagemap.pictures import Y_UP, Z_UP, Orientation, find_orientation, matching_turn
from cagemap.report import draw_gallery
from cagemap.report.figures import Gallery

from example_once import example_pair
from example_result import identity_result

SIZE = (90, 70)
# From a model with Y up that faces +Z, as the built-in ones do, to a file's axes, and what is up and in front then.
FACES_X = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
FILES = [
    (np.eye(3), "+y is up and +z in front"),
    (Z_UP.T, "+z is up and -y in front"),
    (FACES_X, "+y is up and +x in front"),
    (FACES_X @ Z_UP.T, "+z is up and +x in front"),
    (np.diag([-1.0, 1.0, -1.0]), "+y is up and -z in front"),
]


@cache
def deer() -> ControlMesh:
    return example_pair(8).target


def seen(mesh: ControlMesh, turned: FloatArray, *known: object) -> Orientation:
    return find_orientation(mesh.positions @ turned, cage_triangles(mesh)[0], *known)


@pytest.mark.parametrize(("turned", "said"), FILES)
def test_a_shape_that_stands_on_feet_is_turned_upright_and_to_the_front(turned: FloatArray, said: str) -> None:
    found = seen(deer(), turned)
    assert str(found) == f"{said}, as its shape shows"
    np.testing.assert_array_equal(turned @ found.turn, np.eye(3))


@pytest.mark.parametrize("mesh", [cube(), icosahedron()])
def test_a_shape_that_does_not_tell_keeps_the_usual_axes(mesh: ControlMesh) -> None:
    assert str(seen(mesh, np.eye(3))) == "+y is up and +z in front, as usual, its shape does not tell"


def test_what_is_said_to_be_up_is_up_and_the_front_is_still_looked_for() -> None:
    assert str(seen(deer(), np.eye(3), Z_UP, "as asked")).startswith("+z is up")
    assert str(seen(deer(), np.eye(3), Y_UP, "as asked")) == "+y is up and +z in front, as asked"
    said = "+z is up and +x in front, as its file says, the front as its shape shows"
    assert str(seen(deer(), FACES_X @ Z_UP.T, Z_UP, "as its file says")) == said


@pytest.mark.parametrize(("turned", "said"), FILES)
def test_the_source_is_seen_from_where_the_target_is_whatever_its_axes_are(turned: FloatArray, said: str) -> None:
    points = deer().positions
    angle = np.radians(20.0)
    aside = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    there = 3.0 * points @ aside @ turned
    np.testing.assert_allclose(there @ matching_turn(there, points @ Z_UP.T, Z_UP), 3.0 * points, atol=1e-9)


@cache
def usual_gallery() -> Gallery:
    return draw_gallery(identity_result(1, (deer(), deer())), size=SIZE)


@pytest.mark.slow
@pytest.mark.parametrize(("turned", "said"), FILES[1::2])
def test_reports_show_a_model_alike_whatever_axes_its_file_has(turned: FloatArray, said: str) -> None:
    usual, other = deer(), deer().with_positions(deer().positions @ turned)
    expected = usual_gallery()
    found = draw_gallery(identity_result(1, (other, usual)), size=SIZE)
    assert found.orientation.startswith(said)
    for one, two in zip(expected.looks, found.looks, strict=True):
        # Only rounding differs, at an edge here or there; lying on its tail, the deer covers other pixels.
        assert np.mean(np.abs(one.target.astype(int) - two.target)) < 0.5
        assert np.mean(np.abs(one.source.astype(int) - two.source)) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axis", "words", "said"),
    [
        ("Z", (), "+z is up and -y in front, as its file says"),
        ("Y", (), "+y is up and +z in front, as its file says"),
        ("Z", ("--up", "y"), "+y is up and +z in front, as asked"),
    ],
)
def test_the_report_takes_what_a_usd_file_or_the_user_says(run, axis, words, said):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    write_mesh("a.usda", cube())
    file = Path("a.usda")
    file.write_text(re.sub(r'upAxis = "\w"', f'upAxis = "{axis}"', file.read_text()))
    assert run("match -t a.usda -s a.usda --level 2 -k 5 -o R").code == 0
    assert run("report R", *words, "-o", "r.html").code == 0
    assert f"Of the target, {said}." in Path("r.html").read_text()
