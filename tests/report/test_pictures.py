"""Pictures: what is drawn is where and how it should be."""

import sys

import numpy as np
import pytest

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import decode_srgb, encode_srgb
from cagemap.pictures import (
    BALANCE_SCALE,
    VIEWS,
    Model,
    Skin,
    View,
    draw_dots,
    frame,
    position_colors,
    render,
    render_skins,
    sample_texture,
    scalar_colors,
    turn_angle,
    visible_points,
)

from refusals import refuses

ray_casting = sys.modules[render.__module__]
SIZE = {"width": 96, "height": 72}
STRAIGHT = View("straight", 0.0, 0.0)


def cube(shift: float = 0.0, scale: float = 1.0) -> Model:
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    return Model(corners * scale + shift, triangles)


def screen() -> tuple[Model, np.ndarray]:
    """A square facing +Z, and its corner UVs with v up."""
    positions = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    return Model(positions, triangles), positions[triangles][..., :2]


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.name)
def test_frame_keeps_everything_inside_and_uses_the_space(view: View) -> None:
    points = np.random.default_rng(5).normal(size=(400, 3)) * [3.0, 1.0, 0.2] + [100.0, -20.0, 3.0]
    camera = frame(points, view, aspect=4 / 3)
    spots = camera.project(points, 400, 300) / [400, 300]
    assert spots.min() >= 0.0
    assert spots.max() <= 1.0
    assert np.ptp(spots, axis=0).max() > 0.75  # the border is 6 % on each side, perspective costs a little


def test_turning_by_the_difference_makes_figures_face_alike() -> None:
    points = np.random.default_rng(23).normal(size=(9, 3))
    angle = np.radians(130.0)
    turned = points @ np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    view = View("any", 20.0, 10.0)
    further = View("any", 20.0 + turn_angle(points, turned), 10.0)
    pictures = [frame(points, view).project(points, 80, 60), frame(turned, further).project(turned, 80, 60)]
    np.testing.assert_allclose(pictures[0], pictures[1], atol=1e-9)


def test_camera_rays_pass_through_the_points_they_project_to() -> None:
    camera = frame(cube().positions, VIEWS[0])
    directions = camera.rays(8, 6)
    points = camera.eye + 5.0 * directions
    rows, columns = np.divmod(np.arange(48), 8)
    np.testing.assert_allclose(camera.project(points, 8, 6), np.stack([columns, rows], 1) + 0.5, atol=1e-9)


def test_texture_row_zero_is_the_top_and_u_runs_right() -> None:
    model, uvs = screen()
    texture = np.zeros((2, 2, 3))
    texture[0, 0], texture[0, 1], texture[1, 0], texture[1, 1] = [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]
    picture = render(
        model, Skin(texture=texture, corner_uvs=uvs), frame(model.positions, STRAIGHT), floor=False, **SIZE
    )
    upper_left, upper_right, lower_left = (picture[row, column] for row, column in ((14, 24), (14, 72), (58, 24)))
    assert upper_left.argmax() == 0
    assert upper_right.argmax() == 1
    assert lower_left.argmax() == 2


def test_sampling_hits_texel_centres_exactly_and_is_linear_between() -> None:
    texture = np.random.default_rng(7).random((4, 5, 3))
    centres = np.array([[(column + 0.5) / 5, 1 - (row + 0.5) / 4] for row in range(4) for column in range(5)])
    np.testing.assert_allclose(sample_texture(texture, centres), texture.reshape(-1, 3), atol=1e-12)
    between = sample_texture(texture, np.array([[2.0 / 5, 1 - 0.5 / 4]]))[0]
    np.testing.assert_allclose(between, (texture[0, 1] + texture[0, 2]) / 2, atol=1e-12)
    np.testing.assert_allclose(sample_texture(np.full((1, 1, 3), 0.3), np.array([[0.9, -2.0]])), 0.3)
    # Repeating textures and layouts in other tiles: as bakes read them.
    for shift in ([1.0, 0.0], [-2.0, 3.0]):
        np.testing.assert_allclose(sample_texture(texture, centres + shift), texture.reshape(-1, 3), atol=1e-12)
    # At the border is no colour of the other side.
    for edges in ([[0.0, 0.0], [1.0, 1.0]], [[-1e-9, 0.0], [1.0, 1.0 + 1e-9]]):
        np.testing.assert_allclose(sample_texture(texture, np.array(edges)), texture[[-1, 0], [0, -1]], atol=1e-6)


def test_background_is_untouched_without_a_floor_and_shadowed_with_one() -> None:
    model = cube()
    camera = frame(model.positions, VIEWS[0])
    plain, floored = render(model, Skin(), camera, floor=False, **SIZE), render(model, Skin(), camera, **SIZE)
    assert (plain[0] == 255).all()
    assert (plain[:, 0] == 255).all()
    assert (floored <= plain).all()
    assert (floored < plain).any()


def test_picture_does_not_depend_on_unit_or_place() -> None:
    near, far = cube(), cube(shift=2e3, scale=1e3)
    pictures = [render(m, Skin(), frame(m.positions), **SIZE).astype(int) for m in (near, far)]
    # Rays that graze an edge may fall on either side of it.
    assert np.mean(np.abs(pictures[0] - pictures[1]) > 2) < 0.01


def test_face_and_vertex_colours_arrive() -> None:
    model = cube()
    red = np.tile([1.0, 0.0, 0.0], (12, 1))
    for skin in (Skin(face_colors=red), Skin(vertex_colors=red[:8])):
        picture = render(model, skin, frame(model.positions), floor=False, **SIZE)
        drawn = picture[(picture != 255).any(-1)]
        assert (drawn[:, 0] >= drawn[:, 1]).all()
        assert drawn[:, 0].max() > 150


@pytest.mark.slow
def test_skins_of_one_view_are_drawn_with_few_more_rays_than_one(monkeypatch: pytest.MonkeyPatch) -> None:
    model = Model(np.random.default_rng(3).normal(size=(300, 3)), np.arange(300).reshape(100, 3))
    camera = frame(model.positions)
    skins = [Skin(), Skin(vertex_colors=np.tile([0.2, 0.4, 0.6], (300, 1)))] * 2
    alone = [render(model, skin, camera, **SIZE) for skin in skins]
    cast, counts = ray_casting._cast, list[int]()

    def counted(model: Model, origins: np.ndarray, directions: np.ndarray) -> dict[str, np.ndarray]:
        counts.append(len(directions))
        return cast(model, origins, directions)

    monkeypatch.setattr(ray_casting, "_cast", counted)
    render(model, skins[0], camera, **SIZE)
    rays_of_one = sum(counts)
    counts.clear()
    together = list(render_skins(model, skins, camera, (SIZE["width"], SIZE["height"])))
    assert sum(counts) < 2 * rays_of_one
    np.testing.assert_array_equal(together, alone)


@pytest.mark.slow
def test_light_of_the_sky_is_interpolated_on_smooth_surfaces_only(monkeypatch: pytest.MonkeyPatch) -> None:
    model, camera = cube(), frame(cube().positions)
    quick = render(model, Skin(), camera, width=600, height=460).astype(int)
    monkeypatch.setattr(ray_casting, "MIN_NORMAL_AGREEMENT", 2.0)  # never
    exact = render(model, Skin(), camera, width=600, height=460).astype(int)
    assert np.abs(quick - exact).max() <= 10
    assert np.abs(quick - exact).mean() < 0.05


def test_visible_knows_front_from_back() -> None:
    model = cube()
    camera = frame(model.positions, STRAIGHT)
    np.testing.assert_array_equal(
        visible_points(model, camera, np.array([[0.1, 0.2, 1.0], [0.1, 0.2, -1.0]])), [True, False]
    )


def test_dots_are_drawn_where_points_are_and_only_if_seen() -> None:
    model = cube()
    camera = frame(model.positions, STRAIGHT)
    image = np.full((72, 96, 3), 255, np.uint8)
    points, green = np.array([[0.5, 0.5, 1.0], [0.0, 0.0, -1.0]]), np.array([[0.0, 1.0, 0.0]] * 2)
    dotted = draw_dots(image, model, camera, points, green, radius=3.0)
    column, row = camera.project(points, 96, 72)[0].astype(int)
    np.testing.assert_array_equal(dotted[row, column], [0, 255, 0])
    np.testing.assert_array_equal(dotted[36, 48], [255, 255, 255])
    assert (image == 255).all()


def test_encodings_are_inverse() -> None:
    values = np.linspace(0, 1, 101)
    np.testing.assert_allclose(encode_srgb(decode_srgb(values)), values, atol=1e-6)  # the two branches meet within 1e-7


def test_scalar_colours_end_at_the_ends_and_nan_is_grey() -> None:
    colors = scalar_colors(np.array([-5.0, 0.0, 1.0, 9.0, np.nan]), 0.0, 1.0, BALANCE_SCALE)
    np.testing.assert_allclose(colors[[0, 1]], BALANCE_SCALE[[0, 0]])
    np.testing.assert_allclose(colors[[2, 3]], BALANCE_SCALE[[-1, -1]])
    np.testing.assert_allclose(colors[4], 0.6)


def test_equal_points_have_equal_map_colours() -> None:
    points = np.random.default_rng(11).normal(size=(50, 3))
    colors = position_colors(points, points)
    np.testing.assert_array_equal(position_colors(points[::3], points), colors[::3])
    plain = position_colors(points, points, cells=0)  # without a checker
    np.testing.assert_allclose(np.unique(np.round(colors / plain, 6)), [0.86, 1.0])
    assert colors.min() >= 0
    assert colors.max() <= 1


@pytest.mark.parametrize(
    ("skin", "words"),
    [
        (Skin(vertex_colors=np.zeros((7, 3))), r"vertex_colors.*\(8, 3\).*\(7, 3\)"),
        (Skin(texture=np.zeros((2, 2, 3))), "corner_uvs"),
    ],
)
def test_skins_that_do_not_fit_are_refused(skin: Skin, words: str) -> None:
    refuses(ParameterError, words, render, cube(), skin, frame(cube().positions), **SIZE)


def test_nothing_to_draw_is_refused() -> None:
    refuses(ParameterError, "triangles", Model, np.zeros((3, 3)), np.zeros((0, 3), np.int64))
    refuses(ParameterError, "finite", frame, np.full((2, 3), np.nan))
