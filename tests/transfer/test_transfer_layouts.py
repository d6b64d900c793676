"""Layouts that bakes are made into: tiles, UDIM sets, borders of islands, what lies outside, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from examples.shapes import grid, torus

from cagemap.errors import ParameterError
from cagemap.files.images.image import (
    read_image,
    read_image_form,
    read_texture,
    texture_files,
    tile_pattern,
    udim_path,
    write_image,
)
from cagemap.maps.masks import Masks
from cagemap.maps.point_map import PointMap
from cagemap.mesh.control_mesh import MIN_UV_AREA, ControlMesh
from cagemap.subdivision import Level, refine
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import triangle_areas, triangle_neighbors
from cagemap.tasks.bake_tiles import layout_tiles, map_path, unwrapped_name
from cagemap.transfer import (
    BakeOptions,
    bake_detail_texture,
    bake_face_colors,
    bake_texture,
    detail_over,
    prepare_transfer,
    target_tiles,
    unwrap,
)
from cagemap.transfer import baking as bake_module
from cagemap.transfer.locate import TexelSamples
from cagemap.transfer.lookups import pad_islands
from cagemap.transfer.masks import bake_mask, painted_mask
from cagemap.transfer.texels import lay_out, rasterize_band
from cagemap.transfer.texture import OVERHANG, Filter, Texture, tile_cells
from cagemap.transfer.textured_surface import TexturedSurface

from bake_images import BARE, noise, ramps
from refusals import refuses
from transfer_reference import look_up_slowly
from transfer_scenes import crossed_cube, face_texture, identity_map, plane, plane_map


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


@pytest.mark.parametrize("right", [False, True])
@pytest.mark.parametrize("side", ["target", "source"])
def test_texels_of_overlapping_halves_take_the_half_that_the_masks_allow(right: bool, side: str) -> None:
    source = plane(8, 8)
    uvs = np.abs(source.uvs * (2.0, 1.0) - (1.0, 0.0))  # the left half is mirrored over the right one
    target = source.with_uvs(uvs, source.uv_indices)
    allowed = (source.positions[:, 0] >= 0.5) == right
    masks = Masks(**{side: np.where(np.isclose(source.positions[:, 0], 0.5), 1.0, allowed)})
    transfer = prepare_transfer(target, source, identity_map(source), masks)
    baked = bake_texture(transfer, np.linspace(0, 1, 256)[None, :, None] * np.ones((2, 1, 1)), size=64, options=BARE)
    u = (np.arange(64) + 0.5) / 64
    np.testing.assert_allclose(baked[:, :, 0], np.broadcast_to(0.5 + (0.5 if right else -0.5) * u, (64, 64)), atol=0.01)
    assert bake_mask(transfer, size=64, options=BARE).min() > 0.99


def test_smooth_lookups_see_nothing_beside_an_island() -> None:
    """The layout covers the middle of the image; what is painted two texels beside it does not matter."""
    level = plane(8, 8, lambda points: 0.25 + 0.5 * points)
    transfer = prepare_transfer(level, level, plane_map(level, 8, 8, lambda p: 0.02 + 0.93 * p))
    textures = [noise(64, 64, 3, "uint8", seed) for seed in (1, 2)]
    inside = np.s_[15:49, 15:49]
    textures[1][inside] = textures[0][inside]
    baked = [bake_texture(transfer, texture, size=64) for texture in textures]
    np.testing.assert_array_equal(*baked)


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


@pytest.mark.parametrize("background", [0.0, 0.75, np.nan])
@pytest.mark.parametrize("kind", ["smooth", "linear", "nearest"])
def test_the_background_of_a_texture_without_padding_does_not_show(kind: Filter, background: float) -> None:
    source, target = (refine(unwrap(torus(6, 4), padding=padding), 3).finest for padding in (1 / 32, 1 / 50))
    surface, size = TexturedSurface.from_level(source), 256
    texture = np.full((size, size, 1), background, dtype=np.float32)
    neighbors = triangle_neighbors(surface.layout()[1])
    cells = rasterize_band(lay_out(surface.corner_uvs(), neighbors, size, size, band_rows=size, gutter=0.0), 0)
    texture[cells >= 0] = np.where(source.positions[surface.triangles[cells[cells >= 0], 0], :1] > 0, 0.25, 0.5)
    transfer = prepare_transfer(target, source, identity_map(source))
    for count in (size, 2 * size, size // 4):
        baked = bake_texture(transfer, texture, size=count, options=BakeOptions(filter=kind))
        assert 0.25 - 1e-4 <= baked.min() <= baked.max() <= 0.5 + 1e-4
    detail = detail_over(transfer.point_map.source, source.positions, surface.triangles)
    baked = bake_detail_texture(
        transfer, detail, texture, *surface.layout(), size=size, options=BakeOptions(filter=kind)
    )
    assert 0.25 - 1e-4 <= baked.min() <= baked.max() <= 0.5 + 1e-4
    mask = painted_mask(source, texture)
    assert 0.25 - 1e-6 <= mask.min() <= mask.max() <= 0.5 + 1e-6


@pytest.mark.parametrize("background", [0, 255])
def test_the_background_of_a_jpeg_without_padding_does_not_show(background: int, tmp_path: Path) -> None:
    """Compression changes the background beside islands: no two texels there need be equal."""
    source, target = (refine(unwrap(torus(6, 4), padding=padding), 3).finest for padding in (1 / 32, 1 / 50))
    surface, size = TexturedSurface.from_level(source), 256
    texture = np.full((size, size, 3), background, dtype=np.uint8)
    neighbors = triangle_neighbors(surface.layout()[1])
    cells = rasterize_band(lay_out(surface.corner_uvs(), neighbors, size, size, band_rows=size, gutter=0.0), 0)
    texture[cells >= 0] = [120, 130, 140]
    write_image(tmp_path / "skin.jpg", texture)
    compressed = read_image(tmp_path / "skin.jpg").pixels
    transfer = prepare_transfer(target, source, identity_map(source))
    for count in (size, size // 4):
        baked = bake_texture(transfer, compressed, size=count).astype(int)
        assert np.abs(baked - [120, 130, 140]).max() < 40  # as much as inside islands


def test_a_padded_texture_keeps_its_padding() -> None:
    """Some texels beside the island are nearer to the flat background's colour than to the island's."""
    uvs = np.array([[0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75]])
    texture = np.zeros((64, 64, 3), dtype=np.uint8)
    rng = np.random.default_rng(0)
    texture[8:56, 8:56] = rng.choice([100, 220], (48, 48, 1), p=[0.2, 0.8]) + rng.integers(0, 20, (48, 48, 3))
    texture[16:48, 16:48] = 250
    laid = Texture({0: texture}, uvs, np.array([[0, 1, 2], [0, 2, 3]]), np.zeros(2, dtype=np.int64))
    np.testing.assert_array_equal(pad_islands(laid, [0])[0].tiles[0], texture)


def test_surface_points_are_carried_not_texture_coordinates() -> None:
    # Two source islands far apart in the layout; a coarse target triangle lies over the seam between them.
    source = plane(8, 8)
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


def test_texture_coordinates_outside_the_square_repeat() -> None:
    texture = noise(32, 32, 3, "uint8")
    inside, target = plane(8, 8), plane(8, 8)
    shifted = plane(8, 8, lambda points: points + np.array([2, -1]))
    expected = bake_texture(prepare_transfer(target, inside, identity_map(target)), texture, size=32)
    transfer = prepare_transfer(target, shifted, identity_map(target))
    np.testing.assert_array_equal(bake_texture(transfer, texture, size=32), expected)


@pytest.mark.parametrize("square", [(1, 0), (-2, 3), (1e-6, -1e-6)])
def test_the_edge_of_a_repeated_square_is_not_its_opposite_edge(square: tuple[float, float]) -> None:
    # The padding around the target's island takes the source's border, at u = 2 of a square from 1 to 2.
    texture = noise(32, 32, 3, "uint8")
    target, inside = plane(8, 8, lambda points: 0.17 + 0.61 * points), plane(8, 8)
    shifted = plane(8, 8, lambda points: points + np.array(square))
    expected = bake_texture(prepare_transfer(target, inside, identity_map(target)), texture, size=64)
    baked = bake_texture(prepare_transfer(target, shifted, identity_map(target)), texture, size=64)
    assert np.abs(baked.astype(int) - expected.astype(int)).max() <= 1


def test_border_texels_never_mix_with_the_opposite_border() -> None:
    texture = np.zeros((8, 8, 1), dtype=np.uint8)
    texture[:, 0] = 255
    level = plane(4, 4)
    baked = bake_texture(prepare_transfer(level, level, identity_map(level)), texture, size=64)
    assert (baked[:, 40:] == 0).all()


def test_islands_go_on_for_a_texel_beyond_their_border() -> None:
    # A plane cut in two islands: colours linear in position must stay linear where an island is extended.
    target = plane(8, 8)
    left = target.positions[target.faces].mean(axis=1)[:, 0] < 0.5
    uvs = np.concatenate([target.positions[:, :2] * (0.5, 1), target.positions[:, :2] * (0.5, 1) + (0.25, 0)])
    moved = target.faces + np.where(left, 0, len(target.positions))[:, None]
    cut = target.with_uvs(uvs, moved)
    source = plane(8, 8)
    baked = bake_texture(prepare_transfer(cut, source, identity_map(source)), ramps(64, 64), size=200, options=BARE)
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
    layout = bake_module.make_layout(transfer, size, BakeOptions())

    def shade(samples: TexelSamples) -> np.ndarray:
        corners = surface.positions[surface.triangles[samples.triangle]]
        return np.asarray(samples.mean(np.einsum("sc,scd->sd", samples.barycentric, corners)))

    ones = np.ones((len(surface.triangles), 2), dtype=np.int32)
    image = bake_module.Bake(transfer, layout, BakeOptions(), np.dtype(np.float32), ones).run(shade, 3)
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


def test_udim_tiles_of_the_source_and_of_the_target() -> None:
    plain, size = plane(8, 8), 48
    wide = plane(8, 8, lambda points: points * 2)
    texture = noise(2 * size, 2 * size, 3, "uint8")
    upper, lower = np.split(texture, 2)
    quarters = *np.split(lower, 2, axis=1), *np.split(upper, 2, axis=1)
    tiles = dict(zip((1001, 1002, 1011, 1012), quarters, strict=True))
    transfer = prepare_transfer(plain, wide, identity_map(plain))
    expected = bake_texture(prepare_transfer(plain, plain, identity_map(plain)), texture, size=2 * size)
    baked = bake_texture(transfer, tiles, size=2 * size)
    # At the border between two tiles the bilinear filter is cut off.
    np.testing.assert_array_equal(baked, expected)

    assert target_tiles(TexturedSurface.from_level(plain)) == [0]
    assert target_tiles(TexturedSurface.from_level(wide)) == sorted(tiles)
    holes = (wide.uvs[wide.uv_indices] <= 1).all(axis=(1, 2))
    assert target_tiles(TexturedSurface.from_level(wide, holes)) == sorted(tiles)[1:]
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
            "unit square, got 32 triangles, 32 of them in one point, on a line or in hole faces and 0",
        ),
        (lambda points: points * (1, 0), 0, "32 of them in one point"),
        (lambda points: points - (3, 0), 0, "unit square, got 32 triangles, 0 of them .* and 32 outside"),
        (lambda points: points, 1002, "UDIM tile 1002, got 32 triangles"),
    ],
)
def test_a_layout_that_covers_nothing_is_refused(layout, tile, found):
    plain, target = plane(4, 4), plane(4, 4, layout)
    transfer = prepare_transfer(target, plain, identity_map(plain))
    with pytest.raises(ParameterError, match=found):
        bake_texture(transfer, noise(8, 8, 3, "uint8"), size=8, options=BakeOptions(tile=tile))


@pytest.mark.parametrize(("share", "is_laid_out"), [(0.75, False), (1.5, True)])
def test_the_least_area_of_a_layout_is_the_same_for_a_mesh_and_for_a_bake(share: float, is_laid_out: bool) -> None:
    flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    uvs = np.sqrt(2.0 * share * MIN_UV_AREA) * flat[:, :2]
    mesh = ControlMesh.from_faces(flat, [[0, 1, 2]]).with_uvs(uvs, np.arange(3))
    level = Level(flat, np.array([[0, 1, 2]]), np.zeros(1, dtype=np.int64)).with_uvs(uvs, np.array([[0, 1, 2]]))
    assert mesh.has_layout == is_laid_out
    assert bake_module._is_laid_out(TexturedSurface.from_level(level)).any() == is_laid_out


def test_tiles_that_only_points_lie_in_are_none() -> None:
    level = plane(4, 4)
    uvs, corners = level.layout
    corners = corners.copy()
    corners[0] = len(uvs)
    stray = level.with_uvs(np.vstack([uvs, [[1.5, 0.5]]]), corners)
    assert target_tiles(TexturedSurface.from_level(stray)) == [0]


def test_wrong_input_is_refused_with_its_remedy() -> None:
    level = plane(4, 4)
    naked = Level(level.positions, level.faces, level.face_parents)
    texture = noise(8, 8, 3, "uint8")
    with pytest.raises(ParameterError, match="`unwrap`"):
        bake_texture(prepare_transfer(naked, level, identity_map(level)), texture, size=8)
    refuses(ParameterError, "target and source exchanged", prepare_transfer, plane(3, 3), level, identity_map(level))
    refuses(ParameterError, "target and source exchanged", prepare_transfer, level, plane(1, 1), identity_map(level))
    transfer = prepare_transfer(level, level, identity_map(level))
    refuses(ParameterError, "size: expected", bake_texture, transfer, texture, size=0)
    refuses(ParameterError, "image of shape", bake_texture, transfer, texture[None], size=8)
    refuses(ParameterError, "unsigned integers or floats", bake_texture, transfer, texture.astype(np.int32), size=8)
    refuses(ParameterError, "supersample: expected 1 to 16", BakeOptions, supersample=99)
    with pytest.raises(ParameterError, match="refine it once"):
        prepare_transfer(Level(level.positions, None, level.face_parents), level, identity_map(level))


def _tiled_grid(columns: int, rows: int, margin: float = 0.02) -> ControlMesh:
    """A bent grid whose faces lie in a UDIM tile each."""
    mesh = grid(columns, rows)
    unit = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]) * (1 - 2 * margin) + margin
    uvs = np.concatenate([unit + np.array([face % columns, face // columns]) for face in range(mesh.n_faces)])
    x, y = mesh.positions[:, 0], mesh.positions[:, 1]
    bent = np.column_stack([x, y, 0.3 * np.sin(x) * np.cos(y)])
    return mesh.with_positions(bent).with_uvs(uvs, np.arange(4 * mesh.n_faces))


def _noise(size: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (size, size, 3), dtype=np.uint8)


def test_what_overhangs_a_tile_by_a_rounding_does_not_become_two() -> None:
    mesh = _tiled_grid(2, 1, margin=0.0)
    level = refine(mesh, 5).finest
    assert target_tiles(TexturedSurface.from_level(level)) == [1001, 1002]
    for shift in (1e-7, -1e-7, 0.4 * OVERHANG):
        moved = refine(mesh.with_uvs(mesh.uvs + np.array([shift, 0]), mesh.uv_indices), 5).finest
        assert target_tiles(TexturedSurface.from_level(moved)) == [1001, 1002]
    single = _tiled_grid(1, 1, margin=0.0)
    grown = refine(single.with_uvs((single.uvs - 0.5) * (1 + OVERHANG) + 0.5, single.uv_indices), 8).finest
    assert target_tiles(TexturedSurface.from_level(grown)) == [0]
    across = np.array([[[0.4, 0.5], [1.4, 0.5], [1.2, 0.9]], [[-1e-6, 0], [0, 1e-6], [0, 0]]])
    np.testing.assert_array_equal(tile_cells(across), [[1, 0], [0, 0]])


@pytest.mark.parametrize("hole", [False, True])
def test_faces_that_get_no_texels_do_not_turn_tiles_off(hole: bool) -> None:
    mesh = _tiled_grid(3, 1)
    uvs = mesh.uvs.copy()
    uvs[:4] = [-0.1, -0.1] if not hole else uvs[:4] - 1.0
    level = refine(mesh.with_uvs(uvs, mesh.uv_indices), 2).finest
    surfaces = [TriangleSurface.from_faces(level.positions, level.faces)] * 2
    point_map = PointMap.from_vertices(*surfaces, np.arange(level.n_vertices))
    transfer = prepare_transfer(level, level, point_map, holes=level.face_parents == 0 if hole else None)
    assert layout_tiles(transfer) == ([1002, 1003], [])


def test_all_spellings_of_a_set(tmp_path: Path) -> None:
    for number in (1001, 1012):
        write_image(udim_path(tmp_path / "skin.%(UDIM)d.png", number), _noise(8, number))
    (tmp_path / "skin.1x01.png").write_bytes(b"")
    assert sorted(path.name for path in tmp_path.iterdir())[:2] == ["skin.1001.png", "skin.1012.png"]
    for name in ("skin.<UDIM>.png", "skin.%(UDIM)d.png", "skin.<udim>.png"):
        assert unwrapped_name(tmp_path / name).name == "skin_unwrapped.obj"
        assert list(read_texture(tmp_path / name)) == [1001, 1012]
        assert len(texture_files(tmp_path / name)) == 2
        assert read_image_form(tmp_path / name) == (np.dtype(np.uint8), 3, (8, 8))
        assert tile_pattern(tmp_path / name).name == "skin.<UDIM>.png"
    assert tile_pattern("skin.png").name == "skin.<UDIM>.png"


def test_a_set_named_by_its_first_tile_has_the_number_once() -> None:
    first = Path("skin.1001.png")
    assert [udim_path(first, tile).name for tile in (0, 1001, 1012)] == [
        "skin.1001.png",
        "skin.1001.png",
        "skin.1012.png",
    ]
    assert tile_pattern(first).name == "skin.<UDIM>.png"
    assert map_path(first, "color").name == "skin_color.<UDIM>.png"
    assert map_path(first, "") == first
    assert unwrapped_name(first).name == "skin_unwrapped.obj"
    assert udim_path("skin_1024.png", 1002).name == "skin_1024.1002.png"  # a size
    assert udim_path("photo1001.png", 1002).name == "photo1001.1002.png"  # a name
    assert udim_path("<udim>.1001.png", 1002).name == "1002.1001.png"
