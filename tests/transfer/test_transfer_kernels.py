"""The bake's kernels against their slow twins."""

import numpy as np
import pytest
from examples.shapes import torus
from hypothesis import given
from hypothesis import strategies as st

from cagemap.maps.point_map import PointMap
from cagemap.numerics.threads import thread_limit
from cagemap.subdivision import refine
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import triangle_areas, triangle_neighbors
from cagemap.transfer.locate import TexelSamples, locate_samples, map_surface, target_barycentric
from cagemap.transfer.lookups import plan_samples
from cagemap.transfer.texels import dilate, lay_out, rasterize_band
from cagemap.transfer.texture import SmoothTile, lay_texture, look_up, smooth_cells
from cagemap.transfer.textured_surface import TexturedSurface
from cagemap.transfer.unwrap import unwrap

import transfer_reference as reference


@pytest.fixture(scope="module")
def ring() -> TexturedSurface:
    return TexturedSurface.from_level(refine(unwrap(torus()), 2).finest)


def identity(surface: TexturedSurface) -> PointMap:
    """Every vertex to itself, as a corner of the last triangle that has it."""
    triangles = TriangleSurface.from_faces(surface.positions, surface.triangles)
    return PointMap.from_vertices(triangles, triangles, np.arange(triangles.n))


def test_neighbors_lie_across_their_edges(ring: TexturedSurface) -> None:
    np.testing.assert_array_equal(triangle_neighbors(ring.triangles), reference.neighbors_slowly(ring.triangles))
    islands = triangle_neighbors(ring.uv_triangles)
    np.testing.assert_array_equal(islands, reference.neighbors_slowly(ring.uv_triangles))
    assert (islands < 0).any()


def test_edges_of_more_than_two_triangles_are_paired_in_order() -> None:
    fan = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4], [1, 0, 5], [0, 1, 6]])
    assert triangle_neighbors(fan)[:, 2].tolist() == [1, 0, 3, 2, -1]


@pytest.mark.parametrize("band_rows", [7, 64])
def test_raster_is_the_first_triangle_over_each_centre(ring: TexturedSurface, band_rows: int) -> None:
    corner_uvs = ring.corner_uvs()
    layout = lay_out(corner_uvs, triangle_neighbors(ring.uv_triangles), 64, 80, band_rows=band_rows, gutter=0)
    bands = [rasterize_band(layout, band) for band in range(len(layout.band_triangles))]
    np.testing.assert_array_equal(np.concatenate(bands), reference.rasterize_slowly(layout.corners, 64, 80))


def test_overlapping_triangles_outside_and_degenerate_ones() -> None:
    rng = np.random.default_rng(314)
    corner_uvs = rng.uniform(-0.4, 1.4, (60, 3, 2))
    corner_uvs[5] = corner_uvs[5, :1]
    layout = lay_out(corner_uvs, np.full((60, 3), -1, dtype=np.int32), 33, 21, band_rows=8, gutter=0)
    image = np.concatenate([rasterize_band(layout, band) for band in range(5)])
    np.testing.assert_array_equal(image, reference.rasterize_slowly(layout.corners, 33, 21))


def test_gutter_is_the_nearest_border_within_its_radius(ring: TexturedSurface) -> None:
    neighbors = triangle_neighbors(ring.uv_triangles)
    layout = lay_out(ring.corner_uvs(), neighbors, 48, 48, band_rows=16, gutter=3.4)
    bare = reference.rasterize_slowly(layout.corners, 48, 48)
    grown = np.concatenate([rasterize_band(layout, band) for band in range(3)])
    distance = reference.border_distance_slowly(layout.corners, neighbors, 48, 48)
    np.testing.assert_array_equal(grown[bare >= 0], bare[bare >= 0])
    np.testing.assert_array_equal(grown >= 0, (bare >= 0) | (distance.min(axis=2) < 3.4))
    border_triangle = np.nonzero(neighbors < 0)[0]
    for row, column in np.argwhere((bare < 0) & (grown >= 0)):
        nearest = distance[row, column].min()
        # Two borders may be equally near: any of them will do.
        assert grown[row, column] in border_triangle[distance[row, column] < nearest + 1e-9]


@pytest.mark.slow
def test_walk_comes_to_the_closest_point(ring: TexturedSurface) -> None:
    corner_uvs = ring.corner_uvs()
    size = 64
    layout = lay_out(corner_uvs, triangle_neighbors(ring.uv_triangles), size, size, band_rows=size)
    cells = rasterize_band(layout, 0)
    texels = np.flatnonzero(cells.ravel() >= 0)[::5]
    # A map that is not the identity: vertices move by about two edges' lengths along the surface.
    rng = np.random.default_rng(1618)
    still = identity(ring)
    triangle = still.triangle
    for _ in range(2):
        triangle = triangle_neighbors(ring.triangles)[triangle, 1]
    weights = rng.dirichlet((1, 1, 1), len(triangle))
    surface = map_surface(
        ring, ring, PointMap.from_arrays(still.target, still.source, triangle.astype(np.int64), weights)
    )
    ones = np.ones((len(ring.triangles), 2), dtype=np.int32)
    own = cells.ravel()[texels]
    samples = locate_samples(surface, layout.corners, texels, size, 0, own, ones)
    found = np.einsum("kc,kcd->kd", samples.barycentric, ring.positions[ring.triangles[samples.triangle]])
    inside = target_barycentric(layout.corners, samples)
    within = np.flatnonzero(reference.rasterize_slowly(layout.corners, size, size).ravel()[texels] >= 0)
    points = np.einsum("kc,kcd->kd", inside, surface.mapped[ring.triangles[own]])[within]
    best = reference.closest_slowly(ring.positions, ring.triangles, points)
    excess = np.linalg.norm(found[within] - points, axis=1) - np.linalg.norm(best - points, axis=1)
    edge = np.sqrt(triangle_areas(ring.positions, ring.triangles).mean())
    # The walk takes a foot of the perpendicular; on a curved surface another one may be nearer by the chord's height.
    assert np.quantile(excess, 0.99) < 0.02 * edge
    assert excess.max() < 0.2 * edge
    assert samples.barycentric.min() >= 0
    np.testing.assert_allclose(samples.barycentric.sum(axis=1), 1, rtol=0, atol=1e-12)


def test_sample_counts_follow_the_ratio_of_texels(ring: TexturedSurface) -> None:
    surface = map_surface(ring, ring, identity(ring))
    corners = ring.corner_uvs() * (50, 100)
    # Source texture six times wider and twice as tall as the target's.
    counts = plan_samples(surface, corners, ring.corner_uvs() * (300, 200))
    assert np.all(counts == (6, 2))
    assert np.all(plan_samples(surface, corners, corners) == 1)
    assert plan_samples(surface, corners, ring.corner_uvs() * 1e6).max() == 16


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float16", "float32"])
def test_lookup_is_bilinear(dtype: str) -> None:
    rng = np.random.default_rng(577)
    pixels = (rng.random((9, 14, 3)) * 255).astype(dtype)
    uvs = rng.random((3 * 40, 2))
    corners = np.arange(120).reshape(40, 3)
    weights = rng.dirichlet((1, 1, 1), 40)
    texture = lay_texture(pixels, uvs, corners)
    none = np.zeros(40, dtype=np.int32)
    samples = TexelSamples(none, none.astype(np.int64), 1, 0, np.arange(41), np.arange(40), weights)
    points = np.einsum("kc,kcd->kd", weights, uvs[corners])
    expected = reference.look_up_slowly(pixels.astype(np.float64), points)
    np.testing.assert_allclose(look_up(texture, samples), expected, rtol=0, atol=1e-9)


def test_smooth_lookup_is_that_of_six_points_and_reproduces_cubics() -> None:
    rng = np.random.default_rng(578)
    uvs = 0.35 + 0.3 * rng.random((3 * 40, 2))
    corners, weights, none = np.arange(120).reshape(40, 3), rng.dirichlet((1, 1, 1), 40), np.zeros(40, dtype=np.int32)
    samples = TexelSamples(none, none.astype(np.int64), 1, 0, np.arange(41), np.arange(40), weights)
    points = np.einsum("kc,kcd->kd", weights, uvs[corners])
    y, x = np.indices((20, 24)) + 0.5
    cubic = (x**3 - 30 * x**2 + y**3 + x * y**2)[..., None]
    wave = np.cos(0.7 * x + 0.4 * y)[..., None]  # no hard edges: the limits of a lookup are not met
    for pixels, tolerance in ((cubic, 1e-9), (wave, 1e-12)):
        fine = {0: SmoothTile.of(pixels, np.ones((20, 24), dtype=bool))}
        found = look_up(lay_texture(pixels, uvs, corners), samples, fine)
        expected = reference.smooth_slowly(pixels, points)
        np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.abs(pixels).max())
    half = wave.astype(np.float16)
    fine = {0: SmoothTile.of(half, np.ones((20, 24), dtype=bool))}
    found, same = (look_up(lay_texture(pixels, uvs, corners), samples, fine) for pixels in (half, half.astype("f4")))
    np.testing.assert_array_equal(found, same)
    at = points * (24, -20) + (0, 20)
    exact = at[:, 0] ** 3 - 30 * at[:, 0] ** 2 + at[:, 1] ** 3 + at[:, 0] * at[:, 1] ** 2
    np.testing.assert_allclose(reference.smooth_slowly(cubic, points)[:, 0], exact, rtol=1e-12)


@given(height=st.integers(1, 12), width=st.integers(1, 12), seed=st.integers(0, 99))
def test_smooth_cells_have_all_their_texels(height: int, width: int, seed: int) -> None:
    covered = np.random.default_rng(seed).random((height, width)) < 0.98
    expected = [
        [r >= 2 and c >= 2 and r + 3 < height and c + 3 < width and covered[r - 2 : r + 4, c - 2 : c + 4].all()
         for c in range(width)]
        for r in range(height)
    ]  # fmt: skip
    np.testing.assert_array_equal(smooth_cells(covered), expected)


@pytest.mark.parametrize("dtype", ["uint8", "float16", "float32"])
@given(height=st.integers(1, 16), width=st.integers(1, 16), seed=st.integers(0, 99))
def test_even_texels_need_no_cubic(dtype: str, height: int, width: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pixels = (rng.random((height, width, 2)) < 0.01).astype(dtype)
    covered = rng.random((height, width)) < 0.99
    whole = smooth_cells(covered)
    expected = [
        [whole[r, c] and np.ptp(pixels[r - 2 : r + 4, c - 2 : c + 4], axis=(0, 1)).any() for c in range(width)]
        for r in range(height)
    ]
    np.testing.assert_array_equal(SmoothTile.of(pixels, covered).cells, expected)


@pytest.mark.parametrize("share", [0.002, 0.1, 0.9])
def test_dilation_takes_the_nearest_texel(share: float) -> None:
    rng = np.random.default_rng(2236)
    covered = rng.random((90, 130)) < share
    covered[40, 70] = True
    places = np.stack(np.mgrid[0:90, 0:130], axis=2).astype(np.uint16)
    filled = places.copy()
    filled[~covered] = 9999
    with thread_limit(2):
        dilate(filled, covered)
    _, distance = reference.dilate_slowly(places, covered)
    # Several texels may be equally near; the distance is what counts.
    offset = filled.astype(float) - places
    np.testing.assert_allclose(np.hypot(offset[:, :, 0], offset[:, :, 1]), distance, atol=1e-12)
    assert covered[filled[:, :, 0], filled[:, :, 1]].all()


def test_dilation_stops_at_its_distance_and_leaves_an_empty_image() -> None:
    covered = np.zeros((40, 40), dtype=bool)
    covered[20, 20] = True
    image = np.where(covered[:, :, None], np.float32(7), np.float32(0))
    dilate(image, covered, distance=5)
    rows, columns = np.mgrid[0:40, 0:40] - 20
    np.testing.assert_array_equal(image[:, :, 0] == 7, np.hypot(rows, columns) <= 5)
    empty = np.zeros((4, 4, 1))
    dilate(empty, np.zeros((4, 4), dtype=bool))
    assert not empty.any()
