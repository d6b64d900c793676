"""Texture bakes: what must come out exactly, within the filter, and not at all."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from examples.shapes import torus
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.subdivision import Level, refine
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import triangle_areas, triangle_neighbors
from cagemap.transfer import (
    BakeOptions,
    bake_face_colors,
    bake_texture,
    prepare_transfer,
    target_tiles,
    unwrap,
)
from cagemap.transfer import baking as bake_module
from cagemap.transfer.locate import TexelSamples
from cagemap.transfer.mip_maps import halved, low_passed
from cagemap.transfer.textured_surface import TexturedSurface

from transfer_reference import look_up_slowly
from transfer_scenes import crossed_cube, face_texture, identity_map, plane, plane_map, spectrum

BARE = BakeOptions(dilation=0)


def noise(height: int, width: int, channels: int, dtype: str, seed: int = 4711) -> np.ndarray:
    values = np.random.default_rng(seed).random((height, width, channels))
    return (values * np.iinfo(dtype).max).astype(dtype) if dtype.startswith("uint") else values.astype(dtype)


def torn_map(level: Level) -> PointMap:
    """Every vertex to a random place of the same surface."""
    rng, n = np.random.default_rng(97), level.n_vertices
    surface = TriangleSurface.from_faces(level.positions, level.faces)
    return PointMap.from_arrays(surface, surface, rng.integers(0, 2 * level.n_faces, n), rng.dirichlet((1, 1, 1), n))


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float16", "float32"])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_identity_gives_the_texture_back(dtype: str, channels: int) -> None:
    level = plane(9, 7)
    texture = noise(60, 50, channels, dtype)
    baked = bake_texture(prepare_transfer(level, level, identity_map(level)), texture, size=(60, 50))
    assert baked.dtype == texture.dtype
    if dtype.startswith("uint"):
        np.testing.assert_array_equal(baked, texture)
    else:  # interpolation weights are exact to rounding, values are below 1
        np.testing.assert_allclose(baked, texture, rtol=0, atol=1e-3 if dtype == "float16" else 1e-6)


def test_holes_get_no_texels() -> None:
    level = plane(4, 4)
    holes = np.zeros(16, dtype=bool)
    holes[[5, 6, 9, 10]] = True  # the middle
    transfer = prepare_transfer(level, level, identity_map(level), holes=holes)
    baked = bake_texture(transfer, np.full((64, 64, 1), 200, np.uint8), size=64, options=BARE)
    # Their rim is a border of the island: a gutter lies around it, and nothing further in.
    assert np.all(baked[19:45, 19:45] == 0)
    assert np.all(np.delete(baked.reshape(64, 64), np.s_[16:48], axis=0) == 200)
    assert np.all(baked[30, 16] == 200)


@pytest.mark.parametrize("size", [32, 64])
def test_identity_is_exact_where_triangles_are_smaller_than_texels(size: int) -> None:
    """Finer rasters find small triangles; they do not blur what is not shrunk."""
    level = plane(64, 64)
    texture = noise(size, size, 3, "uint8")
    transfer = prepare_transfer(level, level, identity_map(level))
    assert bake_module.make_canvas(transfer, size, BakeOptions()).supersample > 1
    np.testing.assert_array_equal(bake_texture(transfer, texture, size=size), texture)


def test_a_texel_that_spans_more_than_samples_can_see_reads_a_smaller_image() -> None:
    """Stripes one texel wide, shrunk by 64: grey, where 16 samples a side would hit them by chance."""
    level = plane(2, 2)
    texture = np.zeros((2048, 2048, 1), dtype=np.uint8)
    texture[:, ::2] = 255
    texture[::3] //= 2
    baked = bake_texture(prepare_transfer(level, level, identity_map(level)), texture, size=32)
    assert np.abs(baked[1:-1, 1:-1].astype(float) - texture.mean()).max() <= 1


@pytest.mark.parametrize("angle", [0.0, 10.0, 30.0])
def test_a_checker_that_shrinks_by_four_does_not_alias(angle: float) -> None:
    """Squares of 8 texels become squares of 2, turned; beside their own frequencies there is next to nothing."""
    squares = np.arange(512) // 8
    checker = ((squares[:, None] + squares) % 2).astype(np.float32)
    turn = np.array([[np.cos(a := np.radians(angle)), -np.sin(a)], [np.sin(a), np.cos(a)]])
    level, source, size = plane(32, 32), plane(32, 32), 84
    point_map = plane_map(level, 32, 32, lambda p: 0.5 + (p - 0.5) @ turn.T * (4 * size / 512))
    transfer = prepare_transfer(level, source, point_map)
    small, large = (bake_texture(transfer, checker, size=s)[..., 0] for s in (size, 8 * size))
    # 8 times larger nothing is lost: its low frequencies are what the small image should have.
    expected, found = spectrum(large, size), spectrum(small, size)
    beside = found[expected < 0.01 * expected.max()]
    assert beside.max() < 0.025 * expected.max()  # 0.09 with a box of 16 samples
    assert found.max() > 0.6 * expected.max()


def test_detail_of_three_texels_comes_through_a_shift() -> None:
    level = plane(8, 8)
    shifted = plane_map(level, 8, 8, lambda p: p + 0.5 / 96)
    transfer = prepare_transfer(level, level, shifted)
    rows, columns = np.indices((96, 96)) + 0.5
    wave = lambda y, x: (0.5 + 0.2 * np.sin(1.4 * x) + 0.2 * np.cos(1.1 * y + 0.4 * x))[..., None]  # noqa: E731
    texture, inside = wave(rows, columns).astype(np.float32), np.s_[6:-6, 6:-6]
    kinds = ("linear", "smooth")
    baked = [bake_texture(transfer, texture, size=96, options=BakeOptions(filter=kind)) for kind in kinds]
    off = [np.sqrt(np.mean((image - wave(rows - 0.5, columns + 0.5))[inside] ** 2)) for image in baked]
    assert off[1] < off[0] / 3  # 0.012 and 0.042


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_hard_edges_get_no_rings_and_alpha_stays_linear(dtype: str) -> None:
    level = plane(8, 8)
    transfer = prepare_transfer(level, level, plane_map(level, 8, 8, lambda p: p * 0.61 + 0.2))
    one = 255 if dtype == "uint8" else 1
    texture = np.zeros((64, 64, 4), dtype=dtype)
    texture[:, 30:] = one
    texture[31:, :, 3] = one
    kinds = ("smooth", "linear")
    smooth, linear = (bake_texture(transfer, texture, size=96, options=BakeOptions(filter=kind)) for kind in kinds)
    along = smooth[48, :, 0].astype(float)
    assert (np.diff(along) >= 0).all()
    assert (along.min(), along.max()) == (0, one)
    assert np.abs(smooth[..., :3].astype(float) - linear[..., :3]).max() > 0
    np.testing.assert_array_equal(smooth[..., 3], linear[..., 3])


@pytest.mark.parametrize(("size", "reach"), [(32, 40), (96, 8), (200, 8)])
def test_a_texel_that_is_no_number_spoils_nothing_but_itself(size: int, reach: int) -> None:
    level = plane(8, 8)
    transfer = prepare_transfer(level, level, identity_map(level))
    clean = noise(128, 128, 3, "float32")
    dirty = clean.copy()
    dirty[64, 64] = np.nan
    baked, expected = (bake_texture(transfer, texture, size=size) for texture in (dirty, clean))
    at = np.abs((np.arange(size) + 0.5) * (128 / size) - 64.5)
    away = np.maximum(at[:, None], at)
    np.testing.assert_array_equal(baked[away > reach], expected[away > reach])
    assert np.isfinite(baked[away > 2]).all()


def test_noise_keeps_its_range() -> None:
    level = plane(8, 8)
    transfer = prepare_transfer(level, level, plane_map(level, 8, 8, lambda p: p * 0.61 + 0.2))
    texture = (0.2 + 0.6 * noise(64, 64, 2, "float32")).astype(np.float32)
    baked = bake_texture(transfer, texture, size=96)
    assert texture.min() <= baked.min()
    assert baked.max() <= texture.max()


def test_smooth_lookups_see_nothing_beside_an_island() -> None:
    """The layout covers the middle of the image; what is painted two texels beside it does not matter."""
    level = plane(8, 8, lambda points: 0.25 + 0.5 * points)
    transfer = prepare_transfer(level, level, plane_map(level, 8, 8, lambda p: 0.02 + 0.93 * p))
    textures = [noise(64, 64, 3, "uint8", seed) for seed in (1, 2)]
    inside = np.s_[15:49, 15:49]
    textures[1][inside] = textures[0][inside]
    baked = [bake_texture(transfer, texture, size=64) for texture in textures]
    np.testing.assert_array_equal(*baked)


def test_labels_are_never_mixed() -> None:
    for cells in (8, 64):  # in the second, triangles are smaller than texels
        level = plane(cells, cells)
        transfer = prepare_transfer(level, level, plane_map(level, cells, cells, lambda p: 0.9 * p[:, ::-1] ** 1.3))
        labels = np.array([[3], [40], [200]], dtype=np.uint8)[np.random.default_rng(3).integers(0, 3, (64, 64))]
        for size in (20, 90):
            baked = bake_texture(transfer, labels, size=size, options=BakeOptions(filter="nearest"))
            assert set(np.unique(baked)) == {3, 40, 200}
            if cells == 8 and size == 90:
                # Every texel is the one that its centre lies in.
                at = 0.9 * ((np.arange(90) + 0.5) / 90) ** 1.3
                rows, columns = (64 * (1 - at)).astype(int), (64 * at[::-1]).astype(int)
                expected = labels[np.ix_(rows, columns)].transpose(1, 0, 2)
                assert np.mean(baked == expected) > 0.8  # the map is linear between its vertices
    with pytest.raises(ParameterError, match="filter: expected smooth, linear, nearest"):
        bake_texture(transfer, labels, size=9, options=BakeOptions(filter="cubic"))  # type: ignore[arg-type]


@settings(deadline=None, max_examples=30)
@given(height=st.integers(1, 40), width=st.integers(1, 40), seed=st.integers(0, 99))
def test_halving_keeps_what_is_constant_and_reads_only_what_is_covered(height: int, width: int, seed: int) -> None:
    pixels = noise(height, width, 2, "float32", seed)
    covered = (noise(height, width, 1, "float32", seed + 1)[..., 0] > 0.5).astype(np.float32)
    flat, share = halved(np.full_like(pixels, 0.7), covered)
    assert flat.shape == (-(-height // 2), -(-width // 2), 2)
    np.testing.assert_allclose(flat, 0.7, atol=1e-5)
    np.testing.assert_allclose(share.mean(), covered.mean(), atol=1e-4)
    dirty = np.where(covered[..., None] > 0, 0.7, pixels).astype(np.float32)
    half, _ = halved(dirty, covered)
    np.testing.assert_allclose(half[share > 0.1], 0.7, atol=1e-3)
    np.testing.assert_allclose(low_passed(dirty, covered)[covered > 0], 0.7, atol=1e-3)
    whole = np.rint(255 * pixels).astype(np.uint8)
    limits = whole.min(axis=(0, 1)), whole.max(axis=(0, 1))
    kept = low_passed(whole, covered, whole)
    assert kept.dtype == np.uint8
    np.testing.assert_array_equal(kept, np.rint(np.clip(low_passed(whole, covered), *limits)))


@pytest.mark.parametrize(("dtype", "value"), [("uint8", 201), ("uint16", 50001), ("float16", 0.1), ("float32", 1 / 3)])
@pytest.mark.parametrize("size", [40, 150])
def test_a_constant_stays_the_same_to_the_last_bit(dtype: str, value: float, size: int) -> None:
    control = torus()
    target, source = refine(unwrap(control), 1).finest, refine(unwrap(control), 1).finest
    texture = np.full((128, 128, 2), value, dtype=dtype)
    baked = bake_texture(prepare_transfer(target, source, identity_map(target)), texture, size=size)
    assert (baked == texture[0, 0]).all()


def test_linear_colours_follow_a_linear_map_exactly() -> None:
    # Image of the map: the square turned by 30 degrees and shrunk to 0.6, well inside the source.
    c, s = 0.6 * np.cos(np.pi / 6), 0.6 * np.sin(np.pi / 6)
    matrix, offset = np.array([[c, -s], [s, c]]), np.array([0.45, 0.12])
    target, source = plane(5, 4), plane(13, 11)
    point_map = plane_map(target, 13, 11, lambda p: p @ matrix.T + offset)
    baked = bake_texture(prepare_transfer(target, source, point_map), _ramps(64, 64), size=100, options=BARE)
    expected = _texel_centres(100, 100) @ matrix.T + offset
    np.testing.assert_allclose(baked[:, :, :2], expected, rtol=0, atol=1e-6)  # the texture is float32


def test_linear_colours_follow_a_smooth_map_to_second_order() -> None:
    def warp(points: np.ndarray) -> np.ndarray:
        return 0.5 + 0.6 * (points - 0.5) + 0.08 * np.sin(2 * np.pi * points[..., ::-1])

    errors = []
    for n in (8, 16, 32):
        target = plane(n, n)
        point_map = plane_map(target, 13, 11, warp)
        baked = bake_texture(prepare_transfer(target, plane(13, 11), point_map), _ramps(64, 64), size=200)
        errors.append(float(np.abs(baked[:, :, :2] - warp(_texel_centres(200, 200))).max()))
    # Linear interpolation of the map over target triangles: h^2 / 8 times its second derivative, 0.08 (2 pi)^2.
    assert errors[0] < 1.2 * 0.08 * (2 * np.pi) ** 2 / 8 / 8**2
    assert errors[1] < 0.3 * errors[0]
    assert errors[2] < 0.3 * errors[1]


def test_no_colour_crosses_a_seam() -> None:
    colors = np.array([[250, 0, 0], [0, 250, 0], [0, 0, 250], [250, 250, 0], [0, 250, 250], [250, 0, 250]], np.uint8)
    cell = 40
    source = refine(crossed_cube(), 3).finest
    target = refine(unwrap(crossed_cube()), 3).finest
    transfer = prepare_transfer(target, source, identity_map(target))
    baked = bake_texture(transfer, face_texture(colors, cell), size=256, options=BARE)
    truth = bake_face_colors(transfer, colors / 250.0, size=256, dtype=np.float32, options=BARE)
    # 1 where a bilinear lookup stays inside one island: a texel's width from its border.
    inner = np.zeros((cell, cell, 1), dtype=np.float32)
    inner[1:-1, 1:-1] = 1
    sure = bake_texture(transfer, np.tile(inner, (2, 3, 1)), size=256, options=BARE)[:, :, 0] == 1
    pure = (np.isin(truth, (0, 1))).all(axis=2)
    assert (sure & pure).mean() > 0.35
    np.testing.assert_array_equal(baked[sure & pure], np.rint(250 * truth[sure & pure]))
    # Elsewhere at most two neighbouring islands mix, by half a texel: never more than half of a foreign colour.
    filled = baked.any(axis=2)
    assert np.abs(baked.astype(float) - 250 * truth)[filled & pure].max() <= 125 + 1


def test_surface_points_are_carried_not_texture_coordinates() -> None:
    # Two source islands far apart in the layout; a coarse target triangle lies over the seam between them.
    source = plane(8, 8)
    assert source.faces is not None
    left = source.positions[source.faces].mean(axis=1)[:, 0] < 0.5
    uvs = np.concatenate([source.positions[:, :2] * (0.2, 1), source.positions[:, :2] * (0.2, 1) + (0.75, 0)])
    split = source.with_uvs(uvs, source.faces + np.where(left, 0, len(source.positions))[:, None])
    texture = np.zeros((64, 256, 1), dtype=np.float32)
    texture[:, :64] = 1  # the left island is 1, the right one 3, and what lies between them 100
    texture[:, 64:192] = 100
    texture[:, 192:] = 3
    target = plane(1, 1)
    point_map = plane_map(target, 8, 8, lambda p: p)
    baked = bake_texture(prepare_transfer(target, split, point_map), texture, size=100, options=BARE)
    np.testing.assert_array_equal(baked[:, :50], 1)
    np.testing.assert_array_equal(baked[:, 50:], 3)


def test_fine_stripes_become_grey_instead_of_moire() -> None:
    level = plane(6, 6)
    stripes = np.zeros((16, 500, 1), dtype=np.float32)
    stripes[:, ::2] = 1
    baked = bake_texture(prepare_transfer(level, level, identity_map(level)), stripes, size=(16, 61))
    # A texel spans 8.2 stripes: a box over it sees between 4 and 4.2 white ones.
    np.testing.assert_allclose(baked, 0.5, rtol=0, atol=0.03)


def test_texture_coordinates_outside_the_square_repeat_or_clamp() -> None:
    texture = noise(32, 32, 3, "uint8")
    inside, target = plane(8, 8), plane(8, 8)
    shifted = plane(8, 8, lambda points: points + np.array([2, -1]))
    expected = bake_texture(prepare_transfer(target, inside, identity_map(target)), texture, size=32)
    transfer = prepare_transfer(target, shifted, identity_map(target))
    np.testing.assert_array_equal(bake_texture(transfer, texture, size=32), expected)
    clamped = bake_texture(transfer, texture, size=32, options=BakeOptions(wrap="clamp"))
    np.testing.assert_array_equal(clamped, np.broadcast_to(texture[-1, -1], clamped.shape))


def test_border_texels_never_mix_with_the_opposite_border() -> None:
    texture = np.zeros((8, 8, 1), dtype=np.uint8)
    texture[:, 0] = 255
    level = plane(4, 4)
    baked = bake_texture(prepare_transfer(level, level, identity_map(level)), texture, size=64)
    assert (baked[:, 40:] == 0).all()


def test_islands_go_on_for_a_texel_beyond_their_border() -> None:
    # A plane cut in two islands: colours linear in position must stay linear where an island is extended.
    target = plane(8, 8)
    assert target.faces is not None
    left = target.positions[target.faces].mean(axis=1)[:, 0] < 0.5
    uvs = np.concatenate([target.positions[:, :2] * (0.5, 1), target.positions[:, :2] * (0.5, 1) + (0.25, 0)])
    moved = target.faces + np.where(left, 0, len(target.positions))[:, None]
    cut = target.with_uvs(uvs, moved)
    source = plane(8, 8)
    baked = bake_texture(prepare_transfer(cut, source, identity_map(source)), _ramps(64, 64), size=200, options=BARE)
    # The left island ends at column 50, the right one begins at column 100; each goes on for one texel.
    x = (np.arange(200) + 0.5) / 200
    np.testing.assert_allclose(baked[5:-5, 4:51, 0] - 2 * x[4:51], 0, atol=1e-6)
    np.testing.assert_allclose(baked[5:-5, 99:146, 0] - 2 * (x[99:146] - 0.25), 0, atol=1e-6)
    assert not baked[:, 52:98].any()


def test_no_seam_shows_at_any_mip_level() -> None:
    # Colour is the position in space: across a seam it must agree with itself to the size of a texel of that level.
    level = refine(unwrap(torus(6, 4), padding=1 / 32), 3).finest  # 16 texels between islands: 2 at the last level
    transfer = prepare_transfer(level, level, identity_map(level))
    surface, size = transfer.target, 512
    canvas = bake_module.make_canvas(transfer, size, BakeOptions())

    def shade(samples: TexelSamples) -> np.ndarray:
        corners = surface.positions[surface.triangles[samples.triangle]]
        return np.asarray(samples.mean(np.einsum("sc,scd->sd", samples.barycentric, corners)))

    ones = np.ones((len(surface.triangles), 2), dtype=np.int32)
    image = bake_module.run_bake(transfer, canvas, ones, shade, 3, np.float32, BakeOptions())
    corner_uvs = surface.corner_uvs()
    triangle, opposite = np.nonzero(triangle_neighbors(surface.layout()[1]) < 0)
    first, second = (opposite + 1) % 3, (opposite + 2) % 3
    middle = 0.5 * (corner_uvs[triangle, first] + corner_uvs[triangle, second])
    expected = 0.5 * sum(surface.positions[surface.triangles[triangle, corner]] for corner in (first, second))
    area = triangle_areas(surface.positions, surface.triangles).sum()
    flat = triangle_areas(surface.uvs, surface.uv_triangles).sum()
    texel = np.sqrt(area / flat) / size  # length in space
    for _ in range(4):
        error = np.linalg.norm(look_up_slowly(image, middle) - expected, axis=1)
        assert error.max() < 0.4 * texel
        image = image.reshape(len(image) // 2, 2, -1, 2, 3).mean(axis=(1, 3))
        texel *= 2


def test_background_takes_the_nearest_island() -> None:
    control = torus()
    level = refine(unwrap(control), 1).finest
    transfer = prepare_transfer(level, level, identity_map(level))
    texture = noise(64, 64, 3, "uint8")
    bare = bake_texture(transfer, texture, size=64, options=BARE)
    full = bake_texture(transfer, texture, size=64)
    covered = bare.any(axis=2)
    np.testing.assert_array_equal(full[covered], bare[covered])
    assert full.any(axis=2).all()
    assert {tuple(t) for t in full[~covered]} <= {tuple(t) for t in full[covered]}


def test_triangles_smaller_than_texels_are_averaged() -> None:
    level = plane(64, 64)
    texture = np.zeros((64, 64, 1), dtype=np.float32)
    texture[::2, ::2] = 1
    baked = bake_texture(prepare_transfer(level, level, identity_map(level)), texture, size=16)
    # At the image's edge there is nothing beyond to average with.
    np.testing.assert_allclose(baked[1:-1, 1:-1], 0.25, rtol=0, atol=1e-6)
    np.testing.assert_allclose(baked, 0.25, rtol=0, atol=0.03)


def test_neither_bands_nor_threads_change_a_texel(monkeypatch: pytest.MonkeyPatch) -> None:
    level = refine(unwrap(torus()), 1).finest
    transfer = prepare_transfer(level, level, torn_map(level))  # where walks that begin elsewhere may end elsewhere
    texture = noise(300, 300, 3, "uint8")
    wholes = [bake_texture(transfer, texture, size=96, options=BakeOptions(threads=1, supersample=s)) for s in (1, 3)]
    monkeypatch.setattr(bake_module, "_BAND_TEXELS", 700)
    monkeypatch.setattr(bake_module, "_SAMPLE_BUDGET", 3000)
    for supersample, whole in zip((1, 3), wholes, strict=True):
        parts = bake_texture(transfer, texture, size=96, options=BakeOptions(threads=3, supersample=supersample))
        np.testing.assert_array_equal(parts, whole)


def test_number_type_may_be_chosen() -> None:
    level = plane(3, 3)
    transfer = prepare_transfer(level, level, identity_map(level))
    texture = noise(20, 20, 1, "uint8")
    wide = bake_texture(transfer, texture, size=20, dtype=np.uint16)
    np.testing.assert_array_equal(wide, texture.astype(np.uint16) * 257)
    np.testing.assert_allclose(bake_texture(transfer, texture, size=20, dtype=np.float32), texture / 255, atol=1e-6)


def test_pixels_of_any_layout_and_sizes_of_any_whole_number_give_the_same() -> None:
    level = plane(2, 2)
    transfer = prepare_transfer(level, level, identity_map(level))
    pixels = noise(8, 8, 3, "uint16")
    expected = bake_texture(transfer, pixels, size=8)
    np.testing.assert_array_equal(bake_texture(transfer, pixels.astype(">u2"), size=np.int64(8)), expected)
    np.testing.assert_array_equal(bake_texture(transfer, pixels, size=(np.int32(8), 8)), expected)
    long = bake_texture(transfer, pixels.astype(np.longdouble), size=8)
    np.testing.assert_allclose(long, bake_texture(transfer, pixels.astype(np.float64), size=8))
    for size in (8.5, "8", None, (8,), (8, 8, 8), np.float64(8)):
        with pytest.raises(ParameterError, match="whole number of texels"):
            bake_texture(transfer, pixels, size=size)  # type: ignore[arg-type]


def test_udim_tiles_of_the_source_and_of_the_target() -> None:
    plain, size = plane(8, 8), 48
    wide = plane(8, 8, lambda points: points * (2, 1))
    texture = noise(size, 2 * size, 3, "uint8")
    tiles = {1001: texture[:, :size], 1002: texture[:, size:]}
    transfer = prepare_transfer(plain, wide, identity_map(plain))
    expected = bake_texture(prepare_transfer(plain, plain, identity_map(plain)), texture, size=(size, 2 * size))
    baked = bake_texture(transfer, tiles, size=(size, 2 * size))
    # At the border between two tiles the bilinear filter is cut off.
    np.testing.assert_array_equal(baked, expected)

    assert target_tiles(TexturedSurface.from_level(plain)) == [0]
    assert target_tiles(TexturedSurface.from_level(wide)) == [1001, 1002]
    back = prepare_transfer(wide, plain, identity_map(plain))
    for tile, pixels in tiles.items():
        part = bake_texture(back, texture, size=size, options=BakeOptions(tile=tile))
        np.testing.assert_array_equal(part, pixels)


def test_missing_tiles_and_islands_outside_the_grid_are_refused() -> None:
    plain = plane(4, 4)
    wide = plane(4, 4, lambda points: points * (2, 1))
    tile = noise(8, 8, 3, "uint8")
    with pytest.raises(ParameterError, match=r"tiles \[1002\]"):
        bake_texture(prepare_transfer(plain, wide, identity_map(plain)), {1001: tile}, size=8)
    with pytest.raises(ParameterError, match="one number of channels"):
        bake_texture(prepare_transfer(plain, wide, identity_map(plain)), {1001: tile, 1002: tile[:, :, :1]}, size=8)
    with pytest.raises(ParameterError, match="UDIM grid"):
        target_tiles(TexturedSurface.from_level(plane(4, 4, lambda points: points - (3, 0))))


@pytest.mark.parametrize(
    ("layout", "tile", "found"),
    [
        (
            lambda points: 0 * points + 0.3,
            0,
            "unit square, got 32 triangles, 32 of them in one point or on a line and 0",
        ),
        (lambda points: points * (1, 0), 0, "32 of them in one point"),
        (lambda points: points - (3, 0), 0, "unit square, got 32 triangles, 0 of them .* and 32 outside"),
        (lambda points: points, 1002, "UDIM tile 1002, got 32 triangles"),
    ],
)
def test_a_layout_that_covers_nothing_is_refused(
    layout: Callable[[np.ndarray], np.ndarray], tile: int, found: str
) -> None:
    """Its image came out black."""
    plain, target = plane(4, 4), plane(4, 4, layout)
    transfer = prepare_transfer(target, plain, identity_map(plain))
    with pytest.raises(ParameterError, match=found):
        bake_texture(transfer, noise(8, 8, 3, "uint8"), size=8, options=BakeOptions(tile=tile))


def test_tiles_that_only_points_lie_in_are_none() -> None:
    """Stray texture coordinates of faces without a texture got a black image."""
    level = plane(4, 4)
    assert level.layout is not None
    uvs, corners = level.layout
    corners = corners.copy()
    corners[0] = len(uvs)
    stray = level.with_uvs(np.vstack([uvs, [[1.5, 0.5]]]), corners)
    assert target_tiles(TexturedSurface.from_level(stray)) == [0]


def test_wrong_input_is_refused_with_its_remedy() -> None:
    level = plane(4, 4)
    assert level.faces is not None
    naked = Level(level.positions, level.faces, level.face_parents)
    texture = noise(8, 8, 3, "uint8")
    with pytest.raises(ParameterError, match="`unwrap`"):
        bake_texture(prepare_transfer(naked, level, identity_map(level)), texture, size=8)
    with pytest.raises(ParameterError, match="target and source exchanged"):
        prepare_transfer(plane(3, 3), level, identity_map(level))
    with pytest.raises(ParameterError, match="target and source exchanged"):
        prepare_transfer(level, plane(1, 1), identity_map(level))
    transfer = prepare_transfer(level, level, identity_map(level))
    with pytest.raises(ParameterError, match="size: expected"):
        bake_texture(transfer, texture, size=0)
    with pytest.raises(ParameterError, match="image of shape"):
        bake_texture(transfer, texture[None], size=8)
    with pytest.raises(ParameterError, match="unsigned integers or floats"):
        bake_texture(transfer, texture.astype(np.int32), size=8)
    with pytest.raises(ParameterError, match="wrap"):
        bake_texture(transfer, texture, size=8, options=BakeOptions(wrap="mirror"))  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="supersample"):
        bake_texture(transfer, texture, size=8, options=BakeOptions(supersample=99))
    with pytest.raises(ParameterError, match="refine it once"):
        prepare_transfer(Level(level.positions, None, level.face_parents), level, identity_map(level))


def test_a_torn_map_still_gives_texture_colours() -> None:
    # Every vertex to a random place: nothing sensible to see, but no crash, no hang and no invented colour.
    level = refine(unwrap(torus()), 1).finest
    point_map = torn_map(level)
    texture = np.full((16, 16, 1), 0.5, dtype=np.float32)
    texture[::2] = 0.25
    baked = bake_texture(prepare_transfer(level, level, point_map), texture, size=64)
    assert baked.min() >= 0.25
    assert baked.max() <= 0.5


def _ramps(height: int, width: int) -> np.ndarray:
    """A texture whose colour at (u, v) is (u, v, 1), by bilinear interpolation exactly but at the outermost texels."""
    u, v = _texel_centres(height, width).transpose(2, 0, 1)
    return np.stack([u, v, np.ones_like(u)], axis=2).astype(np.float32)


def _texel_centres(height: int, width: int) -> np.ndarray:
    """(h, w, 2) texture coordinates of the texels' centres."""
    rows, columns = np.mgrid[0:height, 0:width] + 0.5
    return np.stack([columns / width, 1 - rows / height], axis=2)
