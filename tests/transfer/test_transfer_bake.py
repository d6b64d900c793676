"""Texture bakes: what comes out exactly (under the identity every covered texel), within the filter, and not at all."""

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import torus
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.errors import ParameterError
from cagemap.maps.point_map import PointMap
from cagemap.numerics.threads import thread_limit
from cagemap.subdivision import Level, refine
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import normalize_rows
from cagemap.transfer import BakeOptions, bake_texture, prepare_transfer, unwrap
from cagemap.transfer import baking as bake_module
from cagemap.transfer.baking import make_layout
from cagemap.transfer.blend_shapes import carry_shape, prepare_shapes
from cagemap.transfer.locate import locate_centers, locate_samples, map_surface, whole_triangles
from cagemap.transfer.mip_maps import halve, low_passed
from cagemap.transfer.texels import rasterize_band
from cagemap.transfer.textured_surface import TexturedSurface
from cagemap.transfer.vectors import bake_normal_map, bake_vector_displacement

from bake_images import BARE, noise, ramps, texel_centres
from refusals import refuses
from transfer_scenes import crossed_cube, identity_map, plane, plane_map, spectrum


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


@pytest.mark.parametrize("size", [32, 64])
def test_identity_is_exact_where_triangles_are_smaller_than_texels(size: int) -> None:
    """Finer rasters find small triangles; they do not blur what is not shrunk."""
    level = plane(64, 64)
    texture = noise(size, size, 3, "uint8")
    transfer = prepare_transfer(level, level, identity_map(level))
    assert bake_module.make_layout(transfer, size, BakeOptions()).supersample > 1
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


@pytest.mark.parametrize(("dtype", "bright"), [("uint8", np.s_[30:]), ("float32", np.s_[:30])])
def test_hard_edges_get_no_rings(dtype: str, bright: slice) -> None:
    level = plane(8, 8)
    transfer = prepare_transfer(level, level, plane_map(level, 8, 8, lambda p: p * 0.61 + 0.2))
    one, low, high = (255, 60, 180) if dtype == "uint8" else (1, 0.25, 0.75)
    texture = np.full((64, 64, 4), low, dtype=dtype)
    texture[:, bright] = high
    texture[0, :2] = [[0], [one]]  # values are limited to a texture's range, which hides rings at its ends
    kinds = ("smooth", "linear")
    smooth, linear = (bake_texture(transfer, texture, size=96, options=BakeOptions(filter=kind)) for kind in kinds)
    along = smooth[48, :, 0].astype(float)
    assert np.abs(np.diff(along)).sum() == high - low
    assert (along.min(), along.max()) == (low, high)
    assert np.abs(smooth.astype(float) - linear).max() > 0


def test_a_colour_multiplied_by_alpha_stays_in_proportion_to_it() -> None:
    level = plane(8, 8)
    transfer = prepare_transfer(level, level, plane_map(level, 8, 8, lambda p: p * 0.61 + 0.2))
    rows, columns = np.indices((64, 64))
    alpha = np.clip(9.3 - np.hypot(rows - 31, columns - 33), 0, 1)[..., None].astype(np.float32)  # a soft-edged disc
    baked = bake_texture(transfer, np.concatenate([0.8 * alpha, 0.1 * alpha, 0 * alpha, alpha], axis=2), size=96)
    np.testing.assert_allclose(baked[..., :3], baked[..., 3:] * (0.8, 0.1, 0), atol=1e-6)  # 0.1 off with bilinear alpha


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
        bake_texture(transfer, labels, size=9, options=BakeOptions(filter="cubic"))
    refuses(ParameterError, "supersample: expected 1 with filter nearest", BakeOptions, filter="nearest", supersample=2)


@pytest.mark.slow
@settings(max_examples=30)
@given(height=st.integers(1, 40), width=st.integers(1, 40), seed=st.integers(0, 99))
def test_halving_keeps_what_is_constant_and_reads_only_what_is_covered(height: int, width: int, seed: int) -> None:
    pixels = noise(height, width, 2, "float32", seed)
    covered = (noise(height, width, 1, "float32", seed + 1)[..., 0] > 0.5).astype(np.float32)
    flat, share = halve(np.full_like(pixels, 0.7), covered)
    assert flat.shape == (-(-height // 2), -(-width // 2), 2)
    np.testing.assert_allclose(flat, 0.7, atol=1e-5)
    np.testing.assert_allclose(share.mean(), covered.mean(), atol=1e-4)
    dirty = np.where(covered[..., None] > 0, 0.7, pixels).astype(np.float32)
    half, _ = halve(dirty, covered)
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
    baked = bake_texture(prepare_transfer(target, source, point_map), ramps(64, 64), size=100, options=BARE)
    expected = texel_centres(100, 100) @ matrix.T + offset
    np.testing.assert_allclose(baked[:, :, :2], expected, rtol=0, atol=1e-6)  # the texture is float32


def test_linear_colours_follow_a_smooth_map_to_second_order() -> None:
    def warp(points: np.ndarray) -> np.ndarray:
        return 0.5 + 0.6 * (points - 0.5) + 0.08 * np.sin(2 * np.pi * points[..., ::-1])

    errors = []
    for n in (8, 16, 32):
        target = plane(n, n)
        point_map = plane_map(target, 13, 11, warp)
        baked = bake_texture(prepare_transfer(target, plane(13, 11), point_map), ramps(64, 64), size=200)
        errors.append(float(np.abs(baked[:, :, :2] - warp(texel_centres(200, 200))).max()))
    # Linear interpolation of the map over target triangles: h^2 / 8 times its second derivative, 0.08 (2 pi)^2.
    assert errors[0] < 1.2 * 0.08 * (2 * np.pi) ** 2 / 8 / 8**2
    assert errors[1] < 0.3 * errors[0]
    assert errors[2] < 0.3 * errors[1]


def test_triangles_smaller_than_texels_are_averaged() -> None:
    level = plane(64, 64)
    texture = np.zeros((64, 64, 1), dtype=np.float32)
    texture[::2, ::2] = 1
    baked = bake_texture(prepare_transfer(level, level, identity_map(level)), texture, size=16)
    # At the image's edge there is nothing beyond to average with.
    np.testing.assert_allclose(baked[1:-1, 1:-1], 0.25, rtol=0, atol=1e-6)
    np.testing.assert_allclose(baked, 0.25, rtol=0, atol=0.03)


@pytest.mark.slow
def test_neither_bands_nor_threads_change_a_texel(monkeypatch: pytest.MonkeyPatch) -> None:
    level = refine(unwrap(torus()), 1).finest
    transfer = prepare_transfer(level, level, torn_map(level))  # where walks that begin elsewhere may end elsewhere
    texture = noise(300, 300, 3, "uint8")
    with thread_limit(1):
        wholes = [bake_texture(transfer, texture, size=96, options=BakeOptions(supersample=s)) for s in (1, 3)]
    monkeypatch.setattr(bake_module, "_BAND_TEXELS", 700)
    monkeypatch.setattr(bake_module, "_SAMPLE_BUDGET", 3000)
    for supersample, whole in zip((1, 3), wholes, strict=True):
        with thread_limit(3):
            parts = bake_texture(transfer, texture, size=96, options=BakeOptions(supersample=supersample))
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
        refuses(ParameterError, "whole number of texels", bake_texture, transfer, pixels, size=size)


def test_a_torn_map_still_gives_texture_colours() -> None:
    # Every vertex to a random place: nothing sensible to see, but no crash, no hang and no invented colour.
    level = refine(unwrap(torus()), 1).finest
    point_map = torn_map(level)
    texture = np.full((16, 16, 1), 0.5, dtype=np.float32)
    texture[::2] = 0.25
    baked = bake_texture(prepare_transfer(level, level, point_map), texture, size=64)
    assert baked.min() >= 0.25
    assert baked.max() <= 0.5


SIZE = 96


def covered(level: Level, size: int) -> np.ndarray:
    """(size, size) texels whose centre lies in the layout."""
    transfer = prepare_transfer(level, level, identity_map(level))
    layout = replace(make_layout(transfer, size, BakeOptions(supersample=1)), gutter=0.0)
    return np.concatenate([rasterize_band(layout, band) for band in range(len(layout.band_triangles))]) >= 0


@pytest.fixture(scope="module", params=range(3))
def crumpled(request: pytest.FixtureRequest) -> Level:
    """Triangles folded back onto each other along most edges: closest points by projection are other triangles'."""
    level = refine(unwrap(torus(8, 6)), 1).finest
    rng = np.random.default_rng(request.param)
    return replace(level, positions=level.positions + 0.3 * rng.standard_normal(level.positions.shape))


def test_colours_come_back(crumpled: Level) -> None:
    transfer = prepare_transfer(crumpled, crumpled, identity_map(crumpled))
    texture = np.random.default_rng(0).integers(0, 256, (SIZE, SIZE, 3)).astype(np.uint8)
    baked = bake_texture(transfer, texture, size=SIZE)
    inside = covered(crumpled, SIZE)
    np.testing.assert_array_equal(baked[inside], texture[inside])


@pytest.mark.parametrize(("green", "dtype"), [("up", np.uint8), ("down", np.uint16)])
@pytest.mark.parametrize("space", ["tangent", "object"])
def test_directions_come_back(crumpled: Level, space: str, green: str, dtype: type) -> None:
    transfer = prepare_transfer(crumpled, crumpled, identity_map(crumpled))
    rng = np.random.default_rng(1)
    vectors = normalize_rows(rng.standard_normal((SIZE * SIZE, 3)) + np.array([0.0, 0.0, 2.0])).reshape(SIZE, SIZE, 3)
    inside = covered(crumpled, SIZE)
    normals = np.rint((0.5 * vectors + 0.5) * np.iinfo(dtype).max).astype(dtype)
    baked = bake_normal_map(transfer, normals, size=SIZE, space=space, green=green)
    # Rounded vectors are not of unit length; normalising them moves a value by one level at most.
    assert np.abs(baked[inside].astype(int) - normals[inside]).max() <= 1
    moved = bake_vector_displacement(transfer, vectors.astype(np.float32), size=SIZE, space=space)
    np.testing.assert_allclose(moved.pixels[inside], vectors[inside], rtol=0, atol=1e-6)


@pytest.mark.parametrize("samples", [25_000, 300])
def test_shapes_come_back(monkeypatch: pytest.MonkeyPatch, samples: int) -> None:
    """A mesh that is folded sharply; and looked at on a coarser level, too."""
    monkeypatch.setattr("cagemap.transfer.blend_shapes._SAMPLES", samples)
    rng = np.random.default_rng(5)
    control = torus(10, 8)
    control = control.with_positions(control.positions + 0.4 * rng.standard_normal(control.positions.shape))
    body = refine(control, 2)
    carrier = prepare_shapes(body, body, identity_map(body.finest))
    shape = rng.standard_normal(control.positions.shape)
    np.testing.assert_allclose(carry_shape(carrier, shape), shape, rtol=0, atol=1e-9)


def test_walks_begin_in_the_triangle_that_holds_all_corners(crumpled: Level) -> None:
    surface = TexturedSurface.from_level(crumpled)
    count = len(surface.triangles)
    mapped = map_surface(surface, surface, identity_map(crumpled))
    np.testing.assert_array_equal(mapped.whole, np.arange(count))
    np.testing.assert_array_equal(locate_centers(mapped), np.arange(count))


def test_corners_at_corners_edges_and_insides_of_one_triangle_are_in_it() -> None:
    level = plane(3, 3)
    source = TriangleSurface.from_faces(level.positions, level.faces)
    rng = np.random.default_rng(7)
    within = np.repeat(np.arange(len(source.triangles)), 40)
    shares = rng.random((len(within), 3, 3)) * rng.integers(0, 2, (len(within), 3, 3))
    kept = (shares.sum(axis=2) > 0).all(axis=1) & (shares.sum(axis=1) > 0).all(axis=1)
    within, shares = within[kept], shares[kept] / shares[kept].sum(axis=2, keepdims=True)
    corners = np.arange(3 * len(within)).reshape(-1, 3)
    found = whole_triangles(corners, source.triangles, np.repeat(within, 3), shares.reshape(-1, 3))
    np.testing.assert_array_equal(found, within)


def test_parts_of_one_triangle_are_found_in_it_and_others_in_none() -> None:
    """A plane of finer squares lies in the coarse one's triangles where the diagonals agree, and across them else."""
    fine, coarse = plane(4, 4), plane(2, 2)
    rows, columns = np.divmod(np.arange(25), 5)
    cell = np.minimum(columns // 2, 1) + 2 * np.minimum(rows // 2, 1)
    fx, fy = columns / 2 - cell % 2, rows / 2 - cell // 2
    upper = fy > fx
    weights = np.where(upper[:, None], np.column_stack([1 - fy, fx, fy - fx]), np.column_stack([1 - fx, fx - fy, fy]))
    surfaces = (TriangleSurface.from_faces(level.positions, level.faces) for level in (fine, coarse))
    point_map = PointMap.from_arrays(*surfaces, 2 * cell + upper, weights)
    one, two = (TexturedSurface.from_level(level) for level in (fine, coarse))
    whole = map_surface(one, two, point_map).whole
    centres = one.positions[one.triangles].mean(axis=1)[:, :2] * 2
    place = np.floor(centres).astype(int)
    across = centres - place
    expected = 2 * (place[:, 0] + 2 * place[:, 1]) + (across[:, 1] > across[:, 0])
    np.testing.assert_array_equal(whole, expected)
    moved = PointMap.from_arrays(
        point_map.target, point_map.source, point_map.triangle, np.full((25, 3), 1 / 3)
    )  # centres of triangles: a square's corners lie in several
    whole = map_surface(one, two, moved).whole
    same = (moved.triangle[one.triangles] == moved.triangle[one.triangles[:, :1]]).all(axis=1)
    np.testing.assert_array_equal(whole, np.where(same, moved.triangle[one.triangles[:, 0]], -1))


def test_what_rounding_puts_outside_does_not_cross_a_seam() -> None:
    """Every edge is a seam, and lies a ten-millionth of a texel beside the centres that it takes."""
    level = refine(crossed_cube(), 1).finest
    shifted = level.with_uvs(level.uvs + np.array([(0.5 + 2e-7) / 90, 0.0]), level.uv_indices)
    surface = TexturedSurface.from_level(shifted)
    transfer = prepare_transfer(shifted, shifted, identity_map(shifted))
    layout = make_layout(transfer, 90, BakeOptions(supersample=1))
    cells = np.concatenate([rasterize_band(layout, band) for band in range(len(layout.band_triangles))])
    texels = np.flatnonzero(cells.ravel() >= 0)
    own = cells.ravel()[texels]
    ones = np.ones((len(surface.triangles), 2), dtype=np.int32)
    samples = locate_samples(transfer.mapped, layout.corners, texels, 90, 0, own, ones)
    edge = np.abs(texels % 90 - 30 * np.rint(texels % 90 / 30)) == 0
    assert edge.sum() >= 90
    np.testing.assert_array_equal(samples.triangle[edge], own[edge])
