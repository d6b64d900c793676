"""The same surface on both sides: every covered texel comes back, however sharply the surface is folded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import torus

from cagemap.maps.point_map import PointMap
from cagemap.subdivision import Level, refine
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import normalize_rows
from cagemap.transfer import BakeOptions, bake_texture, prepare_transfer, unwrap
from cagemap.transfer.baking import make_layout
from cagemap.transfer.blend_shapes import carry_shape, prepare_shapes
from cagemap.transfer.locate import locate_centers, locate_samples, map_surface, whole_triangles
from cagemap.transfer.texels import rasterize_band
from cagemap.transfer.textured_surface import TexturedSurface
from cagemap.transfer.vectors import bake_normal_map, bake_vector_displacement

from transfer_scenes import crossed_cube, identity_map, plane

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
